"""Which mask to use: scores of masks, and the search for better ones."""

from coded_aperture_ros.masks.pictures import PictureScorer
from coded_aperture_ros.masks.predict import MaskScorer, Prediction
from coded_aperture_ros.masks.spectra import SceneConfig
from coded_aperture_ros.masks.subspaces import SubspaceDistances, subspace_distances

__all__ = [
    "MaskScorer",
    "PictureScorer",
    "Prediction",
    "SceneConfig",
    "SubspaceDistances",
    "subspace_distances",
]
