"""Visual odometry by Open3D, and how far the way that it finds is off."""

from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_benchmarks.run import Row
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.optics import Camera

_GAMMA = 2.2
_LARGEST_DEPTH_M = 20.0
_STEPS = (20, 15, 10)  # of the smallest picture, and so on
# Depths, intensities that differ by more do not show the same.
_SAME_DEPTH_M, _SAME_INTENSITY = 0.3, 0.1
_GRADIENT = 0.05


class Tracker:
    """Follows a camera by frames and depths, from each frame to the next."""

    def __init__(self, camera: Camera) -> None:
        self._open3d = _open3d()
        self._intrinsics = self._tensor(np.reshape(camera.intrinsics.camera_matrix, (3, 3)))
        self._before: Any = None
        self._step = np.eye(4)
        self._poses = [np.eye(4)]

    @staticmethod
    def check() -> None:
        """Refuse to begin without Open3D."""
        _open3d()

    def add(self, frame: FloatArray, depth_m: FloatArray) -> None:
        """Take the next frame, linear light, and its depth, not finite where it is unknown."""
        geometry = self._open3d.t.geometry
        shown = np.clip(frame, 0, 1).astype(np.float32) ** np.float32(1 / _GAMMA)
        known = np.where(np.isfinite(depth_m), depth_m, 0).astype(np.float32)
        picture = geometry.RGBDImage(
            geometry.Image(self._tensor(np.repeat(shown[..., None], 3, axis=2))),
            geometry.Image(self._tensor(known[..., None])),
        )
        if self._before is not None:
            self._step = self._between(picture, self._before)
            self._poses.append(self._poses[-1] @ self._step)
        self._before = picture

    def poses(self) -> DoubleArray:
        """Return the poses [frames, 4, 4] so far, as seen from the first."""
        return np.stack(self._poses)

    def _between(self, picture: Any, before: Any) -> DoubleArray:
        odometry = self._open3d.t.pipelines.odometry
        try:
            found = odometry.rgbd_odometry_multi_scale(
                picture,
                before,
                self._intrinsics,
                self._tensor(self._step),
                1.0,
                _LARGEST_DEPTH_M,
                [odometry.OdometryConvergenceCriteria(steps) for steps in _STEPS],
                odometry.Method.Intensity,
                odometry.OdometryLossParams(_SAME_DEPTH_M, _SAME_INTENSITY, _GRADIENT),
            )
        except RuntimeError:  # nothing that both frames show: it goes on as before
            return self._step
        return np.asarray(found.transformation.numpy())

    def _tensor(self, values: Any) -> Any:
        return self._open3d.core.Tensor(np.ascontiguousarray(values))


def tracked(true: DoubleArray, found: DoubleArray, segment_m: float) -> Row:
    """Return how far a way [n, 4, 4] is off, without any alignment but of its first pose.

    Drift is told over ways of a length, or half of the whole way where that is shorter.
    """
    true = np.linalg.inv(true[0]) @ true
    steps_m = np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1)
    way_m = np.concatenate([[0], np.cumsum(steps_m)])
    found_m = np.linalg.norm(np.diff(found[:, :3, 3], axis=0), axis=1)
    if not way_m[-1] > 0:
        raise InputError("the camera does not move: there is no way to follow")
    segment_m = min(segment_m, way_m[-1] / 2)
    first = np.flatnonzero(way_m <= way_m[-1] - segment_m)
    last = np.searchsorted(way_m, way_m[first] + segment_m).clip(max=len(way_m) - 1)
    length_m = way_m[last] - way_m[first]
    inverse = np.linalg.inv
    off = inverse(inverse(true[first]) @ true[last]) @ (inverse(found[first]) @ found[last])
    drift = np.linalg.norm(off[:, :3, 3], axis=1) / length_m
    turned = np.arccos(np.clip((np.trace(off[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))
    end_m = np.linalg.norm(found[-1, :3, 3] - true[-1, :3, 3])
    return {
        "drift_per_m": _rounded(np.sqrt(np.mean(drift**2))),
        "turn_per_m_deg": _rounded(np.rad2deg(np.sqrt(np.mean((turned / length_m) ** 2)))),
        "scale": _rounded(np.median(found_m) / np.median(steps_m)),
        "end_per_m": _rounded(end_m / way_m[-1]),
        "way_m": _rounded(way_m[-1]),
        "segment_m": _rounded(segment_m),
    }


def write_tum(poses: DoubleArray, path: Path) -> None:
    """Write poses as evo reads them: time, place, quaternion; a second from frame to frame."""
    from scipy.spatial.transform import Rotation  # only where trajectories are written

    turned = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    table = np.column_stack([np.arange(len(poses)), poses[:, :3, 3], turned])
    with atomic_output(path) as part:
        np.savetxt(part, table, fmt="%.6f")


def _rounded(value: float) -> float:
    return round(float(value), 5)


def _open3d() -> Any:
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise InputError(
            f"odometry needs Open3D: pip install open3d, and on Ubuntu apt install libusb-1.0-0 "
            f"({error})"
        ) from error
    return open3d
