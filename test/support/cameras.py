"""Cameras of known numbers: that of the thesis, and a pinhole."""

from coded_aperture_ros.optics import Camera, Mask

THESIS = {
    "focal_length_mm": 50,
    "pixel_pitch_um": 18.72,
    "focus_distance_m": 3.0,
    "image_width": 1920,
    "image_height": 1080,
    "mask": {"name": "four_hole"},
    "mask_extent_mm": 11,
}

# The smallest that anything can be done with.
TINY = {
    "focal_length_px": 119.4,
    "focus_distance_m": 1.9,
    "image_width": 64,
    "image_height": 48,
    "mask": {"name": "levin"},
    "mask_extent_mm": 52.0,
}

# Of the lenses whose blur is not everywhere that of the axis.
STRAIGHT = {
    "focal_length_px": 500.0,
    "focus_distance_m": 0.9,
    "image_width": 256,
    "image_height": 192,
    "mask": {"name": "levin"},
    "mask_extent_mm": 36.0,
}


def pinhole(**changes):
    values = {
        "focal_length_px": 800.0,
        "focus_distance_m": 0.9,
        "image_width": 640,
        "image_height": 480,
        "mask": Mask.named("levin"),
        "mask_extent_mm": 30.0,
    }
    return Camera(**{**values, **changes})
