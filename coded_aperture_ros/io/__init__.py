"""Pictures and videos on disk."""

from coded_aperture_ros.io.depth_picture import confidence_picture, depth_picture
from coded_aperture_ros.io.picture_file import (
    PICTURE_SUFFIXES,
    read_depth,
    read_image,
    write_depth,
    write_image,
)
from coded_aperture_ros.io.sequence import VIDEO_SUFFIXES, ImageSequence, open_sequence

__all__ = [
    "PICTURE_SUFFIXES",
    "VIDEO_SUFFIXES",
    "ImageSequence",
    "confidence_picture",
    "depth_picture",
    "open_sequence",
    "read_depth",
    "read_image",
    "write_depth",
    "write_image",
]
