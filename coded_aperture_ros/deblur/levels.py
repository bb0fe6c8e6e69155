"""Blur levels for deblurring: those of a bank, or rendered without one."""

import dataclasses

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank import DEFAULT_LEVEL_COUNT, FilterBank, psf_stack_for_camera
from coded_aperture_ros.likelihood.bank.field import FieldPsfs
from coded_aperture_ros.optics import Camera, PsfStack


@dataclasses.dataclass(frozen=True, eq=False)
class RenderedLevels:
    """PSFs of a camera file: all that deblurring needs of a bank, without learning one."""

    stack: PsfStack
    mask_digest: str
    learned_from: str = "the camera file"
    noise: float = 0.0
    field: FieldPsfs | None = None  # where they change over the image

    @property
    def window_px(self) -> int:
        """Side of the smallest frame, px."""
        return self.stack.psfs.shape[1]

    def for_view(self, camera: Camera | None) -> "RenderedLevels":
        """Levels for frames of a camera, which may show a part of its view only."""
        if self.field is None or camera is None:
            return self
        return dataclasses.replace(self, field=self.field.for_view(camera))


def blur_levels(
    *,
    camera: Camera,
    bank: FilterBank | None = None,
    depth_range_m: tuple[float, float] | None = None,
    level_count: int = DEFAULT_LEVEL_COUNT,
) -> FilterBank | RenderedLevels:
    """Blur levels of a bank, or rendered for a camera and a depth range.

    Parameters
    ----------
    camera : Camera
    bank : FilterBank, optional
        If given, it is returned.
    depth_range_m : (float, float), optional
        m; needed without a bank.
    level_count : int, optional

    Returns
    -------
    FilterBank or RenderedLevels

    Raises
    ------
    InputError
        If there is neither a bank nor a depth range, or the range does not suit the camera.

    Examples
    --------
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(1000.0, 2.0, 64, 48, Mask.named("levin"), mask_extent_mm=10.0)
    >>> len(blur_levels(camera=camera, depth_range_m=(2.5, 6.0), level_count=12).stack)
    12
    """
    if bank is not None:
        return bank
    if depth_range_m is None:
        raise InputError("deblurring needs a bank, or a depth range")
    stack = psf_stack_for_camera(camera, *depth_range_m, level_count, "deblurring")
    field = FieldPsfs.from_camera(camera, stack.blur_sizes_px)
    return RenderedLevels(stack, camera.mask.digest, field=field)
