"""Entrance pupil of a lens, and the largest mask that fits into it.

A thin lens of focal length f and f-number N has a round entrance pupil of diameter f / N. Light
passes an opening of a mask only where the opening lies within the pupil. What is closed may reach
beyond it: the limit of a mask depends on how far from its middle its open cells reach.
"""

import functools
import math

import numpy as np

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics.mask import Mask

# F-numbers and focal lengths are engraved with two or three digits: a mask may be so much larger.
_ROUNDING = 1.01
# Suggested sizes have so many digits, and are rounded down.
_DIGITS = 3
# Of cells that let a part of the light through, as at the rim of a disc, the middle counts.
_FULLY_OPEN = 0.99
_HALF_OPEN = 0.5


@functools.lru_cache(maxsize=64)
def openings_diameter(mask: Mask) -> float:
    """Diameter of the circle around the mask's middle that holds all openings, in extents.

    For a square pattern that is open in its corners the square root of 2.

    Examples
    --------
    >>> round(openings_diameter(Mask.named("four_hole")), 4)
    1.4142
    >>> round(openings_diameter(Mask.named("levin")), 2)
    1.19
    >>> round(openings_diameter(Mask.named("disc")), 2)
    1.0
    """
    rows, columns = mask.transmission.shape
    share = mask.transmission / mask.transmission.max()
    y = np.abs(np.arange(rows) + 0.5 - rows / 2)[:, None]
    x = np.abs(np.arange(columns) + 0.5 - columns / 2)[None, :]
    corners = np.hypot(y + 0.5, x + 0.5)[share >= _FULLY_OPEN]
    middles = np.hypot(y, x)[share > _HALF_OPEN]
    farthest = max(float(corners.max()), float(middles.max()))
    return 2 * farthest / max(rows, columns)


def largest_extent_mm(mask: Mask, pupil_mm: float | None) -> float:
    """Largest extent of a mask whose openings lie within a pupil, mm, rounded down to 3 digits.

    Infinite if the pupil is not known.

    Examples
    --------
    >>> largest_extent_mm(Mask.named("four_hole"), 25 / 1.4)
    12.6
    >>> largest_extent_mm(Mask.named("levin"), 25 / 1.4)
    15.0
    """
    if pupil_mm is None:
        return math.inf
    extent_mm = pupil_mm / openings_diameter(mask)
    unit = 10.0 ** (math.floor(math.log10(extent_mm)) - _DIGITS + 1)
    return round(math.floor(extent_mm / unit * (1 + 1e-9)) * unit, 9)


def exceeds_pupil(mask: Mask, extent_mm: float, pupil_mm: float | None) -> str:
    """Reason why a mask does not fit into a pupil; empty if it does, or the pupil is unknown."""
    if pupil_mm is None or extent_mm * openings_diameter(mask) <= pupil_mm * _ROUNDING:
        return ""
    return (
        f"{extent_mm:.4g} mm is too wide for the entrance pupil of {pupil_mm:.4g} mm "
        f"(focal_length_mm / lens_f_number), as the openings of mask {mask.name} reach "
        f"{openings_diameter(mask):.3g} times its extent: use at most "
        f"{largest_extent_mm(mask, pupil_mm):g} mm"
    )


def measured_beyond_pupil(mask: Mask, extent_mm: float, pupil_mm: float | None) -> str:
    """Reason why a measured extent cannot be right; empty if it fits into the pupil."""
    if not exceeds_pupil(mask, extent_mm, pupil_mm):
        return ""
    return (
        f"by the pictures the mask is {extent_mm:.4g} mm wide, but the lens's pupil of "
        f"{pupil_mm:.3g} mm takes at most {largest_extent_mm(mask, pupil_mm):g} mm: check "
        "focal_length_mm, lens_f_number and the distances"
    )


def check_pupil(
    focal_length_mm: float | None, lens_f_number: float | None, mask: Mask, extent_mm: float
) -> None:
    """Raise `InputError` if an f-number has no focal length, or the mask exceeds the pupil."""
    if lens_f_number is None:
        return
    if focal_length_mm is None:
        raise InputError(
            "lens_f_number: tells the entrance pupil only with focal_length_mm: give "
            "focal_length_mm and pixel_pitch_um instead of focal_length_px"
        )
    reason = exceeds_pupil(mask, extent_mm, focal_length_mm / lens_f_number)
    if reason:
        raise InputError(f"mask_extent_mm: {reason}")


def wider_mask_advice(mask: Mask, extent_mm: float, pupil_mm: float | None) -> str:
    """Words for a wider mask, with the limit of the pupil; for a faster lens at that limit.

    Examples
    --------
    >>> levin = Mask.named("levin")
    >>> wider_mask_advice(levin, 10.0, None)
    'a wider mask'
    >>> wider_mask_advice(levin, 10.0, 25 / 1.4)
    "a wider mask (the lens's pupil of 17.9 mm takes up to 15 mm)"
    >>> wider_mask_advice(levin, 15.0, 25 / 1.4)
    "a lens with a larger pupil (the mask fills this one's 17.9 mm)"
    """
    if pupil_mm is None:
        return "a wider mask"
    largest_mm = largest_extent_mm(mask, pupil_mm)
    if extent_mm * _ROUNDING >= largest_mm:
        return f"a lens with a larger pupil (the mask fills this one's {pupil_mm:.3g} mm)"
    return f"a wider mask (the lens's pupil of {pupil_mm:.3g} mm takes up to {largest_mm:g} mm)"
