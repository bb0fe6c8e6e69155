"""The filter bank: learned once for a mask, applied to every frame."""

from coded_aperture_ros.likelihood.bank.all_frequencies import with_all_frequencies
from coded_aperture_ros.likelihood.bank.empirical import EmpiricalPrior
from coded_aperture_ros.likelihood.bank.file import load_bank
from coded_aperture_ros.likelihood.bank.for_camera import (
    DEFAULT_LEVEL_COUNT,
    describe_textures,
    learn_bank_for_camera,
    learn_bank_for_pattern,
    psf_stack_for_camera,
)
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.learning import LearnConfig, learn_bank, relearn_bank
from coded_aperture_ros.likelihood.bank.model import DEFAULT_STRIDE_PX, FilterBank, check_frame_size
from coded_aperture_ros.likelihood.bank.pattern import LearnedPattern, ThinLens
from coded_aperture_ros.likelihood.bank.prior import NaturalImagePrior, image_prior, power_spectrum
from coded_aperture_ros.likelihood.bank.saving import save_bank
from coded_aperture_ros.likelihood.bank.setting import check_setting

__all__ = [
    "DEFAULT_LEVEL_COUNT",
    "DEFAULT_STRIDE_PX",
    "EmpiricalPrior",
    "FilterBank",
    "LearnConfig",
    "LearnedPattern",
    "NaturalImagePrior",
    "ThinLens",
    "WindowedFourierBasis",
    "check_frame_size",
    "check_setting",
    "describe_textures",
    "image_prior",
    "learn_bank",
    "learn_bank_for_camera",
    "learn_bank_for_pattern",
    "load_bank",
    "power_spectrum",
    "psf_stack_for_camera",
    "relearn_bank",
    "save_bank",
    "with_all_frequencies",
]
