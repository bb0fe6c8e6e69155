"""Unknown depth, and surfaces hidden behind occluders."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError


@dataclasses.dataclass(frozen=True)
class Surface:
    """One surface per pixel."""

    blur_size_px: FloatArray  # [h, w], signed; larger is farther, NaN is no surface
    colours: FloatArray  # [h, w, c]


def hidden_surface(visible: Surface, gap_px: float, reach_px: int) -> Surface:
    """Continuation of surfaces behind their occluders; NaN where nothing is hidden.

    Where a neighbour of a pixel is farther by more than `gap_px` in blur size, the neighbour's
    surface continues behind the pixel, and so on from pixel to pixel up to `reach_px` pixels
    inwards: as far as light passing the occluder's edge can come from.
    """
    front = visible.blur_size_px
    sizes = np.full_like(front, np.nan)
    colours = np.zeros_like(visible.colours)
    # Only pixels with something farther within reach can hide anything.
    window = np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)
    candidates = cv2.dilate(front, window) > front + gap_px
    for _ in range(reach_px):
        rows, columns = np.nonzero(candidates & np.isnan(sizes))
        if not rows.size:
            break
        count = np.zeros(len(rows), np.float32)
        size_sum = np.zeros(len(rows), np.float32)
        colour_sum = np.zeros((len(rows), colours.shape[2]), np.float32)
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            near = (
                np.clip(rows + down, 0, front.shape[0] - 1),
                np.clip(columns + right, 0, front.shape[1] - 1),
            )
            for surface in (visible, Surface(sizes, colours)):
                size = surface.blur_size_px[near]
                colour = surface.colours[near]
                farther = size > front[rows, columns] + gap_px
                count += farther
                size_sum += np.where(farther, size, 0)
                colour_sum += np.where(farther[:, None], colour, 0)
        found = count > 0
        at = rows[found], columns[found]
        sizes[at] = size_sum[found] / count[found]
        colours[at] = colour_sum[found] / count[found, None]
    return Surface(sizes, colours)


def fill_unknown(depth_m: NDArray) -> FloatArray:
    """Depth map [h, w] in m, float32, with unknown (NaN) depth filled from the background.

    Each gets the farther of the nearest known depths to its left and right: holes in depth maps
    are mostly what one of two views beside each other could not see. Rows without known depth are
    filled from above and below.

    Raises
    ------
    InputError
        If no depth is known, or one is not positive.
    """
    depth = np.array(depth_m, dtype=np.float32)
    known = ~np.isnan(depth)
    if not known.any():
        raise InputError("depth: no pixel has a known depth")
    if depth[known].min() <= 0:
        raise InputError("depth: expected more than 0 m everywhere (NaN where unknown)")
    return _fill_rows(_fill_rows(depth).T).T.copy()


def _fill_rows(depth: FloatArray) -> FloatArray:
    from_left = _last_known(depth)
    from_right = _last_known(depth[:, ::-1])[:, ::-1]
    return np.where(np.isnan(depth), np.fmax(from_left, from_right), depth)


def _last_known(depth: FloatArray) -> FloatArray:
    """Last known value in each row up to each pixel; NaN before the first."""
    columns = np.where(np.isnan(depth), 0, np.arange(depth.shape[1]))
    return np.take_along_axis(depth, np.maximum.accumulate(columns, axis=1), axis=1)
