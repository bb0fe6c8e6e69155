"""Way of a camera, from what the estimates of its frames tell of the motion."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.depth.moving.memory import Step
from coded_aperture_ros.depth.moving.uncertainty import carries


@dataclasses.dataclass(frozen=True, eq=False)
class Place:
    """Where a camera is, and how it got there.

    Attributes
    ----------
    pose : ndarray, float64 [4, 4]
        Turns points of the camera into those of its first frame, metres.
    covariance : ndarray, float64 [6, 6]
        Of the pose: translation, m, and rotation, rad, as the camera has them.
    moved : ndarray, float64 [6]
        Translation, m, and rotation vector, rad, since the last frame, as the camera has them.
    moved_covariance : ndarray, float64 [6, 6]
    """

    pose: DoubleArray
    covariance: DoubleArray
    moved: DoubleArray
    moved_covariance: DoubleArray


class Trajectory:
    """Puts steps together.

    Attributes
    ----------
    lost : int
        How often a frame did not tell the motion. The way then goes on as in the last step.

    Examples
    --------
    >>> from coded_aperture_ros.depth.moving.belief import Belief
    >>> nothing = Belief(*np.zeros((3, 2, 2), np.float32))
    >>> way = Trajectory()
    >>> way.add(Step(nothing, np.eye(4), begun=True)) is None
    True
    >>> forward = np.eye(4)
    >>> forward[2, 3] = 0.1
    >>> way.add(Step(nothing, forward)).moved.tolist()
    [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    """

    def __init__(self) -> None:
        self.lost = 0
        self.pose = np.eye(4)
        self._begun = False
        self._origin = self._step = np.eye(4)
        self._covariance = np.zeros((6, 6))

    def add(self, step: Step) -> Place | None:
        """Place of the next frame's camera; None where the frames do not tell."""
        if step.begun:
            self.lost += self._begun
            self._origin = self.pose = self.pose @ self._step if self._begun else self.pose
            self._begun = True
            return None
        pose = self._origin @ step.pose
        self._step = np.linalg.inv(self.pose) @ pose
        self.pose = pose
        # Points of the last view into those of this one.
        into = np.asarray(np.linalg.inv(self._step), np.float64)
        by_landmarks = np.zeros((6, 6)) if step.motion is None else step.motion.covariance
        carried = carries(into)
        self._covariance = carried @ self._covariance @ carried.T + by_landmarks
        moved = np.concatenate([-into[:3, 3], -cv2.Rodrigues(into[:3, :3])[0].ravel()])
        return Place(pose, self._covariance, moved + 0.0, by_landmarks)
