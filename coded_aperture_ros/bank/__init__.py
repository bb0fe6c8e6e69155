"""The filter bank: learned once for a mask, applied to every frame."""

from coded_aperture_ros.bank.bank import FilterBank, ProjectedFrame
from coded_aperture_ros.bank.file import load_bank, save_bank
from coded_aperture_ros.bank.fourier import PatchGrid, WindowedFourierBasis
from coded_aperture_ros.bank.learn import LearnConfig, learn_bank, learn_bank_for_camera
from coded_aperture_ros.bank.prior import NaturalImagePrior, power_spectrum

__all__ = [
    "FilterBank",
    "LearnConfig",
    "NaturalImagePrior",
    "PatchGrid",
    "ProjectedFrame",
    "WindowedFourierBasis",
    "learn_bank",
    "learn_bank_for_camera",
    "load_bank",
    "power_spectrum",
    "save_bank",
]
