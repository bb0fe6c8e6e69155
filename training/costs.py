"""What the network is shown of rendered frames: with noise, through the package's own likelihood.

python training/costs.py --scenes DIR --output DIR --shards 0 40
"""

import argparse
import dataclasses
import os
import tempfile
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scenes import BLUR_STEP, FRAMES_PER_SHARD, LIGHT_STEP, drawn, mask_of
from shards import add_shard_options, compute

from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.decoders.network.cells import CELL_PX, Cells
from coded_aperture_ros.depth.decoders.network.features import (
    LocalContext,
    PatchScale,
    cost_features,
    frame_features,
    tried_sizes,
)
from coded_aperture_ros.depth.decoders.network.small import small_bank, small_cost
from coded_aperture_ros.likelihood import bounded_cost
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig, learn_bank
from coded_aperture_ros.likelihood.bank.file import load_bank, save_bank
from coded_aperture_ros.optics import render_psf_stack

# Frames of one size have no more cells a side than this, whatever the window.
CELLS = 40
_LARGEST_PX = 22.6
# Window, and distance between levels; the first are what is used most.
_BANKS = ((48, 0.5), (48, 0.44), (48, 0.58), (40, 0.5), (64, 0.5), (32, 0.5))
_BANK_SHARES = (0.32, 0.22, 0.22, 0.08, 0.1, 0.06)
_BOTH_SIDES = ((48, 0.6), (48, 0.72))
_BOTH_LARGEST_PX = 16.5
# The share of frames from which weak texture is smoothed away, and up to what contrast.
_SMOOTHED_SHARE, _SMOOTHED = 0.25, (0.003, 0.03)


@dataclasses.dataclass(frozen=True)
class Seen:
    """How a frame is recorded, and by which bank it is looked at."""

    bank: int
    noise: float
    gain: float
    blur_px: float
    smoothed: float
    scale: float
    eight_bits: bool
    known: bool
    added_up: float


def seen(number: int, side: str) -> Seen:
    """Return how frame `number` is seen; the same for the same number."""
    random = np.random.default_rng([8, number])
    bank = random.choice(len(_BANKS), p=_BANK_SHARES)
    if side == "both":
        bank = random.integers(len(_BOTH_SIDES))
    noise = float(np.exp(random.uniform(np.log(3e-4), np.log(5e-3))))
    if random.random() < 0.12:
        noise = 0.0
    return Seen(
        bank=int(bank),
        noise=noise,
        gain=float(random.uniform(0, 4e-5)) if random.random() < 0.2 else 0.0,
        blur_px=float(random.uniform(0.15, 0.5)) if random.random() < 0.3 else 0.0,
        smoothed=_smoothed(number),
        scale=float(random.normal(1, 0.006)),
        eight_bits=bool(random.random() < 0.1),
        known=bool(random.random() < 0.25),
        added_up=float(random.uniform(1.2, 3.0)) if random.random() < 0.15 else 0.0,
    )


def _smoothed(number: int) -> float:
    """Return what frame `number` is smoothed by: cameras take weak texture for noise."""
    random = np.random.default_rng([11, number])
    if random.random() > _SMOOTHED_SHARE:
        return 0.0
    return float(np.exp(random.uniform(*np.log(_SMOOTHED))))


@lru_cache(maxsize=256)
def banks_of(mask: str, side: str, index: int, folder: Path) -> tuple[FilterBank, FilterBank]:
    """Return a bank for all blur sizes, and that of small patches; kept in a folder."""
    both = side == "both"
    name = f"{mask}_{'both' if both else 'one'}_{index}"
    paths = folder / f"{name}.npz", folder / f"{name}_small.npz"
    if not all(path.exists() for path in paths):
        window, step = (_BOTH_SIDES if both else _BANKS)[index]
        # Spectra do not tell the sides: the levels of one serve both.
        sizes = np.arange(0, _BOTH_LARGEST_PX, step) if both else np.arange(0.9, _LARGEST_PX, step)
        bank = learn_bank(render_psf_stack(mask_of(mask), sizes), LearnConfig(window_px=window))
        folder.mkdir(parents=True, exist_ok=True)
        for path, one in zip(paths, (bank, small_bank(bank)), strict=True):
            # Two processes may learn the same bank at once.
            part = path.with_suffix(f".{os.getpid()}.npz")
            save_bank(one, part)
            part.rename(path)
    bank, small = (load_bank(path) for path in paths)
    return bank, small


def recorded(light: np.ndarray, how: Seen, number: int) -> np.ndarray:
    """Return the frame with the noise and the flaws of a camera."""
    random = np.random.default_rng([9, number])
    if how.blur_px:
        light = cv2.GaussianBlur(light, (0, 0), how.blur_px)
    if how.smoothed:
        light = cv2.bilateralFilter(light, 7, how.smoothed, 1.5)
    noise = np.sqrt(how.noise**2 + how.gain * light)
    frame = light + noise * random.standard_normal(light.shape, dtype=np.float32)
    if how.eight_bits:
        frame = np.rint(frame * 255) / 255
    return frame.astype(np.float32)


