"""Where a frame of the robot is in another at a time, from odometry, /tf and /tf_static.

tf2's own buffer is not on PyPI, and waits where this one must not: a frame of the camera is worked
on whether its pose has come or not.
"""

import dataclasses
import threading
from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Header

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.ros.messages import stamp_ns

_SECOND_NS = 1_000_000_000
# Transforms of so long are kept, and times so far beyond the newest are extrapolated, ns.
_KEPT_NS, _BEYOND_NS = 10 * _SECOND_NS, _SECOND_NS // 10
# A chain of more frames than this is a circle.
_LONGEST_CHAIN = 100


@dataclasses.dataclass(frozen=True, eq=False)
class _Transform:
    """Transform from a child frame to its parent at a time."""

    stamp_ns: int
    parent: str
    place: DoubleArray  # [3], m
    turn: DoubleArray  # [4]; unit quaternion x, y, z, w

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

    Examples
    --------
    >>> from nav_msgs.msg import Odometry
    >>> message = Odometry(child_frame_id="base_link")
    >>> message.header.frame_id, message.pose.pose.position.x = "odom", 0.2
    >>> transforms = Transforms()
    >>> transforms.receive_odometry(message)
    >>> transforms.pose("odom", "base_link", 0)[:3, 3].tolist()
    [0.2, 0.0, 0.0]
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._static: dict[str, _Transform] = {}
        self._moving: dict[str, deque[_Transform]] = {}

    def receive(self, message: Any) -> None:
        """Keep the transforms of a `tf2_msgs/TFMessage` on /tf."""
        for each in message.transforms:
            moved = each.transform
            self._keep(
                each.child_frame_id, _transform(each.header, moved.translation, moved.rotation)
            )

    def receive_odometry(self, message: Any) -> None:
        """Keep the pose of a `nav_msgs/Odometry`."""
        pose = message.pose.pose
        self._keep(
            message.child_frame_id, _transform(message.header, pose.position, pose.orientation)
        )

    def _keep(self, child: str, transform: _Transform | None) -> None:
        if transform is None:
            return
        with self._lock:
            kept = self._moving.setdefault(child.lstrip("/"), deque())
            # What comes late, or again, is left out: it is between others that are known.
            if kept and transform.stamp_ns <= kept[-1].stamp_ns:
                return
            kept.append(transform)
            while transform.stamp_ns - kept[0].stamp_ns > _KEPT_NS:
                kept.popleft()

    def receive_static(self, message: Any) -> None:
        """Keep the transforms of a `tf2_msgs/TFMessage` on /tf_static."""
        for each in message.transforms:
            moved = each.transform
            transform = _transform(each.header, moved.translation, moved.rotation)
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
        with self._lock:
            up = self._chain(frame.lstrip("/"), at_ns)
            down = self._chain(fixed_frame.lstrip("/"), at_ns)
        for name, matrix in up.items():
            if name in down:
                return np.asarray(np.linalg.inv(down[name]) @ matrix)
        return None

    def _chain(self, frame: str, at_ns: int) -> dict[str, DoubleArray]:
        """The frame and those above it, with what turns points of the frame into theirs."""
        matrix = np.eye(4)
        chain = {frame: matrix}
        for _ in range(_LONGEST_CHAIN):
            transform = self._static.get(frame) or self._at(frame, at_ns)
            if transform is None or transform.parent in chain:
                break
            matrix, frame = transform.matrix @ matrix, transform.parent
            chain[frame] = matrix
        return chain

    def _at(self, child: str, at_ns: int) -> _Transform | None:
        kept = self._moving.get(child)
        if not kept or at_ns < kept[0].stamp_ns or at_ns > kept[-1].stamp_ns + _BEYOND_NS:
            return None
        stamps = [transform.stamp_ns for transform in kept]
        after = bisect_left(stamps, at_ns)
        if len(kept) == 1 or (after < len(kept) and stamps[after] == at_ns):
            return kept[min(after, len(kept) - 1)]
        after = min(max(after, 1), len(kept) - 1)
        return _between(kept[after - 1], kept[after], at_ns)


def _between(before: _Transform, after: _Transform, at_ns: int) -> _Transform:
    """Transform between two, or on from them."""
    share = (at_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    turn = after.turn if before.turn @ after.turn >= 0 else -after.turn
    turn = (1 - share) * before.turn + share * turn
    place = (1 - share) * before.place + share * after.place
    return _Transform(at_ns, after.parent, place, turn / np.linalg.norm(turn))


def _transform(header: Header, place: Any, turn: Any) -> _Transform | None:
    """Transform of a position and a quaternion; None if they are none."""
    values = np.array([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w], np.float64)
    length = np.linalg.norm(values[3:])
    if not np.isfinite(values).all() or not 0.9 < length < 1.1:
        return None
    parent = header.frame_id.lstrip("/")
    return _Transform(stamp_ns(header), parent, values[:3], values[3:] / length)


def listen_to_poses(listen: Callable[..., None], transforms: Transforms) -> str:
    """Subscribe to odometry, /tf and /tf_static; return the package that is missing, if one is.

    Parameters
    ----------
    listen : callable
        Of a node: takes a topic, a type, a callback and a QoS profile.
    transforms : Transforms
    """
    many = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    listen("odometry", Odometry, transforms.receive_odometry, many)
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        return "tf2_msgs"
    listen("/tf", TFMessage, transforms.receive, many)
    listen("/tf_static", TFMessage, transforms.receive_static, latched)
    return ""
