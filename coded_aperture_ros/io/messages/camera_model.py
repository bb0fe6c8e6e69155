"""The camera model of a message, for the same view resized."""

from typing import Any

from coded_aperture_ros.io.messages.encodings import MessageError
from coded_aperture_ros.optics.intrinsics import scaled_matrix


def scaled_matrices(info: Any, width: int, height: int) -> tuple[list[float], list[float]]:
    """Return K and P of a `sensor_msgs/CameraInfo` for its view resized to `width` x `height`.

    Parameters
    ----------
    info : sensor_msgs/CameraInfo
        Or anything with its fields `width`, `height`, `k` and `p`. Distortion coefficients act on
        normalised coordinates and stay.
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
    k = list(scaled_matrix(info.k, x, y))
    if info.p[0] > 0:
        return k, list(scaled_matrix(info.p, x, y))
    return k, [*k[:3], 0.0, *k[3:6], 0.0, 0.0, 0.0, 1.0, 0.0]
