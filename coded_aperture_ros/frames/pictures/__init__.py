"""Stored pictures: decoding, damage, noise of compression."""

from coded_aperture_ros.frames.pictures.decoding import FORMATS, StoredPicture, decode_picture
from coded_aperture_ros.frames.pictures.jpeg import is_damaged_jpeg, quantisation_sigma

__all__ = ["FORMATS", "StoredPicture", "decode_picture", "is_damaged_jpeg", "quantisation_sigma"]
