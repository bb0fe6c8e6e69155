"""What a camera cannot see from its centre: unknown depth, and surfaces behind occluders."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.errors import InputError


@dataclasses.dataclass(frozen=True)
class Surface:
    """One surface per pixel.

    Attributes
    ----------
    blur_size_px : ndarray of float32, shape [h, w]
        Signed; larger is farther. NaN where there is no surface.
    colours : ndarray of float32, shape [h, w, c]
    """

    blur_size_px: NDArray[np.float32]
    colours: NDArray[np.float32]


def hidden_surface(visible: Surface, gap_px: float, reach_px: int) -> Surface:
    """Continue surfaces behind what occludes them.

    Wherever a pixel has a neighbour that is farther by more than `gap_px` in blur size, the
    neighbour's surface is taken to continue behind the pixel, and so on from pixel to pixel up to
    `reach_px` pixels inwards: as far as light passing the occluder's edge can come from.
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
                size, colour = surface.blur_size_px[near], surface.colours[near]
                farther = size > front[rows, columns] + gap_px
                count += farther
                size_sum += np.where(farther, size, 0)
                colour_sum += np.where(farther[:, None], colour, 0)
        found = count > 0
        at = rows[found], columns[found]
        sizes[at] = size_sum[found] / count[found]
        colours[at] = colour_sum[found] / count[found, None]
    return Surface(sizes, colours)


def fill_unknown(depth_m: NDArray) -> NDArray[np.float32]:
    """Give unknown depths that of the farthest neighbour that is known; holes grow inwards.

    Holes in depth maps are mostly what one of two views could not see: the background.

    Raises
    ------
    InputError
        If no depth is known or one is not positive.
    """
    depth = np.array(depth_m, dtype=np.float32)
    known = ~np.isnan(depth)
    if not known.any():
        raise InputError("depth: no pixel has a known depth")
    if depth[known].min() <= 0:
        raise InputError("depth: expected more than 0 m everywhere (NaN where unknown)")
    depth[~known] = -np.inf
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    while (unknown := np.isneginf(depth)).any():
        depth[unknown] = cv2.dilate(depth, cross)[unknown]
    return depth
