"""Light that the corners of the picture lose at a mask that is thick, or far from the pupil."""

import math

from coded_aperture_ros.design.holder import Holder
from coded_aperture_ros.design.openings import mask_openings
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.pupil import openings_diameter

# Of the narrowest opening, what a floor that has the openings may shade in the corners.
_MAX_SHADOW = 0.25
# Pupils are known to so much, as a share.
_ROUNDING = 1.01


def shadow_mm(holder: Holder, camera: Camera) -> float:
    """How far the floor shades an opening for the corners of the picture, mm.

    The thickness of the floor times the tangent of half of the diagonal field of view.

    Examples
    --------
    >>> from coded_aperture_ros.design.holder import mask_holder
    >>> from coded_aperture_ros.optics import Mask
    >>> levin = Mask.named("levin")
    >>> camera = Camera(1000.0, 1.0, 640, 480, levin, 9.6)
    >>> round(shadow_mm(mask_holder(levin, 9.6, 26.4), camera), 3)
    0.32
    """
    return holder.floor_mm * _corner_slope(camera)


def shadow_warning(holder: Holder, camera: Camera) -> str:
    """Warning if the floor shades the mask in the corners of the picture; empty if it does not."""
    shadow = shadow_mm(holder, camera)
    if holder.takes_piece:
        openings_mm = camera.mask_extent_mm * openings_diameter(camera.mask)
        if holder.opening_mm >= openings_mm + 2 * shadow:
            return ""
        return (
            f"the floor of {holder.floor_mm:g} mm shades the mask in the corners of the picture: "
            f"use --margin-mm {math.ceil(20 * shadow) / 10:g} or more"
        )
    hole_mm = camera.mask_extent_mm * mask_openings(camera.mask).smallest_width
    if shadow <= _MAX_SHADOW * hole_mm:
        return ""
    return (
        f"the floor of {holder.floor_mm:g} mm narrows openings of {hole_mm:.2f} mm by "
        f"{shadow:.2f} mm in the corners of the picture: use a thinner one (--floor-mm)"
    )


def front_mask_warning(camera: Camera) -> str:
    """Warning of a mask before or behind the pupil, which cuts it off in the corners.

    Empty if it does not, or the pupil is not known.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(
    ...     1000.0, 1.0, 640, 480, Mask.named("four_hole"), 8.0, lens_mask_distance_mm=10.0,
    ...     focal_length_mm=16.0, lens_f_number=1.4,
    ... )
    >>> front_mask_warning(camera).partition(": ")[2][:56]
    'in the corners of the picture light passes the mask 4 mm'
    """
    if camera.pupil_mm is None:
        return ""
    beside_mm = abs(camera.lens_mask_distance_mm) * _corner_slope(camera)
    room_mm = camera.pupil_mm * _ROUNDING - 2 * beside_mm
    diameter = openings_diameter(camera.mask)
    if camera.mask_extent_mm * diameter <= room_mm:
        return ""
    largest_mm = math.floor(10 * room_mm / diameter) / 10
    advice = "bring the mask nearer to the lens's iris"
    if largest_mm > 0:
        advice += f", or use a mask of at most {largest_mm:g} mm"
    return (
        f"lens_mask_distance_mm: in the corners of the picture light passes the mask "
        f"{beside_mm:.2g} mm beside its middle, and the pupil of {camera.pupil_mm:.3g} mm cuts off "
        f"openings: {advice}"
    )


def _corner_slope(camera: Camera) -> float:
    """Tangent of half of the diagonal field of view."""
    return math.hypot(camera.image_width, camera.image_height) / 2 / camera.focal_length_px
