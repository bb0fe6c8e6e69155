"""Errors of depth and pictures, how well edges are kept, and how reliable a confidence is."""

from coded_aperture_ros.metrics.errors import delta_shares, depth_error, psnr_db
from coded_aperture_ros.metrics.reliability import Reliability

__all__ = ["Reliability", "delta_shares", "depth_error", "psnr_db"]
