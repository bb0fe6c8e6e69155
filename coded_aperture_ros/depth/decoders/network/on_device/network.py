"""Refinement network on a device; see `Network`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from coded_aperture_ros.core.arrays import BoolArray
from coded_aperture_ros.core.tensors.networks import TorchNetwork
from coded_aperture_ros.depth.decoders.network.features import BLUR_SIZES_PX, COST_CHANNELS
from coded_aperture_ros.depth.decoders.network.network import FirstLayer, Logits


class DeviceNetwork:
    """Logits of the half-cells' blur sizes from costs and frame.

    Parameters
    ----------
    arrays : mapping
        Of a weights' file.
    tried : ndarray, bool [blur sizes]
        Which of `BLUR_SIZES_PX`, neighbours of each other, have costs.
    device : str
        PyTorch's name of the device.
    """

    def __init__(self, arrays: Mapping[str, Any], tried: BoolArray, device: str) -> None:
        first, last = np.flatnonzero(tried)[[0, -1]]
        self._tried = slice(int(first), int(last) + 1)

        def constant(values: Any) -> torch.Tensor:
            return torch.tensor(np.ascontiguousarray(values), device=device)

        self._levels, self._cells = (
            TorchNetwork(arrays, name, device) for name in ("levels", "cells")
        )
        rows = np.repeat(np.append(tried, True), 4)
        self._weights = constant(arrays["size_weights"][rows])[..., None, None]
        self._bias = constant(arrays["size_bias"][rows])
        self._trust = constant(np.asarray(arrays["trust"], np.float32))
        layer = FirstLayer.from_weights(arrays, self._tried)
        self._channels = constant(layer.channels)
        self._of_costs = constant(layer.weights)[..., None, None]
        self._of_scalars = constant(layer.scalars)[..., None, None]
        self._added = constant(layer.added)[..., None]

    def __call__(self, costs: torch.Tensor, frame: torch.Tensor) -> Logits:
        """Logits of the half-cells, from `cost_features` and `frame_features`."""
        of_level = self._levels({"levels": self._first(costs)})
        levels = costs.new_zeros(1, len(BLUR_SIZES_PX), *costs.shape[1:])
        levels[0, self._tried] = functional.pixel_shuffle(of_level[:, -4:], 2)[:, 0]
        cells = self._cells({"costs": costs[None], "frame": frame[None], "levels": levels})
        outputs = functional.conv2d(cells, self._weights, self._bias)
        outputs = functional.pixel_shuffle(outputs, 2)[0]
        # What the four cells of every square add, in their order and then in that of half-cells.
        count = len(of_level)
        of_squares = functional.pixel_shuffle(of_level[:, :16], 2)
        size = outputs[:count] + functional.pixel_shuffle(of_squares, 2)[:, 0]
        size = size - self._cost_logits(costs)
        return Logits(size, outputs[count], cells[0])

    def _first(self, costs: torch.Tensor) -> torch.Tensor:
        """First layer for every blur size, on squares of 2 x 2 cells; see `FirstLayer`."""
        squares = functional.pixel_unshuffle(costs, 2).unflatten(0, (-1, 4))
        shown = squares[self._channels].flatten(1, 2)
        scalars = squares[COST_CHANNELS:].flatten(0, 1)[None]
        found = functional.conv2d(shown, self._of_costs)
        return found + functional.conv2d(scalars, self._of_scalars) + self._added

    def _cost_logits(self, costs: torch.Tensor) -> torch.Tensor:
        """Negative logits by the costs alone, to which the network adds, of half-cells."""
        of_kinds = costs[:COST_CHANNELS].unflatten(0, (len(self._trust), -1))[:, self._tried]
        logits = torch.tensordot(self._trust, of_kinds, 1)
        return functional.interpolate(logits[None], scale_factor=2, mode="bilinear")[0]
