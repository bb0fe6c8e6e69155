"""Deblurring a lens whose PSF changes over the image, part by part."""

import dataclasses
from functools import lru_cache

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.deblur.blur_map import filled_blur_map, known_pixels
from coded_aperture_ros.deblur.config import DeblurConfig
from coded_aperture_ros.deblur.deblurrer import Deblurrer
from coded_aperture_ros.deblur.levels import RenderedLevels
from coded_aperture_ros.deblur.problem import full_resolution_motion, measured_pixels
from coded_aperture_ros.deblur.uncertainty import Uncertainty
from coded_aperture_ros.frames import check_frame
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.likelihood.bank.field import COLUMNS, ROWS, FieldPsfs
from coded_aperture_ros.likelihood.protocol import BlurLevels
from coded_aperture_ros.optics import PsfStack
from coded_aperture_ros.optics.wavefront import field_tangents

# Half as many along a side as depth has: all of them are 0.3 dB better, and take three times as
# long (a ray-traced double Gauss).
_ROWS = ROWS // 2
_COLUMNS = COLUMNS // 2
# By so much parts overlap, and are blended.
_MARGIN_PX = 28


@dataclasses.dataclass(frozen=True)
class _Part:
    """A part of a frame with its margins, and how much it counts there."""

    where: tuple[slice, slice]
    weight: FloatArray  # [rows, columns]


class FieldDeblurrer:
    """Makes frames all-in-focus as `Deblurrer` does, each part of them with PSFs of its own.

    Parameters and methods are those of `Deblurrer`, but for the PSFs of the `field`; the stack has
    those of the axis.
    """

    def __init__(
        self,
        stack: PsfStack,
        field: FieldPsfs,
        config: DeblurConfig | None = None,
        progress: Progress = iter,
    ) -> None:
        self.stack = stack
        self._deblurrers = []
        for tangent in field_tangents(field.intrinsics, _ROWS, _COLUMNS):
            nearest = np.argsort(np.sum((field.tangents - tangent) ** 2, axis=1))[:4]
            of_part = dataclasses.replace(stack, psfs=field.psfs[nearest].mean(axis=0))
            self._deblurrers.append(Deblurrer(of_part, config, progress))

    @property
    def config(self) -> DeblurConfig:
        """The settings."""
        return self._deblurrers[0].config

    @property
    def removes_motion(self) -> bool:
        """Whether the method can remove blur by motion too."""
        return self._deblurrers[0].removes_motion

    def prepare(self, shape: Shape) -> None:
        """Compute beforehand what the first frame of `shape` (rows, columns) would wait for."""
        for part, deblurrer in zip(_parts(tuple(shape)), self._deblurrers, strict=True):
            deblurrer.prepare(part.weight.shape)

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""
        for deblurrer in self._deblurrers:
            deblurrer.reset()

    def reconfigure(self, config: DeblurConfig) -> None:
        """Deblur by other settings from the next frame on."""
        for deblurrer in self._deblurrers:
            deblurrer.reconfigure(config)

    def close(self) -> None:
        """End the threads that the frames were shared among."""
        for deblurrer in self._deblurrers:
            deblurrer.close()

    def deblur(
        self,
        frame: FloatArray,
        blur_size_px: FloatArray,
        noise: float | None = None,
        motion_px: FloatArray | None = None,
    ) -> FloatArray:
        """Return the all-in-focus frame; see `Deblurrer.deblur`."""
        check_frame(frame)
        clean, *_ = measured_pixels(frame, self.config.saturation)
        filled = filled_blur_map(blur_size_px, clean)
        known = known_pixels(blur_size_px, frame.shape)
        blur = np.where(known, filled, np.float32(np.nan))
        motion = full_resolution_motion(motion_px, frame.shape)
        sharp = np.zeros_like(frame)
        weight = np.zeros(frame.shape[:2], np.float32)
        for part, deblurrer in zip(_parts(frame.shape[:2]), self._deblurrers, strict=True):
            # A part without any depth takes that of its neighbours.
            of_part = blur if known[part.where].any() else filled
            maps = frame, of_part, *(() if motion is None else (motion,))
            cut, sizes_px, *moved = (np.ascontiguousarray(each[part.where]) for each in maps)
            found = deblurrer.deblur(cut, sizes_px, noise, *moved)
            sharp[part.where] += (found.T * part.weight.T).T
            weight[part.where] += part.weight
        return (sharp.T / weight.T).T

    def uncertainty(
        self,
        frame: FloatArray,
        sharp: FloatArray,
        blur_size_px: FloatArray,
        noise: float | None = None,
    ) -> Uncertainty:
        """Return how far each pixel can be relied on; see `Deblurrer.uncertainty`.

        What is seen through the aperture is reckoned with the PSFs of the axis.
        """
        whole = Deblurrer(self.stack, self.config)
        try:
            return whole.uncertainty(frame, sharp, blur_size_px, noise)
        finally:
            whole.close()


@lru_cache(maxsize=4)
def _parts(shape: Shape) -> tuple[_Part, ...]:
    """Return the parts of frames of a shape (rows, columns), row by row."""
    down, across = (
        _stretches(length, count) for length, count in zip(shape, (_ROWS, _COLUMNS), strict=True)
    )
    return tuple(
        _Part((rows, columns), np.outer(of_rows, of_columns))
        for rows, of_rows in down
        for columns, of_columns in across
    )


def _stretches(length: int, count: int) -> list[tuple[slice, FloatArray]]:
    """Cut a side into parts with margins; weights fall to the margins' ends."""
    places = np.arange(length)
    found = []
    for number in range(count):
        first = number * length // count
        end = (number + 1) * length // count
        # Half way into the margin lies the border, where two parts count alike.
        before = np.ones(length) if not number else (places - first + _MARGIN_PX) / _MARGIN_PX / 2
        after = np.ones(length) if end == length else (end + _MARGIN_PX - places) / _MARGIN_PX / 2
        weight = np.minimum(before, after).clip(0, 1).astype(np.float32)
        inside = slice(*np.flatnonzero(weight)[[0, -1]] + [0, 1])
        found.append((inside, weight[inside]))
    return found


AnyDeblurrer = Deblurrer | FieldDeblurrer


def make_deblurrer(
    model: BlurLevels, config: DeblurConfig | None = None, progress: Progress = iter
) -> AnyDeblurrer:
    """Return what deblurs a model's frames: by parts, where its PSFs change over the image."""
    field = model.field if isinstance(model, RenderedLevels) else None
    if isinstance(model, FilterBank) and model.field is not None:
        field = model.field.field
    if field is None:
        return Deblurrer(model.stack, config, progress)
    return FieldDeblurrer(model.stack, field, config, progress)
