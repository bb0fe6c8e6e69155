"""Write the fitted network in the form that the package runs.

    python training/export.py --state DIR/state.pt -o refinement.npz
    python training/export.py --state DIR/state.pt -o refinement.npz --shipped OLD.npz

With --shipped, its weights and those that were fitted further from it are averaged.
"""

import argparse
import hashlib
import io
from pathlib import Path
from typing import Any

import numpy as np
import torch
from network import BINS, Refinement
from shipped import shipped

from coded_aperture_ros.core.archive import write_archive
from coded_aperture_ros.depth.decoders.network.features import COST_CHANNELS, FRAME_CELL_PX, SCALARS
from coded_aperture_ros.depth.decoders.network.network import SCHEMA, SCHEMA_VERSION

# Of a single-precision number; what is left out is below what half precision keeps.
_DROPPED_BITS = 12
# OpenCV takes other sizes, too.
_ROWS, _COLUMNS = 64, 84
_LEVELS = 30
# Of the weights that ship, in an average with those that were fitted further from them.
_OF_SHIPPED = 0.3


def rounded(weights: torch.Tensor) -> torch.Tensor:
    """Return weights with 11 significant bits, so that the file packs well."""
    bits = weights.contiguous().view(torch.int32)
    half = 1 << (_DROPPED_BITS - 1)
    return ((bits + half) >> _DROPPED_BITS << _DROPPED_BITS).view(torch.float32)


def written(
    module: torch.nn.Module, inputs: tuple[torch.Tensor, ...], names: list[str], output: str
) -> np.ndarray:
    """Return a module in the form that OpenCV reads."""
    file = io.BytesIO()
    torch.onnx.export(
        module,
        inputs,
        file,
        input_names=names,
        output_names=[output],
        dynamo=False,
        opset_version=11,
    )
    return np.frombuffer(file.getvalue(), np.uint8)


def main() -> None:
    """Write the network, and print its size and checksum."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--state", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--shipped", type=Path)
    args = parser.parse_args()
    network = Refinement()
    network.load_state_dict(torch.load(args.state)["average"])
    _fold(network)
    if args.shipped:
        old = shipped(args.shipped)
        _fold(old)
        for parameter, other in zip(network.parameters(), old.parameters(), strict=True):
            parameter.data.lerp_(other.data, _OF_SHIPPED)
    for parameter in network.parameters():
        parameter.data = rounded(parameter.data)
    costs = torch.zeros(1, COST_CHANNELS + SCALARS, _ROWS, _COLUMNS)
    frame = torch.zeros(1, FRAME_CELL_PX**2, 2 * _ROWS, 2 * _COLUMNS)
    levels = torch.zeros(1, BINS, _ROWS, _COLUMNS)
    first = network.every_level.layers.first
    of_level = torch.zeros(_LEVELS, first.out_channels, _ROWS // 2, _COLUMNS // 2)
    arrays: dict[str, Any] = {
        "levels_onnx": written(_AfterFirst(network), (of_level,), ["levels"], "found"),
        "first_weights": first.weight.detach().numpy()[:, :, 0, 0],
        "first_bias": first.bias.detach().numpy(),
        "cells_onnx": written(
            _Trunk(network), (costs, frame, levels), ["costs", "frame", "levels"], "cells"
        ),
    }
    for name, layer in (("size", network.size), ("choice", network.choice)):
        arrays[f"{name}_weights"] = layer.weight.detach().numpy()[:, :, 0, 0]
        arrays[f"{name}_bias"] = layer.bias.detach().numpy()
    arrays["trust"] = network.trust.detach().numpy()
    write_archive(args.output, SCHEMA, SCHEMA_VERSION, arrays)
    packed = args.output.read_bytes()
    count = sum(parameter.numel() for parameter in network.parameters())
    print(f"{count} weights, {len(packed)} bytes, sha256 {hashlib.sha256(packed).hexdigest()}")


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


def _fold(network: torch.nn.Module) -> None:
    """Fold batch normalisations into the convolutions before them."""
    network.eval()
    for module in list(network.modules()):
        names = dict(module.named_children())
        for first, second in (("0", "1"), ("spatial", "norm")):
            convolution, norm = names.get(first), names.get(second)
            if isinstance(convolution, torch.nn.Conv2d) and isinstance(norm, torch.nn.BatchNorm2d):
                fused = torch.nn.utils.fusion.fuse_conv_bn_eval(convolution, norm)
                setattr(module, first, fused)
                setattr(module, second, torch.nn.Identity())


if __name__ == "__main__":
    main()
