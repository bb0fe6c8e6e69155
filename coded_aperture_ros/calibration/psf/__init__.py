"""Measuring PSFs: from pictures of a grid of dots, or from a sharp and a coded picture."""

from coded_aperture_ros.calibration.psf.dots import DotPsf, psf_from_dots
from coded_aperture_ros.calibration.psf.pair import PairPsf, psf_from_pair
from coded_aperture_ros.calibration.psf.stack import CentredPsf, centre_psf, psf_picture, psf_stack

__all__ = [
    "CentredPsf",
    "DotPsf",
    "PairPsf",
    "centre_psf",
    "psf_from_dots",
    "psf_from_pair",
    "psf_picture",
    "psf_stack",
]
