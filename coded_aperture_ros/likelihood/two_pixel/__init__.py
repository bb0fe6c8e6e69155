"""Two-pixel method: a pixel and its neighbours at the offsets of a mask's equal holes."""

from coded_aperture_ros.likelihood.two_pixel.holes import find_holes, neighbour_lines
from coded_aperture_ros.likelihood.two_pixel.likelihood import TwoPixelModel
from coded_aperture_ros.likelihood.two_pixel.model import (
    TwoPixelConfig,
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
