"""The methods of blur identification that the benchmarks compare, by name."""

import dataclasses
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.datasets.textures import training_textures
from coded_aperture_benchmarks.thesis.reference import REFERENCE_METHODS, HypothesisPlanes
from coded_aperture_benchmarks.thesis.reference.conditional import conditional_levels
from coded_aperture_benchmarks.thesis.reference.subspace import SubspaceBank, learn_subspace_bank
from coded_aperture_benchmarks.thesis.stair import blur_stack, make_stair
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import options_of
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames.noise import NOISE_FLOOR
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig, learn_bank
from coded_aperture_ros.likelihood.two_pixel import (
    TwoPixelConfig,
    TwoPixelModel,
    find_holes,
    two_pixel_model,
)
from coded_aperture_ros.optics import PsfStack, load_mask

# The level of least cost of the filter bank; `bank-tv` and so on are regularised.
BANK = "bank"
# A bare window, which an edge-aware method has to improve on.
PLAIN = "plain-48"
_PLAIN_WINDOW_PX = 48
# The thesis' own method.
SUBSPACE = "subspace"
# The method for masks of a few equal holes; `two_pixel-graphcut` and so on are regularised.
TWO_PIXEL = "two_pixel"
# What the thesis has in its place.
CONDITIONAL = "conditional"
# The level of least cost, nothing else.
_BARE: dict[str, Any] = {"regularize": "none", "edge_correction": 0.0}
# Reference methods learn a weight for every level. One stair has a single texture for each.
_TRAINING_STAIRS = 4
# The seed decides the noise too: it has to be another one than in any test.
_TRAINING_SEED = 1_000_000_007


@dataclasses.dataclass(frozen=True)
class Setting:
    """What a method knows beside the frame.

    Attributes
    ----------
    mask : str
        Name or file.
    sigma : float
        Noise behind an open aperture.
    noise : float or None
        Noise of the frame, if it is known; else methods that can estimate it do.
    levels : int
        Number of blur levels.
    window_px : int
        Side of the bank's patches.
    rank : int
        Vectors in the bank's common basis.
    stride_px : int or None
        Distance between the patches; None for the default.
    """

    mask: str
    sigma: float
    noise: float | None
    levels: int
    window_px: int
    rank: int
    stride_px: int | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Identified:
    """What a method says about a frame.

    Attributes
    ----------
    level : ndarray of float, shape [rows, columns]
        Fractional where the method gives that; NaN where unknown.
    confidence : ndarray of float32, shape [rows, columns], or None
    noise : float or None
        As the method estimated it.
    seconds : float
        Without learning.
    """

    level: NDArray[np.floating]
    confidence: NDArray[np.float32] | None
    noise: float | None
    seconds: float


@dataclasses.dataclass(frozen=True)
class MethodOnFrames:
    """Frames of one kind that one method identifies the blur in.

    Attributes
    ----------
    setting : Setting
        Its noise is filled in frame by frame if `known_noise`.
    images : pathlib.Path or None
        Folder of the textures' pictures.
    seeds : tuple of int
        One frame for each.
    known_noise : bool
        Whether this project's methods know the noise.
    """

    method: str
    setting: Setting
    images: Path | None
    seeds: tuple[int, ...]
    known_noise: bool

    def identify(self, coded: NDArray[np.float32], noise: float) -> Identified:
        """Identify the blur of a frame with a known noise."""
        setting = dataclasses.replace(self.setting, noise=noise if self.known_noise else None)
        return identify(self.method, coded, noise, setting)


def regularizations() -> tuple[str, ...]:
    """Return the ways to regularise; the first is not to."""
    return options_of(DepthConfig)["regularize"][1].choices or ("none",)


def is_bank(method: str) -> bool:
    """Whether a method is the filter bank, with or without regularisation."""
    return method.partition("-")[0] == BANK


def is_two_pixel(method: str) -> bool:
    """Whether a method is the two-pixel one, with or without regularisation."""
    return method.partition("-")[0] == TWO_PIXEL


def method_names() -> tuple[str, ...]:
    """Return the names of all methods."""
    ways = [how for how in regularizations() if how != "none"]
    banks, two_pixel = ((name, *(f"{name}-{how}" for how in ways)) for name in (BANK, TWO_PIXEL))
    return (*banks, PLAIN, SUBSPACE, *two_pixel, CONDITIONAL, *REFERENCE_METHODS)


