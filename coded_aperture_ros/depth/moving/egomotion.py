"""Motion of the camera between two frames, by points whose depth is believed.

The depths are those of this lens, and so is the scale of the motion. They are uncertain: what is
off along a point's epipolar line counts by as much as its depth allows.
"""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.depth.moving.belief import Belief
from coded_aperture_ros.depth.moving.equations import add_equations
from coded_aperture_ros.depth.moving.geometry import Pinhole

# Points that are looked for, by OpenCV: how many, their least quality and distance, px. They are
# spread: something textured that moves by itself must not have most of them.
_POINTS, _QUALITY, _APART_PX, _CORNER_PX = 200, 0.0005, 11, 5
_FEWEST = 20
_LEAST_CONFIDENCE, _LEAST_INVERSE = 0.3, 0.02
# Search for them: window and levels of half the size; and how far the way back may miss them, px.
_SEARCH_PX, _LEVELS, _BACK_LEVELS, _RETURN_PX = 13, 3, 1, 0.5
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
# Beginning of the motion: distance of points that agree, px, and tries.
_AGREE_PX, _TRIES = 1.0, 100
# What is added to the standard deviation of a point's inverse depth, a share.
_DEPTH_SHARE = 0.05
# Errors of depth are common to points: motions on walks were three times as far off as by errors of
# each point's own.
_COMMON = 3.0
_ROUNDS, _CONVERGED, _HELD = 8, 1e-5, 1e-13
# Normalised squared errors that are no error of these points. A motion with a larger median of them
# is none.
_OUTLIER, _MOST_MISFIT = 9.0, 5.0
# What a guess leads to is taken at once if the median and the share that goes with it are so good.
_GOOD_MISFIT, _GOOD_SHARE = 1.5, 0.6


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """Motion between two views.

    Attributes
    ----------
    matrix : ndarray, float64 [4, 4]
        Turns points of the earlier view into those of the later one, metres.
    covariance : ndarray, float64 [6, 6]
        Of the translation, m, and the rotation, rad, as the later view has them.
    share : float
        How many of all landmarks are found and go with it, in [0, 1].
    misfit : float
        Median of their normalised squared errors; about 1 if these are what is expected.
    """

    matrix: DoubleArray
    covariance: DoubleArray
    share: float
    misfit: float


@dataclasses.dataclass(frozen=True, eq=False)
class Expected:
    """Motion between two views as it is known beforehand.

    Attributes
    ----------
    matrix : ndarray, float64 [4, 4]
    information : ndarray, float64 [6, 6]
        Inverse of the covariance of its translation, m, and rotation, rad, as the later view has
        them; 0 where nothing is known.
    """

    matrix: DoubleArray
    information: DoubleArray

    @classmethod
    def turned(cls, matrix: DoubleArray, deviation: float) -> "Expected":
        """Motion of which only the rotation is known, to a deviation around each axis, rad."""
        return cls(matrix, np.diag([0, 0, 0, *(deviation**-2.0,) * 3]))

    def add_to(self, information: DoubleArray, pull: DoubleArray, matrix: DoubleArray) -> None:
        """Add to the normal equations [6, 6] and [6] of a change of a motion [4, 4]."""
        turn = self.matrix[:3, :3] @ matrix[:3, :3].T
        shift = self.matrix[:3, 3] - turn @ matrix[:3, 3]
        weight = _COMMON**2 * self.information
        information += weight
        pull += weight @ np.concatenate([shift, cv2.Rodrigues(turn)[0].ravel()])


