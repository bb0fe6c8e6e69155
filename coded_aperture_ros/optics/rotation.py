"""Motion of the picture predicted from a gyroscope."""

import math
from collections.abc import Sequence

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import ExpectedMotion
from coded_aperture_ros.optics.intrinsics import Intrinsics


def expected_motion(
    angular_velocity_rad_s: Sequence[float] | None,
    exposure_s: float,
    intrinsics: Intrinsics,
    delay_s: float = 0.0,
    max_delay_s: float = 0.05,
) -> ExpectedMotion:
    """Motion of the picture predicted from an angular velocity.

    Points at any distance move alike in the picture of a camera that turns; translation of the
    camera, and objects that move, are not in the prediction.

    Parameters
    ----------
    angular_velocity_rad_s : sequence of 3 float, or None
        In the camera's optical frame: around x to the right, y down and z forward, rad/s. A
        `sensor_msgs/Imu` has it in the frame of its own header. None if there is no measurement.
    exposure_s : float
        Time of the exposure, s.
    intrinsics : Intrinsics
    delay_s : float, optional
        Time between measurement and exposure, s, before or after.
    max_delay_s : float, optional
        Delay above which a measurement is not used, s.

    Returns
    -------
    ExpectedMotion
        With a `reason` where it is unknown, and all motions have to be tried.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Intrinsics
    >>> found = expected_motion((0.0, 0.2, 0.0), 0.01, Intrinsics.pinhole(500.0, 640, 480))
    >>> found.angle_rad
    (0.0, 0.002, 0.0)
    """

    def motion(angle: tuple[float, float, float] | None, reason: str = "") -> ExpectedMotion:
        return ExpectedMotion(angle, intrinsics.camera_matrix, intrinsics.image_width, reason)

    if angular_velocity_rad_s is None:
        return motion(None, "no angular velocity")
    if len(angular_velocity_rad_s) != 3:
        return motion(None, f"angular velocity: 3 numbers expected, {len(angular_velocity_rad_s)}")
    if not all(math.isfinite(rate) for rate in angular_velocity_rad_s):
        return motion(None, "angular velocity is not finite")
    if not (math.isfinite(exposure_s) and exposure_s > 0):
        return motion(None, f"exposure of {exposure_s:g} s is not motion")
    if not abs(delay_s) <= max_delay_s:  # a NaN is late too
        return motion(None, f"angular velocity is {abs(delay_s):.3g} s late")
    x, y, z = (float(rate) * exposure_s for rate in angular_velocity_rad_s)
    return motion((x, y, z))


def parse_imu_axes(axes: str) -> tuple[tuple[int, int], ...]:
    """Index of the gyroscope's axis, and its sign, for each axis of the camera.

    Raises
    ------
    InputError
        If the text does not name each axis once, or describes a mirror image.
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
