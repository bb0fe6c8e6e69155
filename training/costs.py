"""What the refinement is given of frames: with noise, through the package's own likelihood."""

import dataclasses
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from banks import BankPair, kept_banks
from scenes import SCENES, blur_px, frame_numbers, light_and_blur, mask_named, scene_plan
from shards import Arrays, Data, stack

from coded_aperture_ros.calibration.fine_tuning.cells import CELLS, padded
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.decoders.network.cells import CELL_PX, Cells
from coded_aperture_ros.depth.decoders.network.features import (
    LocalContext,
    PatchScale,
    cost_features,
    frame_features,
    tried_sizes,
)
from coded_aperture_ros.depth.decoders.network.small import small_cost
from coded_aperture_ros.likelihood import bounded_cost
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig, learn_bank
from coded_aperture_ros.optics import render_psf_stack

_LARGEST_PX = 22.6
# Window, and distance between levels; the first are what is used most.
_BANKS = ((48, 0.5), (48, 0.44), (48, 0.58), (40, 0.5), (64, 0.5), (32, 0.5))
_BANK_SHARES = (0.32, 0.22, 0.22, 0.08, 0.1, 0.06)
_BOTH_SIDES = ((48, 0.6), (48, 0.72))
_BOTH_LARGEST_PX = 16.5
# The share of frames from which weak texture is smoothed away, and up to what contrast.
_SMOOTHED_SHARE = 0.25
_SMOOTHED = (0.003, 0.03)


@dataclasses.dataclass(frozen=True)
class Recording:
    """How a frame is recorded, and which bank is used for it."""

    bank: int
    noise: float
    gain: float
    blur_px: float
    smoothed: float
    scale: float
    eight_bits: bool
    known: bool
    added_up: float


def recording_plan(number: int, side: str) -> Recording:
    """How frame `number` is recorded; the same for the same number."""
    random = np.random.default_rng([8, number])
    bank = random.choice(len(_BANKS), p=_BANK_SHARES)
    if side == "both":
        bank = random.integers(len(_BOTH_SIDES))
    noise = float(np.exp(random.uniform(np.log(3e-4), np.log(5e-3))))
    if random.random() < 0.12:
        noise = 0.0
    return Recording(
        bank=int(bank),
        noise=noise,
        gain=float(random.uniform(0, 4e-5)) if random.random() < 0.2 else 0.0,
        blur_px=float(random.uniform(0.15, 0.5)) if random.random() < 0.3 else 0.0,
        smoothed=_smoothed_contrast(number),
        scale=float(random.normal(1, 0.006)),
        eight_bits=bool(random.random() < 0.1),
        known=bool(random.random() < 0.25),
        added_up=float(random.uniform(1.2, 3.0)) if random.random() < 0.15 else 0.0,
    )


def _smoothed_contrast(number: int) -> float:
    """Contrast up to which frame `number` is smoothed: cameras take weak texture for noise."""
    random = np.random.default_rng([11, number])
    if random.random() > _SMOOTHED_SHARE:
        return 0.0
    return float(np.exp(random.uniform(*np.log(_SMOOTHED))))


@lru_cache(maxsize=256)
def mask_banks(mask: str, side: str, index: int, folder: Path) -> BankPair:
    """Banks of a mask for all blur sizes, kept in a folder."""
    both = side == "both"

    def learn() -> FilterBank:
        window, step = (_BOTH_SIDES if both else _BANKS)[index]
        # Spectra do not tell the sides: the levels of one serve both.
        sizes = np.arange(0, _BOTH_LARGEST_PX, step) if both else np.arange(0.9, _LARGEST_PX, step)
        psfs = render_psf_stack(mask_named(mask), sizes)
        return learn_bank(psfs, LearnConfig(window_px=window))

    found = kept_banks(f"{mask}_{'both' if both else 'one'}_{index}", folder, learn)
    assert found is not None
    return found


