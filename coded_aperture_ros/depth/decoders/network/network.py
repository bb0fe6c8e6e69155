"""Refinement network: inference with the weights that ship with the package."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.arrays import (
    BoolArray,
    FloatArray,
    IndexArray,
    as_floats,
    constant,
    namespace,
    zeros,
)
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.networks import network_of
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network import array_forms
from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_SIZES_PX,
    COST_CHANNELS,
    KINDS,
    SCALARS,
)


def _put_loop(cells: FloatArray, channels: IndexArray, squares: FloatArray) -> None:
    count, _, rows, columns = squares.shape
    for n in range(count):
        channel = channels[n]
        for i in range(rows):
            for down in range(2):
                for j in range(columns):  # both at once: they lie side by side
                    squares[n, 2 * down, i, j] = cells[channel, 2 * i + down, 2 * j]
                    squares[n, 2 * down + 1, i, j] = cells[channel, 2 * i + down, 2 * j + 1]


# Puts some channels [n] of cells [channels, rows, columns], those of 2 x 2 cells side by side, into
# squares [n, 4, rows / 2, columns / 2].
gather_squares = Compiled(_put_loop, array_forms.put_in_squares)


def to_half_cells(of_cells: NDArray[Any]) -> NDArray[Any]:
    """Half-cells [n, 2 rows, 2 columns] from the channels of cells [4 n, rows, columns]."""
    count, rows, columns = of_cells.shape
    whole = zeros((count // 4, 2 * rows, 2 * columns), of_cells)
    for quarter in range(4):
        whole[:, quarter // 2 :: 2, quarter % 2 :: 2] = of_cells[quarter::4]
    return whole


def _add_up_loop(
    cells: FloatArray, squares: FloatArray, costs: FloatArray, first: int, size: FloatArray
) -> None:
    count, rows, columns = costs.shape
    line, far, near = np.empty(columns + 2, np.float32), np.float32(0.25), np.float32(0.75)
    for b in range(count):
        for y in range(2 * first, 2 * (first + cells.shape[1])):
            i, down = y // 2, y % 2
            beside = min(max(i + 2 * down - 1, 0), rows - 1)
            for j in range(columns):
                line[1 + j] = near * costs[b, i, j] + far * costs[b, beside, j]
            line[0], line[columns + 1] = line[1], line[columns]
            left, right = cells[4 * b + 2 * down, i - first], cells[4 * b + 2 * down + 1, i - first]
            of_left, of_right, s = 8 * down + 2 * (i % 2), 8 * down + 2 * (i % 2) + 4, i // 2
            for c in range(columns // 2):
                j, x = 2 * c, 4 * c
                before, here, then, after = line[j], line[j + 1], line[j + 2], line[j + 3]
                less, more = near * here + far * before, near * here + far * then
                size[b, y, x] = left[j] + squares[b, of_left, s, c] - less
                size[b, y, x + 1] = right[j] + squares[b, of_right, s, c] - more
                less, more = near * then + far * here, near * then + far * after
                size[b, y, x + 2] = left[j + 1] + squares[b, of_left + 1, s, c] - less
                size[b, y, x + 3] = right[j + 1] + squares[b, of_right + 1, s, c] - more


# Writes logits of the half-cells [>= n, 2 rows, 2 columns] of some rows of cells, from an even one
# on: what there is of them [>= 4 n, some rows, columns] and of all squares [n, >= 16, rows / 2,
# columns / 2], less the costs of all cells [n, rows, columns], linear between their middles.
add_up = Compiled(_add_up_loop, array_forms.add_up_rows)


WEIGHTS = "refinement.npz"
# The first and last layer are run for so many blur sizes, or rows of cells, at a time: few large
# calls, but not much more than a core's cache holds.
_SIZES = 4
_ROWS = 16
SCHEMA = "coded-aperture refinement network"
SCHEMA_VERSION = 3


def refinement_weights(own: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Arrays of the weights' file that ships, or those of a bank that has its own."""
    return own or read_shipped(__file__, WEIGHTS, SCHEMA, SCHEMA_VERSION)


