"""Motion during the exposure: what has moved where in a frame."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.methods.motion import motion_kernel

# Motions that a frame is divided among, at most; rarer ones are taken for the nearest of these.
_MOST_MOTIONS = 8
# Motions are told apart in steps of this, px.
_STEP_PX = 0.25


@dataclasses.dataclass(frozen=True, eq=False)
class MotionParts:
    """The motion of a frame: M ways to the right, and down, and which of them each pixel has."""

    vectors_px: NDArray[np.float32]  # [M, 2]
    labels: NDArray[np.intp]  # [rows, columns]

    def traces(self) -> list[NDArray[np.float32]]:
        """Return the PSF of every motion."""
        return [motion_kernel((vector[0], vector[1])) for vector in self.vectors_px]


def motion_of_frame(
    motion_px: NDArray[np.float32] | None, shape: tuple[int, ...]
) -> NDArray[np.float32] | None:
    """Return a map of motion in the size of the frame; None where nothing moves.

    An `InputError` if it is not [rows, columns, 2], or not of a floating type.
    """
    if motion_px is None:
        return None
    if motion_px.ndim != 3 or motion_px.shape[2] != 2 or not motion_px.size:
        raise InputError(f"motion: expected [rows, columns, 2], got {list(motion_px.shape)}")
    if not np.issubdtype(motion_px.dtype, np.floating):
        raise InputError(f"motion: expected floating values in px, got {motion_px.dtype}")
    if not np.nan_to_num(motion_px).any():
        return None
    motion = np.ascontiguousarray(motion_px, np.float32)
    size = (shape[1], shape[0])
    return np.asarray(cv2.resize(motion, size, interpolation=cv2.INTER_NEAREST_EXACT))


def motion_parts(motion_px: NDArray[np.float32]) -> MotionParts:
    """Divide a map [rows, columns, 2] among the motions that occur most; none where not finite."""
    known = np.isfinite(motion_px).all(axis=2, keepdims=True)
    coarse = np.rint(np.where(known, motion_px, 0) / _STEP_PX)
    # Blur does not tell one way along a line from the other.
    right, down = coarse[..., 0], coarse[..., 1]
    back = (right < 0) | ((right == 0) & (down < 0))
    coarse = np.where(back[..., None], -coarse, coarse) + 0.0
    found, labels, counts = np.unique(
        coarse.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True
    )
    kept = np.argsort(-counts, kind="stable")[:_MOST_MOTIONS]
    apart = np.minimum(
        *(np.linalg.norm(found[:, None] - sign * found[kept], axis=2) for sign in (1, -1))
    )
    labels = apart.argmin(axis=1)[labels.ravel()].reshape(motion_px.shape[:2])
    return MotionParts((found[kept] * _STEP_PX).astype(np.float32), labels)
