"""Whether the frame fits its bank at all, and its range."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, in_memory
from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.quality import FitCheck, Health
from coded_aperture_ros.depth.stage import Plan, Stage, Work
from coded_aperture_ros.depth.stages import temporal
from coded_aperture_ros.likelihood.bank import FilterBank

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "check_fit"
# Of what is sure, a frame of the benchmarks has up to a quarter at one end; frames that are all in
# focus, through a bank that begins at more blur, up to all of it.
_MOST = 0.6
_SURE = 0.45
_FEWEST_SURE = 0.02
# What is at an end, as a share of the levels.
_AT_END = 0.05
# A bank from this blur on, px, has what is sharp among its levels.
_SHARP_PX = 0.5
_VALUE = 0.4


@dataclasses.dataclass(frozen=True)
class Config(temporal.Config):
    """Whether frames are checked against their bank."""

    check_fit: bool = option(
        True,
        "Check whether frames fit the bank at all, and lower the confidence where they do not.",
        parameter="confidence.check_fit",
    )


def make(plan: Plan, config: Config) -> Stage:
    """Stage of the check."""
    levels = plan.levels if isinstance(plan.model, FilterBank) else None
    return QualityOfFit(plan.fit_check, levels)


@dataclasses.dataclass(frozen=True, eq=False)
class QualityOfFit(Stage):
    """Lowers the confidence of frames that do not fit, or lie at an end of the levels.

    The health that a stage before has found, as of a second frame, counts where it is less.
    """

    check: FitCheck | None
    levels: Levels | None  # of a bank
    name = "quality of fit"

    def __call__(self, work: Work) -> None:
        """Check the frame."""
        health, misfit = work.health, work.frame_cost.misfit
        if self.check is not None and misfit is not None:
            # What it has learned with, where that is not what is published.
            sure = getattr(work.decoded, "checked", work.confidence)
            own = self.check(work.observation, in_memory(misfit), work.level, sure)
            if own is not None and (health is None or own.value <= health.value):
                health = own
        if self.levels is not None:
            health = limit_at_end(health, self.levels, work.level, work.confidence)
        work.health = health
        if health is not None:
            work.confidence = health.limit_confidence(work.confidence)
            work.doubted |= not health.fits

    def reset(self) -> None:
        """Forget the frames so far."""
        if self.check is not None:
            self.check.reset()


def open_ends(levels: Levels) -> tuple[bool, bool]:
    """Whether there may be something beyond the first and the last level.

    There is nothing beyond what is sharp, and nothing beyond infinity.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(0.3, 9, 15)))
    >>> open_ends(Levels.from_model(bank))
    (False, True)
    """
    closed = (np.abs(levels.blur_sizes_px[[0, -1]]) < _SHARP_PX) & levels.in_pixels
    if levels.depths_m is not None:
        closed |= ~np.isfinite(levels.depths_m[[0, -1]])
    return not closed[0], not closed[1]


def limit_at_end(
    health: Health | None, levels: Levels, level: FloatArray, confidence: FloatArray
) -> Health | None:
    """Health of a frame, lowered if most of what is sure lies at one open end of the levels.

    Then nobody can tell whether it is there, or anywhere beyond.

    Parameters
    ----------
    health : Health or None
        By the check of fit.
    levels : Levels
    level, confidence : ndarray, float32 [rows, columns]
        Estimated fractional level of every pixel, and its confidence.
    """
    some = np.s_[::3, ::3]  # enough for shares
    sure = level[some][confidence[some] >= _SURE]
    if sure.size < _FEWEST_SURE * level[some].size:
        return health
    last = len(levels) - 1
    at_ends = (sure <= _AT_END * last).mean(), (sure >= last - _AT_END * last).mean()
    at_end = max(np.multiply(open_ends(levels), at_ends)) >= _MOST
    fits = health is None or health.value >= _VALUE
    return Health(_VALUE, "range") if at_end and fits else health
