"""The refinement network: costs of a neighbourhood in, logits of blur sizes out."""

import dataclasses
from collections.abc import Callable

import torch
from torch import nn
from torch.nn import functional

from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_SIZES_PX,
    COST_CHANNELS,
    FRAME_CELL_PX,
    KINDS,
    SCALARS,
    UNTRIED,
)

BINS = len(BLUR_SIZES_PX)
# Channels of every blur size by itself, in squares of 16 px.
_LEVEL = 24
# The same of the large network, in cells and in squares of 16 px.
_CELL = 16
_CELL_HALF = 32
# What comes of each: logits of a cell's four half-cells, and one more.
PER_LEVEL = 5
NEIGHBOURS = 9
CHOICES = 4 * NEIGHBOURS


@dataclasses.dataclass(frozen=True)
class Widths:
    """How large a network is, in channels.

    Of cells of 8 px, of squares of 16 and of 32 px with what is between their convolutions, and of
    what a cell knows of the frame; and the distances that cells look at, before and after.
    """

    cell: int = 48
    half: int = 64
    of_half: int = 32
    quarter: int = 96
    frame: int = 24
    before: tuple[int, ...] = (1,)
    after: tuple[int, ...] = (1, 1)


def convolution(inputs: int, outputs: int, side: int = 1, stride: int = 1) -> nn.Sequential:
    """Convolution with batch normalisation, which is folded into it in the end."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class Around(nn.Module):
    """Adds what convolutions find around each place, or at a distance.

    With `inner` they have fewer channels, and add nothing in the beginning; if not `mixed`, what
    the first finds is added as it is.
    """

    def __init__(self, width: int, dilation: int = 1, inner: int = 0, mixed: bool = True) -> None:
        super().__init__()
        channels = inner or width
        self.reduce = convolution(width, inner) if inner else nn.Identity()
        self.spatial = nn.Conv2d(channels, channels, 3, 1, dilation, dilation, bias=False)
        self.norm = nn.BatchNorm2d(channels)
        self.mix = nn.Conv2d(channels, width, 1) if mixed else nn.Identity()
        if inner:
            nn.init.zeros_(self.mix.weight)
            nn.init.zeros_(self.mix.bias)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Output of these layers."""
        found: torch.Tensor = self.mix(torch.relu(self.norm(self.spatial(self.reduce(x)))))
        return x + found


