"""Random scenes of planes, and measured ones in slices, drawn in batches on any device."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import torch
from measured import load_measured
from torch.nn import functional

from raw.covers import log_uniform, random_covers, smooth_noise, uniform
from raw.planes import MARGIN_PX, Planes

# Things before the room of a random scene; behind them are a floor and a wall.
THINGS = 10
_SLANTED_SHARE = 0.25
_FLOOR_SHARE = 0.45
_SAME_COLOUR_SHARE = 0.2
_PLAIN_PARTS_SHARE = 0.2
_CROWDED_SHARE = 0.6


@dataclasses.dataclass(frozen=True, eq=False)
class BlurRanges:
    """Signed blur sizes of the nearest and the farthest surface of each scene, px [batch]."""

    near_px: torch.Tensor
    far_px: torch.Tensor


def random_scenes(side: int, blur: BlurRanges, photographs: torch.Tensor) -> Planes:
    """Scenes of `THINGS`, a floor and a wall, of frames with `side` px a side.

    `photographs` [n, 3, rows, columns], linear light, are what some of the surfaces show.
    """
    count = len(blur.near_px)
    device = photographs.device
    size = (side + 2 * MARGIN_PX,) * 2
    planes = THINGS + 2
    covers = random_covers(count * planes, size, device).view(count, planes, *size)
    absent = torch.rand(count, planes, device=device) < uniform(0, 0.5, count, 1, device=device)
    covers[absent] = 0
    away, blur_px = _blur_planes(side, blur)
    covers[:, -2] = _floors(away, blur_px, size, device)
    covers[:, -1] = 1
    light = _paint(count, planes, size, photographs)
    painted = torch.cat([light * covers[:, :, None], covers[:, :, None]], 2)
    return Planes(painted, blur_px)


def _blur_planes(side: int, blur: BlurRanges) -> tuple[torch.Tensor, torch.Tensor]:
    """Where planes are between the nearest, 0, and the farthest, 1, and their blur sizes."""
    count, device = len(blur.near_px), blur.near_px.device
    end = 1 - 0.3 * torch.rand(count, 1, device=device) ** 2
    # Some scenes have most things near.
    crowded = torch.rand(count, 1, device=device) < _CROWDED_SHARE
    things = torch.rand(count, THINGS, device=device)
    things = torch.where(crowded, things**1.7, things).sort(1).values * end
    away = torch.cat([things, end, end], 1)
    span = (blur.far_px - blur.near_px)[:, None]
    slope = uniform(-1, 1, count, THINGS + 2, 2, device=device) * (0.6 * span / side)[:, :, None]
    slanted = torch.rand(count, THINGS + 2, 1, device=device) < _SLANTED_SHARE
    slope = torch.where(slanted, slope, torch.zeros_like(slope))
    # The blur of a slanted plane stays within the range over the whole frame.
    room = torch.minimum(away, 1 - away) * span.abs() / (0.5 * side)
    most = slope.abs().sum(2)
    slope = slope * (room / most.clamp(min=1e-9)).clamp(max=1)[:, :, None]
    size = blur.near_px[:, None] + span * away
    return away, torch.cat([size[:, :, None], slope], 2)


def _floors(
    away: torch.Tensor, blur_px: torch.Tensor, size: tuple[int, int], device: torch.device
) -> torch.Tensor:
    """Covers of floors, ceilings or walls beside, whose blur reaches that of the wall at an edge.

    `blur_px` of the floors, which are the last planes but one, is changed.
    """
    count, side = len(away), size[0] - 2 * MARGIN_PX
    wall = blur_px[:, -1, 0]
    nearest = blur_px[:, :-2, 0].gather(1, (away[:, :-2]).argmin(1, keepdim=True))[:, 0]
    angle = torch.randint(0, 4, (count,), device=device) * (math.pi / 2)
    angle = angle + uniform(-0.2, 0.2, count, device=device)
    edge = uniform(-0.3, 0.35, count, device=device) * side
    reach = 0.5 * side - edge
    growth = (nearest - wall) * uniform(0.3, 1, count, device=device) / reach
    down, right = angle.cos(), angle.sin()
    blur_px[:, -1, 1:] = 0
    blur_px[:, -2] = torch.stack([wall - growth * edge, growth * down, growth * right], 1)
    places = torch.arange(size[0], device=device, dtype=torch.float32) - (size[0] - 1) / 2
    beyond = down[:, None, None] * places[:, None] + right[:, None, None] * places
    cover = (beyond - edge[:, None, None] + 0.5).clamp(0, 1)
    there = torch.rand(count, 1, 1, device=device) < _FLOOR_SHARE
    return cover * there


def _paint(
    count: int, planes: int, size: tuple[int, int], photographs: torch.Tensor
) -> torch.Tensor:
    """Light [count, planes, 3, rows, columns] of surfaces with textures of random kinds."""
    device = photographs.device
    total = count * planes
    kind = torch.rand(total, 1, 1, device=device)
    noise = smooth_noise(total, size, uniform(0.3, 2.2, total, device=device), device)
    patches = torch.tanh(noise * log_uniform(1, 12, total, 1, 1, device=device))
    stripes = _stripes(total, size, device)
    texture = torch.where(kind < 0.25, noise.clamp(-3, 3) / 2, patches)
    texture = torch.where(kind > 0.5, stripes, texture)
    photo = _cut_out(total, size, photographs)
    of_photo = (kind > 0.54)[:, None]
    mean = photo.mean((1, 2, 3), keepdim=True).clamp(min=1e-3)
    texture = torch.where(of_photo, photo / mean - 1, texture[:, None].expand(-1, 3, -1, -1))
    contrast = log_uniform(0.01, 0.7, total, 1, 1, 1, device=device)
    contrast = torch.where(of_photo, log_uniform(0.2, 1.2, total, 1, 1, 1, device=device), contrast)
    plain = torch.rand(total, 1, 1, 1, device=device) < _PLAIN_PARTS_SHARE
    parts = (smooth_noise(total, size, uniform(1.5, 2.5, total, device=device), device) > 0)[
        :, None
    ]
    contrast = torch.where(plain & parts, 0.02 * contrast, contrast)
    base = _colours(count, planes, device).view(total, 3, 1, 1)
    light = base * (1 + contrast * texture) * _shading(total, size, device)[:, None]
    return light.clamp(0, 1).view(count, planes, 3, *size)


def _colours(count: int, planes: int, device: torch.device) -> torch.Tensor:
    """Mean light of surfaces; some have that of the one behind."""
    grey = log_uniform(0.04, 0.8, count, planes, 1, device=device)
    tint = log_uniform(0.6, 1.6, count, planes, 3, device=device)
    tint = tint ** torch.rand(count, planes, 1, device=device)
    colours = grey * tint
    same = torch.rand(count, planes, 1, device=device) < _SAME_COLOUR_SHARE
    behind = torch.roll(colours, -1, 1) * log_uniform(0.93, 1.07, count, planes, 1, device=device)
    return torch.where(same, behind, colours)


def _shading(count: int, size: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Light that changes slowly over a surface."""
    rough = uniform(0.6, 1.0, count, 1, 4, 4, device=device)
    rough = 1 + (rough - 1) * torch.rand(count, 1, 1, 1, device=device)
    return functional.interpolate(rough, size, mode="bicubic", align_corners=True)[:, 0]


