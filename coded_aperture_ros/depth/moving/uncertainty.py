"""How surely a motion between two views is known, and what that means in pixels."""

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.depth.moving.geometry import Pinhole
from coded_aperture_ros.frames.pose import Pose


def carries(motion: DoubleArray) -> DoubleArray:
    """Matrix [6, 6] that turns small translations and rotations before a motion into those after.

    Examples
    --------
    >>> ahead = np.eye(4)
    >>> ahead[2, 3] = 2.0
    >>> (carries(ahead) @ [0, 0, 0, 0.1, 0, 0]).tolist()  # a turn moves what is ahead
    [0.0, 0.2, 0.0, 0.1, 0.0, 0.0]
    """
    turn, (x, y, z) = motion[:3, :3], motion[:3, 3]
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.block([[turn, across @ turn], [np.zeros((3, 3)), turn]])


def motion_covariance(before: Pose, after: Pose) -> DoubleArray | None:
    """Covariance [6, 6] of the motion between two poses, as the later view has it; None: unknown.

    What both poses have in common is no error of the motion. If the covariance grows, as that of
    odometry does, the motion adds what it grows by; if it shrinks, as when a place is recognised,
    the pose was corrected by so much (the estimates of a Kalman filter are uncorrelated with their
    own errors). Where a filter does both at once it is a lower bound.
    """
    if before.covariance is None or after.covariance is None:
        return None
    turned = np.eye(4)
    turned[:3, 3] = before.matrix[:3, 3] - after.matrix[:3, 3]
    lever = carries(turned)
    # Errors of the place before, and those that its rotation makes at the place after.
    grown = after.covariance - lever @ before.covariance @ lever.T
    values, axes = np.linalg.eigh((grown + grown.T) / 2)
    into = np.kron(np.eye(2), after.matrix[:3, :3].T)
    axes = into @ axes
    return np.asarray((axes * np.abs(values)) @ axes.T)


def deviation_px(covariance: DoubleArray, view: Pinhole, inverse: float) -> float:
    """Standard deviation, px, of where the middle of a view is after a motion.

    Parameters
    ----------
    covariance : ndarray, float64 [6, 6]
        Of the motion: translation, m, and rotation, rad, as the later view has them.
    view : Pinhole
    inverse : float
        Inverse depth of what is there, 1/m.

    Examples
    --------
    >>> view = Pinhole((120, 160), (150.0, 150.0), (79.5, 59.5))
    >>> to_the_side = np.diag([0.01**2, 0.01**2, 0, 0, 0, 0])
    >>> round(deviation_px(to_the_side, view, 0.5), 3)
    0.75
    """
    fx, fy = view.focal_px
    slopes = np.array([[fx * inverse, 0, 0, 0, fx, 0], [0, fy * inverse, 0, -fy, 0, 0]])
    return float(np.sqrt(np.trace(slopes @ covariance @ slopes.T) / 2))