@dataclasses.dataclass(frozen=True, eq=False)
class Landmarks:
    """Points of a frame that can be found again.

    Attributes
    ----------
    image : ndarray, uint8 [rows, columns]
    pixels : ndarray, float32 [n, 2]
        Column and row.
    inverse, variance : ndarray, float64 [n]
        Inverse depth, 1/m, and its variance.
    """

    image: NDArray[np.uint8]
    pixels: FloatArray
    inverse: DoubleArray
    variance: DoubleArray

    @classmethod
    def of(cls, image: NDArray[np.uint8], belief: Belief) -> "Landmarks":
        """Points of an image whose depth is believed; none, if there is no texture."""
        found = cv2.goodFeaturesToTrack(image, _POINTS, _QUALITY, _APART_PX, blockSize=_CORNER_PX)
        pixels = np.zeros((0, 2), np.float32) if found is None else found.reshape(-1, 2)
        columns, rows = np.rint(pixels).astype(int).T
        inverse = belief.inverse[rows, columns].astype(np.float64)
        known = belief.confidence[rows, columns] > _LEAST_CONFIDENCE
        known &= inverse > _LEAST_INVERSE
        variance = belief.variance[rows, columns] + np.square(_DEPTH_SHARE * inverse)
        return cls(image, pixels[known], inverse[known], variance[known])

    def some(self, which: BoolArray) -> "Landmarks":
        """Those of the points that a mask [n] has."""
        of_points = self.pixels[which], self.inverse[which], self.variance[which]
        return Landmarks(self.image, *of_points)

    def moved(self, view: Pinhole, matrix: DoubleArray) -> DoubleArray:
        """Pixels [n, 2] where the points are after a motion [4, 4]."""
        points = np.column_stack([view.rays(self.pixels), np.ones(len(self.pixels))])
        points = points @ matrix[:3, :3].T + self.inverse[:, None] * matrix[:3, 3]
        return view.pixels(points[:, :2] / np.maximum(points[:, 2:], 1e-3))

    def followed(
        self, image: NDArray[np.uint8], expected: DoubleArray
    ) -> tuple[DoubleArray, BoolArray]:
        """Pixels [n, 2] of the points in another image, and which of them were found.

        `expected` is where to begin, [n, 2].
        """
        if not len(self.pixels):
            return np.zeros((0, 2)), np.zeros(0, np.bool_)
        found, there, _ = self._search(self.image, image, self.pixels, expected, _LEVELS)
        again, back, _ = self._search(image, self.image, found, self.pixels, _BACK_LEVELS)
        missed = np.abs(again - self.pixels).max(axis=1)
        ok = (there.ravel() > 0) & (back.ravel() > 0) & (missed < _RETURN_PX)
        return found.astype(np.float64), ok

    @staticmethod
    def _search(
        first: NDArray[np.uint8],
        second: NDArray[np.uint8],
        pixels: FloatArray,
        begin: FloatArray | DoubleArray,
        levels: int,
    ) -> tuple[FloatArray, NDArray[np.uint8], FloatArray]:
        return cv2.calcOpticalFlowPyrLK(
            first,
            second,
            np.ascontiguousarray(pixels),
            np.array(begin, np.float32),
            winSize=(_SEARCH_PX, _SEARCH_PX),
            maxLevel=levels,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
            criteria=_CRITERIA,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """Landmarks that were found again in a later frame.

    Attributes
    ----------
    landmarks : Landmarks
        Those that were found.
    pixels : ndarray, float64 [n, 2]
        Where they are there.
    share : float
        How many of all were found, in [0, 1].
    """

    landmarks: Landmarks
    pixels: DoubleArray
    share: float

    @classmethod
    def of(
        cls, landmarks: Landmarks, image: NDArray[np.uint8], view: Pinhole, guess: DoubleArray
    ) -> "Found | None":
        """Landmarks in a later image, searched for from a guessed motion on; None: too few."""
        pixels, found = landmarks.followed(image, landmarks.moved(view, guess))
        if found.sum() < _FEWEST:
            return None
        return cls(landmarks.some(found), pixels[found], float(found.mean()))

    def motion(
        self, view: Pinhole, guess: DoubleArray, expected: Expected | None = None
    ) -> Motion | None:
        """Motion since the frame of the landmarks; None if too few points agree.

        A guess [4, 4] from which they all but agree is where it begins.
        """
        near = self.improved(guess, view, expected)
        if near.misfit < _GOOD_MISFIT and near.share > _GOOD_SHARE:
            return near
        begin = _beginning(self.landmarks, self.pixels, view)
        motion = None if begin is None else self.improved(begin, view, expected)
        return motion if motion is not None and motion.misfit < _MOST_MISFIT else None

    def improved(
        self, matrix: DoubleArray, view: Pinhole, expected: Expected | None = None
    ) -> Motion:
        """Likeliest motion near one [4, 4]."""
        motion = _improved(matrix, self, view, expected)
        return dataclasses.replace(motion, share=motion.share * self.share)

    def disagreement(self, matrix: DoubleArray, view: Pinhole) -> float:
        """Median of the normalised squared errors under a motion [4, 4]; about 1 if it is right."""
        return float(np.median(_normal_equations(self.landmarks, self.pixels, view, matrix)[0]))


def _beginning(landmarks: Landmarks, pixels: DoubleArray, view: Pinhole) -> DoubleArray | None:
    """Motion [4, 4] by the points that agree; None if there is none."""
    depth = 1 / landmarks.inverse
    points = np.column_stack([view.rays(landmarks.pixels) * depth[:, None], depth])
    cv2.setRNGSeed(0)  # the same frames give the same motion
    ok, turn, shift, agree = cv2.solvePnPRansac(
        points,
        pixels,
        view.matrix,
        np.zeros(0),
        iterationsCount=_TRIES,
        reprojectionError=_AGREE_PX,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not ok or agree is None or len(agree) < _FEWEST:
        return None
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return matrix


def _improved(
    matrix: DoubleArray, found: Found, view: Pinhole, expected: Expected | None
) -> Motion:
    """Likeliest motion near a first one; outliers count less (Cauchy's weights)."""
    for _ in range(_ROUNDS):
        equations = _normal_equations(found.landmarks, found.pixels, view, matrix)
        squares, information, pull = equations
        if expected is not None:
            expected.add_to(information, pull, matrix)
        # Where nothing tells a direction, nothing changes in it.
        held = information + _HELD * np.trace(information) * np.eye(6)
        change = np.linalg.solve(held, pull)
        turned = cv2.Rodrigues(change[3:])[0]
        matrix = matrix.copy()
        matrix[:3, 3] = turned @ matrix[:3, 3] + change[:3]
        matrix[:3, :3] = turned @ matrix[:3, :3]
        if np.abs(change).max() < _CONVERGED:
            break
    share, misfit = float((squares < _OUTLIER).mean()), float(np.median(squares))
    covariance = np.asarray(_COMMON**2 * np.linalg.pinv(information), np.float64)
    return Motion(matrix, covariance, share, misfit)


def _normal_equations(
    landmarks: Landmarks, pixels: DoubleArray, view: Pinhole, matrix: DoubleArray
) -> tuple[DoubleArray, DoubleArray, DoubleArray]:
    """Normalised squared errors [n], their information on a change [6, 6], and its pull [6].

    Along a point's epipolar line and across it: only along the line counts how uncertain its depth
    is. A change is that of translation and rotation.
    """
    squares, system = np.empty(len(pixels)), np.empty((7, 6))
    points = view.rays(landmarks.pixels), landmarks.inverse, landmarks.variance
    add_equations(points, pixels, (view.focal_px, view.centre), matrix, (squares, system))
    return squares, system[:6], system[6]
