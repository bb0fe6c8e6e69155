"""Write the fitted network in the form that the package runs.

python training/blend_export.py --state DIR/state.pt -o coded_aperture_ros/deblur/blend/blend.npz
"""

import argparse
import hashlib
from pathlib import Path

import torch
from blend_network import PIXELS, Blend
from export import rounded, written

from coded_aperture_ros.core.archive import write_archive
from coded_aperture_ros.deblur.blend.blend import SCHEMA, SCHEMA_VERSION
from coded_aperture_ros.deblur.blend.features import MAPS
from coded_aperture_ros.deblur.blend.hypotheses import HYPOTHESES

# OpenCV takes other sizes, too.
_ROWS, _COLUMNS = 120, 160


def _fold(network: Blend) -> None:
    """Put batch normalisation, and what a layer is added to, into the weights."""
    for name in ("fine", "down", "both"):
        setattr(network, name, _folded(getattr(network, name), name != "down"))
    network.coarse = torch.nn.ModuleList(_folded(layer, True) for layer in network.coarse)


def _folded(layer: torch.nn.Sequential, added: bool) -> torch.nn.Conv2d:
    folded = torch.nn.utils.fusion.fuse_conv_bn_eval(*layer)
    if added:
        middle = range(folded.out_channels)
        folded.weight.data[middle, middle, 1, 1] += 1
    return folded


class _Plain(torch.nn.Module):
    """The network when it is folded."""

    def __init__(self, network: Blend) -> None:
        super().__init__()
        _fold(network)
        self.network = network

    def forward(self, shown: torch.Tensor) -> torch.Tensor:
        network = self.network
        fine = torch.relu(network.fine(torch.relu(network.first(shown))))
        coarse = torch.relu(network.down(fine))
        for layer in network.coarse:
            coarse = torch.relu(layer(coarse))
        up = torch.nn.functional.interpolate(network.up(coarse), scale_factor=2)
        return network.last(torch.relu(network.both(torch.relu(fine + up))))


def main() -> None:
    """Write the network, and print its size and checksum."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--state", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    state = torch.load(args.state)["average"]
    network = Blend()
    network.load_state_dict(state)
    folded = _Plain(network.eval())
    for parameter in folded.parameters():
        parameter.data = rounded(parameter.data)
    shown = torch.zeros(1, HYPOTHESES * PIXELS + MAPS, _ROWS, _COLUMNS)
    write_archive(
        args.output,
        SCHEMA,
        SCHEMA_VERSION,
        {"blend_onnx": written(folded, (shown,), ["shown"], "told")},
    )
    packed = args.output.read_bytes()
    count = sum(parameter.numel() for parameter in folded.parameters())
    print(f"{count} weights, {len(packed)} bytes, sha256 {hashlib.sha256(packed).hexdigest()}")


if __name__ == "__main__":
    main()
