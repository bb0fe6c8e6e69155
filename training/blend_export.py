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


def main() -> None:
    """Write the network, and print its size and checksum."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--state", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    network = Blend()
    network.load_state_dict(torch.load(args.state)["average"])
    folded = _Folded(network.eval())
    for parameter in folded.parameters():
        parameter.data = rounded(parameter.data)
    shown = torch.zeros(1, HYPOTHESES * PIXELS + MAPS, _ROWS, _COLUMNS)
    arrays = {"blend_onnx": written(folded, (shown,), ["shown"], "told")}
    write_archive(args.output, SCHEMA, SCHEMA_VERSION, arrays)
    packed = args.output.read_bytes()
    count = sum(parameter.numel() for parameter in folded.parameters())
    print(f"{count} weights, {len(packed)} bytes, sha256 {hashlib.sha256(packed).hexdigest()}")


class _Folded(torch.nn.Module):
    """The network without batch normalisation, and with fewer additions."""

    def __init__(self, network: Blend) -> None:
        super().__init__()
        self.first, self.up, self.last = network.first, network.up, network.last
        self.fine, self.both = _with_input(network.fine), _with_input(network.both)
        self.down = _fused(network.down)
        self.coarse = torch.nn.ModuleList(_with_input(layer) for layer in network.coarse)

    def forward(self, shown: torch.Tensor) -> torch.Tensor:
        fine = torch.relu(self.fine(torch.relu(self.first(shown))))
        coarse = torch.relu(self.down(fine))
        for layer in self.coarse:
            coarse = torch.relu(layer(coarse))
        up = torch.nn.functional.interpolate(self.up(coarse), scale_factor=2)
        return self.last(torch.relu(self.both(torch.relu(fine + up))))


def _fused(layer: torch.nn.Sequential) -> torch.nn.Conv2d:
    return torch.nn.utils.fusion.fuse_conv_bn_eval(*layer)


def _with_input(layer: torch.nn.Sequential) -> torch.nn.Conv2d:
    """Return a convolution that gives the layer's input and output together."""
    fused = _fused(layer)
    middle = range(fused.out_channels)
    fused.weight.data[middle, middle, 1, 1] += 1
    return fused


if __name__ == "__main__":
    main()