@dataclasses.dataclass(frozen=True, eq=False)
class Logits:
    """Output of the network for every half-cell; float32."""

    size: FloatArray  # [tried, rows, columns]; logits of the blur sizes that were tried
    # [rows, columns]; logarithm of the mean error in px, if the likeliest blur size is about right.
    log_width: FloatArray
    cells: FloatArray  # [channels, rows, columns]; input of the last layer, of every cell


class Network:
    """Refinement network: logits of the half-cells' blur sizes from costs and frame.

    A runtime runs all but the first layer of the blur sizes (see `FirstLayer`) and the last layer,
    of which only the rows are computed that are needed. Not for several threads at once.

    Parameters
    ----------
    tried : ndarray, bool [blur sizes]
        Which of `BLUR_SIZES_PX`, neighbours of each other, have costs.
    workers : Workers
        Threads that share the work.
    runtime : str
        See `network_of`.
    own : mapping, optional
        Arrays of a weights' file in place of the one that ships.
    """

    def __init__(
        self,
        tried: BoolArray,
        workers: Workers,
        runtime: str = "auto",
        own: Mapping[str, Any] | None = None,
    ) -> None:
        arrays = refinement_weights(own)
        self._workers = workers
        self.level_network, self.cell_network = (
            network_of(arrays, name, runtime, workers.threads) for name in ("levels", "cells")
        )
        # The last of the blur sizes' rows is the width; each is four, one of every half-cell.
        rows = np.repeat(np.append(tried, True), 4)
        self._weights, self._bias = (arrays[f"size_{name}"][rows] for name in ("weights", "bias"))
        first, last = np.flatnonzero(tried)[[0, -1]]
        self._tried = slice(int(first), int(last) + 1)
        self._trust = as_floats(arrays["trust"])
        self.calibration = Calibration.from_weights(arrays)
        self.checked = Calibration.of_check(arrays)
        self._first = FirstLayer.from_weights(arrays, self._tried)

    def __call__(self, costs: FloatArray, frame: FloatArray) -> Logits:
        """Logits of the half-cells, from `cost_features` and `frame_features`."""
        tried, shape = self._tried, costs.shape[1:]
        # Logits of the half-cells of all squares, and one more channel for the other part.
        of_level = self.level_network({"levels": self._first(costs, self._workers)})
        levels = np.zeros((1, len(BLUR_SIZES_PX), *shape), np.float32)
        levels[0, tried] = to_half_cells(of_level[:, -4:].reshape(-1, *of_level.shape[2:]))
        cells = self.cell_network({"costs": costs[None], "frame": frame[None], "levels": levels})[0]
        # Logits by the costs alone, to which the network adds.
        of_kinds = costs[:COST_CHANNELS].reshape(len(self._trust), -1, *shape)[:, tried]
        cost_logits = (self._trust @ of_kinds.reshape(len(of_kinds), -1)).reshape(-1, *shape)
        count = len(of_level)
        size = np.empty((count + 1, 2 * shape[0], 2 * shape[1]), np.float32)

        def last_layer(first: int, _: int) -> None:
            some = cells[:, first : first + _ROWS]
            outputs = self._weights @ some.reshape(len(some), -1)
            outputs += self._bias[:, None]
            outputs = outputs.reshape(-1, *some.shape[1:])
            add_up(outputs, of_level, cost_logits, first, size)
            size[count:, 2 * first : 2 * (first + _ROWS)] = to_half_cells(outputs[-4:])

        self._workers.each(last_layer, range(0, shape[0], _ROWS))
        return Logits(size[:count], size[count], cells)


