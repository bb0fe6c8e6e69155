"""Pictures in files and in memory: linear light, sequences, depth pictures."""

from coded_aperture_ros.images.decoding import decode_picture
from coded_aperture_ros.images.depth_picture import confidence_picture, depth_picture
from coded_aperture_ros.images.light import (
    SRGB,
    Gamma,
    decode,
    encode,
    gamma_from_text,
    linear_from_pixels,
    pixels_from_linear,
)
from coded_aperture_ros.images.picture_file import (
    PICTURE_SUFFIXES,
    read_depth,
    read_image,
    write_depth,
    write_image,
)
from coded_aperture_ros.images.sequence import VIDEO_SUFFIXES, ImageSequence, open_sequence

__all__ = [
    "PICTURE_SUFFIXES",
    "SRGB",
    "VIDEO_SUFFIXES",
    "Gamma",
    "ImageSequence",
    "confidence_picture",
    "decode",
    "decode_picture",
    "depth_picture",
    "encode",
    "gamma_from_text",
    "linear_from_pixels",
    "open_sequence",
    "pixels_from_linear",
    "read_depth",
    "read_image",
    "write_depth",
    "write_image",
]
