"""The network that blends hypotheses of deblurring; see `coded_aperture_ros/deblur/blend`."""

import torch
from torch import nn
from torch.nn import functional

from coded_aperture_ros.deblur.blend.features import CELL_PX, MAPS
from coded_aperture_ros.deblur.blend.hypotheses import HYPOTHESES

PIXELS = CELL_PX**2
# Channels of cells, and of squares of two by two cells, which see farther; and layers of these.
_FINE, _COARSE, _COARSE_LAYERS = 32, 64, 4
# The hypothesis that a pixel begins with: its own blur size, well bounded.
_SAFE = 1


def _layer(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """Return a convolution with batch normalisation, which is folded into it in the end."""
    convolution = nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs))


class Blend(nn.Module):
    """Hypotheses and maps in cells to weights of the hypotheses, and what is added to them.

    Takes what `pictures.list_pictures` has as cells and maps, one after the other [batch, channels,
    rows, columns], rows and columns even. Returns for each pixel of a cell the weights of all
    hypotheses, and last what is added [batch, (hypotheses + 1) * 16, rows, columns].
    """

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(HYPOTHESES * PIXELS + MAPS, _FINE, 1)
        self.fine = _layer(_FINE, _FINE)
        self.down = _layer(_FINE, _COARSE, 2)
        self.coarse = nn.ModuleList(_layer(_COARSE, _COARSE) for _ in range(_COARSE_LAYERS))
        self.up = nn.Conv2d(_COARSE, _FINE, 1)
        self.both = _layer(_FINE, _FINE)
        self.last = nn.Conv2d(_FINE, (HYPOTHESES + 1) * PIXELS, 1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)
        with torch.no_grad():
            self.last.bias[_SAFE * PIXELS : (_SAFE + 1) * PIXELS] = 1

    def forward(self, shown: torch.Tensor) -> torch.Tensor:
        fine = torch.relu(self.first(shown))
        fine = torch.relu(fine + self.fine(fine))
        coarse = torch.relu(self.down(fine))
        for layer in self.coarse:
            coarse = torch.relu(coarse + layer(coarse))
        found = torch.relu(fine + functional.interpolate(self.up(coarse), scale_factor=2))
        return self.last(torch.relu(found + self.both(found)))


def blended(told: torch.Tensor, cells: torch.Tensor) -> torch.Tensor:
    """Return the picture in cells [batch, 16, rows, columns].

    Takes what `Blend` returns, and the hypotheses in cells. Weights are made to sum to 1.
    """
    told = told.unflatten(1, (HYPOTHESES + 1, PIXELS))
    weights, added = told[:, :-1], told[:, -1]
    weights = weights + (1 - weights.sum(1, keepdim=True)) / HYPOTHESES
    return (weights * cells.unflatten(1, (HYPOTHESES, PIXELS))).sum(1) + added
