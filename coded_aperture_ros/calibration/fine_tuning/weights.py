"""The refinement network from the arrays of a weights' file, and back."""

from collections.abc import Mapping
from typing import Any

import torch

from coded_aperture_ros.calibration.fine_tuning.network import BINS, Refinement
from coded_aperture_ros.calibration.fine_tuning.onnx_form import (
    Arrays,
    load_folded,
    onnx_weights,
    to_onnx,
)
from coded_aperture_ros.depth.decoders.network.features import COST_CHANNELS, FRAME_CELL_PX, SCALARS

# Sizes that are written into the file; OpenCV takes others, too.
_ROWS = 64
_COLUMNS = 84
_LEVELS = 30


def network_arrays(network: Refinement) -> dict[str, Any]:
    """Arrays of the weights' file, of a network whose normalisations are folded."""
    first = network.every_level.layers.first
    of_level = torch.zeros(_LEVELS, first.out_channels, _ROWS // 2, _COLUMNS // 2)
    of_cells = {
        "costs": torch.zeros(1, COST_CHANNELS + SCALARS, _ROWS, _COLUMNS),
        "frame": torch.zeros(1, FRAME_CELL_PX**2, 2 * _ROWS, 2 * _COLUMNS),
        "levels": torch.zeros(1, BINS, _ROWS, _COLUMNS),
    }
    arrays = {
        "levels_onnx": to_onnx(_AfterFirst(network), {"levels": of_level}, "found"),
        "cells_onnx": to_onnx(_Trunk(network), of_cells, "cells"),
        "trust": network.trust.detach().numpy(),
    }
    for name, layer in (("first", first), ("size", network.size), ("choice", network.choice)):
        arrays[f"{name}_weights"] = layer.weight.detach().numpy()[:, :, 0, 0]
        arrays[f"{name}_bias"] = layer.bias.detach().numpy()
    return arrays


def network_of_arrays(arrays: Mapping[str, Any]) -> Refinement:
    """Network of the arrays of a weights' file, in the form in which it can be fitted further."""
    weights: Arrays = {"trust": arrays["trust"]}
    # Of the modules that were written, and where they are in the network.
    for model, prefix, place in (
        ("levels_onnx", "layers.", "every_level.layers."),
        ("cells_onnx", "network.", ""),
    ):
        for name, value in onnx_weights(arrays[model]).items():
            if name.startswith(prefix):
                weights[place + name.removeprefix(prefix)] = value
    layers = {"first": "every_level.layers.first", "size": "size", "choice": "choice"}
    for name, layer in layers.items():
        weights[f"{layer}.weight"] = arrays[f"{name}_weights"][:, :, None, None]
        weights[f"{layer}.bias"] = arrays[f"{name}_bias"]
    network = Refinement()
    load_folded(network, weights)
    return network


class _AfterFirst(torch.nn.Module):
    """What is done to every blur size, but for the first layer."""

    def __init__(self, network: Refinement) -> None:
        super().__init__()
        self.layers = network.every_level.layers

    def forward(self, first: torch.Tensor) -> torch.Tensor:
        found: torch.Tensor = self.layers.after_first(first)
        return found


class _Trunk(torch.nn.Module):
    """All but the last layer."""

    def __init__(self, network: Refinement) -> None:
        super().__init__()
        self.network = network

    def forward(
        self, costs: torch.Tensor, frame: torch.Tensor, levels: torch.Tensor
    ) -> torch.Tensor:
        return self.network.trunk(costs, frame, levels)
