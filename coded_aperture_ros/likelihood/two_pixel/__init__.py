"""Depth for masks of a few equal holes: a pixel and its neighbours at the holes' offsets."""

from coded_aperture_ros.likelihood.two_pixel.config import SimpleConfig
from coded_aperture_ros.likelihood.two_pixel.holes import find_holes
from coded_aperture_ros.likelihood.two_pixel.likelihood import NeighbourModel
from coded_aperture_ros.likelihood.two_pixel.lines import neighbour_lines
from coded_aperture_ros.likelihood.two_pixel.model import (
    neighbour_model,
    neighbour_model_for_camera,
)

__all__ = [
    "NeighbourModel",
    "SimpleConfig",
    "find_holes",
    "neighbour_lines",
    "neighbour_model",
    "neighbour_model_for_camera",
]
