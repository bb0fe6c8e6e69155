"""3D pictures: what two eyes would see of an all-in-focus frame, given its depth."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur.blur_map import filled_blur_map
from coded_aperture_ros.imaging import check_frame

# The few pixels beyond these percentiles of blur size, most of them wrong, do not set the scale.
_EXTREMES = (1, 99)
# Relief that is no more than the error of the blur size is not made any larger.
_LEAST_RELIEF_PX = 1.0
# Neighbouring pixels whose disparities differ by more belong to two surfaces.
_TEAR_PX = 2.0
# Pixels next to an edge have light of both sides. They stay with the foreground: left behind, they
# would be its ghost, and holes would be filled with its colour.
_MIXED_PX = 2
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
    def of_scene(cls, blur_size_px: FloatArray, shift_px: float) -> "Parallax":
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
        A number stands for `Parallax.of_scene` of it. A video keeps its scale if all frames share
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
    sharp = np.ascontiguousarray(sharp, np.float32)
    blur = filled_blur_map(blur_size_px, sharp)
    if not isinstance(parallax, Parallax):
        parallax = Parallax.of_scene(blur_size_px, parallax)
    check_parallax(parallax.largest_px, sharp.shape[1])
    disparity = parallax.disparity_px(blur)
    for _ in range(_MIXED_PX):  # foregrounds take the pixels around them along
        nearer = cv2.dilate(disparity, np.ones((3, 3), np.uint8))
        disparity = np.where(nearer - disparity > _TEAR_PX, nearer, disparity)
    left = _left_view(sharp, disparity)
    # What the right eye sees is what the left one would see in a mirror.
    right = _left_view(np.ascontiguousarray(sharp[:, ::-1]), disparity[:, ::-1])
    return left, np.ascontiguousarray(right[:, ::-1])


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


def _left_view(sharp: FloatArray, disparity: FloatArray) -> FloatArray:
    """Move every pixel to the right by half of its disparity."""
    columns = _seen_columns(disparity / np.float32(2))
    rows = np.repeat(np.arange(len(sharp), dtype=np.float32)[:, None], sharp.shape[1], axis=1)
    view = cv2.remap(sharp, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.clip(view, 0, 1)


def _seen_columns(shift: FloatArray) -> FloatArray:
    """Return which fractional column of the frame each pixel of a view shows [rows, columns].

    `shift` says how far each pixel of the frame moves to the right; the nearer, the farther.
    """
    height, width = shift.shape
    column = np.arange(width, dtype=np.float32)
    place = column + shift
    torn = np.abs(np.diff(shift, axis=1)) > _TEAR_PX / 2
    # A pixel reaches half-way to its neighbours; where the surface ends, half a pixel.
    half_way = (place[:, 1:] + place[:, :-1]) / 2
    start, stop = place - 0.5, place + 0.5
    start[:, 1:] = np.where(torn, start[:, 1:], half_way)
    stop[:, :-1] = np.where(torn, stop[:, :-1], half_way)

    seen = np.tile(column, (height, 1))
    _fill_holes(seen, shift, place, torn)
    # Where several pixels land on one, the leftmost is the nearest: it has moved the most. So all
    # are painted from right to left, and need no comparison of their depths.
    row = np.repeat(np.arange(height), width)
    start, stop = start[:, ::-1].ravel(), stop[:, ::-1].ravel()
    pixel, target, distance = _painted(row, start, stop, width)
    origin = np.tile(column[::-1], height)[pixel]
    seen.reshape(-1)[target] = origin - np.float32(0.5) + distance / (stop - start)[pixel]
    return seen


def _fill_holes(seen: FloatArray, shift: FloatArray, place: FloatArray, torn: BoolArray) -> None:
    """Paint what is behind all surfaces: backgrounds that go on, mirrored at their ends.

    A hole opens to the right of a pixel that moves less than its right neighbour, and so is the
    farther of the two; and at the borders of the view.
    """
    height, width = shift.shape
    # The surface of each pixel begins at the last tear before it.
    after_tear = np.pad(np.where(torn, np.arange(1, width), 0), ((0, 0), (1, 0)))
    first = np.maximum.accumulate(after_tear, axis=1)
    row, last = np.nonzero(torn & (np.diff(shift, axis=1) > 0))
    every = np.arange(height)
    # The right border first: what is found inside is painted over it.
    stop = np.concatenate([np.full(height, width, np.float32), place[row, last + 1] - 0.5])
    row = np.concatenate([every, row])
    last = np.concatenate([np.full(height, width - 1), last])
    hole, target, distance = _painted(row, place[row, last] + np.float32(0.5), stop, width)
    span = (last - first[row, last])[hole]
    seen.reshape(-1)[target] = last[hole] - _mirrored(distance, span)

    stop = place[:, 0] - np.float32(0.5)
    hole, target, _ = _painted(every, np.zeros_like(stop), stop, width)
    span = np.pad(torn, ((0, 0), (0, 1)), constant_values=True).argmax(axis=1)[hole]
    seen.reshape(-1)[target] = _mirrored(stop[hole] - target % width, span)


def _mirrored(distance: FloatArray, span: IndexArray) -> FloatArray:
    """Return how far back to go for what lies beyond a surface's end, to and fro within its span.

    The `distance` >= 0 is from the edge of the surface's last pixel.
    """
    period = np.maximum(span, 1)
    phase = np.maximum(distance - np.float32(0.5), 0) % (2 * period)
    return np.minimum(period - np.abs(period - phase), span).astype(np.float32)


def _painted(
    row: IndexArray, start: FloatArray, stop: FloatArray, width: int
) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Go through the pixels of a view that intervals ``start <= column < stop`` of rows cover.

    Returns, for each, the index of its interval, in the order given; its flat index in a view of
    `width` columns; and its distance from the interval's start.
    """
    first = np.maximum(np.ceil(start), 0).astype(np.intp)
    counts = np.maximum(np.minimum(np.ceil(stop), width).astype(np.intp) - first, 0)
    interval = np.repeat(np.arange(len(row)), counts)
    column = np.arange(len(interval)) - np.repeat(np.cumsum(counts) - counts, counts)
    column += first[interval]
    distance = column.astype(np.float32) - start[interval]
    return interval, row[interval] * width + column, distance
