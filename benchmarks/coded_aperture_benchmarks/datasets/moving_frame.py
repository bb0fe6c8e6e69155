"""Objects that move during the exposure, in front of a scene that stands still."""

import dataclasses
import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.simulation.render import render_coded_frame

# Instants of the exposure for each pixel that the fastest object moves.
_INSTANTS_PER_PX = 1.5


@dataclasses.dataclass(frozen=True, eq=False)
class MovingObject:
    """A thing in front of a scene, as it is in the middle of the exposure.

    Attributes
    ----------
    image : ndarray, shape [h, w] or [h, w, 3]
        Linear light, of the size of the scene; beyond the object, what is not seen.
    depth_m : ndarray, shape [h, w]
        Metres; finite and positive where the object is.
    covered : ndarray of bool, shape [h, w]
        Where the object is.
    motion_px : (float, float)
        Way during the exposure, px: to the right, and down.
    """

    image: NDArray
    depth_m: NDArray
    covered: NDArray[np.bool_]
    motion_px: tuple[float, float]

    def __post_init__(self) -> None:
        shape = self.covered.shape
        if self.image.shape[:2] != shape or self.depth_m.shape != shape or not self.covered.any():
            raise InputError(
                "moving object: image, depth and where it is must be of one size, and it must be "
                f"somewhere: got {list(self.image.shape)}, {list(self.depth_m.shape)} and "
                f"{list(shape)}"
            )
        if not (np.isfinite(self.motion_px).all() and len(self.motion_px) == 2):
            raise InputError(f"moving object: expected a motion in px, got {self.motion_px!r}")

    def placed(self, image: NDArray, depth_m: NDArray, share: float) -> tuple[NDArray, NDArray]:
        """Put the object into a scene as it is a share of the exposure after its middle."""
        right, down = (share * way for way in self.motion_px)
        move = np.array([[1.0, 0.0, right], [0.0, 1.0, down]])
        size = self.covered.shape[::-1]
        moved, covered, depths = (
            cv2.warpAffine(
                np.ascontiguousarray(values, np.float32), move, size, flags=how, borderMode=border
            )
            for values, how, border in (
                (self.image, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE),
                (self.covered, cv2.INTER_LINEAR, cv2.BORDER_CONSTANT),
                (self.depth_m, cv2.INTER_NEAREST, cv2.BORDER_REPLICATE),
            )
        )
        there = covered >= 0.5
        of_image = there.reshape(*there.shape, *(1,) * (image.ndim - 2))
        return np.where(of_image, moved, image), np.where(there, depths, depth_m)


@dataclasses.dataclass(frozen=True, eq=False)
class MovingFrame:
    """A coded frame of moving objects, and the truth in the middle of the exposure.

    Attributes
    ----------
    coded : ndarray of float32, shape [h, w] or [h, w, 3]
        Without noise.
    sharp : ndarray of float32, of the same shape
    depth_m : ndarray of float32, shape [h, w]
    motion_px : ndarray of float32, shape [h, w, 2]
        Way during the exposure, to the right, and down; zeros where nothing moves.
    """

    coded: NDArray[np.float32]
    sharp: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    motion_px: NDArray[np.float32]


def render_moving_frame(
    image: NDArray,
    depth_m: NDArray,
    objects: Sequence[MovingObject],
    camera: Camera,
    *,
    layer_spacing_px: float = 0.5,
    aperture_blocks: int = 2,
    progress: Progress = iter,
) -> MovingFrame:
    """Render what a coded-aperture camera records while objects move at constant speed.

    The frame is the mean of frames at instants of the exposure, each with all of its occlusions:
    what an object hides for a part of the exposure is seen for the rest.

    Parameters
    ----------
    image, depth_m
        Of what stands still; see `render_coded_frame`.
    objects : sequence of MovingObject
        Later ones are in front of earlier ones.
    layer_spacing_px, aperture_blocks
        See `render_coded_frame`.
    progress : callable, optional
        Wraps the iteration over instants.
    """
    for each in objects:
        if each.image.shape != image.shape:
            raise InputError(
                f"moving object of the shape {list(each.image.shape)}: expected that of the scene, "
                f"{list(image.shape)}"
            )
    longest = max((math.hypot(*each.motion_px) for each in objects), default=0.0)
    count = max(math.ceil(longest * _INSTANTS_PER_PX), 1)
    coded = np.zeros(image.shape, np.float32)
    # In the middles of equal parts of the exposure.
    for share in progress((np.arange(count) + 0.5) / count - 0.5):
        coded += render_coded_frame(
            *_instant(image, depth_m, objects, float(share)),
            camera,
            layer_spacing_px=layer_spacing_px,
            aperture_blocks=aperture_blocks,
        )
    coded /= np.float32(count)
    sharp, depth = _instant(image, depth_m, objects, 0.0)
    motion = np.zeros((*depth.shape, 2), np.float32)
    for each in objects:
        motion[each.covered] = each.motion_px
    return MovingFrame(coded, sharp.astype(np.float32), depth.astype(np.float32), motion)


def _instant(
    image: NDArray, depth_m: NDArray, objects: Sequence[MovingObject], share: float
) -> tuple[NDArray, NDArray]:
    for each in objects:
        image, depth_m = each.placed(image, depth_m, share)
    return image, depth_m
