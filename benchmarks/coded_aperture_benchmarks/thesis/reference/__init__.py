"""What others did before: depth by deconvolution with the PSF of every level."""

from coded_aperture_benchmarks.thesis.reference.deconvolution import REFERENCE_METHODS, deconvolve
from coded_aperture_benchmarks.thesis.reference.hypothesis_planes import HypothesisPlanes

__all__ = ["REFERENCE_METHODS", "HypothesisPlanes", "deconvolve"]
