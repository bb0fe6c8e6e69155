"""Does a frame fit its bank at all, and if not, why? See `FitCheck`."""

from coded_aperture_ros.depth.quality.health import CAUSES, FitCheck, Health, can_be_checked
