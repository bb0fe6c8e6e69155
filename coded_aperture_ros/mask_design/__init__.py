"""Which mask to use: scores of masks, and the search for better ones."""

from coded_aperture_ros.mask_design.pictures import PictureScorer
from coded_aperture_ros.mask_design.predict import MaskScorer, Prediction
from coded_aperture_ros.mask_design.spectra import SceneConfig
from coded_aperture_ros.mask_design.subspaces import SubspaceDistances, subspace_distances

__all__ = [
    "MaskScorer",
    "PictureScorer",
    "Prediction",
    "SceneConfig",
    "SubspaceDistances",
    "subspace_distances",
]
