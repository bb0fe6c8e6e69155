"""Where a frame of the robot is in another at a time, from odometry, /tf and /tf_static.

tf2's own buffer is not on PyPI, and waits where this one must not: a frame of the camera is worked
on whether its pose has come or not.
"""

import dataclasses
import threading
from bisect import bisect_left
from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.frames.pose import Pose
from coded_aperture_ros.io.messages.encodings import stamp_ns

_SECOND_NS = 1_000_000_000
# Times so far beyond the newest transform are extrapolated, ns.
_BEYOND_NS = _SECOND_NS // 10
# A chain of more frames than this is a circle.
_LONGEST_CHAIN = 100
# Least eigenvalue of a covariance, as a share of its largest number: messages round.
_ROUNDED = 1e-6
# Of a place, m, and of a unit quaternion.
_Numbers = tuple[tuple[float, ...], tuple[float, ...]]


@dataclasses.dataclass(frozen=True, eq=False)
class _Transform:
    """Transform from a child frame to its parent at a time."""

    stamp_ns: int
    parent: str
    place: DoubleArray  # [3], m
    turn: DoubleArray  # [4]; unit quaternion x, y, z, w
    # [6, 6], of place and rotation about the parent's axes; 0: exact; None: unknown
    covariance: DoubleArray | None

    @property
    def matrix(self) -> DoubleArray:
        """Turns points of the child into those of the parent [4, 4]."""
        from scipy.spatial.transform import Rotation  # poses are told to few

        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_quat(self.turn).as_matrix()
        matrix[:3, 3] = self.place
        return matrix


class Transforms:
    """Transforms of the last seconds; safe to use from several threads.

    Parameters
    ----------
    kept_s : float
        How old they may become, s.

    Examples
    --------
    >>> transforms = Transforms()
    >>> transforms.keep("odom", "base_link", 0, (0.2, 0, 0), (0, 0, 0, 1))
    >>> transforms.pose("odom", "base_link", 0)[:3, 3].tolist()
    [0.2, 0.0, 0.0]
    """

    def __init__(self, kept_s: float = 10.0) -> None:
        self._lock = threading.Lock()
        self._kept_ns = kept_s * _SECOND_NS
        self._static: dict[str, _Transform] = {}
        self._moving: dict[str, list[_Transform]] = {}

    @property
    def frames(self) -> list[str]:
        """Names of all frames, in alphabetical order."""
        parents = self._parents()
        return sorted({*parents, *parents.values()})

    def connects(self, fixed_frame: str, frame: str) -> bool:
        """Whether a frame's place in a fixed one is known at some time."""
        parents, above = self._parents(), []
        for start in (fixed_frame, frame):
            names = [start.lstrip("/")]
            while names[-1] in parents and len(names) < _LONGEST_CHAIN:
                names.append(parents[names[-1]])
            above.append(set(names))
        return bool(above[0] & above[1])

    def add_missing(self, others: "Transforms") -> None:
        """Add the moving frames of others that are not here."""
        with self._lock:
            self._moving = others._moving | self._moving

    def _parents(self) -> dict[str, str]:
        with self._lock:
            moving = {child: kept[-1].parent for child, kept in self._moving.items()}
            return moving | {child: each.parent for child, each in self._static.items()}

    def keep(
        self,
        parent: str,
        child: str,
        at_ns: int,
        place: Sequence[float],
        turn: Sequence[float],
        covariance: DoubleArray | None = None,
    ) -> None:
        """Keep a transform from a child frame to its parent.

        What comes late, or again, or is no transform, is left out.

        Parameters
        ----------
        parent, child : str
            With or without a slash before the name.
        at_ns : int
            Stamp, ns.
        place : 3 numbers
            Of the child in the parent, m.
        turn : 4 numbers
            Unit quaternion, x, y, z, w.
        covariance : ndarray, float64 [6, 6], optional
            Of the child's place, m, and of its rotation, rad, about the axes of the parent.
        """
        transform = _transform(parent, at_ns, place, turn, covariance)
        if transform is None:
            return
        with self._lock:
            kept = self._moving.setdefault(child.lstrip("/"), [])
            # What comes late is between others that are known; odometry knows more than /tf.
            if kept and transform.stamp_ns <= kept[-1].stamp_ns:
                if transform.stamp_ns < kept[-1].stamp_ns or covariance is None:
                    return
                del kept[-1]
            kept.append(transform)
            oldest_ns = transform.stamp_ns - self._kept_ns
            del kept[: bisect_left(kept, oldest_ns, key=attrgetter("stamp_ns"))]

    def receive(self, message: Any) -> None:
        """Keep the transforms of a `tf2_msgs/TFMessage` on /tf."""
        for each in message.transforms:
            moved = each.transform
            self._receive(each, _numbers(moved.translation, moved.rotation))

    def receive_odometry(self, message: Any) -> None:
        """Keep the pose of a `nav_msgs/Odometry`."""
        told = message.pose
        numbers = _numbers(told.pose.position, told.pose.orientation)
        self._receive(message, numbers, stated_covariance(told.covariance))

    def _receive(
        self, message: Any, numbers: _Numbers, covariance: DoubleArray | None = None
    ) -> None:
        header = message.header
        names = header.frame_id, message.child_frame_id
        self.keep(*names, stamp_ns(header), *numbers, covariance)

    def receive_static(self, message: Any) -> None:
        """Keep the transforms of a `tf2_msgs/TFMessage` on /tf_static."""
        for each in message.transforms:
            moved = each.transform
            numbers = _numbers(moved.translation, moved.rotation)
            transform = _transform(each.header.frame_id, 0, *numbers, np.zeros((6, 6)))
            if transform is not None:
                with self._lock:
                    self._static[each.child_frame_id.lstrip("/")] = transform

    def forget(self) -> None:
        """Forget what moves, for example after the clock has jumped back."""
        with self._lock:
            self._moving.clear()

    def pose(self, fixed_frame: str, frame: str, at_ns: int) -> DoubleArray | None:
        """Turns points of a frame into those of a fixed one, at a time; None if it is not known.

        Parameters
        ----------
        fixed_frame, frame : str
            With or without a slash before the name.
        at_ns : int
            Stamp, ns. Between transforms it is interpolated; up to 0.1 s after the newest one it
            goes on as before.

        Returns
        -------
        ndarray, float64 [4, 4], or None
        """
        found = self.located(fixed_frame, frame, at_ns)
        return None if found is None else found.matrix

    def located(self, fixed_frame: str, frame: str, at_ns: int) -> Pose | None:
        """The same, with its covariance, where every transform on the way has one.

        Those of /tf have none, those of /tf_static are exact.
        """
        with self._lock:
            up = self._chain(frame.lstrip("/"), at_ns)
            down = self._chain(fixed_frame.lstrip("/"), at_ns)
        for name, pose in up.items():
            if name in down:
                return _seen_from(down[name], pose)
        return None

    def _chain(self, frame: str, at_ns: int) -> dict[str, Pose]:
        """The frame and those above it, with the frame's pose in them."""
        pose = Pose(np.eye(4), np.zeros((6, 6)))
        chain = {frame: pose}
        for _ in range(_LONGEST_CHAIN):
            transform = self._static.get(frame) or self._at(frame, at_ns)
            if transform is None or transform.parent in chain:
                break
            pose, frame = _put_above(pose, transform), transform.parent
            chain[frame] = pose
        return chain

    def _at(self, child: str, at_ns: int) -> _Transform | None:
        kept = self._moving.get(child)
        if not kept or at_ns < kept[0].stamp_ns or at_ns > kept[-1].stamp_ns + _BEYOND_NS:
            return None
        after = bisect_left(kept, at_ns, key=attrgetter("stamp_ns"))
        if len(kept) == 1 or (after < len(kept) and kept[after].stamp_ns == at_ns):
            return kept[min(after, len(kept) - 1)]
        after = min(max(after, 1), len(kept) - 1)
        return _between(kept[after - 1], kept[after], at_ns)


