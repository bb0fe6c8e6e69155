"""Pixels of `sensor_msgs/CompressedImage`."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.messages.encodings import MessageError

_FLAGS = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def array_from_compressed(message: Any) -> NDArray:
    """Return the pixels of a compressed image message.

    Parameters
    ----------
    message : sensor_msgs/CompressedImage
        Of rclpy, of a bag, or anything with its fields; JPEG, PNG or another format that OpenCV
        reads.

    Returns
    -------
    ndarray of uint8 or uint16, [row, column] or [row, column, RGB]

    Raises
    ------
    MessageError
        Of kind "encoding" for the compressed depth of image_transport, or "data".
    """
    if "compressedDepth" in message.format:
        raise MessageError(
            "encoding", f"format {message.format!r} is compressed depth, expected a picture"
        )
    data = np.frombuffer(message.data, np.uint8)
    try:
        pixels = cv2.imdecode(data, _FLAGS) if data.size else None
    except cv2.error:
        pixels = None
    if pixels is None:
        raise MessageError(
            "data", f"{data.size} bytes of {message.format!r} are not a picture that can be read"
        )
    # image_transport stores pictures in the usual way, whatever encoding they had before.
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB) if pixels.ndim == 3 else pixels
