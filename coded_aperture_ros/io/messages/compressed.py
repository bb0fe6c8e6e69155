"""Pixels of `sensor_msgs/CompressedImage`."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.imaging import decode_picture
from coded_aperture_ros.io.messages.encodings import MessageError


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
    pixels = decode_picture(message.data)
    if pixels is None or pixels.dtype not in (np.uint8, np.uint16):
        raise MessageError(
            "data",
            f"{len(message.data)} bytes of {message.format!r} are not a picture that can be read",
        )
    # image_transport stores pictures in the usual way, whatever encoding they had before.
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB) if pixels.ndim == 3 else pixels
