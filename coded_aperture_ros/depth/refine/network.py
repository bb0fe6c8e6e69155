"""Runs the network that ships with the package."""

import dataclasses
from functools import lru_cache
from importlib.resources import as_file, files

import cv2
import numpy as np

from coded_aperture_ros.core.archive import read_archive
from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.refine.features import BLUR_SIZES_PX, COST_CHANNELS, KINDS

WEIGHTS = "refinement.npz"
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
    choice : ndarray [4 * 9, rows, columns]
        For each quarter of a half-cell, logits of the half-cells around whose blur size it has.
    """

    size: FloatArray
    log_width: FloatArray
    choice: FloatArray


class Network:
    """Costs and frame in, logits out; see `training/network.py` for its layers.

    OpenCV runs all but the last layer, of which only the rows are computed that are needed.

    Parameters
    ----------
    tried : ndarray, bool [blur sizes]
        Which of `BLUR_SIZES_PX` there are costs of.

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
        self._tried = np.flatnonzero(tried)
        self._trust = arrays["trust"]

    def __call__(self, costs: FloatArray, frame: FloatArray) -> Logits:
        """Return the logits of half-cells, from `cost_features` and `frame_features`."""
        tried, count = self._tried, len(self._tried)
        self._of_level.setInput(self._levels(costs), "levels")
        # Logits of the four half-cells of every cell, and one more channel for the other network.
        of_level = self._of_level.forward("found")
        levels = np.zeros((1, len(BLUR_SIZES_PX), *costs.shape[1:]), np.float32)
        levels[0, tried] = of_level[:, 4]
        for values, name in ((costs[None], "costs"), (frame[None], "frame"), (levels, "levels")):
            self._of_cells.setInput(values, name)
        cells = self._of_cells.forward("cells")[0]
        found = self._weights @ cells.reshape(len(cells), -1)
        found += self._bias[:, None]
        found = found.reshape(-1, *cells.shape[1:])
        found[: 4 * count] += of_level[:, :4].reshape(4 * count, *cells.shape[1:])
        found = _at_half_cells(found)
        size = found[:count]
        # What the costs say by themselves, to which the network adds.
        shape = size.shape[2], size.shape[1]
        of_kinds = costs[:COST_CHANNELS].reshape(len(self._trust), -1, *costs.shape[1:])
        own = np.tensordot(self._trust, of_kinds[:, tried], 1)
        for of_size, cost in zip(size, own, strict=True):
            of_size -= cv2.resize(cost, shape, interpolation=cv2.INTER_LINEAR)
        return Logits(size, found[count], found[count + 1 :])

    def _levels(self, costs: FloatArray) -> FloatArray:
        """Return what each blur size is looked at by [tried, channels, rows, columns]."""
        tried, last = self._tried, len(BLUR_SIZES_PX) - 1
        volume = costs[:COST_CHANNELS].reshape(-1, last + 1, *costs.shape[1:])
        beside = volume[::KINDS]  # of neighbouring sizes, the logarithms
        lower, upper = (beside[:, np.clip(tried + step, 0, last)] for step in (-1, 1))
        size = (BLUR_SIZES_PX[None, tried, None, None] / 10).astype(np.float32)
        parts: list[FloatArray] = [
            volume[:, tried],
            lower,
            upper,
            costs[COST_CHANNELS:, None],
            size,
        ]
        levels = np.empty(
            (len(tried), sum(len(part) for part in parts), *costs.shape[1:]), np.float32
        )
        start = 0
        for part in parts:
            levels[:, start : start + len(part)] = part.swapaxes(0, 1)
            start += len(part)
        return levels


def _at_half_cells(of_cells: FloatArray) -> FloatArray:
    """Put groups of four channels side by side: [4 n, rows, columns] to [n, 2 rows, 2 columns]."""
    count, rows, columns = of_cells.shape
    quarters = of_cells.reshape(count // 4, 2, 2, rows, columns).transpose(0, 3, 1, 4, 2)
    return np.ascontiguousarray(quarters).reshape(count // 4, 2 * rows, 2 * columns)


@lru_cache(maxsize=1)
def _arrays() -> dict[str, FloatArray]:
    with as_file(files(__package__) / WEIGHTS) as path:
        return read_archive(path, SCHEMA, SCHEMA_VERSION)
