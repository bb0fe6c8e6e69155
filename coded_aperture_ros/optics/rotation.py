"""What a gyroscope says about blur: the motion that a turning camera gives the picture."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Intrinsics


@dataclasses.dataclass(frozen=True)
class ExpectedMotion:
    """The motion of the picture while a camera turns during an exposure.

    Attributes
    ----------
    angle_rad : (float, float, float) or None
        By which the camera turns around its axes: x to the right, y down, z forward. None if it is
        not known.
    camera_matrix : tuple of 9 float
        K, row by row, of pictures `image_width` wide.
    image_width : int
    reason : str
        Why the angle is not known, for a person to read; empty if it is.
    """

    angle_rad: tuple[float, float, float] | None
    camera_matrix: tuple[float, ...]
    image_width: int
    reason: str = ""

    def motion_px(self, rows: ArrayLike, columns: ArrayLike, image_width: int) -> DoubleArray:
        """Return the way of the picture during the exposure, to the right and down, px [r, c, 2].

        In a grid of places, rows [r] and columns [c] of a picture of `image_width`, px; zeros if
        the angle is not known.
        """
        scale = image_width / self.image_width
        fx, _, cx, _, fy, cy = self.camera_matrix[:6]
        # The middle of the first pixel is at 0 in each of the two pictures.
        x = (((np.asarray(columns, np.float64) + 0.5) / scale - 0.5) - cx) / fx
        y = ((((np.asarray(rows, np.float64) + 0.5) / scale - 0.5) - cy) / fy)[:, None]
        about_x, about_y, about_z = self.angle_rad or (0.0, 0.0, 0.0)
        right = about_x * x * y - about_y * (1 + x**2) + about_z * y
        down = about_x * (1 + y**2) - about_y * x * y - about_z * x
        return np.stack([right * fx, down * fy], axis=-1) * scale


def expected_motion(
    angular_velocity_rad_s: Sequence[float] | None,
    exposure_s: float,
    intrinsics: Intrinsics,
    delay_s: float = 0.0,
    max_delay_s: float = 0.05,
) -> ExpectedMotion:
    """Predict the motion of the picture from a gyroscope.

    Points at any distance move alike in the picture of a camera that turns; what the camera
    moves by itself, and what moves before it, is not in the prediction.

    Parameters
    ----------
    angular_velocity_rad_s : sequence of 3 float, or None
        Of the camera, in its optical frame: around x to the right, y down and z forward, rad/s. A
        `sensor_msgs/Imu` has it in the frame of its own header. None if there is no measurement.
    exposure_s : float
        Time of the exposure, s.
    delay_s : float, optional
        How far in time the measurement is from the exposure, s, before or after.
    max_delay_s : float, optional
        From where on that is too far.

    Returns
    -------
    ExpectedMotion
        Never an error: with `reason` where nothing is known, and all motions have to be tried.
    """

    def known(angle: tuple[float, float, float] | None, reason: str = "") -> ExpectedMotion:
        return ExpectedMotion(angle, intrinsics.camera_matrix, intrinsics.image_width, reason)

    if angular_velocity_rad_s is None:
        return known(None, "no angular velocity")
    if len(angular_velocity_rad_s) != 3:
        return known(None, f"angular velocity: 3 numbers expected, {len(angular_velocity_rad_s)}")
    if not all(math.isfinite(rate) for rate in angular_velocity_rad_s):
        return known(None, "angular velocity is not finite")
    if not (math.isfinite(exposure_s) and exposure_s > 0):
        return known(None, f"exposure of {exposure_s:g} s is not known")
    if not abs(delay_s) <= max_delay_s:  # a NaN is late too
        return known(None, f"angular velocity is {abs(delay_s):.3g} s late")
    x, y, z = (float(rate) * exposure_s for rate in angular_velocity_rad_s)
    return known((x, y, z))


def parse_imu_axes(axes: str) -> tuple[tuple[int, int], ...]:
    """Return for each axis of the camera the index of the gyroscope's axis, and its sign.

    An `InputError` if the text does not name each axis once, or means a mirror and no rotation.
    """
    found = []
    for word in axes.split():
        sign, name = (-1, word[1:]) if word.startswith("-") else (1, word.removeprefix("+"))
        if len(name) == 1 and name in "xyz":
            found.append(("xyz".index(name), sign))
    order = [index for index, _ in found]
    if sorted(order) != [0, 1, 2] or len(axes.split()) != 3:
        raise InputError(f"imu_axes: expected three axes like -y -z x, got {axes!r}")
    even = order in ([0, 1, 2], [1, 2, 0], [2, 0, 1])
    if (1 if even else -1) * found[0][1] * found[1][1] * found[2][1] != 1:
        raise InputError(f"imu_axes: {axes!r} is a mirror image, no rotation: check the signs")
    return tuple(found)
