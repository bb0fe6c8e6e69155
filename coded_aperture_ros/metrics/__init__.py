"""Errors of depth and images, and calibration of confidence."""

from coded_aperture_ros.metrics.errors import depth_error, psnr_db
from coded_aperture_ros.metrics.reliability import Reliability

__all__ = ["Reliability", "depth_error", "psnr_db"]
