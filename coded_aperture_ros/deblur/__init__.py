"""All-in-focus frames from coded frames and their depth."""

from coded_aperture_ros.deblur.blur_map import covers_frame
from coded_aperture_ros.deblur.config import DeblurConfig
from coded_aperture_ros.deblur.deblurrer import Deblurrer
from coded_aperture_ros.deblur.field import AnyDeblurrer, make_deblurrer
from coded_aperture_ros.deblur.levels import blur_levels
from coded_aperture_ros.deblur.stereo import (
    Parallax,
    anaglyph,
    check_parallax,
    side_by_side,
    stereo_pair,
)
from coded_aperture_ros.deblur.uncertainty import FILLED, SEEN, UNCERTAIN, Uncertainty
from coded_aperture_ros.deblur.views import opening_centres, view_through

__all__ = [
    "FILLED",
    "SEEN",
    "UNCERTAIN",
    "AnyDeblurrer",
    "DeblurConfig",
    "Deblurrer",
    "Parallax",
    "Uncertainty",
    "anaglyph",
    "blur_levels",
    "check_parallax",
    "covers_frame",
    "make_deblurrer",
    "opening_centres",
    "side_by_side",
    "stereo_pair",
    "view_through",
]
