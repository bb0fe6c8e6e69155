"""Whether the frame fits its bank at all."""

import dataclasses

from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.quality import FitCheck
from coded_aperture_ros.depth.stage import Plan, Stage, Work
from coded_aperture_ros.depth.stages import temporal

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "check_fit"


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
    return QualityOfFit(plan.fit_check)


@dataclasses.dataclass(frozen=True, eq=False)
class QualityOfFit(Stage):
    """Lowers the confidence of frames that do not fit.

    The health that a stage before has found, as of a second frame, counts where it is less.
    """

    check: FitCheck | None
    name = "quality of fit"

    def __call__(self, work: Work) -> None:
        """Check the frame."""
        health, misfit = work.health, work.frame_cost.misfit
        if self.check is not None and misfit is not None:
            # What it has learned with, where that is not what is published.
            sure = getattr(work.decoded, "checked", work.confidence)
            own = self.check(work.observation, misfit, work.level, sure)
            if own is not None and (health is None or own.value <= health.value):
                health = own
        work.health = health
        if health is not None:
            work.confidence = health.limit_confidence(work.confidence)
            work.doubted |= not health.fits

    def reset(self) -> None:
        """Forget the frames so far."""
        if self.check is not None:
            self.check.reset()
