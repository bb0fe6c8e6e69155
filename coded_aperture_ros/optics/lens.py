"""Thin-lens formulas: blur size from depth, depth from blur size, number of depth levels.

Blur sizes are signed: positive beyond the focal plane, negative in front of it. The sign is what
the thesis' equations (M. Martinello, *Coded Aperture Imaging*, 2012, ch. 3) lose by taking the
absolute value; it tells which way round the mask is seen in the image.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def image_distance(focal_length: float, focus_distance: float) -> float:
    """Return the lens-to-sensor distance that brings `focus_distance` into focus (thesis eq. 3.14).

    All lengths in one unit; `focus_distance` must exceed `focal_length`.
    """
    return focal_length * focus_distance / (focus_distance - focal_length)


def blur_size_from_depth(
    depth_m: ArrayLike,
    focus_distance_m: float,
    blur_at_infinity_px: float,
    lens_mask_distance_m: float = 0.0,
) -> NDArray[np.float64]:
    """Return the signed blur size of a point at `depth_m` (thesis eq. 3.28, with its sign).

    With the mask extent `M`, the focal length in pixels `f` and the mask a distance `C` in front
    of the lens, `S = M f (1/z_focus - 1/z) z / (z - C)`; `M f / z_focus`, the limit for `z` to
    infinity, is `blur_at_infinity_px`.

    Parameters
    ----------
    depth_m : array_like
        Depth along the optical axis in metres; infinity is allowed.
    focus_distance_m, blur_at_infinity_px, lens_mask_distance_m : float
        The camera.

    Returns
    -------
    ndarray of float64
        Blur size in pixels, of the shape of `depth_m`; NaN where the depth is NaN or lies
        behind the lens or the mask.
    """
    z = np.asarray(depth_m, dtype=np.float64)
    visible = z > max(0.0, lens_mask_distance_m)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inverse = np.where(visible, 1.0 / z, np.nan)
    # Divided through by z, so that an infinite depth needs no special case.
    ratio = (1.0 - focus_distance_m * inverse) / (1.0 - lens_mask_distance_m * inverse)
    return np.asarray(blur_at_infinity_px * ratio)


def depth_from_blur_size(
    blur_size_px: ArrayLike,
    focus_distance_m: float,
    blur_at_infinity_px: float,
    lens_mask_distance_m: float = 0.0,
) -> NDArray[np.float64]:
    """Return the depth of a point from its signed blur size; the inverse of `blur_size_from_depth`.

    Returns
    -------
    ndarray of float64
        Depth in metres: `+inf` at or beyond the blur size of infinity, NaN where the blur size is
        NaN or so far in front of the focal plane that no depth has it.
    """
    size = np.asarray(blur_size_px, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = size / blur_at_infinity_px
        depth = (focus_distance_m - relative * lens_mask_distance_m) / (1.0 - relative)
        depth = np.where(relative >= 1.0, np.inf, depth)
        return np.where(depth > max(0.0, lens_mask_distance_m), depth, np.nan)


def levels_between(smallest_px: float, largest_px: float, resolution_px: float = 1.0) -> float:
    """Count the depth levels that can be told apart (thesis eq. 3.29; 3.31 at 1 px).

    `resolution_px` is the smallest change of blur size that the estimator detects, in pixels of
    the image that it is given.
    """
    return (largest_px - smallest_px) / resolution_px + 1.0
