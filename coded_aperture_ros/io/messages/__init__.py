"""Content of ROS messages, without ROS: pixels, depth, camera models.

A message is any object with the fields of its type: those of rclpy and those read from a bag.
"""

from coded_aperture_ros.io.messages.camera_info import scaled_matrices, view_from_camera_info
from coded_aperture_ros.io.messages.compressed import (
    DEPTH_FORMATS,
    compressed_depth,
    compressed_picture,
)
from coded_aperture_ros.io.messages.encodings import (
    ENCODINGS,
    MessageError,
    array_from_compressed,
    array_from_image,
    check_pixels,
    mosaic_encoding,
    output_encoding,
    parse_encoding,
    stamp_ns,
)
from coded_aperture_ros.io.messages.frames import (
    depth_from_pixels,
    depth_pixels,
    frame_from_image,
    limit_depth,
    limit_layer,
    luminance,
    millimetres_from_depth,
    pixels_from_frame,
)

__all__ = [
    "DEPTH_FORMATS",
    "ENCODINGS",
    "MessageError",
    "array_from_compressed",
    "array_from_image",
    "check_pixels",
    "compressed_depth",
    "compressed_picture",
    "depth_from_pixels",
    "depth_pixels",
    "frame_from_image",
    "limit_depth",
    "luminance",
    "millimetres_from_depth",
    "mosaic_encoding",
    "output_encoding",
    "parse_encoding",
    "pixels_from_frame",
    "scaled_matrices",
    "stamp_ns",
    "view_from_camera_info",
]
