"""Batches of fresh frames, as networks see them, and their truth."""

import argparse
import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import read_image
from raw.cameras import Camera, exposed, random_camera, recorded
from raw.evidence import Evidence, evidence, transfer_functions
from raw.planes import Trace
from raw.scenes import BlurRanges, Slices, measured_scenes, random_scenes

SIDE_PX = 256
# Of which the frames of a batch are.
_CAMERAS = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Sources:
    """What scenes are made of: photographs [n, 3, rows, columns], and measured scenes."""

    photographs: torch.Tensor
    measured: list[Slices]
    through: Trace


@dataclasses.dataclass(frozen=True, eq=False)
class Sample:
    """A batch as networks see it, and its truth.

    Attributes
    ----------
    given : Evidence
    sizes_px : Tensor [batch, LEVELS]
        Blur sizes of the levels.
    near : Tensor [batch]
        1 if the scene is before the plane in focus, else 0.
    blur_px : Tensor [batch, rows / 2, columns / 2]
        True blur sizes; NaN where they are not known.
    """

    given: Evidence
    sizes_px: torch.Tensor
    near: torch.Tensor
    blur_px: torch.Tensor

    @classmethod
    def joined(cls, parts: "list[Sample]") -> "Sample":
        """One batch of several."""

        def all_of(name: str, of: list[Any]) -> torch.Tensor:
            return torch.cat([getattr(one, name) for one in of])

        given = [part.given for part in parts]
        names = [field.name for field in dataclasses.fields(Evidence)]
        return cls(
            Evidence(*(all_of(name, given) for name in names)),
            *(all_of(name, parts) for name in ("sizes_px", "near", "blur_px")),
        )


def load_photographs(folder: Path, device: torch.device) -> torch.Tensor:
    """Linear light [n, 3, 512, 768] of the pictures of a folder."""
    photographs = []
    for path in sorted(folder.glob("*.png")):
        picture = read_image(path, SRGB)
        if picture.shape[0] > picture.shape[1]:
            picture = picture.transpose(1, 0, 2)
        picture = cv2.resize(picture, (768, 512), interpolation=cv2.INTER_AREA)
        photographs.append(
            np.where(picture <= 0.04045, picture / 12.92, ((picture + 0.055) / 1.055) ** 2.4)
        )
    return torch.from_numpy(np.stack(photographs).transpose(0, 3, 1, 2).copy()).float().to(device)


def lights(
    cameras: list[Camera], sources: Sources, each: int, measured: bool, random: np.random.Generator
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Light of fresh scenes through each camera, and true blur sizes, NaN where not known."""
    device = sources.photographs.device
    ends = torch.tensor([[camera.near_px, camera.far_px] for camera in cameras], device=device)
    ends = ends.repeat_interleave(each, 0)
    blur = BlurRanges(ends[:, 0], ends[:, 1])
    with torch.no_grad():
        if measured:
            planes, known = measured_scenes(SIDE_PX, blur, sources.measured)
        else:
            planes = random_scenes(SIDE_PX, blur, sources.photographs)
            known = None
        found = []
        for index, camera in enumerate(cameras):
            these = slice(index * each, (index + 1) * each)
            light, truth = exposed(planes.part(these), camera, random, sources.through)
            if known is not None:
                truth = truth.masked_fill(~known[these], math.nan)
            found.append((light, truth))
    return found


def sample(camera: Camera, light: torch.Tensor, truth: torch.Tensor) -> Sample:
    """What networks see of light through a camera; every time with other noise."""
    with torch.no_grad():
        frames, noise = recorded(light)
        stated = noise * torch.exp(0.1 * torch.randn_like(noise))
        psfs = torch.from_numpy(camera.psfs()).to(light.device)
        given = evidence(frames, stated, transfer_functions(psfs, frames.shape[-2:]))
        down, right = torch.randint(0, 2, (2,)).tolist()
        sizes = torch.from_numpy(camera.sizes_px).to(light.device).expand(len(light), -1)
        near = torch.full((len(light),), float(camera.near), device=light.device)
    return Sample(given, sizes, near, truth[:, down::2, right::2].contiguous())


def batches(
    sources: Sources, options: argparse.Namespace, random: np.random.Generator, mask: str | None
) -> Iterator[tuple[str, Sample]]:
    """Batches of one drawing of scenes, with a word for their kind."""
    measured = bool(sources.measured) and random.random() < options.measured_share
    cameras = [random_camera(random, mask) for _ in range(_CAMERAS)]
    each = max(options.batch // _CAMERAS, 1)
    found = lights(cameras, sources, each, measured, random)
    for _ in range(options.noises):
        parts = [sample(camera, *one) for camera, one in zip(cameras, found, strict=True)]
        yield "measured" if measured else "random", Sample.joined(parts)
