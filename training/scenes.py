"""Frames to learn from: scenes through many masks, without noise, and their blur sizes."""

import dataclasses
from pathlib import Path

import numpy as np
from measured import load_measured, measured_scene
from shards import Arrays, Data, stack

from coded_aperture_ros.calibration.fine_tuning.cells import BLUR_STEP
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
_RANDOM_MASKS = 12
_RANDOM_SHARE = 11
_ASYMMETRIC = 0.05
# Shards from this one on have what is rare in those before: wide blur, little blur everywhere, and
# rooms with nothing in them, such as a wall that fills the frame. Their shares; the rest is wide.
FIRST_RARE_SHARD = 80
_SHALLOW_SHARE = 0.2
_EMPTY_SHARE = 0.2
# From this one on frames show a room behind a net, leaves or a pane, or by itself: how many of
# each, how many before the focal plane, and how much more often these masks are drawn.
FIRST_FENCED_SHARD = 200
_FENCE_SHARES = (0.4, 0.2, 0.15, 0.25)
_FENCED_NEAR = 0.15
# From this one on frames show photographs with measured disparity, if there are any.
FIRST_MEASURED_SHARD = 300
# From this one on the check of fit is shown boards only, sharp ones and soft ones.
FIRST_BOARD_SHARD = 400
# From this one on blur of boards is small: there masks are told apart the least.
FIRST_NEAR_SHARD = 440
# From this one on its boards have noise or bricks on them, through the masks that are common.
FIRST_NOISE_SHARD = 460
_COMMON_MASKS = ("levin", "zhou", "four_hole")
_MEASURED_NEAR = 0.15
_MORE_OFTEN = {"zhou": 2.0, "four_hole": 2.0}
# Blur is kept in 16 bits.
_WIDEST_PX = 21.8


def mask_named(name: str) -> Mask:
    """Mask of the package, or a random one if the name is `random_N`."""
    if not name.startswith("random_"):
        return Mask.named(name)
    random = np.random.default_rng([11, int(name.removeprefix("random_"))])
    side = int(random.integers(7, 14))
    grid = random.random((side, side)) < random.uniform(0.3, 0.6)
    return Mask(name, grid.astype(np.float32))


def mask_names() -> tuple[str, ...]:
    """Names of all masks that are learned from."""
    return (*_MASKS, *(f"random_{number}" for number in range(_RANDOM_MASKS)))


def frame_numbers(shard: int) -> range:
    """Numbers of the frames of a shard."""
    return range(shard * FRAMES_PER_SHARD, (shard + 1) * FRAMES_PER_SHARD)


def is_fenced(number: int) -> bool:
    """Whether a frame shows a room behind something, or by itself: from `FIRST_FENCED_SHARD`."""
    first, end = (shard * FRAMES_PER_SHARD for shard in (FIRST_FENCED_SHARD, FIRST_MEASURED_SHARD))
    return first <= number < end


def is_measured(number: int) -> bool:
    """Whether a frame shows a photograph with measured disparity: from `FIRST_MEASURED_SHARD`."""
    first, end = (shard * FRAMES_PER_SHARD for shard in (FIRST_MEASURED_SHARD, FIRST_BOARD_SHARD))
    return first <= number < end


@dataclasses.dataclass(frozen=True)
class ScenePlan:
    """Which scene a frame shows, and through which mask."""

    seed: int
    mask: str
    side: str
    blur_range_px: tuple[float, float] | None = None
    empty: bool = False
    fence: str = ""


def scene_plan(number: int) -> ScenePlan:
    """What frame `number` shows; the same for the same number."""
    random = np.random.default_rng([5, number])
    weights = np.array([*_MASKS.values(), *[_RANDOM_SHARE / _RANDOM_MASKS] * _RANDOM_MASKS])
    fenced = is_fenced(number)
    if fenced:
        weights *= [_MORE_OFTEN.get(name, 1.0) for name in mask_names()]
    mask = str(random.choice(mask_names(), p=weights / weights.sum()))
    if number >= FIRST_NOISE_SHARD * FRAMES_PER_SHARD:
        mask = _COMMON_MASKS[number % len(_COMMON_MASKS)]
    if fenced:
        fence = str(random.choice([*FENCES, ""], p=_FENCE_SHARES))
        side = "near" if random.random() < _FENCED_NEAR else "far"
        return ScenePlan(number, mask, side, empty=not fence, fence=fence)
    if is_measured(number):
        far = random.uniform(6, _WIDEST_PX)
        near = max(random.uniform(0.05, 0.7) * far, 0.9)
        if random.random() < _MEASURED_NEAR:
            return ScenePlan(number, mask, "near", (-far, -near))
        return ScenePlan(number, mask, "far", (near, far))
    side = str(random.choice(["far", "near", "both"], p=[0.76, 0.1, 0.14]))
    if side == "both" and mask_named(mask).asymmetry < _ASYMMETRIC:
        side = "far"
    if number < FIRST_RARE_SHARD * FRAMES_PER_SHARD or side == "both":
        return ScenePlan(number, mask, side)
    return ScenePlan(number, mask, side, *_rare(random, side))


