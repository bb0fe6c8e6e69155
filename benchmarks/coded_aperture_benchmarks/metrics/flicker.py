"""How much what is estimated of still surfaces changes from frame to frame, seen by a camera."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.depth import DepthConfig, DepthEstimate
from coded_aperture_ros.depth.moving import Pinhole
from coded_aperture_ros.optics import Camera, PsfStack

# Two frames show the same point if its depth is as true in both to this share.
_SAME = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """What a frame truly shows.

    Attributes
    ----------
    pose : ndarray, float64 [4, 4]
        Turns points of the camera into those of the world.
    depth_m : ndarray, float32 [rows, columns]
        True depth.
    clear : ndarray, float32 [rows, columns]
        All-in-focus frame by that depth.
    """

    pose: DoubleArray
    depth_m: FloatArray
    clear: FloatArray


def changes(
    before: FloatArray, after: FloatArray, seen: tuple[Seen, Seen], view: Pinhole
) -> FloatArray:
    """By how much a map changes at the points that both frames show [n].

    Parameters
    ----------
    before, after : ndarray, float32 [rows, columns]
        Of two frames: errors, or what else does not depend on the view.
    seen : (Seen, Seen)
        What the two frames show.
    view : Pinhole
        Of both.

    Examples
    --------
    >>> view = Pinhole((4, 6), (5.0, 5.0), (2.5, 1.5))
    >>> wall = np.full((4, 6), 2.0, np.float32)
    >>> aside = np.eye(4)
    >>> aside[0, 3] = 0.4  # one pixel
    >>> columns = np.tile(np.arange(6, dtype=np.float32), (4, 1))
    >>> seen = tuple(Seen(each, wall, wall) for each in (np.eye(4), aside))
    >>> found = changes(columns, columns + 1, seen, view)
    >>> found.size, float(abs(found).max().round(3))
    (20, 0.0)
    """
    column, row, both = _same_points(seen, view)
    carried = cv2.remap(np.asarray(before, np.float32), column, row, cv2.INTER_CUBIC)
    return np.asarray((after - carried)[both], np.float32)


class Deblurring:
    """Makes all-in-focus frames, and tells how they amplify noise.

    Parameters
    ----------
    stack : PsfStack
    noise : float
        Standard deviation of the noise of coded frames, linear light, > 0.
    """

    def __init__(self, stack: PsfStack, noise: float) -> None:
        self.noise = noise
        self._deblurrer = Deblurrer(stack, DeblurConfig(method="fast"))

    def by_truth(self, camera: Camera, coded: FloatArray, depth_m: FloatArray) -> FloatArray:
        """All-in-focus frame [rows, columns] of a coded one by its true depth."""
        return self._deblurrer.deblur(
            coded, np.asarray(camera.blur_size_px(depth_m), np.float32), self.noise
        )

    def by_estimate(self, coded: FloatArray, estimate: DepthEstimate) -> FloatArray:
        """The same by depth as it is published by default."""
        sure = estimate.where_confident(DepthConfig().confidence_threshold)
        return self._deblurrer.deblur(coded, np.asarray(sure.blur_size_px), self.noise)

    def close(self) -> None:
        """End the worker threads."""
        self._deblurrer.close()


class Flicker:
    """How much depth and all-in-focus frames of still surfaces change from frame to frame.

    What an all-in-focus frame has with true depth, too, is not counted: noise, and texture finer
    than pixels.

    Parameters
    ----------
    deblurring : Deblurring
    view : Pinhole
    """

    def __init__(self, deblurring: Deblurring, view: Pinhole) -> None:
        self._deblurring, self._view = deblurring, view
        self._random = np.random.default_rng(7)
        self._before: tuple[Seen, FloatArray, FloatArray] | None = None
        self._frames: list[tuple[float, float, float]] = []

    def add(self, coded: FloatArray, seen: Seen, estimate: DepthEstimate) -> None:
        """Go on with the next frame."""
        deblurring, noise = self._deblurring, self._deblurring.noise
        errors = np.asarray(estimate.depth_m, np.float32) / seen.depth_m - 1
        clear = deblurring.by_estimate(coded, estimate)
        if self._before is not None:
            before, errors_before, light_before = self._before
            pair = before, seen
            depth = changes(errors_before, errors, pair, self._view)
            light = changes(light_before, clear - seen.clear, pair, self._view)
            noisier = coded + noise * self._random.standard_normal(coded.shape, np.float32)
            amplified = deblurring.by_estimate(noisier, estimate) - clear
            # Two frames have noise of their own each.
            by_noise = 2**0.5 * float(amplified.std())
            self._frames.append((float(np.nanmedian(np.abs(depth))), float(light.std()), by_noise))
        self._before = seen, errors, clear - seen.clear

    def result(self, begin: int = 1) -> dict[str, float]:
        """Median change of the depth as a share; change of the light over that by noise.

        `begin` is the first frame that counts, with what has changed since the one before it.
        """
        depth, light, by_noise = np.array(self._frames[begin - 1 :]).T
        ratio = np.sqrt(np.mean(light**2) / np.mean(by_noise**2))
        return {
            "depth_flicker": round(float(depth.mean()), 5),
            "light_flicker": round(float(ratio), 4),
        }


def _same_points(
    seen: tuple[Seen, Seen], view: Pinhole
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Where the pixels of the later frame are in the earlier one, and which it shows, too."""
    earlier, later = seen
    rows, columns = np.indices(view.shape).reshape(2, -1)
    rays = view.rays(np.column_stack([columns, rows]).astype(np.float64))
    depth = later.depth_m.reshape(-1, 1)
    motion = np.linalg.inv(earlier.pose) @ later.pose
    points = np.column_stack([rays * depth, depth]) @ motion[:3, :3].T + motion[:3, 3]
    ahead = np.maximum(points[:, 2], 1e-6)
    places = view.pixels(points[:, :2] / ahead[:, None]).astype(np.float32)
    column, row = (each.reshape(view.shape) for each in places.T)
    there = cv2.remap(earlier.depth_m, column, row, cv2.INTER_NEAREST, borderValue=-1.0)
    both = np.abs(there / ahead.reshape(view.shape) - 1) < _SAME
    return np.ascontiguousarray(column), np.ascontiguousarray(row), both
