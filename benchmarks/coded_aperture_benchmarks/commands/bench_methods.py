"""The methods of blur identification that the benchmarks compare, by name."""

import dataclasses
import time
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from coded_aperture_ros.cli.options import mask_of
from coded_aperture_ros.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from coded_aperture_ros.bank import FilterBank
    from coded_aperture_ros.optics import PsfStack

# The minimum of the filter bank's energies; `bank-tv` and so on are regularised.
BANK = "bank"
# A bare window, which an edge-aware method has to improve on.
PLAIN = "plain-48"
_PLAIN_WINDOW_PX = 48
# The minimum of the energies, nothing else.
_BARE: dict[str, Any] = {"regularize": "none", "edge_correction": 0.0}
# The thesis' own method.
SUBSPACE = "subspace"
# The method for masks of a few equal holes; `simple-graphcut` and so on are regularised.
SIMPLE = "simple"
# What the thesis has in its place.
CONDITIONAL = "conditional"
# Reference methods learn a weight for every level. One stair has a single texture for each.
_TRAINING_STAIRS = 4
# The seed decides the noise too: it has to be another one than in any test.
_TRAINING_SEED = 1_000_000_007


@dataclasses.dataclass(frozen=True)
class Setting:
    """What a method is told beside the frame.

    Attributes
    ----------
    mask : str
        Name or file.
    sigma : float
        Noise behind an open aperture.
    noise : float or None
        Noise of the frame, if it is given; else methods that can estimate it do.
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
    stride_px: int | None


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

    level: "NDArray[np.floating]"
    confidence: "NDArray[np.float32] | None"
    noise: float | None
    seconds: float


def is_bank(method: str) -> bool:
    """Whether a method is the filter bank, with or without regularisation."""
    return method.partition("-")[0] == BANK


def bank_methods() -> dict[str, str]:
    """Return the methods that are the filter bank, and how each is regularised."""
    from coded_aperture_ros.core.options import options_of
    from coded_aperture_ros.depth import DepthConfig

    _, described = options_of(DepthConfig)["regularize"]
    ways = [how for how in described.choices or () if how != "none"]
    return {BANK: "none"} | {f"{BANK}-{how}": how for how in ways}


def simple_methods() -> dict[str, str]:
    """Return the methods for simple masks, and how each is regularised."""
    return {method.replace(BANK, SIMPLE): how for method, how in bank_methods().items()}


def reference_methods() -> tuple[str, ...]:
    """Return the names of the reference methods."""
    from coded_aperture_benchmarks.reference import REFERENCE_METHODS

    return REFERENCE_METHODS


def method_names() -> tuple[str, ...]:
    """Return the names of all methods."""
    return (
        *bank_methods(),
        PLAIN,
        SUBSPACE,
        *simple_methods(),
        CONDITIONAL,
        *reference_methods(),
    )


def identify(
    method: str, coded: "NDArray[np.float32]", noise: float, setting: Setting
) -> Identified:
    """Identify the blur level of every pixel.

    Parameters
    ----------
    method : str
        One of `method_names`.
    coded : ndarray, float32 [rows, columns]
    noise : float
        True noise of the frame, for the reference methods: they need it.
    setting : Setting

    Raises
    ------
    InputError
        If there is no such method.
    """
    if method in bank_methods():
        bank = _bank(setting.mask, setting.levels, setting.window_px, setting.rank)
        how = {"regularize": bank_methods()[method]}
        return _by_bank(bank, _BARE if method == BANK else how, coded, setting)
    if method == PLAIN:
        bank = _bank(setting.mask, setting.levels, _PLAIN_WINDOW_PX, setting.rank)
        return _by_bank(bank, _BARE, coded, setting)
    if method == SUBSPACE:
        return _by_bank(_subspace_bank(setting.mask, setting.levels), _BARE, coded, setting)
    if method in simple_methods():
        model = _neighbour_model(setting.mask, setting.levels, setting.window_px)
        how = {"regularize": simple_methods()[method]}
        return _by_bank(model, _BARE if method == SIMPLE else how, coded, setting)
    if method == CONDITIONAL:
        return _timed(lambda: (_conditional(coded, setting), None, None))
    if method in reference_methods():
        planes = _reference(method, setting.mask, setting.levels, setting.sigma, noise)
        return _timed(lambda: (planes.levels(coded), None, None))
    raise InputError(f"unknown method {method!r}: use one of {', '.join(method_names())}")


def _by_bank(
    bank: Any, options: dict[str, Any], coded: "NDArray[np.float32]", setting: Setting
) -> Identified:
    from coded_aperture_ros.depth import DepthConfig, DepthEstimator
    from coded_aperture_ros.imaging.noise import NOISE_FLOOR

    # Every pixel is scored, so none is left out for lack of confidence. Nothing is clipped.
    config = DepthConfig(confidence_threshold=0.0, saturation=2.0, **options)
    if setting.stride_px is not None:
        config = dataclasses.replace(config, stride_px=setting.stride_px)
    if setting.noise is not None:
        # To the estimator, 0 means that it is not known.
        config = dataclasses.replace(config, noise=max(setting.noise, NOISE_FLOOR))
    estimator = DepthEstimator(bank, config)

    def run() -> Any:
        estimate = estimator.estimate(coded)
        return estimate.level, estimate.confidence, estimate.noise

    return _timed(run)


def _timed(run: Callable[[], Any]) -> Identified:
    start = time.perf_counter()
    level, confidence, noise = run()
    return Identified(level, confidence, noise, time.perf_counter() - start)


def _stack(mask: str, levels: int) -> "PsfStack":
    from coded_aperture_benchmarks.stair import blur_stack

    return blur_stack(mask_of(mask), levels)


# A process works through its cells in order of masks: a few banks at a time are enough.
@lru_cache(maxsize=4)
def _bank(mask: str, levels: int, window_px: int, rank: int) -> "FilterBank":
    from coded_aperture_ros.bank import LearnConfig, learn_bank

    config = LearnConfig(window_px=window_px, rank=rank)
    return learn_bank(_stack(mask, levels), config, mask=mask_of(mask))


@lru_cache(maxsize=4)
def _neighbour_model(mask: str, levels: int, window_px: int) -> Any:
    from coded_aperture_ros.methods.two_pixel import SimpleConfig, neighbour_model

    return neighbour_model(_stack(mask, levels), mask_of(mask), SimpleConfig(window_px=window_px))


def _conditional(coded: "NDArray[np.float32]", setting: Setting) -> Any:
    from coded_aperture_benchmarks.reference.conditional import conditional_levels
    from coded_aperture_ros.methods.two_pixel import find_holes

    sizes = _stack(setting.mask, setting.levels).blur_sizes_px
    return conditional_levels(coded, find_holes(mask_of(setting.mask)), sizes, setting.window_px)


@lru_cache(maxsize=2)
def _subspace_bank(mask: str, levels: int) -> Any:
    from coded_aperture_benchmarks.reference.subspace import learn_subspace_bank

    return learn_subspace_bank(_stack(mask, levels), mask=mask_of(mask))


# Masks vary slowest, noise and methods fastest.
@lru_cache(maxsize=32)
def _reference(method: str, mask: str, levels: int, sigma: float, noise: float) -> Any:
    """Return a reference method with weights learned on pictures that are not scored."""
    import numpy as np

    from coded_aperture_benchmarks.reference import HypothesisPlanes
    from coded_aperture_benchmarks.stair import make_stair
    from coded_aperture_ros.io.textures import training_textures

    stairs = [
        make_stair(mask_of(mask), training_textures(), sigma, _TRAINING_SEED + number, levels)
        for number in range(_TRAINING_STAIRS)
    ]
    planes = HypothesisPlanes(method, stairs[0].stack, noise)
    return planes.with_learned_weights(
        np.concatenate([stair.coded for stair in stairs]),
        np.concatenate([stair.level for stair in stairs]).astype(np.intp),
    )
