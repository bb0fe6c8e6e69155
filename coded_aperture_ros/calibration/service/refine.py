"""Correction of a camera by ordinary frames: mask, then focus."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from coded_aperture_ros.calibration.service.focus import FocusShift, fit_focus
from coded_aperture_ros.calibration.service.mask import MaskState, fit_mask
from coded_aperture_ros.calibration.service.tracks import Tracks, track_points
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.pipeline import FramePipeline

_MAX_MASK_FRAMES = 40  # more frames add little information
_MIN_BLUR_PX = 2.5
_LEVELS = 30
# Largest level, as a share of the blur of infinity: farther depths cannot be distinguished.
_FARTHEST = 0.97
_WIDER = 1.05  # than the farthest by the camera as it was: it may have been refocused
_CONFIDENT = 0.4
# A focus is known if depth is right to this by it.
_WELL_KNOWN = 0.01
# Below so many degrees a mask has not turned.
_TURNED_DEG = 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class Refined:
    """Camera corrected by frames.

    Attributes
    ----------
    camera : Camera
        With the certain corrections.
    mask : MaskState
    focus : FocusShift or None
        None if points cannot be tracked.
    unknown : str
        Why the focus is unchanged; empty if it was found.
    """

    camera: Camera
    mask: MaskState
    focus: FocusShift | None
    unknown: str

    @property
    def is_turned(self) -> bool:
        """Whether the mask has turned."""
        return abs(self.mask.turned_deg) > max(_TURNED_DEG, 3 * self.mask.std_deg)


def refine_camera(camera: Camera, frames: Sequence[FloatArray], progress: Progress) -> Refined:
    """Mask and focus of a camera from the frames of a video.

    Parameters
    ----------
    camera : Camera
        As it was set up; its scene is beyond the focal plane.
    frames : sequence of ndarray, float32 [rows, columns]
        Grey, linear light, in order.
    progress : Progress

    Returns
    -------
    Refined

    Raises
    ------
    InputError
        If the scene is not beyond the focal plane, or there is too little texture.
    """
    if camera.side != "far":
        raise InputError("expected a camera whose scene is beyond the focus (side: far)")
    largest_px = _WIDER * camera.blur_at_infinity_px
    some = frames[:: -(-len(frames) // _MAX_MASK_FRAMES)]
    mask = fit_mask(camera, some, largest_px, progress)
    found = Refined(camera, mask, None, "")
    if found.is_turned or mask.covered.any():
        turn = mask.turned_deg if found.is_turned else 0.0
        now = dataclasses.replace(mask, turned_deg=turn).mask(camera.mask)
        found = dataclasses.replace(found, camera=dataclasses.replace(camera, mask=now))
    try:
        focus = fit_focus(_tracked(found.camera, frames, progress), camera.focal_length_px)
    except InputError as error:
        return dataclasses.replace(found, unknown=str(error))
    if focus.std * focus.depth_m > _WELL_KNOWN:
        off = f"{focus.std * focus.depth_m:.1%} of the depth at {focus.depth_m:.2g} m"
        unknown = f"known to {off} only: drive towards things at different distances"
        return dataclasses.replace(found, focus=focus, unknown=unknown)
    moved = found.camera.refocused(1 / (1 / camera.focus_distance_m - focus.dioptres))
    return dataclasses.replace(found, focus=focus, camera=moved)


def _tracked(
    camera: Camera, frames: Sequence[FloatArray], progress: Progress
) -> Iterator[tuple[Tracks, DoubleArray, DoubleArray]]:
    """Tracked points with their inverse depths by blur, and the errors of these; NaN is unknown."""
    ends_px = _MIN_BLUR_PX, _FARTHEST * camera.blur_at_infinity_px
    near_m, far_m = camera.depth_m(ends_px)
    bank = learn_bank_for_camera(camera, float(near_m), float(far_m), _LEVELS)
    everywhere = DepthConfig(confidence_threshold=0.0)
    pipeline = FramePipeline(bank, camera, everywhere, deblur=None)
    for tracks in progress(list(track_points(frames, camera.intrinsics))):
        estimate = pipeline(frames[tracks.frame])
        at = tuple(tracks.points.T)
        assert estimate.depth_m is not None and estimate.std_dev_m is not None
        depth_m, std_m = (
            np.where(estimate.confidence[at] >= _CONFIDENT, values[at], np.nan).astype(np.float64)
            for values in (estimate.depth_m, estimate.std_dev_m)
        )
        yield tracks, 1 / depth_m, std_m / depth_m**2
    pipeline.close()