def _stripes(count: int, size: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Stripes and squares, sharp or soft."""
    angle = uniform(0, math.pi, count, 1, 1, device=device)
    down = torch.arange(size[0], device=device, dtype=torch.float32).view(1, -1, 1)
    right = torch.arange(size[1], device=device, dtype=torch.float32).view(1, 1, -1)
    rate = 2 * math.pi / log_uniform(4, 60, count, 1, 1, device=device)
    along = torch.sin(rate * (angle.cos() * down + angle.sin() * right))
    across = torch.sin(rate * (angle.cos() * right - angle.sin() * down))
    squares = torch.rand(count, 1, 1, device=device) < 0.5
    wave = torch.where(squares, along * across, along)
    return torch.tanh(wave * log_uniform(0.7, 10, count, 1, 1, device=device))


def _cut_out(count: int, size: tuple[int, int], photographs: torch.Tensor) -> torch.Tensor:
    """Parts of photographs [count, 3, rows, columns], turned and scaled at random."""
    device = photographs.device
    chosen = torch.randint(0, len(photographs), (count,), device=device)
    zoom = log_uniform(0.45, 1.25, count, device=device)
    angle = uniform(0, 2 * math.pi, count, device=device)
    rows, columns = photographs.shape[-2:]
    reach = torch.tensor([size[1] / columns, size[0] / rows], device=device)
    flip = torch.where(torch.rand(count, device=device) < 0.5, -1.0, 1.0)
    cos, sin = zoom * angle.cos(), zoom * angle.sin()
    shift = uniform(-1, 1, count, 2, device=device) * 0.6
    aspect = rows / columns
    matrix = torch.stack(
        [
            torch.stack([flip * cos * reach[0], -sin * reach[1] * aspect, shift[:, 0]], 1),
            torch.stack([flip * sin * reach[0] / aspect, cos * reach[1], shift[:, 1]], 1),
        ],
        1,
    )
    cut = torch.empty(count, 3, *size, device=device)
    # One photograph at a time: indexing would copy a photograph for each surface.
    for index in range(len(photographs)):
        of_it = torch.nonzero(chosen == index)[:, 0]
        if len(of_it):
            grid = functional.affine_grid(
                matrix[of_it], [len(of_it), 3, *size], align_corners=False
            )
            photo = photographs[index : index + 1].expand(len(of_it), -1, -1, -1)
            cut[of_it] = functional.grid_sample(
                photo, grid, padding_mode="reflection", align_corners=False
            )
    return cut


@dataclasses.dataclass(frozen=True, eq=False)
class Slices:
    """A photograph in slices of like disparity, nearest first, that go on behind each other.

    Attributes
    ----------
    painted : Tensor [slices, 5, rows, columns]
        Light times cover, cover, and whether the disparity is known.
    away : Tensor [slices]
        From the nearest, 0, to the farthest, 1: linear in inverse depth.
    """

    painted: torch.Tensor
    away: torch.Tensor


def load_slices(folder: Path, count: int) -> Slices:
    """Slices of a folder with `sharp_srgb.png` and `disparity.npz`; the first may be empty."""
    measured = load_measured(folder, count)
    painted = []
    for part in measured.slices:
        cover = part.cover[..., None]
        planes = [part.light * cover, cover, measured.known[..., None]]
        painted.append(np.concatenate(planes, 2).transpose(2, 0, 1).astype(np.float16))
    away = [float(part.away[part.cover].mean()) for part in measured.slices]
    empty = count - len(painted)
    painted = [np.zeros_like(painted[0])] * empty + painted
    return Slices(torch.from_numpy(np.stack(painted)), torch.tensor([0.0] * empty + away))


def measured_scenes(
    side: int, blur: BlurRanges, sources: list[Slices]
) -> tuple[Planes, torch.Tensor]:
    """Parts of measured scenes at random sizes and angles, and where their depth is known."""
    device = sources[0].painted.device
    size = (side + 2 * MARGIN_PX,) * 2
    painted, known, sizes = [], [], []
    for near, far in zip(blur.near_px, blur.far_px, strict=True):
        slices = sources[int(torch.randint(0, len(sources), (1,)))]
        rows, columns = slices.painted.shape[-2:]
        zoom = float(log_uniform(0.6, 1.2, 1, device=torch.device("cpu")))
        angle = math.pi / 2 * int(torch.randint(0, 4, (1,))) + float(torch.randn(1)) * 0.1
        flip = -1.0 if torch.rand(1) < 0.5 else 1.0
        reach = zoom * size[0]
        slack = [max(1 - 1.1 * reach / length, 0) for length in (columns, rows)]
        shift = [(2 * float(torch.rand(1)) - 1) * part for part in slack]
        matrix = torch.tensor(
            [
                [
                    flip * math.cos(angle) * reach / columns,
                    -math.sin(angle) * reach / columns,
                    shift[0],
                ],
                [flip * math.sin(angle) * reach / rows, math.cos(angle) * reach / rows, shift[1]],
            ],
            device=device,
        )
        grid = functional.affine_grid(matrix[None], [1, 5, *size], align_corners=False)
        cut = functional.grid_sample(
            slices.painted.float(),
            grid.expand(len(slices.away), -1, -1, -1),
            padding_mode="reflection",
            align_corners=False,
        )
        cut[-1, 3] = cut[-1, 3].clamp(min=1e-3)
        painted.append(cut[:, :4])
        known.append(cut[0, 4, MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] > 0.99)
        sizes.append(near + (far - near) * slices.away)
    base = torch.stack(sizes)[:, :, None]
    return Planes(
        torch.stack(painted), torch.cat([base, torch.zeros_like(base).expand(-1, -1, 2)], 2)
    ), torch.stack(known)
