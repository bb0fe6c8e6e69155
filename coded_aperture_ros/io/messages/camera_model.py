"""The camera model of a message, for the same view resized."""

from typing import Any

from coded_aperture_ros.io.messages.encodings import MessageError


def scaled_matrices(info: Any, width: int, height: int) -> tuple[list[float], list[float]]:
    """Return K and P of a `sensor_msgs/CameraInfo` for its view resized to `width` x `height`.

    Pixel centres have whole coordinates: a scale s moves x to s (x + 1/2) - 1/2. Distortion
    coefficients act on normalised coordinates and stay.

    Parameters
    ----------
    info : sensor_msgs/CameraInfo
        Of rclpy, of a bag, or anything with its fields `width`, `height`, `k` and `p`.
    width, height : int

    Returns
    -------
    k : list of 9 float
    p : list of 12 float
        Made from K where a driver left it empty.

    Raises
    ------
    MessageError
        Of kind "camera_info", where the message holds no camera model.
    """
    if info.width == 0 or info.height == 0 or info.k[0] <= 0 or info.k[4] <= 0:
        raise MessageError("camera_info", "camera_info holds no camera model (size or K is 0)")
    x, y = width / info.width, height / info.height
    k, p = [float(value) for value in info.k], [float(value) for value in info.p]
    scaled_k = [
        *(k[0] * x, k[1] * x, _moved_centre(k[2], x)),
        *(k[3] * y, k[4] * y, _moved_centre(k[5], y)),
        *k[6:],
    ]
    if p[0] <= 0:  # P left empty by an uncalibrated driver
        return scaled_k, [*scaled_k[:3], 0.0, *scaled_k[3:6], 0.0, 0.0, 0.0, 1.0, 0.0]
    scaled_p = [
        *(p[0] * x, p[1] * x, _moved_centre(p[2], x), p[3] * x),
        *(p[4] * y, p[5] * y, _moved_centre(p[6], y), p[7] * y),
        *p[8:],
    ]
    return scaled_k, scaled_p


def _moved_centre(centre: float, scale: float) -> float:
    return scale * (centre + 0.5) - 0.5
