"""Where a camera is, and how surely."""

import dataclasses

from coded_aperture_ros.core.arrays import DoubleArray


@dataclasses.dataclass(frozen=True, eq=False)
class Pose:
    """Pose of a camera in a fixed frame.

    Attributes
    ----------
    matrix : ndarray, float64 [4, 4]
        Turns points of the camera into those of the fixed frame, metres; the last column is NaN
        where only the turn is known, as by a gyroscope.
    covariance : ndarray, float64 [6, 6], or None
        Of the camera's place, m, and of its rotation, rad, about the axes of the fixed frame, as
        `geometry_msgs/PoseWithCovariance` has it; None: unknown.

    Examples
    --------
    >>> import numpy as np
    >>> Pose.of(np.eye(4)).covariance is None
    True
    """

    matrix: DoubleArray
    covariance: DoubleArray | None = None

    @classmethod
    def of(cls, pose: "Pose | DoubleArray") -> "Pose":
        """Pose of a matrix [4, 4]; a pose is returned as it is."""
        return pose if isinstance(pose, Pose) else cls(pose)
