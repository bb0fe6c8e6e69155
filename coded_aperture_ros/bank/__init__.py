"""The filter bank: learned once for a mask, applied to every frame."""

from coded_aperture_ros.bank.bank import FilterBank, ProjectedFrame
from coded_aperture_ros.bank.empirical import EmpiricalPrior
from coded_aperture_ros.bank.file import load_bank, save_bank
from coded_aperture_ros.bank.fourier import PatchGrid, WindowedFourierBasis
from coded_aperture_ros.bank.learn import (
    LearnConfig,
    learn_bank,
    learn_bank_for_camera,
    textures_of,
)
from coded_aperture_ros.bank.learn_planes import learn_bank_for_pattern, learn_bank_from_planes
from coded_aperture_ros.bank.pattern import LearnedPattern
from coded_aperture_ros.bank.planes import Planes
from coded_aperture_ros.bank.prior import NaturalImagePrior, image_prior, power_spectrum
from coded_aperture_ros.bank.subspace import SubspaceBank, learn_subspace_bank

__all__ = [
    "EmpiricalPrior",
    "FilterBank",
    "LearnConfig",
    "LearnedPattern",
    "NaturalImagePrior",
    "PatchGrid",
    "Planes",
    "ProjectedFrame",
    "SubspaceBank",
    "WindowedFourierBasis",
    "image_prior",
    "learn_bank",
    "learn_bank_for_camera",
    "learn_bank_for_pattern",
    "learn_bank_from_planes",
    "learn_subspace_bank",
    "load_bank",
    "power_spectrum",
    "save_bank",
    "textures_of",
]