def shown(
    number: int,
    light: np.ndarray,
    blur_px: np.ndarray,
    folder: Path,
    near_px: np.ndarray | None = None,
) -> dict[str, Any]:
    """Return what the network is shown of frame `number`; `near_px` is that of something before."""
    what = drawn(number)
    how = seen(number, what.side)
    frame = recorded(light, how, number)
    banks = banks_of(what.mask, what.side, how.bank, folder)
    all_px = blur_px if near_px is None else np.stack([blur_px, near_px])
    keep = _levels_kept(banks[0].blur_sizes_px, all_px, number)
    bank, bank_of_small = (with_levels(each, keep) for each in banks)
    noise = max(np.hypot(how.noise, 0.0011 * how.eight_bits), 2e-4) if how.known else 0.0
    estimator = DepthEstimator(bank, DepthConfig(noise=float(noise), regularize="semiglobal"))
    work = estimator.run_front(frame)
    observed, cost = work.observation, work.frame_cost
    estimator.close()
    volume = cost.volume
    if how.added_up:
        volume = bounded_cost(volume) * np.float32(how.added_up)
    small = bank_of_small.plan(frame.shape, CELL_PX)
    of_small = small_cost(small, observed, observed.grey, observed.noise.deviation)
    looks = PatchScale.of(cost, observed.grid, volume), PatchScale.of(of_small, small.grid)
    small.close()
    cells = Cells.covering(frame.shape, observed.grid)
    around = LocalContext.of(observed.grey, observed.noise.typical)
    sizes = bank.blur_sizes_px * how.scale
    near = {"far": 0.0, "near": 1.0, "both": 0.5}[what.side]
    grid = observed.grid
    truth = grid.at_centres(blur_px)
    about = np.abs(sizes[cost.volume.argmin(-1)] - truth) < 1
    return {
        "costs": _whole(cost_features(looks, around, cells, sizes, near), CELLS),
        "frame": _whole(frame_features(around, cells), 2 * CELLS),
        "tried": tried_sizes(sizes),
        "corner": np.array([cells.top, cells.left], np.int32),
        "told": np.float32(about.mean()),
    }


def _levels_kept(sizes: np.ndarray, blur_px: np.ndarray, number: int) -> np.ndarray:
    """Return which levels a bank for about the scene's depth range has."""
    random = np.random.default_rng([10, number])
    low, high = np.nanmin(blur_px), np.nanmax(blur_px)
    ends = np.array([low, high]) + random.exponential(1.0, 2) * [-1, 1]
    if random.random() < 0.3:
        ends += [-8, 8]
    kept = (sizes >= min(ends[0], low - 0.3)) & (sizes <= max(ends[1], high + 0.3))
    return np.flatnonzero(kept) if kept.sum() >= 8 else np.arange(len(sizes))


def with_levels(bank: FilterBank, kept: np.ndarray) -> FilterBank:
    """Return a bank with some of its levels."""
    stack = bank.stack
    return dataclasses.replace(
        bank,
        stack=dataclasses.replace(
            stack, blur_sizes_px=stack.blur_sizes_px[kept], psfs=stack.psfs[kept]
        ),
        coefficients=bank.coefficients[..., kept],
        log_determinants=bank.log_determinants[..., kept],
    )


def _whole(values: np.ndarray, side: int) -> np.ndarray:
    """Pad the last two axes to a common size by the outermost values."""
    margins = [(0, 0)] + [(0, side - length) for length in values.shape[-2:]]
    return np.pad(values, margins, mode="edge").astype(np.float16)


def shown_shard(
    shard: int,
    light: np.ndarray,
    blur: np.ndarray,
    folder: Path | None,
    near: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Return what the network is shown of all frames of a shard, stacked."""
    folder = folder or Path(tempfile.gettempdir()) / "coded_aperture_training_banks"
    each = []
    for index, (frame, sizes) in enumerate(zip(light, blur, strict=True)):
        blur_px = np.abs(sizes * np.float32(BLUR_STEP))
        blur_px[sizes == 0] = np.nan  # seams between two surfaces
        number = shard * FRAMES_PER_SHARD + index
        near_px = None if near is None else np.abs(near[index] * np.float32(BLUR_STEP))
        each.append(shown(number, frame * np.float32(LIGHT_STEP), blur_px, folder, near_px))
    return {name: np.stack([one[name] for one in each]) for name in each[0]}


def main() -> None:
    """Compute the shards that are not there yet, of the scenes that are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, required=True)
    add_shard_options(parser)
    args = parser.parse_args()
    # Other machines keep the banks that they learn to themselves.
    folder = None if args.scheduler else args.output / "banks"

    def read(shard: int, source: Path) -> tuple[int, np.ndarray, np.ndarray, Path | None]:
        with np.load(source) as scenes:
            return shard, scenes["light"], scenes["blur"], folder, scenes.get("near")

    tasks = [
        (args.output / f"costs_{shard:04d}.npz", partial(read, shard, source))
        for shard in range(*args.shards)
        if (source := args.scenes / f"scenes_{shard:04d}.npz").exists()
    ]
    compute(shown_shard, tasks, ("shards.py", "scenes.py", "costs.py"), args.scheduler)


if __name__ == "__main__":
    # Workers know the functions of modules, not those of this program.
    from costs import main

    main()