def recorded(light: np.ndarray, plan: Recording, number: int) -> np.ndarray:
    """Frame with the noise and the flaws of a camera, float32 [height, width]."""
    random = np.random.default_rng([9, number])
    if plan.blur_px:
        light = cv2.GaussianBlur(light, (0, 0), plan.blur_px)
    if plan.smoothed:
        light = cv2.bilateralFilter(light, 7, plan.smoothed, 1.5)
    noise = np.sqrt(plan.noise**2 + plan.gain * light)
    frame = light + noise * random.standard_normal(light.shape, dtype=np.float32)
    if plan.eight_bits:
        frame = np.rint(frame * 255) / 255
    return frame.astype(np.float32)


def network_inputs(
    number: int,
    light: np.ndarray,
    true_px: np.ndarray,
    folder: Path,
    near_px: np.ndarray | None = None,
) -> Arrays:
    """What the refinement is given of frame `number`.

    Parameters
    ----------
    number : int
    light, true_px : ndarray [height, width]
        See `light_and_blur`.
    folder : Path
        Banks are kept there.
    near_px : ndarray or None
        Blur sizes of something before a room, which the bank has to hold as well.

    Returns
    -------
    dict of str to ndarray
        `costs` and `frame`, float16, padded to `CELLS` a side; `tried`, which of the blur sizes
        there are costs of; `corner`, first row and column of the cells; `told`, share of the
        patches that the costs tell about rightly.
    """
    scene = scene_plan(number)
    how = recording_plan(number, scene.side)
    frame = recorded(light, how, number)
    banks = mask_banks(scene.mask, scene.side, how.bank, folder)
    all_px = true_px if near_px is None else np.stack([true_px, near_px])
    banks = banks.with_levels(_kept_levels(banks.bank.blur_sizes_px, all_px, number))
    noise = max(np.hypot(how.noise, 0.0011 * how.eight_bits), 2e-4) if how.known else 0.0
    estimator = DepthEstimator(banks.bank, DepthConfig(noise=float(noise), regularize="semiglobal"))
    work = estimator.run_front(frame)
    observed, cost = work.observation, work.frame_cost
    estimator.close()
    volume = cost.volume
    if how.added_up:
        volume = bounded_cost(volume) * np.float32(how.added_up)
    small = banks.small.plan(frame.shape, CELL_PX)
    of_small = small_cost(small, observed, observed.grey, observed.noise.deviation)
    scales = (
        PatchScale.from_cost(cost, observed.grid, volume),
        PatchScale.from_cost(of_small, small.grid),
    )
    small.close()
    cells = Cells.covering(frame.shape, observed.grid)
    around = LocalContext.from_frame(observed.grey, observed.noise.typical)
    sizes = banks.bank.blur_sizes_px * how.scale
    near = {"far": 0.0, "near": 1.0, "both": 0.5}[scene.side]
    truth = observed.grid.centre_values(true_px)
    about = np.abs(sizes[cost.volume.argmin(-1)] - truth) < 1
    return {
        "costs": padded(cost_features(scales, around, cells, sizes, near), CELLS),
        "frame": padded(frame_features(around, cells), 2 * CELLS),
        "tried": tried_sizes(sizes),
        "corner": np.array([cells.top, cells.left], np.int32),
        "told": np.float32(about.mean()),
    }


def _kept_levels(sizes: np.ndarray, true_px: np.ndarray, number: int) -> np.ndarray:
    """Levels that a bank for about the scene's depth range has."""
    random = np.random.default_rng([10, number])
    low, high = np.nanmin(true_px), np.nanmax(true_px)
    ends = np.array([low, high]) + random.exponential(1.0, 2) * [-1, 1]
    if random.random() < 0.3:
        ends += [-8, 8]
    kept = (sizes >= min(ends[0], low - 0.3)) & (sizes <= max(ends[1], high + 0.3))
    return np.flatnonzero(kept) if kept.sum() >= 8 else np.arange(len(sizes))


def _compute_shard(shard: int, sources: dict[str, Arrays], folder: Path) -> Arrays:
    scenes = sources["scenes"]
    frames = []
    for index, number in enumerate(frame_numbers(shard)):
        near_px = blur_px(scenes["near"][index]) if "near" in scenes else None
        light, true_px = light_and_blur(scenes, index)
        frames.append(network_inputs(number, light, true_px, folder, near_px))
    return stack(frames)


COSTS = Data("costs", _compute_shard, (SCENES,), ("measured", "scenes", "banks", "costs"))
