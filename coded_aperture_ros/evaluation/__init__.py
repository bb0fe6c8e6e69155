"""How good the results are."""

from coded_aperture_ros.evaluation.metrics import DepthError, depth_error, psnr_db
from coded_aperture_ros.evaluation.ray_traced import RayTracedScene
from coded_aperture_ros.evaluation.reliability import Reliability
from coded_aperture_ros.evaluation.stair import LevelError, Stair, level_error, make_stair
from coded_aperture_ros.evaluation.textures import Textures, load_textures, training_textures
from coded_aperture_ros.evaluation.thesis_tables import thesis_error
from coded_aperture_ros.evaluation.two_plane import (
    TwoPlaneError,
    TwoPlanes,
    make_two_planes,
    two_plane_error,
)

__all__ = [
    "DepthError",
    "LevelError",
    "RayTracedScene",
    "Reliability",
    "Stair",
    "Textures",
    "TwoPlaneError",
    "TwoPlanes",
    "depth_error",
    "level_error",
    "load_textures",
    "make_stair",
    "make_two_planes",
    "psnr_db",
    "thesis_error",
    "training_textures",
    "two_plane_error",
]
