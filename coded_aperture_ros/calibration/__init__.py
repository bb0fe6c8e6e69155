"""Calibration of a camera from its own pictures: planes of known depth, PSFs, noise."""

from coded_aperture_ros.calibration.noise import SensorNoise, noise_from_frames

__all__ = ["SensorNoise", "noise_from_frames"]
