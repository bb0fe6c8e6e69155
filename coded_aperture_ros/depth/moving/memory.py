"""State of a video of a moving camera."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.moving.belief import Belief
from coded_aperture_ros.depth.moving.carrying import carried
from coded_aperture_ros.depth.moving.egomotion import Expected, Found, Landmarks, Motion
from coded_aperture_ros.depth.moving.fusion import fused
from coded_aperture_ros.depth.moving.geometry import Pinhole, Transfer
from coded_aperture_ros.depth.moving.parallax import Seen, with_parallax
from coded_aperture_ros.depth.moving.uncertainty import deviation_px, motion_covariance
from coded_aperture_ros.frames.pose import Pose

# How much two frames of a moving camera tell that agree: their errors have much in common. At rest
# they are the same again; they tell something new if the picture has moved by more than this, px.
_AGREEMENT, _NEW_PX = 0.3, 1.0
# Past frames that are kept, and the parallax that is best to compare with, px of the map.
_KEPT, _BEST_PARALLAX_PX, _LEAST_PARALLAX_PX = 10, 10.0, 1.0
# What is seen of a step forward, beside one to the side.
_FORWARD = 0.1
# Landmarks are looked for anew when fewer of them than this share go with the motion.
_SHARE_LEFT, _MOST_MISFIT = 0.75, 1.5
# A pose is wrong if the squared errors of landmarks are so many times what the best motion near it
# leaves, and by so much more.
_WRONG, _WRONG_BY = 2.0, 2.0
# Standard deviation of a turn that is told, as by a gyroscope: rad, and as a share of it.
_TURN, _TURN_SHARE = 0.001, 0.01
# No stated covariance of a step is taken to be less: standard deviations, m and rad.
_LEAST_SHIFT_M, _LEAST_TURN = 1e-4, 1e-5
# Frames are smoothed, which leaves so much of their noise.
_SMOOTHING_PX, _SMOOTHED = 0.7, 0.4
# Least grey of 8 bits that the middle of a frame has where landmarks are looked for, and the ratio
# of the medians of two frames from which their exposures differ.
_MIDDLE_GREY, _SAME_EXPOSURE = 80, 1.1
# Every fourth row and column is enough for a median.
_SPARSE = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Step:
    """What a frame and those before it tell together.

    Attributes
    ----------
    belief : Belief
    pose : ndarray, float64 [4, 4]
        Of the camera, as seen from the first frame since the memory began.
    motion : Motion or None
        Since an earlier frame, as landmarks tell it; None if there are too few.
    begun : bool
        Whether the memory began with this frame, as nothing tells the motion.
    refused : bool
        Whether a pose was given that the frames contradict.
    told_by_pose : bool
        Whether the motion is that of poses.
    """

    belief: Belief
    pose: DoubleArray
    motion: Motion | None = None
    begun: bool = False
    refused: bool = False
    told_by_pose: bool = False

    def __str__(self) -> str:
        """What tells how the camera has moved, in a few words."""
        if self.begun:
            told = "unknown: the memory begins"
        else:
            told = "told by the pose" if self.told_by_pose else "found in the frames"
        return f"{told}, the pose contradicts the frames" if self.refused else told


@dataclasses.dataclass(frozen=True, eq=False)
class _Last:
    """The last frame; `given` is the pose that somebody told."""

    step: Step
    light: FloatArray
    given: Pose | None


@dataclasses.dataclass(frozen=True, eq=False)
class _Key:
    """Frame whose landmarks are followed, and the motion since it, [4, 4]."""

    landmarks: Landmarks
    since: DoubleArray


@dataclasses.dataclass(frozen=True, eq=False)
class _Moved:
    """Motion since the key frame, [4, 4]; None: unknown.

    `by_landmarks` is what they tell, `given` whether it is that of a pose, and `refused` whether
    the pose contradicts them. `covariance` [6, 6] is that of the step from the last frame, if the
    poses state one.
    """

    since: DoubleArray | None
    by_landmarks: Motion | None = None
    given: bool = False
    refused: bool = False
    covariance: DoubleArray | None = None


class MovingMemory:
    """Adds up what the frames of a moving camera tell of depth.

    Parameters
    ----------
    view : Pinhole
        Of the maps.
    frames : float
        Frames after which most of what was seen is forgotten, > 0.
    workers : Workers, optional
        Threads that share the work; by default the calling one.

    Examples
    --------
    >>> view = Pinhole((48, 64), (60.0, 60.0), (31.5, 23.5))
    >>> memory = MovingMemory(view, frames=8)
    >>> light = np.random.default_rng(0).random((48, 64), np.float32)
    >>> depth = Belief(*(np.full((48, 64), value, np.float32) for value in (0.5, 1e-3, 0.6)))
    >>> memory.add(light, depth, np.eye(4)).begun
    True
    >>> again = memory.add(light, depth, np.eye(4))
    >>> again.begun, round(float(again.belief.inverse.mean()), 2)
    (False, 0.5)
    """

    def __init__(self, view: Pinhole, frames: float, workers: Workers | None = None) -> None:
        self._view, self._keep = view, float(np.exp(-1 / frames))
        self._workers = workers or Workers()
        self.reset()

    def reset(self) -> None:
        """Forget the frames so far."""
        self._last: _Last | None = None
        self._key: _Key | None = None
        self._seen: tuple[Seen, ...] = ()
        # Median of the last frame's square roots of light, and greys for one.
        self._exposure: tuple[float, float] | None = None

    def add(
        self,
        light: FloatArray,
        belief: Belief,
        pose: Pose | DoubleArray | None = None,
        noise: float = 0.0,
    ) -> Step:
        """Put the next frame's belief together with what was seen before.

        Parameters
        ----------
        light : ndarray, float32 [rows, columns]
            The frame, linear light.
        belief : Belief
            By this frame alone.
        pose : Pose or ndarray, float64 [4, 4], optional
            Turns points of the camera into those of a fixed frame, metres; its last column is NaN
            where only the turn is known, as by a gyroscope. Where its covariance is stated,
            landmarks change the motion within it, and what is carried and compared counts by as
            much less.
        noise : float, optional
            Standard deviation of the noise of `light`.
        """
        smooth = cv2.GaussianBlur(light, (0, 0), _SMOOTHING_PX)
        roots = cv2.sqrt(np.maximum(smooth, np.float32(1e-4)))
        middle = float(np.median(roots[::_SPARSE, ::_SPARSE]))
        image = np.asarray(cv2.convertScaleAbs(roots, alpha=self._greys_of(middle)), np.uint8)
        given = None if pose is None else Pose.of(pose)
        last, key, moved = self._last, self._key, self._moved(image, given)
        if last is None or key is None or moved.since is None:
            self._seen = ()
            step = Step(belief, np.eye(4), begun=True, refused=moved.refused)
        else:
            matrix = moved.since @ np.linalg.inv(key.since)
            place = last.step.pose @ np.linalg.inv(matrix)
            keep = self._keep * self._novelty(last.step.belief, matrix)
            off_px = self._spread(matrix, moved.covariance, last.step.belief.middle)
            past = carried(last.step.belief, last.light, smooth, self._view, matrix, keep, off_px)
            together = fused(past, belief, _AGREEMENT)
            misfit = 1.0 if moved.by_landmarks is None else moved.by_landmarks.misfit
            seen_noise = _SMOOTHED * noise / (2 * middle)
            together = self._with_parallax(together, roots, place, (seen_noise, misfit))
            step = Step(
                together, place, moved.by_landmarks, refused=moved.refused, told_by_pose=moved.given
            )
        self._last = _Last(step, smooth, given)
        self._keep_seen(Seen(roots, step.pose), step.belief)
        self._follow(image, step, moved)
        return step

    def _greys_of(self, middle: float) -> float:
        """Greys of 8 bits for a square root of light, by the median of a frame's.

        So many that dark scenes have landmarks, too; else only changed exposures change it: what
        comes into view changes the median by less.
        """
        before, greys = self._exposure or (middle, max(_MIDDLE_GREY / middle, 255.0))
        if not 1 / _SAME_EXPOSURE < middle / before < _SAME_EXPOSURE:
            greys *= before / middle
        self._exposure = middle, greys
        return greys

    def _spread(self, matrix: DoubleArray, covariance: DoubleArray | None, inverse: float) -> float:
        """Standard deviation of a step's end, px, by its stated covariance; past frames have it.

        0 without one.
        """
        self._seen = tuple(seen.carried(matrix, covariance) for seen in self._seen)
        return 0.0 if covariance is None else deviation_px(covariance, self._view, inverse)

    def _moved(self, image: NDArray[np.uint8], pose: Pose | None) -> _Moved:
        """Find the motion since the key frame, from the last motion on, or check a given one."""
        last, key = self._last, self._key
        if last is None or key is None:
            return _Moved(None)
        given = None
        if pose is not None and last.given is not None:
            if np.isnan(pose.matrix).any() or np.isnan(last.given.matrix).any():
                return self._moved_by_turn(image, last.given.matrix, pose.matrix)
            given = np.linalg.inv(pose.matrix) @ last.given.matrix @ key.since
            told = self._moved_by_pose(image, given, motion_covariance(last.given, pose))
            if told is not None:
                return told
        found = Found.of(key.landmarks, image, self._view, key.since)
        motion = None if found is None else found.motion(self._view, key.since)
        if motion is not None:
            return _Moved(motion.matrix, motion, refused=given is not None)
        # Where most of the view moves by itself, no one motion contradicts a pose.
        return _Moved(given, given=given is not None)

    def _moved_by_pose(
        self, image: NDArray[np.uint8], given: DoubleArray, covariance: DoubleArray | None
    ) -> _Moved | None:
        """Check a given motion since the key frame; None if landmarks contradict it.

        Within its covariance, if one is stated, they change it.
        """
        assert self._key is not None  # there is a last frame
        found = Found.of(self._key.landmarks, image, self._view, given)
        if found is None:  # nothing contradicts it
            return _Moved(given, given=True, covariance=covariance)
        near, matrix = found.improved(given, self._view), given
        if covariance is not None:
            least = np.diag([_LEAST_SHIFT_M**2] * 3 + [_LEAST_TURN**2] * 3)
            told = Expected(given, np.asarray(np.linalg.inv(covariance + least)))
            together = found.improved(given, self._view, told)
            matrix, covariance = together.matrix, together.covariance
        if found.disagreement(matrix, self._view) >= _WRONG * near.misfit + _WRONG_BY:
            return None
        return _Moved(matrix, near, given=True, covariance=covariance)

    def _moved_by_turn(
        self, image: NDArray[np.uint8], before: DoubleArray, now: DoubleArray
    ) -> _Moved:
        """Find the motion since the key frame, the turn of which is known."""
        assert self._key is not None  # there is a last frame
        key, turned = self._key, np.eye(4)
        turned[:3, :3] = now[:3, :3].T @ before[:3, :3]
        guess = turned @ key.since
        found = Found.of(key.landmarks, image, self._view, guess)
        if found is not None:
            angle = np.arccos(np.clip((np.trace(guess[:3, :3]) - 1) / 2, -1, 1))
            told = Expected.turned(guess, _TURN + _TURN_SHARE * float(angle))
            motion = found.motion(self._view, guess, told)
            if motion is not None:
                return _Moved(motion.matrix, motion)
        found = Found.of(key.landmarks, image, self._view, key.since)
        motion = None if found is None else found.motion(self._view, key.since)
        if motion is None:
            return _Moved(None)
        return _Moved(motion.matrix, motion, refused=True)

    def _novelty(self, belief: Belief, matrix: DoubleArray) -> float:
        """How much of what the frame shows was not in the last frame's windows, in [0, 1]."""
        # The middle of the picture, as far as most of it.
        middle = Pinhole((1, 1), self._view.focal_px, (0.0, 0.0))
        inverse = np.full((1, 1), belief.middle, np.float32)
        shift_px = np.hypot(*Transfer(middle.way(matrix), middle.shape).columns_rows(inverse))
        return float(1 - np.exp(-shift_px[0, 0] / _NEW_PX))

    def _with_parallax(
        self, belief: Belief, roots: FloatArray, pose: DoubleArray, errors: tuple[float, float]
    ) -> Belief:
        """Belief with what the past frame tells whose parallax suits best.

        `errors` are the noise of the roots, and the misfit of the landmarks.
        """
        if not self._seen:
            return belief
        parallax_px = self._parallax_px(self._seen, pose, belief.middle)
        index = int(np.argmin(np.abs(np.log((parallax_px + 1e-3) / _BEST_PARALLAX_PX))))
        if parallax_px[index] < _LEAST_PARALLAX_PX:
            return belief
        best = self._seen[index]
        return with_parallax(belief, (roots, best), pose, self._view, errors, self._workers)

    def _parallax_px(
        self, seen: tuple[Seen, ...], pose: DoubleArray, inverse: float
    ) -> DoubleArray:
        """About how far what has an inverse depth moved since frames, but for rotation, px [n]."""
        before = np.stack([each.pose[:3] for each in seen])
        shift = np.einsum("nij,ni->nj", before[:, :, :3], pose[:3, 3] - before[:, :, 3])
        length = np.hypot(np.hypot(shift[:, 0], shift[:, 1]), _FORWARD * shift[:, 2])
        return np.asarray(length * self._view.focal_px[0] * inverse)

    def _keep_seen(self, seen: Seen, belief: Belief) -> None:
        """Keep a frame, unless it has hardly any parallax to the last that was kept."""
        last = self._seen[-1:]
        if last and self._parallax_px(last, seen.pose, belief.middle)[0] <= _LEAST_PARALLAX_PX:
            return
        self._seen = (*self._seen, seen)[-_KEPT:]

    def _follow(self, image: NDArray[np.uint8], step: Step, moved: _Moved) -> None:
        """Go on with the landmarks, or look for new ones where they have become few or strange."""
        key, motion = self._key, moved.by_landmarks
        good = motion and motion.share >= _SHARE_LEFT and motion.misfit <= _MOST_MISFIT
        if key is not None and moved.since is not None and good:
            self._key = dataclasses.replace(key, since=moved.since)
        else:
            self._key = _Key(Landmarks.of(image, step.belief), np.eye(4))
