"""Refinement of the cost volume by a small network that was trained on random scenes."""

from coded_aperture_ros.depth.refine.refine import Refined, refinement_note, untrained

__all__ = ["Refined", "refinement_note", "untrained"]
