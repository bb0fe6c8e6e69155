"""Planes that occlude each other, and the light of them that reaches a sensor, on any device.

The same optics as `coded_aperture_ros.simulation.layered.tracing`, for batches and in colour: a ray
from pixel ``x`` through the point ``u`` of the aperture arrives at ``p = x - u S(p)``, where the
blur size ``S`` is linear on a plane.
"""

import dataclasses
from collections.abc import Callable

import torch
from torch.nn import functional

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.simulation.layered.tracing import lens_samples

# Around a frame planes are drawn this much further: half of the widest blur.
MARGIN_PX = 13
# An opening of the mask is sampled where its image is at most as wide, px; what lies between the
# samples is interpolated.
_SAMPLE_PX = 1.7
# A mask of more cells along a side is averaged over no fewer.
_FEWEST_CELLS = 17
_SEEN = 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class Planes:
    """Scenes of planes, nearest first, the last of which covers everything.

    Attributes
    ----------
    painted : Tensor [batch, planes, 4, rows, columns]
        Red, green and blue light times cover, and cover, with `MARGIN_PX` around the frame.
    blur_px : Tensor [batch, planes, 3]
        Signed blur size in the middle of the frame, and its change per pixel down and right.
    """

    painted: torch.Tensor
    blur_px: torch.Tensor

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame."""
        rows, columns = self.painted.shape[-2:]
        return rows - 2 * MARGIN_PX, columns - 2 * MARGIN_PX

    def part(self, scenes: slice) -> "Planes":
        """Some of the scenes."""
        return Planes(self.painted[scenes], self.blur_px[scenes])


def aperture_samples(mask: Mask, widest_px: float) -> FloatArray:
    """Points of the aperture, down and right, in units of the mask's extent, and weights [n, 3].

    They are so many that blur of the width has no gaps.
    """
    return lens_samples(mask, widest_px, _FEWEST_CELLS, _SAMPLE_PX)


def _frame_places(planes: Planes) -> tuple[torch.Tensor, torch.Tensor]:
    """Distances of pixels from the middle of the frame, down [rows, 1] and right [1, columns]."""
    rows, columns = planes.shape
    device = planes.painted.device
    down = torch.arange(rows, device=device, dtype=torch.float32) - (rows - 1) / 2
    right = torch.arange(columns, device=device, dtype=torch.float32) - (columns - 1) / 2
    return down[:, None], right[None, :]


def traced(planes: Planes, samples: FloatArray, through: "Trace | None" = None) -> torch.Tensor:
    """Light [batch, 3, rows, columns] that reaches the sensor through points of an aperture.

    `through` is `light_through`, or what a compiler makes of it.
    """
    down, right = _frame_places(planes)
    base, by_row, by_column = planes.blur_px[:, :, :, None, None].unbind(2)
    size = base + by_row * down + by_column * right
    device = planes.painted.device
    light = torch.zeros(len(size), 3, *planes.shape, device=device)
    points = torch.from_numpy(samples).to(device)
    for point in points:
        light = light + (through or light_through)(planes.painted, size, planes.blur_px, point)
    return light


def light_through(
    painted: torch.Tensor, size: torch.Tensor, blur_px: torch.Tensor, point: torch.Tensor
) -> torch.Tensor:
    """Light [batch, 3, rows, columns] through one point of the aperture: down, right, weight."""
    batch, count, _, rows, columns = painted.shape
    height, width = size.shape[-2:]
    down = torch.arange(height, device=size.device, dtype=torch.float32)[:, None]
    right = torch.arange(width, device=size.device, dtype=torch.float32)
    scale = 1 + blur_px[:, :, 1] * point[0] + blur_px[:, :, 2] * point[1]
    arrives = size / scale[:, :, None, None]
    across = (right - (width - 1) / 2 - point[1] * arrives) * (2 / (columns - 1))
    along = (down - (height - 1) / 2 - point[0] * arrives) * (2 / (rows - 1))
    grid = torch.stack([across, along], -1).flatten(0, 1)
    seen = functional.grid_sample(
        painted.flatten(0, 1), grid, padding_mode="border", align_corners=True
    ).view(batch, count, 4, height, width)
    light = torch.zeros_like(seen[:, 0, :3])
    passed = torch.ones_like(seen[:, 0, :1])
    for plane in range(count):
        light = light + passed * seen[:, plane, :3]
        passed = passed * (1 - seen[:, plane, 3:])
    return point[2] * light


Trace = Callable[[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]


def seen_from_centre(planes: Planes) -> torch.Tensor:
    """Signed blur size [batch, rows, columns] of what the centre of each pixel shows."""
    cover = planes.painted[:, :, 3, MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    nearest = (cover > _SEEN).float().argmax(1)
    down, right = _frame_places(planes)
    base, by_row, by_column = planes.blur_px[:, :, :, None, None].unbind(2)
    size = base + by_row * down + by_column * right
    return torch.gather(size, 1, nearest[:, None])[:, 0]