def identify(method: str, coded: NDArray[np.float32], noise: float, setting: Setting) -> Identified:
    """Identify the blur level of every pixel.

    Parameters
    ----------
    method : str
        One of `method_names`.
    coded : ndarray, float32 [rows, columns]
    noise : float
        True noise of the frame, for the reference methods: they need it.
    """
    if method not in method_names():
        raise InputError(f"unknown method {method!r}: use one of {', '.join(method_names())}")
    if method in REFERENCE_METHODS:
        planes = _reference(method, setting.mask, setting.levels, setting.sigma, noise)
        return _timed(lambda: (planes.levels(coded), None, None))
    if method == CONDITIONAL:
        holes, stack = find_holes(load_mask(setting.mask)), _stack(setting.mask, setting.levels)
        sizes = stack.blur_sizes_px
        return _timed(
            lambda: (conditional_levels(coded, holes, sizes, setting.window_px), None, None)
        )
    estimator = _estimator(method, setting)

    def run() -> Any:
        estimate = estimator.estimate(coded)
        return estimate.level, estimate.confidence, estimate.noise

    return _timed(run)


def _timed(run: Callable[[], Any]) -> Identified:
    start = time.perf_counter()
    level, confidence, noise = run()
    return Identified(level, confidence, noise, time.perf_counter() - start)


def _estimator(method: str, setting: Setting) -> DepthEstimator:
    _, regularized, how = method.partition("-")
    options = {"regularize": how} if regularized and method != PLAIN else _BARE
    # Every pixel is scored, so none is left out for lack of confidence. Nothing is clipped.
    config = DepthConfig(confidence_threshold=0.0, saturation=2.0, threads=1, **options)
    if setting.stride_px is not None:
        config = dataclasses.replace(config, stride_px=setting.stride_px)
    if setting.noise is not None:
        # To the estimator, 0 means that it is not known.
        config = dataclasses.replace(config, noise=max(setting.noise, NOISE_FLOOR))
    return DepthEstimator(_model(method, setting), config)


def _model(method: str, setting: Setting) -> LikelihoodModel:
    mask, levels = setting.mask, setting.levels
    if method == SUBSPACE:
        return _subspace_bank(mask, levels)
    if is_two_pixel(method):
        return _two_pixel_model(mask, levels, setting.window_px)
    window_px = _PLAIN_WINDOW_PX if method == PLAIN else setting.window_px
    return _bank(mask, levels, window_px, setting.rank)


def _stack(mask: str, levels: int) -> PsfStack:
    return blur_stack(load_mask(mask), levels)


# A process works through its cells in order of masks: a few models at a time are enough.
@lru_cache(maxsize=4)
def _bank(mask: str, levels: int, window_px: int, rank: int) -> FilterBank:
    config = LearnConfig(window_px=window_px, rank=rank)
    return learn_bank(_stack(mask, levels), config, mask=load_mask(mask))


@lru_cache(maxsize=4)
def _two_pixel_model(mask: str, levels: int, window_px: int) -> TwoPixelModel:
    return two_pixel_model(
        _stack(mask, levels), load_mask(mask), TwoPixelConfig(window_px=window_px)
    )


@lru_cache(maxsize=2)
def _subspace_bank(mask: str, levels: int) -> SubspaceBank:
    return learn_subspace_bank(_stack(mask, levels), mask=load_mask(mask))


# Masks vary slowest, noise and methods fastest.
@lru_cache(maxsize=32)
def _reference(method: str, mask: str, levels: int, sigma: float, noise: float) -> HypothesisPlanes:
    """Return a reference method with weights learned on pictures that are not scored."""
    stairs = [
        make_stair(load_mask(mask), training_textures(), sigma, _TRAINING_SEED + number, levels)
        for number in range(_TRAINING_STAIRS)
    ]
    planes = HypothesisPlanes(method, stairs[0].stack, noise)
    return planes.with_learned_weights(
        np.concatenate([stair.coded for stair in stairs]),
        np.concatenate([stair.level for stair in stairs]).astype(np.intp),
    )
