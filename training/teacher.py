"""A larger network than the one that ships: it is fitted first, and the other learns from it."""

import torch
from network import PER_LEVEL, Refinement, Widths, convolution
from torch import nn

# Channels of every blur size by itself, of cells and of squares of 16 px.
_LEVEL, _LEVEL_HALF = 16, 32


class CellLayers(nn.Module):
    """What is done to every blur size, always with the same weights, in cells of 8 px."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.first = convolution(inputs, _LEVEL, 3)
        self.down = convolution(_LEVEL, _LEVEL_HALF, 3, 2)
        self.wide = nn.Sequential(*(convolution(_LEVEL_HALF, _LEVEL_HALF, 3) for _ in range(3)))
        self.up = nn.ConvTranspose2d(_LEVEL_HALF, _LEVEL, 2, 2)
        self.join = convolution(2 * _LEVEL, _LEVEL)
        self.out = nn.Conv2d(_LEVEL, PER_LEVEL, 3, 1, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        fine = self.first(x)
        found: torch.Tensor = self.out(
            self.join(torch.cat([fine, self.up(self.wide(self.down(fine)))], 1))
        )
        return found


def teacher() -> Refinement:
    """Return the network, untrained."""
    widths = Widths(
        cell=64, half=96, of_half=40, quarter=112, frame=32, before=(1, 2), after=(1, 2, 1)
    )
    return Refinement(widths, CellLayers)
