"""Images, depth maps and points on disk; messages of ROS in `io.messages`."""

from coded_aperture_ros.io.depth_picture import (
    confidence_picture,
    depth_picture,
    error_picture,
    grey_picture,
)
from coded_aperture_ros.io.picture_file import (
    PICTURE_SUFFIXES,
    picture_files,
    read_depth,
    read_image,
    write_depth,
    write_image,
)
from coded_aperture_ros.io.points_file import write_points

__all__ = [
    "PICTURE_SUFFIXES",
    "confidence_picture",
    "depth_picture",
    "error_picture",
    "grey_picture",
    "picture_files",
    "read_depth",
    "read_image",
    "write_depth",
    "write_image",
    "write_points",
]
