"""Stored pictures: decoding, damage, noise of compression."""

from coded_aperture_ros.frames.pictures.decoding import FORMATS, StoredPicture, decode_picture
from coded_aperture_ros.frames.pictures.jpeg import is_damaged_jpeg, quantisation_sigma
from coded_aperture_ros.frames.pictures.size import LARGEST_PIXELS, check_size

__all__ = [
    "FORMATS",
    "LARGEST_PIXELS",
    "StoredPicture",
    "check_size",
    "decode_picture",
    "is_damaged_jpeg",
    "quantisation_sigma",
]
