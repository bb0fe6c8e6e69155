"""Content of ROS messages, without ROS: pixels, depth, camera models.

A message is any object with the fields of its type: those of rclpy and those read from a bag.
"""

from coded_aperture_ros.io.messages.camera_info import (
    check_camera_info,
    choose_camera_info,
    contradiction,
    has_matrices,
    region_intrinsics,
    region_matrices,
    sensor_intrinsics,
    view_from_camera_info,
)
from coded_aperture_ros.io.messages.camera_infos import CameraInfos
from coded_aperture_ros.io.messages.compressed import (
    DEPTH_FORMATS,
    PICTURE_FORMATS,
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
from coded_aperture_ros.io.messages.transforms import Transforms
from coded_aperture_ros.io.messages.turns import Turns

__all__ = [
    "DEPTH_FORMATS",
    "ENCODINGS",
    "PICTURE_FORMATS",
    "CameraInfos",
    "MessageError",
    "Transforms",
    "Turns",
    "array_from_compressed",
    "array_from_image",
    "check_camera_info",
    "check_pixels",
    "choose_camera_info",
    "compressed_depth",
    "compressed_picture",
    "contradiction",
    "depth_from_pixels",
    "depth_pixels",
    "frame_from_image",
    "has_matrices",
    "limit_depth",
    "luminance",
    "millimetres_from_depth",
    "mosaic_encoding",
    "output_encoding",
    "parse_encoding",
    "pixels_from_frame",
    "region_intrinsics",
    "region_matrices",
    "sensor_intrinsics",
    "stamp_ns",
    "view_from_camera_info",
]
