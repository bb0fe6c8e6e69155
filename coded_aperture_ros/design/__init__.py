"""Design of a coded-aperture camera: depth resolution of a lens, a mask and a focus."""

from coded_aperture_ros.design.curves import (
    best_settings,
    default_extent_range_mm,
    default_focus_range_m,
    design_curves,
    extents_within_pupil,
)
from coded_aperture_ros.design.openings import mask_openings
from coded_aperture_ros.design.setting import DesignConfig, design_setting

__all__ = [
    "DesignConfig",
    "best_settings",
    "default_extent_range_mm",
    "default_focus_range_m",
    "design_curves",
    "design_setting",
    "extents_within_pupil",
    "mask_openings",
]
