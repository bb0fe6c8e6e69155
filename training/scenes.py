"""Frames to learn from: random scenes through many masks, rendered once, kept in shards on disk.

python training/scenes.py --output DIR --shards 0 40
"""

import argparse
import dataclasses

import numpy as np
from shards import add_shard_options, compute

from coded_aperture_ros.optics import Mask
from coded_aperture_ros.simulation.layered import (
    FENCES,
    Fenced,
    LayeredScene,
    fenced_scene,
    random_scene,
)

FRAMES_PER_SHARD = 50
FRAME_PX = 288
# Frames and blur sizes are kept as whole numbers of these.
LIGHT_STEP = 1 / 65535
BLUR_STEP = 1 / 1500

# How often each mask is drawn; the random ones share the last number.
_MASKS = {
    "levin": 44,
    "zhou": 16,
    "four_hole": 14,
    "three_wide": 4,
    "four_wide": 3,
    "three_hole": 2,
    "veeraraghavan": 2,
    "mura": 2,
    "annulus": 1,
    "disc": 1,
}
_RANDOM_MASKS, _RANDOM_SHARE = 12, 11
_ASYMMETRIC = 0.05
# Shards from this one on have what is rare in those before: wide blur, little blur everywhere, and
# rooms with nothing in them, such as a wall that fills the frame. Their shares; the rest is wide.
FIRST_RARE_SHARD = 80
_SHALLOW_SHARE, _EMPTY_SHARE = 0.2, 0.2
# From this one on frames show a room behind a net, leaves or a pane, or by itself: how many of
# each, how many before the focal plane, and how much more often these masks are drawn.
FIRST_FENCED_SHARD = 200
_FENCE_SHARES, _FENCED_NEAR = (0.4, 0.2, 0.15, 0.25), 0.15
_MORE_OFTEN = {"zhou": 2.0, "four_hole": 2.0}
# Blur is kept in 16 bits.
_WIDEST_PX = 21.8


def mask_of(name: str) -> Mask:
    """Return a mask by its name: the package's, or `random_N`."""
    if not name.startswith("random_"):
        return Mask.named(name)
    random = np.random.default_rng([11, int(name.removeprefix("random_"))])
    side = int(random.integers(7, 14))
    grid = random.random((side, side)) < random.uniform(0.3, 0.6)
    return Mask(name, grid.astype(np.float32))


def mask_names() -> tuple[str, ...]:
    """Return the names of all masks that are learned from."""
    return (*_MASKS, *(f"random_{number}" for number in range(_RANDOM_MASKS)))


@dataclasses.dataclass(frozen=True)
class Drawn:
    """Which scene a frame shows, and through what."""

    seed: int
    mask: str
    side: str
    blur_range_px: tuple[float, float] | None = None
    empty: bool = False
    fence: str = ""


def drawn(number: int) -> Drawn:
    """Return what frame `number` shows; the same for the same number."""
    random = np.random.default_rng([5, number])
    weights = np.array([*_MASKS.values(), *[_RANDOM_SHARE / _RANDOM_MASKS] * _RANDOM_MASKS])
    fenced = number >= FIRST_FENCED_SHARD * FRAMES_PER_SHARD
    if fenced:
        weights *= [_MORE_OFTEN.get(name, 1.0) for name in mask_names()]
    mask = str(random.choice(mask_names(), p=weights / weights.sum()))
    if fenced:
        fence = str(random.choice([*FENCES, ""], p=_FENCE_SHARES))
        side = "near" if random.random() < _FENCED_NEAR else "far"
        return Drawn(number, mask, side, empty=not fence, fence=fence)
    side = str(random.choice(["far", "near", "both"], p=[0.76, 0.1, 0.14]))
    if side == "both" and mask_of(mask).asymmetry < _ASYMMETRIC:
        side = "far"
    if number < FIRST_RARE_SHARD * FRAMES_PER_SHARD or side == "both":
        return Drawn(number, mask, side)
    return Drawn(number, mask, side, *_rare(random, side))


def _rare(random: np.random.Generator, side: str) -> tuple[tuple[float, float], bool]:
    """Return a range of blur sizes that is rare otherwise, and whether the room is empty."""
    kind = random.random()
    empty = kind < _EMPTY_SHARE
    if empty:
        far = random.uniform(1.5, _WIDEST_PX)
        near = random.uniform(0.5, 0.98) * far
    elif kind < _EMPTY_SHARE + _SHALLOW_SHARE:
        far = random.uniform(2.5, 8)
        near = random.uniform(0.3, 0.7) * far
    else:
        far = random.uniform(16, _WIDEST_PX)
        near = random.uniform(1.0, (0.5 if random.random() < 0.75 else 0.85) * far)
    near = max(near, 0.9)
    return ((near, far) if side == "far" else (-far, -near)), empty


def scene_of(what: Drawn) -> tuple[LayeredScene, Fenced | None]:
    """Return a scene, and what it is made of if something stands before a room."""
    mask, shape = mask_of(what.mask), (FRAME_PX, FRAME_PX)
    if what.fence:
        fenced = fenced_scene(what.seed, mask, what.fence, what.side, shape)
        return fenced.scene, fenced
    return random_scene(what.seed, mask, what.side, shape, what.blur_range_px, what.empty), None


def render(number: int) -> dict[str, np.ndarray]:
    """Return frame `number` without noise, and its truth."""
    what = drawn(number)
    random = np.random.default_rng([6, number])
    mask = mask_of(what.mask)
    scene, fenced = scene_of(what)
    # Cut and printed masks differ a little from what the bank believes.
    uneven = 1 + random.uniform(0, 0.08) * random.standard_normal(mask.transmission.shape)
    cells = np.clip(mask.transmission * uneven, 0, 1).astype(np.float32)
    light = scene.coded(Mask(mask.name, cells))
    two_surfaces = {}
    if number >= FIRST_FENCED_SHARD * FRAMES_PER_SHARD:
        room = fenced.behind_px if fenced else scene.blur_size_px()
        two_surfaces = {
            "cover": np.rint(255 * (fenced.cover if fenced else 0 * room)).astype(np.uint8),
            "near": np.rint((fenced.near_px if fenced else room) / BLUR_STEP).astype(np.int16),
            "behind": np.rint(room / BLUR_STEP).astype(np.int16),
        }
    return {
        "light": np.rint(np.clip(light, 0, 1) / LIGHT_STEP).astype(np.uint16),
        "blur": np.rint(scene.blur_size_px() / BLUR_STEP).astype(np.int16),
        "infinity": np.float32(scene.camera.blur_at_infinity_px),
        **two_surfaces,
    }


def render_shard(shard: int) -> dict[str, np.ndarray]:
    """Return all frames of a shard, stacked."""
    numbers = range(shard * FRAMES_PER_SHARD, (shard + 1) * FRAMES_PER_SHARD)
    frames = [render(number) for number in numbers]
    return {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}


def main() -> None:
    """Render the shards that are not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_shard_options(parser)
    args = parser.parse_args()
    tasks = [
        (args.output / f"scenes_{shard:04d}.npz", lambda shard=shard: (shard,))
        for shard in range(*args.shards)
    ]
    compute(render_shard, tasks, ("shards.py", "scenes.py"), args.scheduler)


if __name__ == "__main__":
    # Workers know the functions of modules, not those of this program.
    from scenes import main

    main()