@dataclasses.dataclass(frozen=True, eq=False)
class FirstLayer:
    """First layer of the network for every blur size, on squares of 2 x 2 cells."""

    channels: IndexArray  # [tried, n]; of the costs of each blur size, and of its two neighbours
    weights: FloatArray  # [out, 4 n]; of these
    scalars: FloatArray  # [out, 4 scalars]; weights of the rest
    added: FloatArray  # [tried, out, 1]; what is added to every blur size

    @classmethod
    def from_weights(cls, arrays: Mapping[str, Any], tried: slice) -> "FirstLayer":
        """Layer of the tried blur sizes, from the arrays of a weights' file."""
        weights, count = arrays["first_weights"], len(BLUR_SIZES_PX)
        weights, scalars, size = np.split(weights, -4 * np.array([SCALARS + 1, 1]), axis=1)
        of_size = BLUR_SIZES_PX[tried, None] / 10 * size.sum(axis=1) + arrays["first_bias"]
        sizes, of_kinds = np.arange(count)[tried], np.arange(COST_CHANNELS).reshape(-1, count)
        beside = (of_kinds[::KINDS, np.clip(sizes + step, 0, count - 1)] for step in (-1, 1))
        channels = np.concatenate([of_kinds[:, sizes], *beside]).T
        return cls(channels, *map(as_floats, (weights, scalars, of_size[..., None])))

    def __call__(self, costs: FloatArray, workers: Workers) -> FloatArray:
        """Output of the layer [tried, out, square rows, square columns] for `cost_features`."""
        rows, columns = costs.shape[1] // 2, costs.shape[2] // 2
        of_scalars = np.empty((SCALARS, 4, rows, columns), np.float32)
        gather_squares(costs, np.arange(COST_CHANNELS, len(costs)), of_scalars)
        rest = self.scalars @ of_scalars.reshape(4 * SCALARS, -1)
        outputs = np.empty((len(self.channels), *rest.shape), np.float32)

        def add_sizes(first: int, _: int) -> None:
            some = slice(first, first + _SIZES)
            channels, layer = self.channels[some], outputs[some]
            squares = np.empty((channels.size, 4, rows, columns), np.float32)
            gather_squares(costs, channels.ravel(), squares)
            np.matmul(self.weights, squares.reshape(len(layer), -1, rows * columns), out=layer)
            layer += rest
            layer += self.added[some]

        workers.each(add_sizes, range(0, len(outputs), _SIZES))
        return outputs.reshape(*outputs.shape[:2], rows, columns)


# Least distance of probabilities from 0 and 1: the logarithm must be finite.
_SURE = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration of confidence and standard deviation: a small network, and a factor.

    They are in the weights' file, into which `training/train.py refinement calibrate` writes them,
    fitted on random scenes and photographs with measured disparity that were kept apart: by itself
    the refinement is underconfident on large smooth surfaces and for wide blur, and overconfident
    between surfaces and where the error may be many pixels.

    Attributes
    ----------
    layers : tuple of ndarray, float32 [out, in + 1]
        Weights and, last, biases, from `HalfCells.confidence_features` to the logarithm of the odds
        that a depth is right; negative outputs of all but the last layer become 0.
    deviation : float32
        Factor of the standard deviation of the refinement's blur sizes.
    """

    layers: tuple[FloatArray, ...]
    deviation: np.float32

    @classmethod
    def from_weights(cls, arrays: Mapping[str, NDArray[Any]]) -> "Calibration":
        """Calibration in a weights' file (`confidence0`, ..., `deviation`).

        Weights that are about to be calibrated have none: their probabilities stay as they are.
        """
        layers = (as_floats(arrays[name]) for name in sorted(arrays) if "confidence" in name)
        return cls(tuple(layers), np.float32(arrays.get("deviation", 1)))

    @classmethod
    def of_check(cls, arrays: Mapping[str, NDArray[Any]]) -> "Calibration":
        """Simpler calibration that the check of fit has learned with."""
        return cls((as_floats(arrays.get("checked", np.eye(1, 4))),), np.float32(1))

    def confidence(self, features: FloatArray) -> FloatArray:
        """Probability that depths are right, 0 to 1 [...], from features [features, ...]."""
        xp, values = namespace(features), features.reshape(len(features), -1)
        for number, weights in enumerate(self.layers):
            layer = constant(weights, features)
            values = layer[:, :-1] @ (xp.clip(values, 0, None, out=values) if number else values)
            values += layer[:, -1:]
        probability: FloatArray = 1 / (1 + xp.exp(-values[0]))
        return probability.reshape(features.shape[1:])


def log_odds(probability: FloatArray) -> FloatArray:
    """Natural logarithm of the odds of a probability, float32."""
    xp = namespace(probability)
    certain = xp.clip(probability, _SURE, 1 - _SURE)
    odds: FloatArray = xp.log(certain / (1 - certain))
    return odds
