"""Which mask to use: scores of masks, and the search for better ones."""

from coded_aperture_ros.mask_design.pictures import PictureScorer
from coded_aperture_ros.mask_design.predict import MaskScorer
from coded_aperture_ros.mask_design.spectra import SceneConfig
