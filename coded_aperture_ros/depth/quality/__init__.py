"""Out-of-distribution check of frames against their bank; see `FitCheck`."""

from coded_aperture_ros.depth.quality.causes import CAUSE_TEXTS, CAUSES
from coded_aperture_ros.depth.quality.evidence import HypothesisTest
from coded_aperture_ros.depth.quality.health import FitCheck, Health, given_of, unchecked_reason
from coded_aperture_ros.depth.quality.optics_test import OpticsFit, OpticsTest, fitted_limits
from coded_aperture_ros.depth.quality.own_fit import OwnFit, fit_terms, turned_gains
from coded_aperture_ros.depth.quality.reason import no_depth_reason
