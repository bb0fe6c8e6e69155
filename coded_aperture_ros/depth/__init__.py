"""Depth of every pixel from one coded frame and a filter bank."""

from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.depth.decoders.edges import DEPTH_EDGE_PX
from coded_aperture_ros.depth.decoders.regularize import REGULARIZERS, Regularizer
from coded_aperture_ros.depth.estimate import DepthEstimate
from coded_aperture_ros.depth.estimator import (
    DepthEstimator,
    model_notes,
    refinement_note,
    side_warning,
    unchecked_note,
)
from coded_aperture_ros.depth.focus_pair import FocusPair
from coded_aperture_ros.depth.layer import Layer, LayerSpec
from coded_aperture_ros.depth.levels import Levels, depths_are_measured
from coded_aperture_ros.depth.map_size import MAP_SIZES, map_size
from coded_aperture_ros.depth.points import nearest_obstacle_m, points_of_depth, points_of_frame
from coded_aperture_ros.depth.quality import CAUSE_TEXTS, CAUSES, Health, no_depth_reason
from coded_aperture_ros.depth.range_check import (
    blur_sizes_px,
    check_depth_range,
    depth_range_m,
    range_complaint,
)
from coded_aperture_ros.depth.stages import layer_specs
from coded_aperture_ros.depth.video import estimate_video

__all__ = [
    "CAUSES",
    "CAUSE_TEXTS",
    "DEPTH_EDGE_PX",
    "MAP_SIZES",
    "REGULARIZERS",
    "DepthConfig",
    "DepthEstimate",
    "DepthEstimator",
    "Health",
    "Levels",
    "Regularizer",
    "blur_sizes_px",
    "check_depth_range",
    "depth_range_m",
    "depths_are_measured",
    "estimate_video",
    "map_size",
    "model_notes",
    "nearest_obstacle_m",
    "no_depth_reason",
    "points_of_depth",
    "points_of_frame",
    "range_complaint",
    "refinement_note",
    "side_warning",
    "unchecked_note",
]
