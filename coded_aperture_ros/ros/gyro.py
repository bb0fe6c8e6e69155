"""Expected motion of a frame, from a gyroscope."""

import dataclasses
import threading
from collections import deque

from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.frames import ExpectedMotion
from coded_aperture_ros.io.messages import Turns
from coded_aperture_ros.optics import Intrinsics
from coded_aperture_ros.optics.rotation import expected_motion, parse_imu_axes
from coded_aperture_ros.ros.messages import stamp_ns

# Messages kept: one second of a fast gyroscope, as frames are processed a little after exposure.
_KEPT_MESSAGES = 1000


@dataclasses.dataclass(frozen=True)
class GyroConfig:
    """How the motion of a frame follows from messages on `imu`."""

    parameter_group = "motion."
    exposure_s: float = option(
        0.0, "Exposure time of the frames; 0: unknown", unit="s", within=(0.0, 10.0)
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
    """Newest messages of a gyroscope; safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # Stamps, ns, and angular velocities, rad/s.
        self._rates: deque[tuple[int, tuple[float, float, float]]] = deque(maxlen=_KEPT_MESSAGES)
        self._turns = Turns()

    def receive(self, message: Imu) -> None:
        """Keep a message."""
        rate = message.angular_velocity
        with self._lock:
            self._rates.append((stamp_ns(message.header), (rate.x, rate.y, rate.z)))
            self._turns.add(*self._rates[-1])

    def forget(self) -> None:
        """Forget all messages, for example after the clock has jumped back."""
        with self._lock:
            self._rates.clear()
            self._turns = Turns()

    def pose(self, at_ns: int, config: GyroConfig) -> DoubleArray | None:
        """Turn of the camera at a stamp, as `Frame.pose` has it; None if it is not known."""
        with self._lock:
            turns = self._turns
        return turns.pose(at_ns, config.imu_axes)

    def expected(
        self, header: Header, config: GyroConfig, intrinsics: Intrinsics
    ) -> ExpectedMotion:
        """Expected motion of a frame, with the reason where it is unknown."""
        stamp = stamp_ns(header)
        with self._lock:
            nearest = min(self._rates, key=lambda each: abs(each[0] - stamp), default=None)
        if nearest is None:
            return expected_motion(None, config.exposure_s, intrinsics)
        rate_stamp, rate = nearest
        axes = parse_imu_axes(config.imu_axes)
        rates = tuple(sign * rate[index] for index, sign in axes)
        delay_s = (rate_stamp - stamp) * 1e-9
        return expected_motion(rates, config.exposure_s, intrinsics, delay_s)
