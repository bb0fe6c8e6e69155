"""The light field behind one frame: what is seen through each place of the aperture."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur.blur_map import filled_blur_map
from coded_aperture_ros.deblur.moving import moved
from coded_aperture_ros.imaging import check_frame
from coded_aperture_ros.optics import Mask

# Groups of cells of a fine mask that let less light pass than this share of the clearest are shut.
_SHUT = 0.2


def openings(mask: Mask, most: int = 11) -> dict[tuple[int, int], tuple[float, float]]:
    """Return the places of a mask's openings, as `view_through` takes them, by row and column.

    Where a mask is more than `most` cells high or wide, these are square groups of cells.
    """
    side = max(mask.transmission.shape)
    group = -(-side // most)
    starts = [np.arange(0, length, group) for length in mask.transmission.shape]
    light = np.add.reduceat(np.add.reduceat(mask.transmission, starts[0], 0), starts[1], 1)
    down, right = (
        (start + np.minimum(start + group, length) - length) / (2 * side)
        for start, length in zip(starts, mask.transmission.shape, strict=True)
    )
    found = np.argwhere(light > _SHUT * light.max()).tolist()
    return {(row, column): (float(down[row]), float(right[column])) for row, column in found}


def view_through(
    sharp: FloatArray, blur_size_px: FloatArray, down: float, right: float
) -> FloatArray:
    """Render what a pinhole at a place of the aperture sees.

    A point of signed blur size S is seen `down` S lower and `right` S farther to the right than in
    the all-in-focus frame, which is the view through the middle. What is in focus stays where it
    is; blur sizes less S keep what has S in its place instead. Nearer things cover farther ones,
    and what appears from behind them is filled with the mirrored background beside it.

    Parameters
    ----------
    sharp : ndarray, float32 [rows, columns] or [rows, columns, 3]
        All-in-focus frame, finite, linear light in [0, 1].
    blur_size_px : ndarray, float32 [map rows, map columns]
        Signed blur sizes, as of `Camera.blur_size_px`: the larger, the farther. The map covers the
        whole frame, may be smaller, and is not finite where the depth is unknown.
    down, right : float
        In units of the mask's extent, from its middle, in [-0.5, 0.5].

    Returns
    -------
    ndarray, float32, like `sharp`
        In [0, 1].

    Raises
    ------
    InputError
        If the frame or the map has a wrong shape or type, no blur size is known, or the place is
        outside of the aperture.
    """
    check_frame(sharp)
    if not max(abs(down), abs(right)) <= 0.5:
        raise InputError(f"view: expected a place within 0.5 of the middle, got {down:g}, {right:g}")
    blur = filled_blur_map(blur_size_px, sharp)
    if down == right == 0:
        return np.array(sharp, np.float32)
    if abs(down) > abs(right):  # the same lying on its side
        return view_through(sharp.swapaxes(0, 1), blur.T, right, down).swapaxes(0, 1)
    if right > 0:  # or in a mirror, as the nearer has to move the farther to the right
        return view_through(sharp[:, ::-1], blur[:, ::-1], down, -right)[:, ::-1]
    shift = np.ascontiguousarray(right * blur, np.float32)
    return moved(np.ascontiguousarray(sharp, np.float32), shift, down / right)
