"""Values that a camera can have, and the thin lens between focus and image distance."""

from collections.abc import Mapping
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import Option, check_option

# Type, unit and range of every number of a camera file.
NUMBERS: dict[str, tuple[type, Option]] = {
    "focal_length_mm": (float, Option("Focal length of the lens", "mm", 0.1, 10_000)),
    "pixel_pitch_um": (float, Option("Distance between pixel centres", "um", 0.1, 1_000)),
    "focal_length_px": (float, Option("Image distance over pixel pitch", "px", 1, 1_000_000)),
    "focus_distance_m": (float, Option("Distance of the focal plane", "m", 0.001, 100_000)),
    "image_width": (int, Option("Width of the image", "px", 1, 100_000)),
    "image_height": (int, Option("Height of the image", "px", 1, 100_000)),
    "mask_extent_mm": (float, Option("Outer extent of the mask's grid", "mm", 0.001, 10_000)),
    "lens_mask_distance_mm": (
        float,
        Option("How far the mask sits in front of the lens", "mm", -1_000, 1_000),
    ),
    "lens_f_number": (float, Option("F-number of the lens wide open", "", 0.4, 200)),
    "wavelength_nm": (float, Option("Wavelength of the light", "nm", 200, 2_000)),
    "noise": (float, Option("Noise of one channel in the dark, linear light", "", 0, 0.5)),
    "noise_gain": (float, Option("Variance of shot noise per unit of light", "", 0, 0.1)),
}
SIDE = Option("Side of the focal plane that the scene is on", choices=("far", "near", "both"))
CALIBRATED = Option("How lens and mask are known", choices=("nominal", "planes", "field", "traced"))
# Together they stand for `focal_length_px`.
LENS_AND_PIXEL = ("focal_length_mm", "pixel_pitch_um")
# Not known of every camera.
_MAY_BE_NONE = ("focal_length_mm", "lens_f_number")
# No lens is faster or, with a mask in it, slower.
_MIN_F_NUMBER = 0.4
_MAX_F_NUMBER = 200.0


def image_distance(focal_length: float, focus_distance: float) -> float:
    """Distance from the lens to the sensor, in the unit of the arguments.

    Parameters
    ----------
    focal_length : float
        More than 0.
    focus_distance : float
        Distance of the focal plane, more than the focal length.

    Returns
    -------
    float

    References
    ----------
    Martinello 2012, eq. 3.14.

    Examples
    --------
    >>> image_distance(50.0, 1050.0)
    52.5
    """
    return focal_length * focus_distance / (focus_distance - focal_length)


def check_numbers(values: Mapping[str, Any]) -> None:
    """Raise `InputError` with the first of some values by name that no camera can have."""
    for name, value in values.items():
        if name in NUMBERS and not (value is None and name in _MAY_BE_NONE):
            check_option(name, value, *NUMBERS[name])


def check_f_number(focal_length_mm: float, extent_mm: float) -> None:
    """Raise `InputError` unless focal length over mask extent is an f-number that lenses have."""
    f_number = focal_length_mm / extent_mm
    if not _MIN_F_NUMBER <= f_number <= _MAX_F_NUMBER:
        raise InputError(
            f"mask_extent_mm: {extent_mm:g} mm in a lens of {focal_length_mm:g} mm is "
            f"f/{f_number:.3g}, and lenses have f/{_MIN_F_NUMBER:g} to "
            f"f/{_MAX_F_NUMBER:g}: give both in millimetres"
        )


def check_focus_distance(focal_length_mm: float, focus_distance_m: float) -> None:
    """Raise `InputError` unless the focal plane lies beyond the focal length."""
    if focus_distance_m * 1e3 <= focal_length_mm:
        raise InputError(
            f"focus_distance_m: {focus_distance_m!r} is not beyond the focal length, "
            f"use more than {focal_length_mm * 1e-3:g} m"
        )


def check_mask_distance(lens_mask_distance_mm: float, focus_distance_m: float) -> None:
    """Raise `InputError` unless the mask lies in front of the focal plane."""
    if lens_mask_distance_mm * 1e-3 >= focus_distance_m:
        raise InputError(
            f"lens_mask_distance_mm: {lens_mask_distance_mm!r} puts the mask beyond the "
            f"focal plane, use less than {focus_distance_m * 1e3:g} mm"
        )


def check_depth_range(
    near_m: float, far_m: float, nearest_m: float, focus_m: float, side: str
) -> None:
    """Raise `InputError` unless a depth range is increasing and on the side of the focal plane.

    It has to begin beyond `nearest_m`.
    """
    if not nearest_m < near_m < far_m:
        raise InputError(
            f"depth range {near_m:g} to {far_m:g} m: expected two increasing distances "
            f"beyond {nearest_m:g} m"
        )
    if side != "both" and near_m < focus_m < far_m:
        raise InputError(
            f"the focus at {focus_m:g} m lies inside the depth range {near_m:g} to {far_m:g} m: "
            "points on the two sides of the focal plane give the same blur (a symmetric mask, "
            "or any power spectrum, cannot tell them apart); focus before or beyond the range, "
            "narrow the range to one side, or, with an asymmetric mask, set side: both"
        )
    if side != "both" and (side == "far") != (near_m >= focus_m):
        actual, other = ("near", "in front of") if side == "far" else ("far", "beyond")
        raise InputError(
            f"the depth range {near_m:g} to {far_m:g} m lies {other} the focus at {focus_m:g} m "
            f"but the camera's side is {side}: set side: {actual} or move the focus"
        )
