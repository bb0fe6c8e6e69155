"""Random scenes of layers to measure on: never those that the refinement is learned from."""

import dataclasses

import numpy as np

from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene, Rods
from coded_aperture_ros.optics import load_mask
from coded_aperture_ros.simulation.layered import LayeredScene, random_scene, rod_scene

# Training has smaller ones.
FIRST_SEED = 1_000_000
# From the thinnest to the widest, each of a share of the range.
_RODS = 8
_THINNEST_PX, _WIDEST_PX = 2.0, 20.0
# A rod counts where what is behind it is farther by this factor: else whoever misses it finds it.
_APART = 1.25


@dataclasses.dataclass(frozen=True)
class RandomScene:
    """A scene by its seed; with rods of known widths, or with whatever comes.

    Attributes
    ----------
    seed : int
    side : {"far", "near", "both"}
    size : (int, int)
        Rows and columns.
    rods : bool
    """

    seed: int
    side: str
    size: tuple[int, int]
    rods: bool = False

    @property
    def kind(self) -> str:
        """What scenes that are pooled have in common."""
        return f"{'rods ' if self.rods else ''}{self.side}"

    @property
    def name(self) -> str:
        """The kind, and the seed."""
        return f"{self.kind} {self.seed}"

    def views(self, mask: str) -> list[RayTracedScene]:
        """Render the scene."""
        rods = None
        if self.rods:
            widths = _rod_widths(self.seed)
            scene, labels = rod_scene(self.seed, load_mask(mask), widths, self.side, self.size)
            behind = LayeredScene(scene.layers[len(widths) :], scene.camera)
            apart = behind.depth_m() >= _APART * scene.depth_m()
            rods = Rods(np.where(apart, labels, 0), widths)
        else:
            scene = random_scene(self.seed, load_mask(mask), self.side, self.size)
        coded, sharp = (
            # Noise is added to each channel by itself, as with other scenes.
            np.repeat(picture[..., None], 3, axis=2)
            for picture in (scene.coded(), scene.all_in_focus())
        )
        return [RayTracedScene(coded, sharp, scene.depth_m(), scene.camera, rods)]


def _rod_widths(seed: int) -> tuple[float, ...]:
    share = (np.arange(_RODS) + np.random.default_rng([3, seed]).random(_RODS)) / _RODS
    return tuple(_THINNEST_PX * (_WIDEST_PX / _THINNEST_PX) ** share)
