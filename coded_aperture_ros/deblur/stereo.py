"""3D pictures: what two eyes would see of an all-in-focus frame, given its depth."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur.blur_map import filled_blur_map
from coded_aperture_ros.deblur.views import view_through
from coded_aperture_ros.frames import check_frame

# The few pixels beyond these percentiles of blur size, most of them wrong, do not set the scale.
_EXTREMES = (1, 99)
# Relief that is no more than the error of the blur size is not made any larger.
_LEAST_RELIEF_PX = 1.0
# Of red, green and blue light, ITU-R BT.709.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclasses.dataclass(frozen=True)
class Parallax:
    """How disparity follows from blur size.

    Both are linear in the inverse depth, so disparity is ``scale (screen - blur size)``, within
    plus and minus `largest_px`. It is what a stereo camera sees whose baseline is `scale` times as
    wide as the mask. What has a signed blur size of `screen_px` appears in the plane of the screen,
    and what has a smaller one in front of it.
    """

    screen_px: float
    scale: float
    largest_px: float

    @classmethod
    def from_scene(cls, blur_size_px: FloatArray, shift_px: float) -> "Parallax":
        """Put the median of a scene at the screen, and give what is farthest from it `shift_px`.

        This is the largest distance between the two views of one point, > 0. A scene that is almost
        flat, with a relief of less than 1 px of blur size, gets less. The blur sizes are signed,
        and not finite where unknown; an `InputError` if all are.
        """
        known = blur_size_px[np.isfinite(blur_size_px)]
        if known.size == 0:
            raise InputError("blur map: no pixel has a known depth")
        nearest, screen, farthest = np.percentile(known, (_EXTREMES[0], 50, _EXTREMES[1]))
        relief = max(screen - nearest, farthest - screen, _LEAST_RELIEF_PX)
        return cls(float(screen), float(shift_px / relief), float(shift_px))

    def disparity_px(self, blur_size_px: FloatArray) -> FloatArray:
        """Return how much farther to the right the left eye sees a point than the right eye."""
        disparity = self.scale * (self.screen_px - blur_size_px)
        return np.clip(disparity, -self.largest_px, self.largest_px).astype(np.float32)


def stereo_pair(
    sharp: FloatArray, blur_size_px: FloatArray, parallax: Parallax | float
) -> tuple[FloatArray, FloatArray]:
    """Render the views of two eyes, at equal distances to the left and right of the given view.

    Surfaces are stretched and compressed without cracks, what is nearer covers what is farther, and
    what appears from behind a foreground is filled with the mirrored background beside it.

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
    """Raise InputError unless views of a frame of so many columns can be so far apart."""
    if not 0 < shift_px < np.inf:
        raise InputError(f"parallax: expected more than 0 px, got {shift_px:g}")
    if 2 * shift_px > width:
        raise InputError(
            f"parallax: {shift_px:g} px is more than half of the frame's width, {width} px"
        )


def anaglyph(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return one picture for glasses with a red filter on the left and a cyan one on the right.

    Red is the luminance of the left view, green and blue are those of the right one: the "half
    color" anaglyph of P. Wimmer, *Anaglyph Methods Comparison*, 3dtv.at. The red of the left view
    itself would make red and blue things bright for one eye and dark for the other.

    Both are float32 in linear light, of one shape, else an `InputError`; the picture is [rows,
    columns, 3].
    """
    _check_pair(left, right)
    if left.ndim == 2:
        return np.dstack([left, right, right])
    return np.dstack([left @ _LUMINANCE, right[..., 1:]])


def side_by_side(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return one picture of twice the width, left on the left; else like `anaglyph`."""
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
