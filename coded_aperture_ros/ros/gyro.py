"""What a gyroscope says about the motion of a frame."""

import dataclasses
import threading
from collections import deque

from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.frames import ExpectedMotion
from coded_aperture_ros.optics import Intrinsics
from coded_aperture_ros.optics.rotation import expected_motion, parse_imu_axes
from coded_aperture_ros.ros.messages import stamp_ns

# A second of a fast gyroscope: frames are worked on a little after they were taken.
_KEPT = 1000


@dataclasses.dataclass(frozen=True)
class GyroConfig:
    """How messages on `imu` are used to know the motion of a frame."""

    parameter_group = "motion."
    exposure_s: float = option(
        0.0, "Exposure time of the frames; 0: not known", unit="s", within=(0.0, 10.0)
    )
    imu_axes: str = option(
        "-y -z x",
        "The camera's axes right, down and forward as axes of the gyroscope; the default is for "
        "one with x forward, y left and z up that looks where the camera looks",
    )

    def __post_init__(self) -> None:
        check_options(self)
        parse_imu_axes(self.imu_axes)


class Gyro:
    """Remembers what the gyroscope said lately; safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lately: deque[tuple[int, tuple[float, float, float]]] = deque(maxlen=_KEPT)

    def receive(self, message: Imu) -> None:
        """Remember a message."""
        rate = message.angular_velocity
        with self._lock:
            self._lately.append((stamp_ns(message.header), (rate.x, rate.y, rate.z)))

    def forget(self) -> None:
        """Forget everything, as when time has gone back."""
        with self._lock:
            self._lately.clear()

    def expected(
        self, header: Header, config: GyroConfig, intrinsics: Intrinsics
    ) -> ExpectedMotion:
        """Return the motion that is expected of a frame; with a reason where it is not known."""
        stamp = stamp_ns(header)
        with self._lock:
            nearest = min(self._lately, key=lambda said: abs(said[0] - stamp), default=None)
        if nearest is None:
            return expected_motion(None, config.exposure_s, intrinsics)
        axes = parse_imu_axes(config.imu_axes)
        rates = tuple(sign * nearest[1][index] for index, sign in axes)
        delay_s = (nearest[0] - stamp) * 1e-9
        return expected_motion(rates, config.exposure_s, intrinsics, delay_s)
