"""Random scenes of layers, for learning and for tests: exact occlusion and exact depth."""

from coded_aperture_benchmarks.layered.scene import SIDES, LayeredScene, random_scene, rod_scene

__all__ = ["SIDES", "LayeredScene", "random_scene", "rod_scene"]
