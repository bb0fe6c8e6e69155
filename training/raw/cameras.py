"""Random cameras: a mask, a range of blur sizes, and the noise of frames."""

import dataclasses
import math

import numpy as np
import torch
from torch.nn import functional

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.optics import Mask, render_psf_stack
from raw.network import LEVELS
from raw.planes import Planes, Trace, aperture_samples, seen_from_centre, traced

# How often masks are drawn; random ones, each a new one, take the rest.
_MASKS = {
    "levin": 0.4,
    "zhou": 0.12,
    "four_hole": 0.12,
    "three_wide": 0.03,
    "four_wide": 0.03,
    "three_hole": 0.03,
    "veeraraghavan": 0.03,
}
_NEAR_SHARE = 0.15
_LARGEST_PX = 22.0
_NOISE = (5e-4, 8e-3)
_LENS_BLUR_PX = (0.15, 0.55)


@dataclasses.dataclass(frozen=True, eq=False)
class Camera:
    """What a batch of frames is recorded with.

    Attributes
    ----------
    mask : Mask
    near_px, far_px : float
        Signed blur sizes of the scene's nearest and farthest surface.
    sizes_px : ndarray, float32 [LEVELS]
        Blur sizes of the levels, without sign; they cover the scene's.
    """

    mask: Mask
    near_px: float
    far_px: float
    sizes_px: FloatArray

    @property
    def near(self) -> bool:
        """Whether the scene is before the plane in focus."""
        return self.near_px < 0

    def psfs(self) -> FloatArray:
        """PSFs [LEVELS, k, k] of the levels, as the camera's owner believes them to be."""
        signed = self.sizes_px * (-1 if self.near else 1)
        return np.asarray(render_psf_stack(self.mask, signed).psfs, np.float32)


def random_camera(random: np.random.Generator, mask: str | None = None) -> Camera:
    """Camera with a mask of a name, or any."""
    if mask is None:
        kind = random.random()
        for name, share in _MASKS.items():
            kind -= share
            if kind < 0:
                mask = name
                break
    pattern = _random_mask(random) if mask is None else Mask.named(mask)
    wide = math.exp(random.uniform(math.log(5), math.log(_LARGEST_PX)))
    narrow = max(wide * random.uniform(0.05, 0.75), 0.7)
    ends = np.array([narrow, wide]) + random.exponential(0.7, 2) * [-1, 1]
    sizes = np.linspace(max(ends[0], 0.4), min(ends[1], _LARGEST_PX + 1), LEVELS, dtype=np.float32)
    near = random.random() < _NEAR_SHARE
    ends_px = (-wide, -narrow) if near else (narrow, wide)
    return Camera(pattern, *ends_px, sizes)


def _random_mask(random: np.random.Generator) -> Mask:
    side = int(random.integers(7, 14))
    while True:
        grid = random.random((side, side)) < random.uniform(0.2, 0.6)
        if grid.any():
            return Mask("random", grid.astype(np.float32))


def exposed(
    planes: Planes, camera: Camera, random: np.random.Generator, through: Trace | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Light [batch, 3, rows, columns] of planes on the sensor, and the true blur sizes, px.

    The mask and the lens differ a little from what the camera's owner believes.
    """
    cells = camera.mask.transmission
    uneven = cells * (1 + random.uniform(0, 0.08) * random.standard_normal(cells.shape))
    mask = Mask(camera.mask.name, np.clip(uneven, 0, 1).astype(np.float32))
    scaled = Planes(planes.painted, planes.blur_px * random.normal(1, 0.006))
    widest = max(abs(camera.near_px), abs(camera.far_px))
    light = traced(scaled, aperture_samples(mask, widest), through)
    if random.random() < 0.5:
        light = _blurred(light, random.uniform(*_LENS_BLUR_PX))
    return light, seen_from_centre(planes).abs()


def recorded(light: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Frames with noise, and its deviation [batch]; some are grey, the colours of all change."""
    batch, device = len(light), light.device

    def some(share: float) -> torch.Tensor:
        return torch.rand(batch, 1, 1, 1, device=device) < share

    low, high = (math.log(value) for value in _NOISE)
    noise = torch.exp(low + (high - low) * torch.rand(batch, device=device))
    tint = torch.exp(0.3 * torch.randn(batch, 3, 1, 1, device=device)).clamp(0.4, 1.6)
    light = light[:, torch.randperm(3, device=device)] * tint
    # Shot noise as strong as the other at half of full light.
    deviation = noise.view(-1, 1, 1, 1)
    shot = deviation * torch.sqrt(0.4 + 1.2 * light.clamp(0, 1))
    deviation = torch.where(some(0.3), shot, deviation)
    frames = light + deviation * torch.randn_like(light)
    grey = some(0.25)
    frames = torch.where(grey, frames[:, 1:2].expand(-1, 3, -1, -1), frames)
    # What three channels would have whose mean is as noisy as the grey frame.
    noise = torch.where(grey.flatten(), noise * math.sqrt(3), noise)
    return frames, noise


def _blurred(light: torch.Tensor, deviation_px: float) -> torch.Tensor:
    places = torch.arange(-2, 3, device=light.device, dtype=torch.float32)
    kernel = torch.exp(-0.5 * (places / deviation_px) ** 2)
    kernel = (kernel / kernel.sum()).view(1, 1, 1, -1).expand(3, -1, -1, -1)
    across = functional.conv2d(functional.pad(light, (2, 2, 0, 0), "reflect"), kernel, groups=3)
    return functional.conv2d(
        functional.pad(across, (0, 0, 2, 2), "reflect"), kernel.transpose(2, 3), groups=3
    )
