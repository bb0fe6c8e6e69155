"""Depth for masks of a few equal holes: a pixel and its neighbours at the holes' offsets."""

from coded_aperture_ros.likelihood.two_pixel.config import TwoPixelConfig
from coded_aperture_ros.likelihood.two_pixel.holes import find_holes
from coded_aperture_ros.likelihood.two_pixel.likelihood import TwoPixelModel
from coded_aperture_ros.likelihood.two_pixel.lines import neighbour_lines
from coded_aperture_ros.likelihood.two_pixel.model import (
    two_pixel_model,
    two_pixel_model_for_camera,
)

__all__ = [
    "TwoPixelConfig",
    "TwoPixelModel",
    "find_holes",
    "neighbour_lines",
    "two_pixel_model",
    "two_pixel_model_for_camera",
]