def _rare(random: np.random.Generator, side: str) -> tuple[tuple[float, float], bool]:
    """Range of blur sizes, px, that is rare otherwise, and whether the room is empty."""
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


def build_scene(plan: ScenePlan) -> tuple[LayeredScene, Fenced | None]:
    """Scene of a plan, and what it is made of if something stands before a room."""
    mask, shape = mask_named(plan.mask), (FRAME_PX, FRAME_PX)
    if plan.fence:
        fenced = fenced_scene(plan.seed, mask, plan.fence, plan.side, shape)
        return fenced.scene, fenced
    return random_scene(plan.seed, mask, plan.side, shape, plan.blur_range_px, plan.empty), None


def uneven_mask(mask: Mask, strength: float, random: np.random.Generator) -> Mask:
    """Mask as it is cut or printed: its cells differ a little from what the bank believes."""
    uneven = 1 + strength * random.standard_normal(mask.transmission.shape)
    return Mask(mask.name, np.clip(mask.transmission * uneven, 0, 1).astype(np.float32))


def light_and_blur(scenes: Arrays, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Light of a frame of a shard, and its blur sizes; float32 [height, width].

    Blur sizes in px, without sign, are NaN at seams between two surfaces.
    """
    return scenes["light"][index] * np.float32(LIGHT_STEP), blur_px(scenes["blur"][index])


def blur_px(steps: np.ndarray) -> np.ndarray:
    """Blur sizes in px, without sign, of what is stored in steps; NaN where they are unknown."""
    sizes = np.abs(steps * np.float32(BLUR_STEP))
    sizes[steps == 0] = np.nan
    return sizes


def render(number: int, photographs: Path = Path("measured")) -> Arrays:
    """Frame `number` without noise, and its truth, in whole steps; see `light_and_blur`.

    `light`, uint16, and `blur`, int16 [height, width]; `infinity`: blur size of what is infinitely
    far, px. From `FIRST_FENCED_SHARD` on also `cover`, uint8: how much of a pixel something before
    the room takes, and the blur sizes of that and of the room, `near` and `behind`, int16.
    """
    plan = scene_plan(number)
    random = np.random.default_rng([6, number])
    if is_measured(number):
        return _render_measured(plan, photographs, random)
    scene, fenced = build_scene(plan)
    light = scene.coded(uneven_mask(mask_named(plan.mask), random.uniform(0, 0.08), random))
    two_surfaces = {}
    if is_fenced(number):
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


def measured_view(
    plan: ScenePlan, photographs: Path, random: np.random.Generator
) -> tuple[LayeredScene, np.ndarray]:
    """Part of a photograph of a folder of folders, and where its truth is known."""
    folders = sorted(path.parent for path in photographs.glob("*/disparity.npz"))
    if not folders:
        raise SystemExit(f"{photographs}: no folder with disparity.npz in it: see README.md")
    assert plan.blur_range_px is not None
    measured = load_measured(folders[plan.seed % len(folders)])
    shape = (FRAME_PX, FRAME_PX)
    return measured_scene(measured, mask_named(plan.mask), plan.blur_range_px, shape, random)


def _render_measured(plan: ScenePlan, photographs: Path, random: np.random.Generator) -> Arrays:
    """The same of a photograph; the truth is 0 where it is not known."""
    mask = mask_named(plan.mask)
    scene, known = measured_view(plan, photographs, random)
    light = scene.coded(uneven_mask(mask, random.uniform(0, 0.08), random))
    return {
        "light": np.rint(np.clip(light, 0, 1) / LIGHT_STEP).astype(np.uint16),
        "blur": np.rint(scene.blur_size_px() * known / BLUR_STEP).astype(np.int16),
        "infinity": np.float32(scene.camera.blur_at_infinity_px),
    }


def _render_shard(shard: int, _: dict[str, Arrays], banks: Path) -> Arrays:
    photographs = banks.parent / "measured"
    return stack([render(number, photographs) for number in frame_numbers(shard)])


SCENES = Data("scenes", _render_shard, modules=("measured", "scenes"))
