"""Depth and motion together: blur by defocus and by what moves during the exposure."""

from coded_aperture_ros.likelihood.motion.bank import learn_motion_bank
from coded_aperture_ros.likelihood.motion.config import MotionConfig
from coded_aperture_ros.likelihood.motion.kernels import Motions, blurred_psf, motion_kernel
from coded_aperture_ros.likelihood.motion.likelihood import MotionModel, with_motion_config

__all__ = [
    "MotionConfig",
    "MotionModel",
    "Motions",
    "blurred_psf",
    "learn_motion_bank",
    "motion_kernel",
    "with_motion_config",
]
