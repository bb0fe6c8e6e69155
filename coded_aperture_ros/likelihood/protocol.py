"""Interface of the methods: a model, planned for frames of one size, returns a cost volume.

A *model* has the blur of a mask at every level. Its `plan` makes a *likelihood* for frames of one
size, which holds threads and buffers and turns each frame into a `Cost`. Everything after the cost
volume is common to all methods.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, Protocol

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, PerPatch, in_memory
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.optics import Camera, PsfStack


@dataclasses.dataclass(frozen=True, eq=False)
class MotionField:
    """Motion of every patch during the exposure.

    Attributes
    ----------
    vectors_px : ndarray, float32 [rows, columns, 2]
        Displacement during the exposure, px: to the right, and down. Blur does not show its sign:
        where no motion was expected, it is to the right, or down where it is vertical. NaN where
        unknown.
    confidence : ndarray, float32 [rows, columns]
        Probability in [0, 1] of about this motion, by the patch alone.
    search_reason : str
        Why all motions were searched, for a person to read; empty if only expected ones were.
    """

    vectors_px: FloatArray
    confidence: FloatArray
    search_reason: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Cost:
    """Cost of every level for every patch of a frame.

    Attributes
    ----------
    volume : ndarray, float32 [rows, columns, L]
        Negative natural logarithm of the likelihood, 0 for the likeliest level; all 0 where
        nothing is known. Never overwritten by the next frame.
    misfit : ndarray, float32 [rows, columns], or None
        Natural logarithm of the residual of the likeliest level over the expected noise: large
        where a patch shows two surfaces. None from methods that do not compute it.
    small : Cost or None
        The same of smaller patches, if they were asked for.
    periodic : ndarray, float32 [some rows, some columns, P], or None
        As `volume`, of periodic texture at the levels `periodic_levels`, once or several times;
        below 0 where it explains a patch better than usual texture at any level.
    periodic_step : int
        Of so many patches, along rows and columns, `periodic` has one, from the first on.
    motion : MotionField or None
        From methods that distinguish motion from defocus.
    seconds : mapping of str to float
        Duration of the parts of the work, s, in their order.

    Examples
    --------
    >>> import numpy as np
    >>> Cost(np.zeros((10, 15, 30), np.float32)).periodic is None
    True
    """

    volume: FloatArray
    misfit: FloatArray | None = None
    small: "Cost | None" = None
    periodic: FloatArray | None = None
    periodic_step: int = 1
    motion: MotionField | None = None
    seconds: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def in_memory(self) -> "Cost":
        """Cost with arrays of NumPy, if it consists of tensors."""
        return dataclasses.replace(
            self,
            volume=in_memory(self.volume),
            misfit=None if self.misfit is None else in_memory(self.misfit),
            small=None if self.small is None else self.small.in_memory(),
            periodic=None if self.periodic is None else in_memory(self.periodic),
        )


class Likelihood(Protocol):
    """Cost volumes of frames of one size."""

    @property
    def grid(self) -> PatchGrid:
        """Positions of the patches."""

    def cost(
        self, grey: FloatArray, noise: PerPatch, usable: BoolArray | None = None, prior: Any = None
    ) -> Cost:
        """Cost of every level for every patch.

        Parameters
        ----------
        grey : ndarray, float32 [height, width]
            A frame of the planned size, linear light, without NaN.
        noise : float, or ndarray, float32 [rows, columns]
            Standard deviation of its noise, linear light, > 0; of the frame, or around each patch.
        usable : ndarray, bool [rows, columns], optional
            Patches that count; by default all.
        prior : ExpectedMotion, optional
            Expected motion during the exposure; methods without motion ignore it.
        """

    def close(self) -> None:
        """Release threads and device memory."""


class BlurLevels(Protocol):
    """Blur of a mask at every level, independent of a method."""

    @property
    def stack(self) -> PsfStack:
        """The L blur levels: sizes, PSFs and, where they were measured, depths."""

    @property
    def window_px(self) -> int:
        """Side of the patches, px: the smallest frame."""

    @property
    def noise(self) -> float:
        """Standard deviation of one channel's noise, linear light; 0: estimated in each frame."""

    @property
    def mask_digest(self) -> str:
        """Digest of the mask's pattern; empty if it is unknown."""

    @property
    def learned_from(self) -> str:
        """Origin of the levels, for a person to read."""


class LikelihoodModel(BlurLevels, Protocol):
    """Model of a mask for one method: the blur levels, and a plan for frames of one size."""

    @property
    def stride_px(self) -> int:
        """Default distance between patches, px."""

    @property
    def fattening(self) -> float:
        """Excess width of foregrounds, relative to that with Hann windows of `window_px`."""

    def for_view(self, camera: Camera | None) -> "LikelihoodModel":
        """Model for a part of a camera's view; itself unless its PSFs change over the image."""

    def plan(
        self, shape: tuple[int, ...], stride_px: int, backend: str = "numpy", threads: int = 1
    ) -> Likelihood:
        """Likelihood for frames of one size.

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the frames.
        stride_px : int
            Distance between patches.
        backend : str
            One of `BACKENDS`; methods with only one ignore it.
        threads : int
            Threads of the processor.

        Raises
        ------
        InputError
            If the frame is smaller than a patch, the backend is not installed, or there are fewer
            processors than threads.
        """
