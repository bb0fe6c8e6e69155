"""Networks that see the frame itself: for any optics, or for those that they were fitted to."""

import itertools

import torch
from torch import nn
from torch.nn import functional

from raw.evidence import Evidence

# Levels of a frame; their blur sizes are spread evenly over the range of its camera.
LEVELS = 28
_FIRST = 16
_LEVEL = 32
_LEVEL_COARSE = 48
# Of each level, what the second part is given at every 4 px: a score, and others.
_FOUND = 4
_LARGEST_PX = 22.0


def _convolution(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class _Residual(nn.Module):
    def __init__(self, width: int, dilation: int = 1) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(width, width, 3, 1, dilation, dilation, bias=False),
            nn.BatchNorm2d(width),
            nn.ReLU(inplace=True),
            nn.Conv2d(width, width, 3, 1, 1, bias=False),
            nn.BatchNorm2d(width),
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.relu(x + self.layers(x))


class _Neighbours(nn.Module):
    """Mixes what is found of a level with that of the levels beside it."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.mix = nn.Conv2d(3 * width, width, 1, bias=False)
        self.norm = nn.BatchNorm2d(width)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        levels = x.unflatten(0, (-1, LEVELS))
        below = torch.cat([levels[:, :1], levels[:, :-1]], 1)
        above = torch.cat([levels[:, 1:], levels[:, -1:]], 1)
        beside = torch.cat([levels, below, above], 2).flatten(0, 1)
        return torch.relu(x + self.norm(self.mix(beside)))


class _EveryLevel(nn.Module):
    """What is done to each level by itself and its neighbours, with the same weights for all."""

    def __init__(self) -> None:
        super().__init__()
        self.first = _convolution(11, _FIRST)
        self.down = _convolution(_FIRST, _LEVEL, 2)
        self.fine = nn.Sequential(_Neighbours(_LEVEL), _Residual(_LEVEL))
        self.coarse = nn.Sequential(
            _convolution(_LEVEL, _LEVEL_COARSE, 2),
            _Neighbours(_LEVEL_COARSE),
            _Residual(_LEVEL_COARSE, 2),
            _Residual(_LEVEL_COARSE, 2),
        )
        self.up = nn.ConvTranspose2d(_LEVEL_COARSE, _LEVEL, 2, 2)
        self.last = nn.Sequential(_Neighbours(_LEVEL), _Residual(_LEVEL))
        self.found = nn.Conv2d(_LEVEL, _FOUND, 1)

    def forward(self, levels: torch.Tensor) -> torch.Tensor:
        fine = self.fine(self.down(self.first(levels)))
        return self.found(self.last(fine + self.up(self.coarse(fine))))


class _Decide(nn.Module):
    """Encoder and decoder from squares of 4 px; logits at every 2 px."""

    def __init__(self, inputs: int, levels: int) -> None:
        super().__init__()
        widths = (72, 104, 144, 160)
        self.stem = _convolution(inputs, widths[0])
        self.encode = nn.ModuleList()
        self.decode = nn.ModuleList()
        for upper, lower in itertools.pairwise(widths):
            self.encode.append(nn.Sequential(_Residual(upper), _convolution(upper, lower, 2)))
            self.decode.append(
                nn.Sequential(
                    nn.Conv2d(lower + upper, upper, 1), nn.ReLU(inplace=True), _Residual(upper)
                )
            )
        self.middle = nn.Sequential(_Residual(widths[-1]), _Residual(widths[-1]))
        self.to_squares = nn.Conv2d(widths[0], 4 * 24, 1)
        self.edges = nn.Sequential(_convolution(24 + 24 + 1, 48), _Residual(48))
        self.logits = nn.Conv2d(48, levels, 1)
        nn.init.zeros_(self.logits.weight)

    def forward(self, coarse: torch.Tensor, fine: torch.Tensor) -> torch.Tensor:
        x = self.stem(coarse)
        before = []
        for encode in self.encode:
            kept = encode[0](x)  # type: ignore[index]
            before.append(kept)
            x = encode[1](kept)  # type: ignore[index]
        x = self.middle(x)
        for decode, kept in zip(reversed(self.decode), reversed(before), strict=True):
            up = functional.interpolate(x, scale_factor=2.0, mode="nearest")
            x = decode(torch.cat([up, kept], 1))
        squares = functional.pixel_shuffle(self.to_squares(x), 2)
        return self.logits(self.edges(torch.cat([squares, fine], 1)))


class _OfFrame(nn.Module):
    """What the frame in squares of 2 px says, there and at 4 px."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.fine = nn.Sequential(_convolution(13, 24), _convolution(24, 24))
        self.coarse = nn.Sequential(_convolution(24, width, 2), _Residual(width))

    def forward(self, given: Evidence) -> tuple[torch.Tensor, torch.Tensor]:
        contrast = functional.avg_pool2d(given.contrast, 2)
        squares = torch.cat([functional.pixel_unshuffle(given.frame, 2), contrast], 1)
        fine = self.fine(squares)
        return torch.cat([fine, contrast], 1), self.coarse(fine)


def _scalars(sizes_px: torch.Tensor, near: torch.Tensor) -> torch.Tensor:
    """What is known of cameras: the ends of their ranges, and which side [batch, 3, 1, 1]."""
    ends = [sizes_px[:, 0] / _LARGEST_PX, sizes_px[:, -1] / _LARGEST_PX, near]
    return torch.stack(ends, 1)[:, :, None, None]


def _signed(values: torch.Tensor) -> torch.Tensor:
    """Values whose large ones are compressed."""
    return torch.sign(values) * torch.log1p(values.abs())


class AnyOptics(nn.Module):
    """Looks at what each level's inverse filter makes of the frame; for PSFs that it never saw.

    Takes `Evidence`, the blur sizes of the levels [batch, LEVELS], px, and whether they are of what
    is before the plane in focus [batch]. Returns logits of the levels [batch, LEVELS, rows / 2,
    columns / 2].
    """

    def __init__(self) -> None:
        super().__init__()
        self.every_level = _EveryLevel()
        self.of_frame = _OfFrame(40)
        self.decide = _Decide(LEVELS * _FOUND + 40 + 3, LEVELS)
        self.trust = nn.Parameter(torch.tensor(1.0))

    def forward(self, given: Evidence, sizes_px: torch.Tensor, near: torch.Tensor) -> torch.Tensor:
        batch, levels, rows, columns = given.sharpened.shape
        sharpened = functional.pixel_unshuffle(_signed(given.sharpened).flatten(0, 1)[:, None], 2)
        frame = functional.pixel_unshuffle(given.frame.mean(1, keepdim=True), 2)
        contrast = functional.avg_pool2d(given.contrast, 2)
        of_all = torch.cat([frame, contrast], 1)[:, None].expand(-1, levels, -1, -1, -1)
        known = torch.stack([sizes_px / _LARGEST_PX, near[:, None].expand(-1, levels)], 2)
        known = known.view(-1, 2, 1, 1).expand(-1, -1, rows // 2, columns // 2)
        found = self.every_level(
            torch.cat([sharpened, of_all.flatten(0, 1), known], 1).contiguous(
                memory_format=torch.channels_last
            )
        )
        found = found.unflatten(0, (batch, levels))
        fine, coarse = self.of_frame(given)
        scalars = _scalars(sizes_px, near).expand(-1, -1, rows // 4, columns // 4)
        logits = self.decide(torch.cat([found.flatten(1, 2), coarse, scalars], 1), fine)
        own = functional.interpolate(found[:, :, 0], scale_factor=2.0, mode="bilinear")
        return logits + self.trust * own


class OneOptics(nn.Module):
    """Looks at the frame alone, and knows one mask: what the pictures of it tell at most.

    Takes what `AnyOptics` takes; `sharpened` is not used. Returns logits of `LEVELS` blur sizes,
    always the same ones.
    """

    def __init__(self) -> None:
        super().__init__()
        self.of_frame = _OfFrame(96)
        self.more = nn.Sequential(_Residual(96), _Residual(96, 2), _Residual(96, 4))
        self.decide = _Decide(96 + 3, LEVELS)

    def forward(self, given: Evidence, sizes_px: torch.Tensor, near: torch.Tensor) -> torch.Tensor:
        fine, coarse = self.of_frame(given)
        scalars = _scalars(sizes_px, near).expand(-1, -1, *coarse.shape[-2:])
        return self.decide(torch.cat([self.more(coarse), scalars], 1), fine)
