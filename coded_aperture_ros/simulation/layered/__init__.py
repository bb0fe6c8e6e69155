"""Random scenes of layers, for learning and for tests: exact occlusion and exact depth."""

from coded_aperture_ros.simulation.layered.generate import (
    FENCES,
    SIDES,
    Fenced,
    fenced_scene,
    random_scene,
    rod_scene,
)
from coded_aperture_ros.simulation.layered.scene import LayeredScene

__all__ = ["FENCES", "SIDES", "Fenced", "LayeredScene", "fenced_scene", "random_scene", "rod_scene"]
