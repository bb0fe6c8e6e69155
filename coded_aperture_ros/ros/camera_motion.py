"""How a node's camera moves: poses that it is told, and the way that it has found."""

import functools
from collections.abc import Callable

from nav_msgs.msg import Odometry
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Header

from coded_aperture_ros.depth.moving import Place, Step, Trajectory
from coded_aperture_ros.frames.pose import Pose
from coded_aperture_ros.io.messages import Transforms
from coded_aperture_ros.ros.messages import odometry_from_place, stamp_ns

# For topics of which no message may be missed, and many come between two frames.
MANY = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


class CameraMotion:
    """Poses for frames, and odometry of what the frames tell.

    Parameters
    ----------
    logger : RcutilsLogger

    Attributes
    ----------
    note : str
        What tells the motion, for /diagnostics; see `Step`.
    """

    def __init__(self, logger: RcutilsLogger) -> None:
        self.note = ""
        self._logger = logger
        self._transforms = Transforms()
        self._listens = False
        self.restart()

    def listen(self, listen: Callable[..., None]) -> None:
        """Subscribe to poses; `listen` is that of a `FrameNode`."""
        self._listens = True
        if missing := _listen_to_poses(listen, self._transforms):
            self._logger.warning(f"poses: of odometry alone, not of tf: no package {missing}")

    def forget_poses(self) -> None:
        """Forget what was told, for example after the clock has jumped back."""
        self._transforms.forget()

    def restart(self) -> None:
        """Begin the way anew, with the next frame."""
        self._trajectory = Trajectory()
        self._place: Place | None = None
        self._moved_ns = self._since_ns = 0

    def pose_of(self, header: Header, fixed_frame: str) -> Callable[[], Pose | None] | None:
        """What gives the camera's pose at a stamp, when it is needed; None without poses."""
        if not self._listens:
            self._logger.warning(
                "temporal.moving_camera: pose has to be set when the node starts: until then the "
                "motion is found in the frames",
                once=True,
            )
            return None
        stamp = stamp_ns(header)
        return functools.partial(self._transforms.located, fixed_frame, header.frame_id, stamp)

    def follow(self, step: Step | None, header: Header) -> None:
        """Go on by what a frame tells of the motion; None: it is not followed."""
        self.note = str(step or "")
        self._place = None if step is None else self._trajectory.add(step)
        self._since_ns, self._moved_ns = stamp_ns(header) - self._moved_ns, stamp_ns(header)

    def odometry(self, header: Header) -> Odometry | None:
        """Where the camera is after the last frame; None where its motion is not known."""
        if self._place is None:
            return None
        return odometry_from_place(self._place, header, self._since_ns * 1e-9)


def _listen_to_poses(listen: Callable[..., None], transforms: Transforms) -> str:
    """Subscribe to odometry, /tf and /tf_static; return the package that is missing, if one is.

    Parameters
    ----------
    listen : callable
        Of a node: takes a topic, a type, a callback and a QoS profile.
    transforms : Transforms
    """
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    listen("odometry", Odometry, transforms.receive_odometry, MANY)
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        return "tf2_msgs"
    listen("/tf", TFMessage, transforms.receive, MANY)
    listen("/tf_static", TFMessage, transforms.receive_static, latched)
    return ""
