"""Views through the openings of the mask: the light field behind one frame."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur.blur_map import filled_blur_map
from coded_aperture_ros.frames import check_frame
from coded_aperture_ros.optics import Mask

# Groups of cells of a fine mask that let less light pass than this share of the clearest are shut.
_MIN_TRANSMISSION = 0.2
# Neighbouring pixels whose places come to differ by more belong to two surfaces.
_TEAR_PX = 1.0
# Pixels next to an edge have light of both sides. They stay with the foreground: left behind, they
# would be its ghost, and holes would be filled with its colour.
_MIXED_PX = 2


def opening_centres(mask: Mask, most: int = 11) -> dict[tuple[int, int], tuple[float, float]]:
    """Positions of a mask's openings, as `view_through` takes them, by row and column.

    For masks of more than `most` cells a side, the centroids of groups of cells.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> opening_centres(Mask.from_rows(["100", "000", "001"]))[0, 0]
    (-0.3333333333333333, -0.3333333333333333)
    """
    shape = mask.transmission.shape
    side = max(mask.transmission.shape)
    rows, columns = (np.arange(0, length, -(-side // most)) for length in shape)
    places = ((np.indices(shape).T + 0.5 - np.divide(shape, 2)) / side).T
    parts = np.array([np.ones(shape), *places]) * mask.transmission
    light, *moments = np.add.reduceat(np.add.reduceat(parts, rows, 1), columns, 2)
    down, right = np.array(moments) / np.maximum(light, 1e-9)
    found = np.argwhere(light > _MIN_TRANSMISSION * light.max()).tolist()
    return {(i, j): (float(down[i, j]), float(right[i, j])) for i, j in found}


def view_through(
    sharp: FloatArray, blur_size_px: FloatArray, down: float, right: float
) -> FloatArray:
    """View of a pinhole at a position in the aperture, float32, like `sharp`, in [0, 1].

    A point of signed blur size S is seen `down` S lower and `right` S farther right than in the
    all-in-focus frame, the view through the middle; a blur size of 0 stays. Nearer things cover
    farther ones; what appears behind them is the mirrored background beside them.

    Parameters
    ----------
    sharp, blur_size_px : ndarray, float32
        As of `stereo_pair`; blur sizes in pixels of the frame.
    down, right : float
        In units of the mask's extent, from its middle, in [-0.5, 0.5].

    Raises
    ------
    InputError
        If the frame, the map or the position cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> sharp = np.linspace(0, 1, 60, dtype=np.float32)[None].repeat(40, axis=0)
    >>> view = view_through(sharp, np.full((40, 60), 4, np.float32), 0.0, 0.5)
    >>> round(float(sharp[20, 30] - view[20, 32]), 3)
    0.0
    """
    check_frame(sharp)
    if not max(abs(down), abs(right)) <= 0.5:
        raise InputError(f"view: expected a place within 0.5 of the middle, got {down}, {right}")
    blur = filled_blur_map(blur_size_px, sharp)
    if abs(down) > abs(right):  # the same lying on its side
        view = view_through(sharp.swapaxes(0, 1), blur.T, right, down).swapaxes(0, 1)
    elif right > 0:  # or in a mirror, as the nearer has to move the farther to the right
        view = view_through(sharp[:, ::-1], blur[:, ::-1], down, -right)[:, ::-1]
    else:
        view = _shifted_view(sharp, np.float32(right) * blur, down / right if right else 0.0)
    return np.ascontiguousarray(view)


def _shifted_view(sharp: FloatArray, shift: FloatArray, slope: float) -> FloatArray:
    """View with pixels moved right by `shift` px and down by `slope` times that."""
    for _ in range(_MIXED_PX):  # foregrounds take the pixels around them along
        nearer = cv2.dilate(shift, np.ones((3, 3), np.uint8))
        shift = np.where(nearer - shift > _TEAR_PX, nearer, shift)
    height, width = shift.shape
    row = np.arange(height)[:, None]
    column = np.arange(width)
    # Sheared, the lines along which pixels move are rows; beyond the frame its border goes on.
    down = np.rint(slope * column).astype(np.intp)
    line = np.arange(-down.max(), height - down.min())[:, None]
    sheared = shift[np.clip(line + down, 0, height - 1), column]
    source = _source_columns(sheared)[row - down + down.max(), column]
    rows = (row + slope * (source - column)).astype(np.float32)
    sharp = np.ascontiguousarray(sharp, np.float32)
    view = cv2.remap(sharp, source, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.clip(view, 0, 1)


def _source_columns(shift: FloatArray) -> FloatArray:
    """Fractional column of the frame that each pixel of a view shows [rows, columns].

    `shift` is how far each pixel of the frame moves to the right; the nearer, the farther.
    """
    height, width = shift.shape
    column = np.arange(width, dtype=np.float32)
    place = column + shift
    torn = np.abs(np.diff(shift, axis=1)) > _TEAR_PX
    # A pixel reaches half-way to its neighbours; where the surface ends, half a pixel.
    half_way = (place[:, 1:] + place[:, :-1]) / 2
    start = place - 0.5
    stop = place + 0.5
    start[:, 1:] = np.where(torn, start[:, 1:], half_way)
    stop[:, :-1] = np.where(torn, stop[:, :-1], half_way)

    source = np.tile(column, (height, 1))
    _fill_holes(source, shift, place, torn)
    # Where several pixels land on one, the leftmost is the nearest: it has moved the most. So all
    # are painted from right to left, and need no comparison of their depths.
    row = np.repeat(np.arange(height), width)
    start = start[:, ::-1].ravel()
    stop = stop[:, ::-1].ravel()
    pixel, target, distance = _covered_pixels(row, start, stop, width)
    origin = np.tile(column[::-1], height)[pixel]
    source.reshape(-1)[target] = origin - np.float32(0.5) + distance / (stop - start)[pixel]
    return source


def _fill_holes(source: FloatArray, shift: FloatArray, place: FloatArray, torn: BoolArray) -> None:
    """Fill what is behind all surfaces: backgrounds continue, mirrored at their ends.

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
    hole, target, distance = _covered_pixels(row, place[row, last] + np.float32(0.5), stop, width)
    span = (last - first[row, last])[hole]
    source.reshape(-1)[target] = last[hole] - _mirrored_offset(distance, span)

    stop = place[:, 0] - np.float32(0.5)
    hole, target, _ = _covered_pixels(every, np.zeros_like(stop), stop, width)
    span = np.pad(torn, ((0, 0), (0, 1)), constant_values=True).argmax(axis=1)[hole]
    source.reshape(-1)[target] = _mirrored_offset(stop[hole] - target % width, span)


def _mirrored_offset(distance: FloatArray, span: IndexArray) -> FloatArray:
    """Distance back into a surface for what lies beyond its end, to and fro within its span.

    The `distance` >= 0 is from the edge of the surface's last pixel.
    """
    period = np.maximum(span, 1)
    phase = np.maximum(distance - np.float32(0.5), 0) % (2 * period)
    return np.minimum(period - np.abs(period - phase), span).astype(np.float32)


def _covered_pixels(
    row: IndexArray, start: FloatArray, stop: FloatArray, width: int
) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Pixels of a view that intervals ``start <= column < stop`` of rows cover.

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
