"""Runs the network that ships with the package."""

import dataclasses
from functools import lru_cache
from importlib.resources import as_file, files
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.archive import read_archive
from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.refine.features import BLUR_SIZES_PX, COST_CHANNELS, KINDS

WEIGHTS = "refinement.npz"
# Neighbours around a half-cell, with itself, that a quarter of it may belong to.
NEIGHBOURS = 9
SCHEMA, SCHEMA_VERSION = "coded-aperture refinement network", 2


@dataclasses.dataclass(frozen=True, eq=False)
class Logits:
    """What the network says of every half-cell; float32.

    Attributes
    ----------
    size : ndarray [tried, rows, columns]
        Logits of the blur sizes that were tried.
    log_width : ndarray [rows, columns]
        Logarithm of the mean error in px, if the likeliest blur size is about right.
    neighbour : ndarray of int [4, rows, columns]
        For each quarter of a half-cell, which of the nine half-cells around has its blur size; row
        by row, 4 is itself.
    """

    size: FloatArray
    log_width: FloatArray
    neighbour: IndexArray


class Network:
    """Costs and frame in, logits out; see `training/network.py` for its layers.

    OpenCV runs all but the last layer, of which only the rows are computed that are needed.

    Not for several threads at once.

    Parameters
    ----------
    tried : ndarray, bool [blur sizes]
        Which of `BLUR_SIZES_PX` there are costs of; neighbours of each other.

    Raises
    ------
    InputError
        If OpenCV cannot run the network.
    """

    def __init__(self, tried: BoolArray) -> None:
        arrays = _arrays()
        try:
            self._of_level, self._of_cells = (
                cv2.dnn.readNetFromONNX(arrays[f"{name}_onnx"]) for name in ("levels", "cells")
            )
        except cv2.error as error:
            raise InputError(
                f"regularize: OpenCV {cv2.__version__} cannot run the network of learned: "
                "use semiglobal, or OpenCV 4.6 or newer"
            ) from error
        # The last of the blur sizes' rows is the width; each is four, one of every half-cell.
        rows = np.repeat(np.append(tried, True), 4)
        self._weights, self._bias = (
            np.concatenate([arrays[f"size_{name}"][rows], arrays[f"choice_{name}"]])
            for name in ("weights", "bias")
        )
        first, last = np.flatnonzero(tried)[[0, -1]]
        self._tried = slice(int(first), int(last) + 1)
        self._trust = arrays["trust"]

    def __call__(self, costs: FloatArray, frame: FloatArray) -> Logits:
        """Return the logits of half-cells, from `cost_features` and `frame_features`."""
        tried = self._tried
        self._of_level.setInput(self._levels(costs), "levels")
        # Logits of the four half-cells of every cell, and one more channel for the other network.
        of_level = self._of_level.forward("found")
        count, shape = len(of_level), costs.shape[1:]
        levels = np.zeros((1, len(BLUR_SIZES_PX), *shape), np.float32)
        levels[0, tried] = of_level[:, 4]
        for values, name in ((costs[None], "costs"), (frame[None], "frame"), (levels, "levels")):
            self._of_cells.setInput(values, name)
        cells = self._of_cells.forward("cells")[0]
        found = self._weights @ cells.reshape(len(cells), -1)
        found += self._bias[:, None]
        found = found.reshape(-1, *shape)
        found[: 4 * count] += of_level[:, :4].reshape(4 * count, *shape)
        choice = found[4 * (count + 1) :].reshape(4, NEIGHBOURS, 4, *shape).argmax(axis=1)
        found = _at_half_cells(found[: 4 * (count + 1)])
        size = found[:count]
        # What the costs say by themselves, to which the network adds.
        of_kinds = costs[:COST_CHANNELS].reshape(len(self._trust), -1, *shape)
        own = np.tensordot(self._trust, of_kinds[:, tried], 1)
        for of_size, cost in zip(size, own, strict=True):
            of_size -= cv2.resize(cost, of_size.shape[::-1], interpolation=cv2.INTER_LINEAR)
        return Logits(size, found[count], _at_half_cells(choice.reshape(-1, *shape)))

    def _levels(self, costs: FloatArray) -> FloatArray:
        """Return what each blur size is looked at by [tried, channels, rows, columns]."""
        tried, last = self._tried, len(BLUR_SIZES_PX) - 1
        volume = costs[:COST_CHANNELS].reshape(-1, last + 1, *costs.shape[1:])
        beside = volume[::KINDS]  # of neighbouring sizes, the logarithms
        index = np.arange(tried.start, tried.stop)
        lower, upper = (beside[:, np.clip(index + step, 0, last)] for step in (-1, 1))
        size = (BLUR_SIZES_PX[None, tried, None, None] / 10).astype(np.float32)
        parts: list[FloatArray] = [
            volume[:, tried],
            lower,
            upper,
            costs[COST_CHANNELS:, None],
            size,
        ]
        levels = np.empty(
            (len(index), sum(len(part) for part in parts), *costs.shape[1:]), np.float32
        )
        start = 0
        for part in parts:
            levels[:, start : start + len(part)] = part.swapaxes(0, 1)
            start += len(part)
        return levels


def _at_half_cells(of_cells: NDArray[Any]) -> NDArray[Any]:
    """Put groups of four channels side by side: [4 n, rows, columns] to [n, 2 rows, 2 columns]."""
    count, rows, columns = of_cells.shape
    whole = np.empty((count // 4, 2 * rows, 2 * columns), of_cells.dtype)
    for quarter in range(4):
        whole[:, quarter // 2 :: 2, quarter % 2 :: 2] = of_cells[quarter::4]
    return whole


@lru_cache(maxsize=1)
def _arrays() -> dict[str, FloatArray]:
    with as_file(files(__package__) / WEIGHTS) as path:
        return read_archive(path, SCHEMA, SCHEMA_VERSION)
