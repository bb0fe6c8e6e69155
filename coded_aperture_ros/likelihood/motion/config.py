"""Settings of the method for depth and motion together."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.likelihood.motion.kernels import Motions


@dataclasses.dataclass(frozen=True)
class MotionConfig:
    """Motions during an exposure that are distinguished, and how they are chosen.

    Examples
    --------
    >>> len(MotionConfig(motion_directions=4, motion_lengths=3).motions)
    13
    """

    parameter_group = "motion."
    motion_directions: int = option(
        8,
        "Directions of motion that are distinguished, from 0 to 180 degrees.",
        within=(1, 64),
        read_only=True,
    )
    motion_lengths: int = option(
        8,
        "Lengths of motion that are distinguished in each direction.",
        within=(1, 64),
        read_only=True,
    )
    longest_motion_px: float = option(
        12.0,
        "Longest motion during the exposure.",
        unit="px",
        within=(0.5, 64.0),
        read_only=True,
        parameter="motion.longest_px",
    )
    motion_rank: int = option(
        128,
        "Vectors in the common basis of the filters of all motions.",
        within=(1, 4096),
        read_only=True,
    )
    finalists: int = option(
        5,
        "Motions, the likeliest of each patch, that are compared under several textures, without "
        "the common basis; 0: it decides.",
        within=(0, 4096),
        read_only=True,
    )
    motion_smoothness: float = option(
        1.0,
        "Strength of the spatial regularisation of motion, relative to its default.",
        within=(0.0, 100.0),
    )
    refinement_px: float = option(
        0.0,
        "Motions that occur are searched for to this accuracy, half a second or more for each; 0: "
        "they lie where a parabola through the costs of the distinguished ones is least.",
        unit="px",
        within=(0.0, 1.0),
    )
    motion_threshold: float = option(
        0.5,
        "How much less (natural logarithm) any motion must cost than none, for a patch to count as "
        "moving.",
        within=(0.0, 100.0),
    )
    prior_motions: int = option(
        3,
        "With a known angular velocity: motions nearest to the expected one that are compared.",
        within=(1, 64),
    )

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def motions(self) -> Motions:
        """All motions, no motion first; lengths are equally spaced."""
        count = self.motion_lengths
        lengths = self.longest_motion_px * np.arange(1, count + 1) / count
        return Motions.grid(self.motion_directions, lengths)
