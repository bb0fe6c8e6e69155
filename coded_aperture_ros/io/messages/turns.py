"""How a gyroscope has turned, from its angular velocities."""

import math
from collections.abc import Sequence

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.io.messages.transforms import Transforms
from coded_aperture_ros.optics.rotation import parse_imu_axes

# Between messages that are farther apart the turn is not known, s.
_LONGEST_GAP_S = 0.1
_BEGINNING, _NOW = "beginning", "now"


class Turns:
    """Orientation of a gyroscope over time, as seen from when it began.

    It drifts: what counts is how it differs between times that are not far apart.

    Examples
    --------
    >>> turns = Turns()
    >>> for stamp_ns in range(0, 1_000_000_001, 10_000_000):
    ...     turns.add(stamp_ns, (0.0, 0.0, math.pi / 2))
    >>> turns.pose(500_000_000, "x y z")[:3, :3].round(3).tolist()
    [[0.707, -0.707, 0.0], [0.707, 0.707, 0.0], [0.0, 0.0, 1.0]]
    """

    def __init__(self) -> None:
        self._transforms = Transforms()
        self._last: tuple[int, DoubleArray] | None = None
        self._turn = np.array([0.0, 0.0, 0.0, 1.0])  # quaternion x, y, z, w

    def add(self, stamp_ns: int, rate_rad_s: Sequence[float]) -> None:
        """Add an angular velocity around x, y and z of the gyroscope at a stamp; a late one not."""
        rate = np.array(rate_rad_s, np.float64)
        if not np.isfinite(rate).all() or (self._last and stamp_ns <= self._last[0]):
            return
        if self._last is not None:
            passed_s = (stamp_ns - self._last[0]) * 1e-9
            if passed_s < _LONGEST_GAP_S:
                self._turn = _product(
                    self._turn, _quaternion(passed_s * (self._last[1] + rate) / 2)
                )
        self._last = stamp_ns, rate
        self._transforms.keep(_BEGINNING, _NOW, stamp_ns, (0.0, 0.0, 0.0), self._turn.tolist())

    def pose(self, at_ns: int, axes: str) -> DoubleArray | None:
        """Pose [4, 4] of a camera at a stamp, its place NaN; None if it is not known.

        `axes` are the camera's, as axes of the gyroscope; see `parse_imu_axes`.
        """
        pose = self._transforms.pose(_BEGINNING, _NOW, at_ns)
        if pose is None:
            return None
        to_camera = np.zeros((3, 3))
        for row, (index, sign) in enumerate(parse_imu_axes(axes)):
            to_camera[row, index] = sign
        turned = np.eye(4)
        turned[:3, :3] = to_camera @ pose[:3, :3] @ to_camera.T
        turned[:3, 3] = np.nan
        return turned


def _quaternion(turn_rad: DoubleArray) -> DoubleArray:
    """Quaternion x, y, z, w of a rotation vector."""
    half = float(np.linalg.norm(turn_rad)) / 2
    return np.append(turn_rad / 2 * np.sinc(half / math.pi), math.cos(half))


def _product(first: DoubleArray, second: DoubleArray) -> DoubleArray:
    """Product of two quaternions: the second rotation, in the axes of the first."""
    (a, b), (c, d) = (first[:3], first[3]), (second[:3], second[3])
    product = np.append(b * c + d * a + np.cross(a, c), b * d - a @ c)
    return np.asarray(product / np.linalg.norm(product))
