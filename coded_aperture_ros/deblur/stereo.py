"""Stereo pairs of an all-in-focus frame and its depth."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur.blur_map import filled_blur_map
from coded_aperture_ros.deblur.views import view_through
from coded_aperture_ros.frames import check_frame

# The few pixels beyond these percentiles of blur size, most of them wrong, do not set the scale.
_PERCENTILES = (1, 99)
# Relief that is no more than the error of the blur size is not made any larger.
_MIN_RELIEF_PX = 1.0
# Of red, green and blue light, ITU-R BT.709.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclasses.dataclass(frozen=True)
class Parallax:
    """Relation between disparity and blur size.

    Both are linear in the inverse depth: disparity is ``scale (screen_px - blur size)``, within
    plus and minus `largest_px`. It is that of a stereo camera whose baseline is `scale` times as
    wide as the mask. A signed blur size of `screen_px` appears in the plane of the screen, and a
    smaller one in front of it.

    Parameters
    ----------
    screen_px : float
        Blur size in the plane of the screen, px.
    scale : float
        Disparity per blur size.
    largest_px : float
        Largest disparity, px.

    References
    ----------
    Martinello 2012, section 6.3.2.

    Examples
    --------
    >>> import numpy as np
    >>> parallax = Parallax(screen_px=5.0, scale=2.0, largest_px=8.0)
    >>> parallax.disparity_px(np.array([3.0, 5.0])).tolist()
    [4.0, 0.0]
    """

    screen_px: float
    scale: float
    largest_px: float

    @classmethod
    def from_scene(cls, blur_size_px: FloatArray, shift_px: float) -> "Parallax":
        """Parallax with the median of a scene at the screen, and `shift_px` for its extremes.

        `shift_px` is the largest distance between the two views of a point, > 0. A scene that is
        almost flat, with a relief of less than 1 px of blur size, gets less. The blur sizes are
        signed, and not finite where unknown; raises `InputError` if all are.
        """
        known = blur_size_px[np.isfinite(blur_size_px)]
        if known.size == 0:
            raise InputError("blur map: no pixel has a known depth")
        nearest, screen, farthest = np.percentile(known, (_PERCENTILES[0], 50, _PERCENTILES[1]))
        relief = max(screen - nearest, farthest - screen, _MIN_RELIEF_PX)
        return cls(float(screen), float(shift_px / relief), float(shift_px))

    def disparity_px(self, blur_size_px: FloatArray) -> FloatArray:
        """Shift of the left view to the right, relative to the right view, px, float32."""
        disparity = self.scale * (self.screen_px - blur_size_px)
        return np.clip(disparity, -self.largest_px, self.largest_px).astype(np.float32)


def stereo_pair(
    sharp: FloatArray, blur_size_px: FloatArray, parallax: Parallax | float
) -> tuple[FloatArray, FloatArray]:
    """Views of two eyes, at equal distances to the left and right of the given view.

    Surfaces are stretched and compressed without cracks, nearer ones cover farther ones, and what
    appears from behind a foreground is filled with the mirrored background beside it.

    Parameters
    ----------
    sharp : ndarray, float32 [rows, columns] or [rows, columns, 3]
        All-in-focus frame, finite, linear light in [0, 1].
    blur_size_px : ndarray, float32 [map rows, map columns]
        Signed blur sizes, as of `Camera.blur_size_px`: the larger, the farther. The map covers the
        whole frame, may be smaller, and is not finite where the depth is unknown.
    parallax : Parallax or float
        A number stands for `Parallax.from_scene` of it. A video keeps its scale if all frames share
        one `Parallax`.

    Returns
    -------
    left, right : ndarray, float32, like `sharp`
        In [0, 1].

    Raises
    ------
    InputError
        If the frame or the map has a wrong shape or type, no blur size is known, or the parallax is
        not positive or more than half of the frame's width.

    References
    ----------
    Martinello 2012, section 6.3.2.

    Examples
    --------
    >>> import numpy as np
    >>> sharp = np.linspace(0, 1, 60, dtype=np.float32)[None].repeat(40, axis=0)
    >>> left, right = stereo_pair(sharp, np.full((40, 60), 4, np.float32), 5.0)
    >>> left.shape == right.shape == sharp.shape
    True
    """
    check_frame(sharp)
    blur = filled_blur_map(blur_size_px, sharp)
    if not isinstance(parallax, Parallax):
        parallax = Parallax.from_scene(blur_size_px, parallax)
    check_parallax(parallax.largest_px, sharp.shape[1])
    # As from both sides of an aperture that makes such blur.
    farness = -parallax.disparity_px(blur)
    return view_through(sharp, farness, 0, -0.5), view_through(sharp, farness, 0, 0.5)


def check_parallax(shift_px: float, width: int) -> None:
    """Raise `InputError` unless views of a frame of so many columns can be so far apart.

    Examples
    --------
    >>> check_parallax(8.0, width=640)
    """
    if not 0 < shift_px < np.inf:
        raise InputError(f"parallax: expected more than 0 px, got {shift_px:g}")
    if 2 * shift_px > width:
        raise InputError(
            f"parallax: {shift_px:g} px is more than half of the frame's width, {width} px"
        )


def anaglyph(left: FloatArray, right: FloatArray) -> FloatArray:
    """Picture [rows, columns, 3] for glasses with a red left and a cyan right filter.

    Red is the luminance of the left view, green and blue are those of the right one ("half color"
    anaglyph). The red of the left view itself would make red and blue things bright for one eye and
    dark for the other.

    Parameters
    ----------
    left, right : ndarray, float32, one shape
        Linear light.

    Raises
    ------
    InputError
        If they differ in shape.

    References
    ----------
    P. Wimmer, *Anaglyph Methods Comparison*, 3dtv.at.

    Examples
    --------
    >>> import numpy as np
    >>> anaglyph(np.zeros((2, 2), np.float32), np.ones((2, 2), np.float32))[0, 0].tolist()
    [0.0, 1.0, 1.0]
    """
    _check_pair(left, right)
    if left.ndim == 2:
        return np.dstack([left, right, right])
    return np.dstack([left @ _LUMINANCE, right[..., 1:]])


def side_by_side(left: FloatArray, right: FloatArray) -> FloatArray:
    """Picture of twice the width, left on the left; arguments and errors as of `anaglyph`.

    Examples
    --------
    >>> import numpy as np
    >>> view = np.zeros((4, 6), np.float32)
    >>> side_by_side(view, view).shape
    (4, 12)
    """
    _check_pair(left, right)
    return np.concatenate([left, right], axis=1)


def _check_pair(left: FloatArray, right: FloatArray) -> None:
    check_frame(left)
    check_frame(right)
    if left.shape != right.shape:
        sizes = (
            f"{view.shape[1]}x{view.shape[0]} px, {view[0, 0].size} channels"
            for view in (left, right)
        )
        raise InputError("the views of a stereo pair differ: left {}, right {}".format(*sizes))