class LevelLayers(nn.Module):
    """What is done to every blur size, always with the same weights.

    In squares of 16 px, whose four cells are channels: a quarter of the work of cells.
    """

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(4 * inputs, _LEVEL, 1)
        self.around = nn.Sequential(*(Around(_LEVEL, mixed=False) for _ in range(2)))
        self.out = nn.Conv2d(_LEVEL, 4 * PER_LEVEL, 3, 1, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Output of these layers."""
        return functional.pixel_shuffle(
            self.after_first(self.first(functional.pixel_unshuffle(x, 2))), 2
        )

    def after_first(self, x: torch.Tensor) -> torch.Tensor:
        """What comes of the first layer, of squares [batch, _LEVEL, rows, columns]."""
        found: torch.Tensor = self.out(self.around(torch.relu(x)))
        return found


class CellLayers(nn.Module):
    """What is done to every blur size, always with the same weights, in cells of 8 px."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.first = convolution(inputs, _CELL, 3)
        self.down = convolution(_CELL, _CELL_HALF, 3, 2)
        self.wide = nn.Sequential(*(convolution(_CELL_HALF, _CELL_HALF, 3) for _ in range(3)))
        self.up = nn.ConvTranspose2d(_CELL_HALF, _CELL, 2, 2)
        self.join = convolution(2 * _CELL, _CELL)
        self.out = nn.Conv2d(_CELL, PER_LEVEL, 3, 1, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Output of these layers."""
        fine = self.first(x)
        found: torch.Tensor = self.out(
            self.join(torch.cat([fine, self.up(self.wide(self.down(fine)))], 1))
        )
        return found


class EveryLevel(nn.Module):
    """Looks at every blur size by itself and its two neighbours, at all with the same weights.

    Takes `cost_features` [batch, channels, rows, columns], gives `PER_LEVEL` channels for each blur
    size [batch, PER_LEVEL, blur sizes, rows, columns]; 0 for those that were not tried.
    """

    def __init__(self, layers: Callable[[int], nn.Module]) -> None:
        super().__init__()
        kinds = COST_CHANNELS // BINS
        self.inputs = kinds + 2 * len(range(0, kinds, KINDS)) + SCALARS + 1
        self.layers = layers(self.inputs)
        self.register_buffer("sizes", torch.from_numpy(BLUR_SIZES_PX).float() / 10)

    def forward(self, costs: torch.Tensor) -> torch.Tensor:
        """What is found of every blur size."""
        if isinstance(self.layers, LevelLayers):
            return self._in_squares(self.layers, costs)
        batch, _, rows, columns = costs.shape
        volume = costs[:, :COST_CHANNELS].unflatten(1, (-1, BINS))
        beside = volume[:, ::KINDS]  # of neighbouring sizes, the logarithms
        lower = torch.cat([beside[:, :, :1], beside[:, :, :-1]], 2)
        upper = torch.cat([beside[:, :, 1:], beside[:, :, -1:]], 2)
        scalars = costs[:, COST_CHANNELS:, None].expand(-1, -1, BINS, -1, -1)
        size = self.sizes.view(1, 1, -1, 1, 1).expand(batch, 1, -1, rows, columns)
        levels = torch.cat([volume, lower, upper, scalars, size], 1)
        tried = (costs[:, :BINS, 0, 0] < UNTRIED).flatten()
        some = levels.transpose(1, 2).flatten(0, 1)[tried]
        found = costs.new_zeros(batch * BINS, PER_LEVEL, rows, columns)
        found[tried] = self.layers(some.contiguous(memory_format=torch.channels_last)).to(
            found.dtype
        )
        return found.unflatten(0, (batch, BINS)).transpose(1, 2)

    def _in_squares(self, layers: LevelLayers, costs: torch.Tensor) -> torch.Tensor:
        """The same, with what the first layer, which is linear, does once for all."""
        batch, _, rows, columns = costs.shape
        squares = functional.pixel_unshuffle(costs, 2).unflatten(1, (-1, 4))
        volume = squares[:, :COST_CHANNELS].unflatten(1, (-1, BINS)).transpose(1, 2)
        of, bins = (costs[:, :BINS, 0, 0] < UNTRIED).nonzero(as_tuple=True)
        lower, upper = (bins - 1).clamp(min=0), (bins + 1).clamp(max=BINS - 1)
        first, kinds = layers.first, volume.shape[2]
        counts = 4 * torch.tensor([kinds + 2 * (kinds // KINDS), SCALARS, 1])
        of_costs, of_scalars, of_size = first.weight.split(counts.tolist(), 1)
        beside = [volume[of, at, ::KINDS] for at in (lower, upper)]  # the logarithms
        shown = torch.cat([volume[of, bins], *beside], 1).flatten(1, 2)
        found = functional.conv2d(shown.contiguous(memory_format=torch.channels_last), of_costs)
        scalars = squares[:, COST_CHANNELS:].flatten(1, 2)
        found = found + functional.conv2d(scalars, of_scalars, first.bias)[of]
        found = found + (self.sizes[:, None] * of_size.sum((1, 2, 3)))[bins][..., None, None]
        found = functional.pixel_shuffle(layers.after_first(found), 2).float()
        whole = costs.new_zeros(batch, BINS, PER_LEVEL, rows, columns)
        return whole.index_put((of, bins), found).transpose(1, 2)


class Refinement(nn.Module):
    """Each channel's surroundings in cells of 8 px, and an encoder and decoder beside them.

    Takes `cost_features` [batch, channels, rows, columns] and `frame_features` [batch, channels, 2
    rows, 2 columns]. Returns, at half-cells of 4 px, the logits of `BLUR_SIZES_PX` and the
    logarithm of the mean error in px, and for each quarter of a half-cell the logits of the
    half-cell around it whose blur size it has.
    """

    def __init__(
        self, widths: Widths | None = None, of_level: Callable[[int], nn.Module] = LevelLayers
    ) -> None:
        super().__init__()
        w = widths or Widths()
        self.frame = nn.Sequential(
            convolution(FRAME_CELL_PX**2, 16), convolution(16, w.frame, 3, 2)
        )
        self.every_level = EveryLevel(of_level)
        self.stem = convolution(COST_CHANNELS + SCALARS + BINS, w.cell)
        self.at_cell = nn.Sequential(
            convolution(w.cell + w.frame, w.cell), *(Around(w.cell, far) for far in w.before)
        )
        self.down = convolution(w.cell, w.half, 3, 2)
        self.at_half = nn.Sequential(*(Around(w.half, inner=w.of_half) for _ in range(2)))
        self.down2 = convolution(w.half, w.quarter, 3, 2)
        self.at_quarter = nn.Sequential(*(Around(w.quarter, inner=48) for _ in range(2)))
        self.up2 = nn.ConvTranspose2d(w.quarter, w.half, 2, 2)
        self.at_half_again = nn.Sequential(
            convolution(2 * w.half, w.half), Around(w.half, inner=w.of_half)
        )
        self.up = nn.ConvTranspose2d(w.half, w.cell, 2, 2)
        self.at_cell_again = nn.Sequential(*(Around(w.cell, far) for far in w.after))
        # Of the four half-cells of each cell.
        self.size = nn.Conv2d(w.cell, 4 * (BINS + 1), 1)
        self.choice = nn.Conv2d(w.cell, 4 * CHOICES, 1)
        # What the costs say by themselves: the network only adds to it.
        self.trust = nn.Parameter(torch.tensor([0.5, 0.0, 0.25, 0.5, 0.0, 0.25]))

    def trunk(self, costs: torch.Tensor, frame: torch.Tensor, levels: torch.Tensor) -> torch.Tensor:
        """What the last two convolutions act on."""
        stem = self.stem(torch.cat([costs, levels], 1))
        cell = self.at_cell(torch.cat([stem, self.frame(frame)], 1))
        half = self.at_half(self.down(cell))
        quarter = self.at_quarter(self.down2(half))
        half = self.at_half_again(torch.cat([half, self.up2(quarter)], 1))
        return self.at_cell_again(cell + self.up(half))

    def forward(
        self, costs: torch.Tensor, frame: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits of blur sizes with the width, and of the choice among half-cells."""
        levels = self.every_level(costs)
        cell = self.trunk(costs, frame, levels[:, 4])
        size = functional.pixel_shuffle(self.size(cell), 2)
        of_kinds = costs[:, :COST_CHANNELS].unflatten(1, (len(self.trust), BINS))
        own = (self.trust.view(-1, 1, 1, 1) * of_kinds).sum(1)
        own = functional.interpolate(own, scale_factor=2.0, mode="bilinear")
        own = own - functional.pixel_shuffle(levels[:, :4].transpose(1, 2).flatten(1, 2), 2)
        choice = functional.pixel_shuffle(self.choice(cell), 2)
        return torch.cat([size[:, :BINS] - own, size[:, BINS:]], 1), choice


def large_network() -> Refinement:
    """Teacher: fitted first, and the network that ships learns from it."""
    widths = Widths(
        cell=64, half=96, of_half=40, quarter=112, frame=32, before=(1, 2), after=(1, 2, 1)
    )
    return Refinement(widths, CellLayers)
