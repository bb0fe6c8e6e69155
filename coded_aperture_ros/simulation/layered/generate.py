"""Random scenes: of all kinds of things, of rods of known widths, or behind a fence."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.simulation.layered.drawing import LARGEST_PX, new_drawing
from coded_aperture_ros.simulation.layered.scene import LayeredScene
from coded_aperture_ros.simulation.layered.tracing import seen_from_centre

SIDES = ("far", "near", "both")
FENCES = ("net", "leaves", "pane")
# How much nearer a fence is than what is behind it.
_FENCE_APART_PX = 2.0


def random_scene(
    seed: int,
    mask: Mask,
    side: str = "far",
    shape: tuple[int, int] = (288, 288),
    blur_range_px: tuple[float, float] | None = None,
    empty: bool = False,
) -> LayeredScene:
    """Random scene; the same for the same arguments.

    Parameters
    ----------
    seed : int
        At least 0.
    mask : Mask
        Of the camera.
    side : {"far", "near", "both"}
        Of the focal plane.
    shape : (int, int)
        Rows and columns of the frame.
    blur_range_px : (float, float) or None
        Signed blur sizes of the nearest and the farthest surface. None: random ones.
    empty : bool
        Only the room, and nothing in it.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> scene = random_scene(0, Mask.named("levin"))  # doctest: +SKIP
    >>> coded, depth_m = scene.coded(), scene.depth_m()  # doctest: +SKIP
    """
    random = np.random.default_rng([seed, SIDES.index(side)])
    draw, camera = new_drawing(random, mask, side, shape, blur_range_px)
    things = () if empty else draw.things()
    return LayeredScene((*things, *draw.room(things)), camera)


def rod_scene(
    seed: int,
    mask: Mask,
    widths_px: Sequence[float],
    side: str = "far",
    shape: tuple[int, int] = (288, 288),
) -> tuple[LayeredScene, NDArray[np.int32]]:
    """Scene of rods of known widths before a room, and which of them each pixel shows.

    Parameters
    ----------
    seed, mask, side, shape
        As of `random_scene`.
    widths_px : sequence of float
        Of the rods, in pixels of the frame. The rods stand or lie side by side in random order.

    Returns
    -------
    scene : LayeredScene
    labels : ndarray, int32 [rows, columns]
        1 for the first width's rod, and so on; 0 where none is seen.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> scene, labels = rod_scene(0, Mask.named("levin"), [2.0, 4.0, 8.0])  # doctest: +SKIP
    """
    random = np.random.default_rng([seed, SIDES.index(side), len(widths_px)])
    draw, camera = new_drawing(random, mask, side, shape)
    room = draw.room(())
    rods = draw.rods(widths_px, seen_from_centre(list(room), shape))
    order = sorted(range(len(rods)), key=lambda index: rods[index][0])
    layers = (*(rods[index][1] for index in order), *room)
    # The same scene once more, with numbers for blur sizes.
    numbers = [float(index + 1) for index in order] + [0.0] * len(room)
    numbered = [
        dataclasses.replace(layer, blur_px=(number, 0.0, 0.0), relief_px=None)
        for layer, number in zip(layers, numbers, strict=True)
    ]
    labels = np.rint(seen_from_centre(numbered, shape)).astype(np.int32)
    return LayeredScene(layers, camera), labels


@dataclasses.dataclass(frozen=True, eq=False)
class Fenced:
    """A scene seen through something that lets part of the view pass.

    Attributes
    ----------
    scene : LayeredScene
    cover : ndarray, float32 [rows, columns]
        Share of each pixel that the nearer surface takes, 0 to 1.
    near_px, behind_px : ndarray, float32 [rows, columns]
        Signed blur sizes of the nearer surface, wherever it may be, and of the room behind.

    Examples
    --------
    See `fenced_scene`.
    """

    scene: LayeredScene
    cover: FloatArray
    near_px: FloatArray
    behind_px: FloatArray


def fenced_scene(
    seed: int, mask: Mask, kind: str = "net", side: str = "far", shape: tuple[int, int] = (288, 288)
) -> Fenced:
    """Room behind a net, foliage or a pane that shines; the same for the same arguments.

    Parameters
    ----------
    seed, mask, shape
        As of `random_scene`.
    kind : {"net", "leaves", "pane"}
        A net, fence or grating; leaves side by side; or glass that reflects, or a thin curtain.
    side : {"far", "near"}
        Of the focal plane.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> fenced = fenced_scene(0, Mask.named("levin"), "leaves")  # doctest: +SKIP
    """
    random = np.random.default_rng([seed, SIDES.index(side), FENCES.index(kind), 3])
    while True:
        draw, camera = new_drawing(random, mask, side, shape, _apart(random, side))
        room = draw.room(())
        behind = seen_from_centre(list(room), shape)
        # A floor or a wall beside may leave no place before it.
        if behind.min() >= draw.nearest + _FENCE_APART_PX:
            break
    layers, cover, near = draw.fence(kind, room, float(behind.min()) - _FENCE_APART_PX)
    return Fenced(LayeredScene((*layers, *room), camera), cover, near, behind)


def _apart(random: np.random.Generator, side: str) -> tuple[float, float]:
    """Range of blur sizes with room for something before the room."""
    wide = random.uniform(7, LARGEST_PX)
    narrow = random.uniform(0.1, 0.55)
    near = max(narrow * wide, 0.9)
    far = wide
    return (near, far) if side == "far" else (-far, -near)
