"""Measuring a camera from its own pictures: PSFs and noise."""

from coded_aperture_ros.calibration.centre import CentredPsf
from coded_aperture_ros.calibration.dots import DotPsf, psf_from_dots
from coded_aperture_ros.calibration.measure import MeasuredPsfs, centred_stack, expected_sizes_px
from coded_aperture_ros.calibration.noise import SensorNoise, noise_from_frames, with_noise_of
from coded_aperture_ros.calibration.pair import PairPsf, psf_from_pair
from coded_aperture_ros.calibration.picture import psf_picture
from coded_aperture_ros.calibration.stack import equally_spaced_stack

__all__ = [
    "CentredPsf",
    "DotPsf",
    "MeasuredPsfs",
    "PairPsf",
    "SensorNoise",
    "centred_stack",
    "equally_spaced_stack",
    "expected_sizes_px",
    "noise_from_frames",
    "psf_from_dots",
    "psf_from_pair",
    "psf_picture",
    "with_noise_of",
]
