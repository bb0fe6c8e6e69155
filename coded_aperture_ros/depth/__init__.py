"""Depth of every pixel from one coded frame and a filter bank."""

from coded_aperture_ros.depth.both_sides import has_both_sides, side_warning
from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.depth.estimate import DepthEstimate, DepthEstimator, depths_are_measured
from coded_aperture_ros.depth.map_size import MAP_SIZES, map_size
from coded_aperture_ros.depth.points import nearest_obstacle_m, points_of_depth
from coded_aperture_ros.depth.rims import DEPTH_EDGE_PX
from coded_aperture_ros.depth.video import estimate_video

__all__ = [
    "DEPTH_EDGE_PX",
    "MAP_SIZES",
    "DepthConfig",
    "DepthEstimate",
    "DepthEstimator",
    "depths_are_measured",
    "estimate_video",
    "has_both_sides",
    "map_size",
    "nearest_obstacle_m",
    "points_of_depth",
    "side_warning",
]
