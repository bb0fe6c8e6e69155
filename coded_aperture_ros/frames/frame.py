"""One frame of a camera: its light, and what is known about it before anything is estimated."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames.expected_motion import ExpectedMotion
from coded_aperture_ros.frames.grey import check_frame, resampled
from coded_aperture_ros.frames.light import (
    AssumedGamma,
    Gamma,
    check_linear,
    compression_noise,
    linear_from_pixels,
)
from coded_aperture_ros.frames.mosaic import colour_from_mosaic, grey_from_mosaic
from coded_aperture_ros.frames.pose import Pose
from coded_aperture_ros.frames.view import View

# An earlier stamp than this is not a frame that was overtaken: time itself has gone back.
_JUMP_NS = 1_000_000_000
# Networks let one or two frames be overtaken; more of them are time that has gone back by less.
_LATE_IN_A_ROW = 3


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """A coded frame; everything that is made of it takes this one argument.

    Attributes
    ----------
    light : ndarray, float32 [rows, columns] or [rows, columns, 3]
        Linear light in [0, 1]; NaN where nothing was measured.
    stamp_ns : int or None
        Time of the exposure, ns. Where it goes back, another video begins.
    colour : ndarray, float32 [rows, columns, 3], or None
        Colour picture beside a grey `light`, as of a sensor with a mosaic of colour filters: it
        is what is deblurred.
    compression_noise : float
        Standard deviation of the noise that lossy compression has hidden, linear light; 0: none.
    view : View or None
        Region of the camera's whole view, and binning; None: the whole view.
    motion : ExpectedMotion or None
        What is known of the picture's motion during the exposure.
    refocused : Frame or None
        A frame of the same view with the lens focused elsewhere; see `FocusPair`.
    pose : callable or None
        Gives what turns points of the camera's optical frame into those of a fixed one, metres,
        a `Pose` or float64 [4, 4]; or None, where it is unknown. The last column is NaN where only
        the turn is known. It is asked when the pose is needed: on a robot it may come a little
        after the frame.

    Examples
    --------
    >>> import numpy as np
    >>> Frame(np.zeros((48, 64), np.float32)).shape
    (48, 64)
    """

    light: FloatArray
    stamp_ns: int | None = None
    colour: FloatArray | None = None
    compression_noise: float = 0.0
    view: View | None = None
    motion: ExpectedMotion | None = None
    refocused: "Frame | None" = None
    pose: Callable[[], Pose | DoubleArray | None] | None = None

    @classmethod
    def of(cls, frame: "Frame | FloatArray") -> "Frame":
        """Frame of an array of light; a frame is returned as it is."""
        return frame if isinstance(frame, Frame) else cls(frame)

    @property
    def shape(self) -> Shape:
        """Rows and columns."""
        rows, columns = self.light.shape[:2]
        return rows, columns

    @property
    def whole_size(self) -> tuple[int, int]:
        """Width and height of the whole view, px of this frame."""
        if self.view is not None:
            return self.view.whole_width, self.view.whole_height
        return self.shape[1], self.shape[0]

    @property
    def channels(self) -> int:
        """Number of channels of `light`, 1 or 3."""
        return 1 if self.light.ndim == 2 else self.light.shape[2]

    @property
    def picture(self) -> FloatArray:
        """What is deblurred: the colour picture, or else the light."""
        return self.light if self.colour is None else self.colour

    def resampled(self, scale: float) -> "Frame":
        """Frame enlarged by a factor; see `coded_aperture_ros.frames.resampled`."""
        colour = None if self.colour is None else resampled(self.colour, scale)
        light = resampled(self.light, scale)
        view = self.view and self.view.resized(light.shape[1], light.shape[0])
        return dataclasses.replace(self, light=light, colour=colour, view=view)

    def check(self) -> None:
        """Raise `InputError` if the light has a shape or type that no frame has."""
        check_frame(self.light)


@dataclasses.dataclass(frozen=True)
class PixelFormat:
    """How stored pixels become linear light.

    Attributes
    ----------
    gamma : float or "srgb"
        Transfer curve of 8-bit pixels; wider types are linear.
    bits : int
        Bits that 16-bit pixels have, where a sensor's 10 or 12 were not scaled to 16.
    mosaic : str
        Order of the colour filters, such as ``rggb``; empty: no mosaic.
    """

    gamma: Gamma = 1.0
    bits: int = 16
    mosaic: str = ""

    def light(self, pixels: Any) -> FloatArray:
        """Linear light of pixels, before a mosaic is taken into account.

        Parameters
        ----------
        pixels : ndarray, uint8, uint16 or float [rows, columns] or [rows, columns, RGB]
            Integers are scaled to [0, 1], floats are taken as they are.

        Returns
        -------
        ndarray, float32
            Of the same shape.

        Raises
        ------
        InputError
            If the pixels have another type, or floats are not linear light.
        """
        if self.bits < 16 and pixels.dtype == np.uint16:
            pixels = np.minimum(pixels, 2**self.bits - 1) << (16 - self.bits)
        if pixels.dtype.kind == "f":
            check_linear(pixels)
        if isinstance(self.gamma, AssumedGamma) and pixels.dtype == np.uint8 and not self.mosaic:
            self.gamma.tell()
        if pixels.dtype == np.float32:
            return np.asarray(pixels)
        return linear_from_pixels(pixels, self.gamma)

    def picture(self, pixels: Any) -> FloatArray:
        """Linear light of pixels, float32; in colour [rows, columns, 3] if they are a mosaic."""
        light = self.light(pixels)
        return colour_from_mosaic(light, self.mosaic) if self.mosaic else light

    def frame(
        self, pixels: Any, compression_loss: float = 0.0, *, colour: bool = True, **known: Any
    ) -> Frame:
        """Frame of stored pixels.

        Parameters
        ----------
        pixels : ndarray, uint8, uint16 or float [rows, columns] or [rows, columns, RGB]
            See `light`.
        compression_loss : float
            Noise that lossy compression has hidden, as `quantisation_sigma` has it, of stored
            values from 0 to 1.
        colour : bool
            Whether a mosaic is turned into a colour picture, too, which takes time.
        **known
            Other attributes of the `Frame`.

        Raises
        ------
        InputError
            If the pixels have a type that no picture has, or cannot be a mosaic.
        """
        light = self.light(pixels)
        picture = None
        if self.mosaic:
            picture = colour_from_mosaic(light, self.mosaic) if colour else None
            light = grey_from_mosaic(light, self.mosaic)
        hidden = compression_noise(compression_loss, light, self.gamma)
        return Frame(light, colour=picture, compression_noise=hidden, **known)


class LateFrameError(InputError):
    """A frame of a video is older than the one before it."""


class StampOrder:
    """Tells frames that came late from a clock that was set back, as when a bag begins again."""

    def __init__(self) -> None:
        self._newest_ns: int | None = None
        self._late = 0

    def forget(self) -> None:
        """Take the next frame for the first."""
        self._newest_ns = None
        self._late = 0

    def follow(self, stamp_ns: int) -> str:
        """Say what a frame with this stamp is, and remember it.

        That is "next", also for the first frame, and for one without a stamp; "late" if it is older
        than the newest one by less than a second; "restart" if it is older than that, or the third
        late one in a row, as where a short recording begins again.
        """
        if not stamp_ns:
            return "next"
        newest_ns, self._newest_ns = self._newest_ns, stamp_ns
        if newest_ns is None or stamp_ns >= newest_ns:
            self._late = 0
            return "next"
        self._late += 1
        if newest_ns - stamp_ns >= _JUMP_NS or self._late == _LATE_IN_A_ROW:
            self._late = 0
            return "restart"
        self._newest_ns = newest_ns
        return "late"
