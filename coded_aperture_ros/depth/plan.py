"""What the stages are made for: frames of one size, a model and its levels."""

import dataclasses
from typing import Protocol

from coded_aperture_ros.core.arrays import Shape
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.regularize import Regularizer
from coded_aperture_ros.depth.decoders.sides import FocalSides
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.quality import Health
from coded_aperture_ros.frames import Frame, KnownNoise, PatchGrid
from coded_aperture_ros.likelihood import Cost, Likelihood, LikelihoodModel


class SecondFocus(Protocol):
    """Adds what a second frame says whose focus is elsewhere; see `FocusPair`."""

    def add(self, cost: Cost, frame: Frame) -> tuple[Cost, Health | None]:
        """Cost of both frames together, and how well the second fits its bank."""

    def close(self) -> None:
        """Let go of threads."""


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """What is the same for all frames of one size.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of the frames.
    model : LikelihoodModel
        For the view that the frames have.
    levels : Levels
        What the model's levels mean.
    likelihood : Likelihood
        Of the model, for frames of this shape.
    known_noise : KnownNoise
        Of one channel, as far as it is known before a frame is seen.
    workers : Workers
        Threads that share the work.
    sides : FocalSides or None
        Where there are levels on both sides of the focal plane.
    small : Likelihood or None
        Of the small patches, if the network decides.
    regularize : Regularizer or None
        In place of the one that the configuration names.
    second_focus : SecondFocus or None
        For pairs of frames at two focus settings.
    """

    shape: Shape
    model: LikelihoodModel
    levels: Levels
    likelihood: Likelihood
    known_noise: KnownNoise
    workers: Workers
    sides: FocalSides | None = None
    small: Likelihood | None = None
    regularize: Regularizer | None = None
    second_focus: SecondFocus | None = None

    @property
    def grid(self) -> PatchGrid:
        """Where the patches lie."""
        return self.likelihood.grid
