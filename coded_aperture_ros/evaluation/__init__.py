"""How good the results are."""

from coded_aperture_ros.evaluation.metrics import DepthError, depth_error, psnr_db
from coded_aperture_ros.evaluation.ray_traced import RayTracedScene

__all__ = ["DepthError", "RayTracedScene", "depth_error", "psnr_db"]
