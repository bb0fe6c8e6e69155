"""Focus of a lens from the disagreement of depth by blur and parallax of a moving camera.

Depth by blur has an unknown offset in inverse depth if the focus has moved; parallax has an unknown
scale. Together, where depths differ enough, they give both.
"""

import dataclasses
from collections.abc import Iterable

import cv2
import numpy as np
from scipy.optimize import least_squares

from coded_aperture_ros.calibration.service.tracks import Tracks
from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError

_MIN_POINTS = 40
_MIN_FRAMES = 6
_TRACK_PX = 0.25
_OUTLIER = 2.0
# What of a depth by blur is common to its neighbourhood, and so is no less by many points.
_COMMON = 4.0


@dataclasses.dataclass(frozen=True)
class FocusShift:
    """Error of the inverse depth by blur.

    Attributes
    ----------
    dioptres, std : float
        To be subtracted from the inverse depth by blur, 1/m, and its standard deviation.
    stretches : int
        Number of stretches of the video that were used.
    depth_m : float
        Median depth of the points, corrected, m.
    """

    dioptres: float
    std: float
    stretches: int
    depth_m: float


def fit_focus(
    tracked: Iterable[tuple[Tracks, DoubleArray, DoubleArray]], focal_length_px: float
) -> FocusShift:
    """Focus shift from tracks, with inverse depths by blur of their points and their errors.

    The errors are standard deviations, 1/m; NaN is unknown. Raises `InputError` if too few frames
    can be used.
    """
    found: list[tuple[float, float, float]] = []
    for tracks, inverse_m, std in tracked:
        followed = np.isfinite(tracks.places[..., 0]).sum(axis=0) >= _MIN_FRAMES
        known = np.isfinite(inverse_m) & np.isfinite(std) & followed
        if known.sum() >= _MIN_POINTS:
            known_values = inverse_m[known], std[known]
            shift, variance = _shift(tracks.places[:, known], *known_values, focal_length_px)
            found.append((shift, variance, float(np.median(inverse_m[known]))))
    if not found:
        raise InputError(
            "no points of known depth can be tracked: move the camera past things with "
            "texture, slowly enough that frames overlap"
        )
    shifts, variances, depths = np.asarray(found, np.float64).T
    # What stretches differ by beyond their errors is theirs, too.
    shift = float(np.average(shifts, weights=1 / variances))
    scatter = max(1.0, float(np.mean((shifts - shift) ** 2 / variances)))
    error = float(np.sqrt(scatter / np.sum(1 / variances)))
    return FocusShift(shift, error, len(found), 1 / (float(np.median(depths)) - shift))


def _shift(
    places: DoubleArray, inverse_m: DoubleArray, std: DoubleArray, focal_px: float
) -> tuple[float, float]:
    """Shift from a stretch, and its variance, by bundle adjustment.

    Unknown are the poses of all frames but the first, the inverse depths in the first, and the
    shift.
    """
    rays = np.column_stack([places[0], np.ones(places.shape[1])])
    later = places[1:]
    count = len(inverse_m)
    poses: list[DoubleArray] = []
    for seen in later:
        ok = np.isfinite(seen[:, 0])
        guess = poses[-1] if poses else np.zeros(6)
        turn = guess[:3].copy()
        way = guess[3:].copy()
        points = np.ascontiguousarray(rays[ok] / inverse_m[ok, None])
        _, turn, way = cv2.solvePnP(points, seen[ok], np.eye(3), None, turn, way, True)
        poses.append(np.concatenate([turn.ravel(), way.ravel()]))
    begin = np.concatenate([np.ravel(poses), inverse_m, [0.0]])
    ok = np.isfinite(later[..., 0])
    weight = focal_px / _TRACK_PX

    def left(state: DoubleArray) -> DoubleArray:
        place, *_ = _seen(state, rays, len(later))
        off = weight * (place - later)[ok]
        return np.concatenate([off.ravel(), (state[-1 - count : -1] - inverse_m + state[-1]) / std])

    def slopes(state: DoubleArray) -> DoubleArray:
        _, by_pose, by_depth = _seen(state, rays, len(later))
        frame, point = np.nonzero(ok)
        rows = np.arange(len(frame))
        flow_slopes = np.zeros((len(frame), 2, len(state)))
        for axis in range(6):
            flow_slopes[rows, :, 6 * frame + axis] = by_pose[frame, point, :, axis]
        flow_slopes[rows, :, 6 * len(later) + point] = by_depth[frame, point]
        depth_slopes = np.zeros((count, len(state)))
        depth_slopes[np.arange(count), 6 * len(later) + np.arange(count)] = 1 / std
        depth_slopes[:, -1] = 1 / std
        return np.concatenate([weight * flow_slopes.reshape(-1, len(state)), depth_slopes])

    found = least_squares(
        left, begin, slopes, loss="soft_l1", f_scale=_OUTLIER, x_scale="jac", max_nfev=25
    )
    information = found.jac.T @ found.jac
    scatter = max(1.0, 2 * found.cost / max(1, len(found.fun) - len(begin)))
    variance = np.linalg.pinv(information)[-1, -1] * scatter * _COMMON
    return float(found.x[-1]), float(variance)


def _seen(state: DoubleArray, rays: DoubleArray, frames: int) -> tuple[DoubleArray, ...]:
    """Projections of points [frames, n, 2], with derivatives by poses and inverse depths."""
    poses = state[: 6 * frames].reshape(frames, 6)
    inverse_m = state[6 * frames : -1]
    place = np.empty((frames, len(rays), 2))
    by_pose = np.empty((*place.shape, 6))
    by_depth = np.empty(place.shape)
    for number, pose in enumerate(poses):
        turn, by_turn = cv2.Rodrigues(pose[:3])
        v = rays @ turn.T + inverse_m[:, None] * pose[3:]
        u = place[number] = v[:, :2] / v[:, 2:]
        for axis in range(3):
            moved = rays @ by_turn[axis].reshape(3, 3).T
            by_pose[number, ..., axis] = moved[:, :2] - u * moved[:, 2:]
        by_pose[number, :, 0, 3:] = np.outer(inverse_m, [1, 0, 0])
        by_pose[number, :, 1, 3:] = np.outer(inverse_m, [0, 1, 0])
        by_pose[number, ..., 5] = -u * inverse_m[:, None]
        by_depth[number] = pose[3:5] - u * pose[5]
        by_pose[number] /= v[:, 2, None, None]
        by_depth[number] /= v[:, 2:]
    return place, by_pose, by_depth