def _between(before: _Transform, after: _Transform, at_ns: int) -> _Transform:
    """Transform between two, or on from them."""
    share = (at_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    turn = after.turn if before.turn @ after.turn >= 0 else -after.turn
    turn = (1 - share) * before.turn + share * turn
    place = (1 - share) * before.place + share * after.place
    covariance = after.covariance
    if before.covariance is not None and covariance is not None and share < 1:
        covariance = (1 - share) * before.covariance + share * covariance
    return _Transform(at_ns, after.parent, place, turn / np.linalg.norm(turn), covariance)


def _put_above(pose: Pose, transform: _Transform) -> Pose:
    """Pose of a frame in the parent of the one that it is in."""
    matrix = transform.matrix
    if pose.covariance is None or transform.covariance is None:
        return Pose(matrix @ pose.matrix)
    turned = np.kron(np.eye(2), matrix[:3, :3])
    # What turns the child moves what is away from it.
    x, y, z = matrix[:3, :3] @ pose.matrix[:3, 3]
    lever = np.eye(6)
    lever[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    covariance = turned @ pose.covariance @ turned.T + lever @ transform.covariance @ lever.T
    return Pose(matrix @ pose.matrix, covariance)


def _seen_from(fixed: Pose, pose: Pose) -> Pose:
    """Pose of a frame in a fixed one, of both in a third; its covariance if the fixed is exact."""
    back = np.asarray(np.linalg.inv(fixed.matrix))
    matrix = back @ pose.matrix
    if pose.covariance is None or fixed.covariance is None or fixed.covariance.any():
        return Pose(matrix)
    turned = np.kron(np.eye(2), back[:3, :3])
    return Pose(matrix, turned @ pose.covariance @ turned.T)


def stated_covariance(values: Any) -> DoubleArray | None:
    """Covariance [6, 6] of a message's 36 numbers; None if it states none.

    That is all 0, or begins with -1, as messages have it that know none, or is no covariance.

    Examples
    --------
    >>> import numpy as np
    >>> stated_covariance([0.0] * 36) is None
    True
    >>> float(stated_covariance(np.eye(6).ravel())[0, 0])
    1.0
    """
    covariance = np.array(values, np.float64).reshape(6, 6)
    if not np.isfinite(covariance).all() or not covariance.any():
        return None
    covariance = (covariance + covariance.T) / 2
    least = np.linalg.eigvalsh(covariance)[0]
    return None if least < -_ROUNDED * np.abs(covariance).max() else covariance


def _numbers(place: Any, turn: Any) -> _Numbers:
    """Numbers of messages of a point and a quaternion."""
    return (place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w)


def _transform(
    parent: str,
    at_ns: int,
    place: Sequence[float],
    turn: Sequence[float],
    covariance: DoubleArray | None = None,
) -> _Transform | None:
    """Transform of a position and a quaternion; None if they are none."""
    values = np.array([*place, *turn], np.float64)
    length = np.linalg.norm(values[3:])
    if not np.isfinite(values).all() or not 0.9 < length < 1.1:
        return None
    return _Transform(at_ns, parent.lstrip("/"), values[:3], values[3:] / length, covariance)
