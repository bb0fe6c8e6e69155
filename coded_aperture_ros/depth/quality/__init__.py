"""Out-of-distribution check of frames against their bank; see `FitCheck`."""

from coded_aperture_ros.depth.quality.health import CAUSES, FitCheck, Health, can_be_checked
