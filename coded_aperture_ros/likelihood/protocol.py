"""The interface between a method and the depth estimator: a model, planned for frames of one size.

A *model* knows the mask: what a patch looks like at every blur level. Its `plan` makes a
*likelihood* for frames of one size, which holds threads and buffers and turns each frame into a
`Cost`. Everything after the cost volume is common to all methods.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, Protocol

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, PerPatch
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.optics import Camera, PsfStack


@dataclasses.dataclass(frozen=True, eq=False)
class MotionField:
    """What a method found out about motion during the exposure, patch by patch.

    Attributes
    ----------
    vectors_px : ndarray, float32 [rows, columns, 2]
        Way during the exposure in pixels of the frame, to the right, and down. Blur does not tell
        which way along its line: where no motion was expected, it is to the right, or down where
        it is upright. NaN where unknown.
    confidence : ndarray, float32 [rows, columns]
        Probability, in [0, 1], that a patch by itself gives to about this motion.
    searched : str
        Why all motions were tried and not only expected ones; empty where these were enough.
    """

    vectors_px: FloatArray
    confidence: FloatArray
    searched: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Cost:
    """What a frame says about every patch's level.

    Attributes
    ----------
    volume : ndarray, float32 [rows, columns, L]
        Negative natural logarithm of the likelihood, 0 for the likeliest level; all 0 where
        nothing is known. Never overwritten by the next frame.
    misfit : ndarray, float32 [rows, columns], or None
        Natural logarithm of what the likeliest level leaves unexplained of a patch, relative to the
        expected noise, for methods that find it: more than usual where a patch shows two surfaces.
    small : Cost or None
        Of smaller patches, where they were asked for.
    periodic : ndarray, float32 [rows, columns, P], or None
        As `volume`, if a patch shows periodic texture at some levels: `periodic_levels`, once or
        several times. Below 0 where it explains more than usual texture at any level.
    motion : MotionField or None
        From methods that tell motion from defocus.
    seconds : mapping of str to float
        How long the parts of the work took, in their order.
    """

    volume: FloatArray
    misfit: FloatArray | None = None
    small: "Cost | None" = None
    periodic: FloatArray | None = None
    motion: MotionField | None = None
    seconds: Mapping[str, float] = dataclasses.field(default_factory=dict)


class Likelihood(Protocol):
    """Turns frames of one size into cost volumes."""

    @property
    def grid(self) -> PatchGrid:
        """Where the patches lie."""

    def cost(
        self, grey: FloatArray, noise: PerPatch, usable: BoolArray | None = None, prior: Any = None
    ) -> Cost:
        """Return the cost of every level for every patch.

        Parameters
        ----------
        grey : ndarray, float32 [height, width]
            A frame of the planned size, linear light, without NaN.
        noise : float, or ndarray, float32 [rows, columns]
            Standard deviation of its noise, > 0; of the frame, or around each patch.
        usable : ndarray, bool [rows, columns], optional
            Which patches say anything; by default all.
        prior : ExpectedMotion, optional
            What is known beforehand; methods without a use for it ignore it.
        """

    def close(self) -> None:
        """Let go of threads and device memory."""


class BlurLevels(Protocol):
    """What is known of a mask without regard to a method: how it blurs at every level."""

    @property
    def stack(self) -> PsfStack:
        """The L blur levels: sizes, PSFs and, where they were measured, depths."""

    @property
    def window_px(self) -> int:
        """Side of the patches, or of the smallest frame."""

    @property
    def noise(self) -> float:
        """Standard deviation of one channel's noise; 0: it is estimated in each frame."""

    @property
    def mask_digest(self) -> str:
        """Digest of the mask's pattern; empty where it is not known."""

    @property
    def learned_from(self) -> str:
        """How the levels came to be, for a person to read."""


class LikelihoodModel(BlurLevels, Protocol):
    """What depth estimation needs to know about a mask: the blur levels, and how to plan."""

    @property
    def stride_px(self) -> int:
        """Distance between patches, unless another is asked for."""

    @property
    def fattening(self) -> float:
        """How far foregrounds are too wide, relative to Hann windows of `window_px`."""

    def for_view(self, camera: Camera | None) -> "LikelihoodModel":
        """Model for frames of a camera that may show a part of its view only.

        It is the model itself, unless its PSFs change over the image.
        """

    def plan(
        self, shape: tuple[int, ...], stride_px: int, backend: str = "numpy", threads: int = 1
    ) -> Likelihood:
        """Plan the work on frames of one size.

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the frames.
        stride_px : int
            Distance between patches.
        backend : str
            One of `BACKENDS`; methods that know only one ignore it.
        threads : int
            Of the processor.

        Raises
        ------
        InputError
            If the frame is smaller than a patch, the backend is not there, or there are fewer
            processors than threads.
        """
