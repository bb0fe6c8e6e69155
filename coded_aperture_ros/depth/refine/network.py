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
from coded_aperture_ros.depth.refine.features import BLUR_SIZES_PX, COST_CHANNELS, KINDS, SCALARS
from coded_aperture_ros.depth.refine.layout import at_half_cells, in_squares, subtract_enlarged

WEIGHTS = "refinement.npz"
# Neighbours around a half-cell, with itself, that a quarter of it may belong to.
NEIGHBOURS = 9
# Channels of each blur size at a cell: the logits of its half-cells, and one more.
PER_LEVEL = 5
SCHEMA, SCHEMA_VERSION = "coded-aperture refinement network", 3


@dataclasses.dataclass(frozen=True, eq=False)
class Logits:
    """What the network says of every half-cell; float32."""

    size: FloatArray  # [tried, rows, columns]; logits of the blur sizes that were tried
    # [rows, columns]; logarithm of the mean error in px, if the likeliest blur size is about right.
    log_width: FloatArray
    # [4, rows, columns]; for each quarter of a half-cell, which of the nine half-cells around has
    # its blur size; row by row, 4 is itself.
    neighbour: IndexArray


class Network:
    """Costs and frame in, logits out; see `training/network.py` for its layers.

    OpenCV runs all but the first layer of the blur sizes (see `_First`) and the last layer, of
    which only the rows are computed that are needed.

    Not for several threads at once. `tried` [blur sizes] says which of `BLUR_SIZES_PX`, neighbours
    of each other, there are costs of. Raises `InputError` if OpenCV cannot run the network.
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
        self._first = _First.of(arrays, self._tried)

    def __call__(self, costs: FloatArray, frame: FloatArray) -> Logits:
        """Return the logits of half-cells, from `cost_features` and `frame_features`."""
        tried, shape = self._tried, costs.shape[1:]
        self._of_level.setInput(self._first(costs), "levels")
        # Logits of the four half-cells of every cell, and one more channel for the other network.
        of_level = self._of_level.forward("found")
        count = len(of_level)
        of_level = at_half_cells(of_level.reshape(-1, *of_level.shape[2:]))
        of_level = of_level.reshape(count, PER_LEVEL, *shape)
        levels = np.zeros((1, len(BLUR_SIZES_PX), *shape), np.float32)
        levels[0, tried] = of_level[:, 4]
        for values, name in ((costs[None], "costs"), (frame[None], "frame"), (levels, "levels")):
            self._of_cells.setInput(values, name)
        cells = self._of_cells.forward("cells")[0]
        found = self._weights @ cells.reshape(len(cells), -1)
        found += self._bias[:, None]
        found = found.reshape(-1, *shape)
        found[: 4 * count] += of_level[:, :4].reshape(4 * count, *shape)
        choice = _likeliest(found[4 * (count + 1) :].reshape(4, NEIGHBOURS, 4, *shape))
        found = at_half_cells(found[: 4 * (count + 1)])
        size = found[:count]
        # What the costs say by themselves, to which the network adds.
        of_kinds = costs[:COST_CHANNELS].reshape(len(self._trust), -1, *shape)
        own = np.tensordot(self._trust, of_kinds[:, tried], 1)
        subtract_enlarged(own, size)
        return Logits(size, found[count], at_half_cells(choice.reshape(-1, *shape)))


@dataclasses.dataclass(frozen=True, eq=False)
class _First:
    """The first layer of what is done to every blur size, in squares of 2 x 2 cells.

    Weights of the costs of the blur size itself [out, 4 kinds], of those of its lower and upper
    neighbour together [2 out, 4 looks], and of the rest [out, 4 scalars]; and what is added to
    every blur size [tried, out, 1].
    """

    tried: slice
    itself: FloatArray
    beside: FloatArray
    scalars: FloatArray
    added: FloatArray

    @classmethod
    def of(cls, arrays: dict[str, FloatArray], tried: slice) -> "_First":
        weights = arrays["first_weights"]
        kinds = COST_CHANNELS // len(BLUR_SIZES_PX)
        looks = kinds // KINDS
        itself, lower, upper, scalars, size = np.split(
            weights, 4 * np.cumsum([kinds, looks, looks, SCALARS]), axis=1
        )
        of_size = BLUR_SIZES_PX[tried, None] / 10 * size.sum(axis=1) + arrays["first_bias"]
        beside = np.concatenate([lower, upper])
        return cls(tried, *map(_contiguous, (itself, beside, scalars, of_size[..., None])))

    def __call__(self, costs: FloatArray) -> FloatArray:
        """Return the layer [tried, out, square rows, square columns] of `cost_features`."""
        tried, last = self.tried, len(BLUR_SIZES_PX) - 1
        volume = costs[:COST_CHANNELS].reshape(-1, last + 1, *costs.shape[1:])
        squares = in_squares(volume[:, tried])
        found = self.itself @ squares
        beside = volume[::KINDS, np.clip(np.arange(tried.start - 1, tried.stop + 1), 0, last)]
        of_beside = self.beside @ in_squares(beside)
        out = len(self.itself)
        found += of_beside[:-2, :out]
        found += of_beside[2:, out:]
        found += self.scalars @ in_squares(costs[COST_CHANNELS:, None])[0] + self.added
        return found.reshape(*found.shape[:2], costs.shape[1] // 2, -1)


def _contiguous(values: NDArray[Any]) -> FloatArray:
    return np.ascontiguousarray(values, np.float32)


def _likeliest(logits: FloatArray) -> NDArray[np.uint8]:
    """Return which along the second axis is the largest; `argmax` takes four times as long."""
    best = logits[:, 0].copy()
    which = np.zeros(best.shape, np.uint8)
    for index in range(1, logits.shape[1]):
        better = logits[:, index] > best
        np.putmask(which, better, index)
        np.maximum(best, logits[:, index], out=best)
    return which


@lru_cache(maxsize=1)
def _arrays() -> dict[str, FloatArray]:
    with as_file(files(__package__) / WEIGHTS) as path:
        return read_archive(path, SCHEMA, SCHEMA_VERSION)
