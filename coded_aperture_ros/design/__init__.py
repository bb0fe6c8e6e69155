"""Design of a coded-aperture camera: what a lens, a mask and a focus can tell, before building."""

from coded_aperture_ros.design.curves import (
    best_settings,
    curves_of,
    default_extent_range_mm,
    default_focus_range_m,
)
from coded_aperture_ros.design.openings import openings_of
from coded_aperture_ros.design.setting import DesignConfig, setting_of
