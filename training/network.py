"""The refinement network: costs of a neighbourhood in, probabilities of blur sizes out."""

import torch
from torch import nn

from coded_aperture_ros.depth.refine.features import BLUR_SIZES_PX, FRAME_CELL_PX, SCALARS

BINS = len(BLUR_SIZES_PX)
# Cells of 8 px, half as many, a quarter; half-cells of 4 px.
WIDTHS = {"cell": 56, "half": 80, "quarter": 96, "fine": 32, "frame": 16}
NEIGHBOURS = 9


def convolution(inputs: int, outputs: int, side: int = 3, stride: int = 1, dilation: int = 1):
    """Return a convolution with batch normalisation, which is folded into it in the end."""
    padding = dilation * (side // 2)
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, side, stride, padding, dilation, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class Residual(nn.Module):
    """Adds what two convolutions find: of the neighbours in each channel, then of all channels."""

    def __init__(self, width: int, dilation: int = 1, dense: bool = False) -> None:
        super().__init__()
        padding = dilation * (1 if dense else 2)
        side, groups = (3, 1) if dense else (5, width)
        self.spatial = nn.Conv2d(width, width, side, 1, padding, dilation, groups, bias=False)
        self.norm = nn.BatchNorm2d(width)
        self.mix = nn.Conv2d(width, width, 1)
        nn.init.zeros_(self.mix.weight)
        nn.init.zeros_(self.mix.bias)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x + self.mix(torch.relu(self.norm(self.spatial(x))))


class Refinement(nn.Module):
    """An encoder and decoder over cells of 8 px, with skips, and a decoder to half-cells.

    Takes `cost_features` [batch, channels, rows, columns] and `frame_features` [batch, channels, 2
    rows, 2 columns]. Returns, at half-cells of 4 px, the logits of `BLUR_SIZES_PX`, the logarithm
    of the mean error in px, and for each quarter of a half-cell the logits of the half-cell around
    it whose blur size it has.
    """

    def __init__(self) -> None:
        super().__init__()
        w = WIDTHS
        self.frame = convolution(FRAME_CELL_PX**2, w["frame"])
        self.frame_down = convolution(w["frame"], 24, 3, 2)
        self.stem = convolution(BINS + SCALARS, w["cell"], 1)
        self.join = convolution(w["cell"] + 24, w["cell"], 1)
        self.at_cell = nn.Sequential(Residual(w["cell"]), Residual(w["cell"]), Residual(w["cell"]))
        self.down = convolution(w["cell"], w["half"], 3, 2)
        self.at_half = nn.Sequential(Residual(w["half"], 2, True), Residual(w["half"]))
        self.down2 = convolution(w["half"], w["quarter"], 3, 2)
        self.at_quarter = nn.Sequential(
            Residual(w["quarter"], 1, True), Residual(w["quarter"], 2, True)
        )
        self.up2 = nn.ConvTranspose2d(w["quarter"], w["half"], 2, 2)
        self.at_half_again = nn.Sequential(
            convolution(2 * w["half"], w["half"], 1), Residual(w["half"])
        )
        self.up = nn.ConvTranspose2d(w["half"], w["cell"], 2, 2)
        self.at_cell_again = nn.Sequential(
            convolution(2 * w["cell"], w["cell"], 1), Residual(w["cell"]), Residual(w["cell"])
        )
        self.to_fine = nn.ConvTranspose2d(w["cell"], w["fine"], 2, 2)
        self.fine = nn.Sequential(
            convolution(w["fine"] + w["frame"], w["fine"], 1), Residual(w["fine"])
        )
        self.head = nn.Conv2d(w["fine"], BINS + 1, 1)
        self.choice = nn.Conv2d(w["fine"], 4 * NEIGHBOURS, 1)

    def forward(
        self, costs: torch.Tensor, frame: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        of_frame = self.frame(frame)
        cell = self.join(torch.cat([self.stem(costs), self.frame_down(of_frame)], 1))
        cell = self.at_cell(cell)
        half = self.at_half(self.down(cell))
        quarter = self.at_quarter(self.down2(half))
        half = self.at_half_again(torch.cat([half, self.up2(quarter)], 1))
        cell = self.at_cell_again(torch.cat([cell, self.up(half)], 1))
        fine = self.fine(torch.cat([torch.relu(self.to_fine(cell)), of_frame], 1))
        return self.head(fine), self.choice(fine)
