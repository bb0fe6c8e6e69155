"""Deblurring with a PSF that changes over the image, tile by tile."""

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
from coded_aperture_ros.deblur.several import ChannelDeblurrer, SeveralDeblurrers
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
class _Tile:
    """Region of a frame with its margins, and its weight there."""

    region: tuple[slice, slice]
    weight: FloatArray  # [rows, columns]


class FieldDeblurrer(SeveralDeblurrers):
    """All-in-focus frames of a lens whose PSF changes over the image.

    Parameters and methods are those of `Deblurrer`, with the PSFs of a `field`; the stack has those
    of the axis.
    """

    def __init__(
        self,
        stack: PsfStack,
        field: FieldPsfs,
        config: DeblurConfig | None = None,
        progress: Progress = iter,
    ) -> None:
        deblurrers = []
        for tangent in field_tangents(field.intrinsics, _ROWS, _COLUMNS):
            nearest = np.argsort(np.sum((field.tangents - tangent) ** 2, axis=1))[:4]
            tile_stack = dataclasses.replace(stack, psfs=field.psfs[nearest].mean(axis=0))
            deblurrers.append(Deblurrer(tile_stack, config, progress))
        super().__init__(stack, deblurrers)

    def prepare(self, shape: Shape) -> None:
        """Make the filters for frames of `shape` (rows, columns) before the first one."""
        for part, deblurrer in zip(_tiles(tuple(shape)), self._deblurrers, strict=True):
            deblurrer.prepare(part.weight.shape)

    def deblur(
        self,
        frame: FloatArray,
        blur_size_px: FloatArray,
        noise: float | None = None,
        motion_px: FloatArray | None = None,
    ) -> FloatArray:
        """All-in-focus frame, float32, shape of `frame`; see `Deblurrer.deblur`."""
        check_frame(frame)
        clean, *_ = measured_pixels(frame, self.config.saturation)
        filled = filled_blur_map(blur_size_px, clean)
        known = known_pixels(blur_size_px, frame.shape)
        blur = np.where(known, filled, np.float32(np.nan))
        motion = full_resolution_motion(motion_px, frame.shape)
        sharp = np.zeros_like(frame)
        weight = np.zeros(frame.shape[:2], np.float32)
        for part, deblurrer in zip(_tiles(frame.shape[:2]), self._deblurrers, strict=True):
            # A part without any depth takes that of its neighbours.
            tile_stack = blur if known[part.region].any() else filled
            maps = frame, tile_stack, *(() if motion is None else (motion,))
            cut, sizes_px, *moved = (np.ascontiguousarray(each[part.region]) for each in maps)
            found = deblurrer.deblur(cut, sizes_px, noise, *moved)
            sharp[part.region] += (found.T * part.weight.T).T
            weight[part.region] += part.weight
        return (sharp.T / weight.T).T


@lru_cache(maxsize=4)
def _tiles(shape: Shape) -> tuple[_Tile, ...]:
    """Tiles of frames of a shape (rows, columns), row by row."""
    down, across = (
        _overlapping_spans(length, count)
        for length, count in zip(shape, (_ROWS, _COLUMNS), strict=True)
    )
    return tuple(
        _Tile((rows, columns), np.outer(row_weights, column_weights))
        for rows, row_weights in down
        for columns, column_weights in across
    )


def _overlapping_spans(length: int, count: int) -> list[tuple[slice, FloatArray]]:
    """Overlapping ranges of a side of the frame, with weights that sum to one."""
    positions = np.arange(length)
    found = []
    for number in range(count):
        first = number * length // count
        end = (number + 1) * length // count
        # Half way into the margin lies the border, where two parts count alike.
        before = (
            np.ones(length) if not number else (positions - first + _MARGIN_PX) / _MARGIN_PX / 2
        )
        after = (
            np.ones(length) if end == length else (end + _MARGIN_PX - positions) / _MARGIN_PX / 2
        )
        weight = np.minimum(before, after).clip(0, 1).astype(np.float32)
        inside = slice(*np.flatnonzero(weight)[[0, -1]] + [0, 1])
        found.append((inside, weight[inside]))
    return found


AnyDeblurrer = Deblurrer | FieldDeblurrer | ChannelDeblurrer


def make_deblurrer(
    model: BlurLevels, config: DeblurConfig | None = None, progress: Progress = iter
) -> AnyDeblurrer:
    """Deblurrer for a model: by tiles or channels if its PSFs change over the image or with colour.

    Parameters
    ----------
    model : BlurLevels
        Filter bank, or levels of `blur_levels`.
    config : DeblurConfig, optional
    progress : callable, optional
        See `Deblurrer`.

    Returns
    -------
    Deblurrer, FieldDeblurrer or ChannelDeblurrer

    Examples
    --------
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.deblur import blur_levels
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(1000.0, 2.0, 64, 48, Mask.named("levin"), mask_extent_mm=10.0)
    >>> levels = blur_levels(camera=camera, depth_range_m=(2.5, 6.0), level_count=12)
    >>> make_deblurrer(levels).removes_motion
    False
    """
    field = model.field if isinstance(model, RenderedLevels) else None
    if isinstance(model, FilterBank) and model.field is not None:
        field = model.field.field
    if field is not None:
        return FieldDeblurrer(model.stack, field, config, progress)
    if model.stack.channel_psfs is not None:
        return ChannelDeblurrer(model.stack, config, progress)
    return Deblurrer(model.stack, config, progress)
