"""Figures of merit."""

from coded_aperture_ros.evaluation.metrics import DepthError, depth_error, psnr_db

__all__ = ["DepthError", "depth_error", "psnr_db"]
