"""Errors of depth and pictures, and how reliable a confidence is."""

from coded_aperture_ros.metrics.errors import depth_error, psnr_db
from coded_aperture_ros.metrics.reliability import Reliability

__all__ = ["Reliability", "depth_error", "psnr_db"]
