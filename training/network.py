"""The refinement network: costs of a neighbourhood in, probabilities of blur sizes out."""

import torch
from torch import nn
from torch.nn import functional

from coded_aperture_ros.depth.refine.features import (
    BLUR_SIZES_PX,
    COST_CHANNELS,
    FRAME_CELL_PX,
    SCALARS,
)

BINS = len(BLUR_SIZES_PX)
# Channels: of cells of 8 px, of squares of 16 and of 32 px, and what a cell knows of the frame.
_CELL, _HALF, _QUARTER, _FRAME = 96, 96, 128, 32
NEIGHBOURS = 9
CHOICES = 4 * NEIGHBOURS


def convolution(inputs: int, outputs: int, side: int = 1, stride: int = 1) -> nn.Sequential:
    """Return a convolution with batch normalisation, which is folded into it in the end."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class Residual(nn.Module):
    """Adds what convolutions find around each place, in fewer channels if `inner` is less."""

    def __init__(self, width: int, inner: int, dilation: int = 1) -> None:
        super().__init__()
        self.reduce = convolution(width, inner) if inner < width else nn.Identity()
        self.spatial = nn.Conv2d(inner, inner, 3, 1, dilation, dilation, bias=False)
        self.norm = nn.BatchNorm2d(inner)
        self.mix = nn.Conv2d(inner, width, 1)
        nn.init.zeros_(self.mix.weight)
        nn.init.zeros_(self.mix.bias)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x + self.mix(torch.relu(self.norm(self.spatial(self.reduce(x)))))


class Refinement(nn.Module):
    """An encoder and decoder over cells of 8 px, with skips, and a decoder to half-cells.

    Takes `cost_features` [batch, channels, rows, columns] and `frame_features` [batch, channels, 2
    rows, 2 columns]. Returns, at half-cells of 4 px, the logits of `BLUR_SIZES_PX` and the
    logarithm of the mean error in px, and for each quarter of a half-cell the logits of the
    half-cell around it whose blur size it has.
    """

    def __init__(self) -> None:
        super().__init__()
        self.frame = nn.Sequential(convolution(FRAME_CELL_PX**2, 16), convolution(16, _FRAME, 3, 2))
        self.stem = convolution(COST_CHANNELS + SCALARS, _CELL)
        self.at_cell = nn.Sequential(
            convolution(_CELL + _FRAME, _CELL), Residual(_CELL, 32), Residual(_CELL, 32)
        )
        self.down = convolution(_CELL, _HALF, 3, 2)
        self.at_half = nn.Sequential(Residual(_HALF, 48), Residual(_HALF, 48))
        self.down2 = convolution(_HALF, _QUARTER, 3, 2)
        self.at_quarter = nn.Sequential(
            Residual(_QUARTER, 64), Residual(_QUARTER, 64, 2), Residual(_QUARTER, 64)
        )
        self.up2 = nn.ConvTranspose2d(_QUARTER, _HALF, 2, 2)
        self.at_half_again = nn.Sequential(convolution(2 * _HALF, _HALF), Residual(_HALF, 48))
        self.up = nn.ConvTranspose2d(_HALF, _CELL, 2, 2)
        self.at_cell_again = nn.Sequential(
            convolution(2 * _CELL, _CELL), Residual(_CELL, 32), Residual(_CELL, 32)
        )
        # Of the four half-cells of each cell.
        self.size = nn.Conv2d(_CELL, 4 * (BINS + 1), 1)
        self.choice = nn.Conv2d(_CELL, 4 * CHOICES, 1)
        # What the costs say by themselves: the network only adds to it.
        self.trust = nn.Parameter(torch.tensor([0.5, 0.0, 0.25, 0.5, 0.0, 0.25]))

    def trunk(self, costs: torch.Tensor, frame: torch.Tensor) -> torch.Tensor:
        """Return what the last two convolutions act on."""
        cell = self.at_cell(torch.cat([self.stem(costs), self.frame(frame)], 1))
        half = self.at_half(self.down(cell))
        quarter = self.at_quarter(self.down2(half))
        half = self.at_half_again(torch.cat([half, self.up2(quarter)], 1))
        return self.at_cell_again(torch.cat([cell, self.up(half)], 1))

    def forward(
        self, costs: torch.Tensor, frame: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        cell = self.trunk(costs, frame)
        size = functional.pixel_shuffle(self.size(cell), 2)
        of_kinds = costs[:, :COST_CHANNELS].unflatten(1, (len(self.trust), BINS))
        own = (self.trust.view(-1, 1, 1, 1) * of_kinds).sum(1)
        own = functional.interpolate(own, scale_factor=2.0, mode="bilinear")
        choice = functional.pixel_shuffle(self.choice(cell), 2)
        return torch.cat([size[:, :BINS] - own, size[:, BINS:]], 1), choice
