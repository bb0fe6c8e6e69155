"""Refinement of the cost volume by a small network that was trained on random scenes."""

from coded_aperture_ros.depth.refine.refine import Refined, refinement_note, untrained
from coded_aperture_ros.depth.refine.small import SmallPatches, small_bank

__all__ = ["Refined", "SmallPatches", "refinement_note", "small_bank", "untrained"]
