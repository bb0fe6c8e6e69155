"""Points tracked from one frame of a video to later ones."""

import dataclasses
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.optics import Intrinsics

Picture = NDArray[np.uint8]
# A stretch ends where so many points are lost, or with so many frames.
_LEFT = 0.35
_MAX_FRAMES = 40
_MAX_POINTS = 400
_APART_PX = 10
_QUALITY = 0.005
_WINDOW_PX = 31
_SMALLER = 3
# A point that does not come back to where it began was lost.
_BACK_PX = 0.7
_MARGIN_PX = 8


@dataclasses.dataclass(frozen=True, eq=False)
class Tracks:
    """Points of a frame, tracked through the frames after it.

    Attributes
    ----------
    frame : int
        Number of the first frame.
    points : ndarray, int [n, 2]
        Rows and columns there.
    places : ndarray, float64 [frames, n, 2]
        Tangents of the angles from the axis, right and down, without distortion; NaN from where a
        point is lost.
    """

    frame: int
    points: IndexArray
    places: DoubleArray


def track_points(frames: Sequence[FloatArray], view: Intrinsics) -> Iterator[Tracks]:
    """Follow points through grey frames [rows, columns] of a video, in stretches."""
    # All alike: points would seem to move with the light.
    low, high = np.quantile([frame[::8, ::8] for frame in frames], (0.002, 0.998))
    pictures = [_picture((frame - low) / max(high - low, 1e-6)) for frame in frames]
    rows, columns = frames[0].shape
    rays = view.rays(rows, columns)
    start = 0
    while start < len(frames) - 1:
        first = cv2.goodFeaturesToTrack(pictures[start], _MAX_POINTS, _QUALITY, _APART_PX)
        end = start + 1
        if first is not None:
            seen = [first[:, 0]]
            here = first
            alive = np.ones(len(first), bool)
            for end in range(start + 1, min(start + _MAX_FRAMES, len(frames))):
                here, found = _followed(pictures[start], pictures[end - 1 : end + 1], first, here)
                x, y = here[:, 0].T
                alive &= found & (x > _MARGIN_PX) & (x < columns - _MARGIN_PX)
                alive &= (y > _MARGIN_PX) & (y < rows - _MARGIN_PX)
                if alive.mean() < _LEFT:
                    break
                seen.append(np.where(alive[:, None], here[:, 0], np.nan))
            points = np.rint(first[:, 0, ::-1]).astype(int)
            yield Tracks(start, points, _tangents(np.stack(seen), rays))
        start = end


def _followed(
    first: Picture, pair: Sequence[Picture], begin: FloatArray, here: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Positions of points in the second of two frames, and which were found.

    They are searched from their positions in the first of them, and then compared with the very
    first frame, so that they do not drift.
    """
    how = {"winSize": (_WINDOW_PX, _WINDOW_PX), "maxLevel": _SMALLER}
    ahead, found, _ = cv2.calcOpticalFlowPyrLK(*pair, here, None, **how)
    near = {**how, "maxLevel": 0, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    there, _, _ = cv2.calcOpticalFlowPyrLK(first, pair[1], begin, ahead.copy(), **near)
    back, again, _ = cv2.calcOpticalFlowPyrLK(pair[1], first, there, begin.copy(), **near)
    returned = np.linalg.norm(back - begin, axis=-1)[:, 0] < _BACK_PX
    return there, returned & (found[:, 0] > 0) & (again[:, 0] > 0)


def _picture(shown: FloatArray) -> Picture:
    return np.asarray(np.rint(255 * np.clip(shown, 0, 1)), np.uint8)


def _tangents(places: FloatArray, rays: FloatArray) -> DoubleArray:
    """Tangents of places [..., 2], x and y in px, from those of every pixel."""
    x, y = np.moveaxis(np.nan_to_num(places).astype(np.float32), -1, 0)
    found = np.stack(
        [cv2.remap(np.ascontiguousarray(rays[..., i]), x, y, cv2.INTER_LINEAR) for i in range(2)],
        axis=-1,
    )
    return np.where(np.isfinite(places), found, np.nan).astype(np.float64)
