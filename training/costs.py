"""Cost volumes of rendered frames: noise is added, and the package's own likelihood looks at them.

python training/costs.py --scenes DIR --output DIR --shards 0 40
"""

import argparse
import dataclasses
import tempfile
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from scenes import FRAMES_PER_SHARD, LIGHT_STEP, drawn, mask_of
from shards import add_shard_options, compute

from coded_aperture_ros.bank import FilterBank, LearnConfig, learn_bank
from coded_aperture_ros.bank.file import load_bank, save_bank
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.optics import render_psf_stack

_LARGEST_PX = 20.6
# Window, and distance between levels; the first are what is used most.
_BANKS = ((32, 0.5), (32, 0.44), (32, 0.58), (40, 0.5), (48, 0.5))
_BANK_SHARES = (0.3, 0.2, 0.2, 0.15, 0.15)
_BOTH_SIDES = ((32, 0.6), (32, 0.72))


@dataclasses.dataclass(frozen=True)
class Seen:
    """How a frame is recorded, and by which bank it is looked at."""

    bank: int
    noise: float
    gain: float
    blur_px: float
    scale: float
    eight_bits: bool
    known: bool


def seen(number: int, side: str) -> Seen:
    """Return how frame `number` is seen; the same for the same number."""
    random = np.random.default_rng([8, number])
    bank = random.choice(len(_BANKS), p=_BANK_SHARES)
    if side == "both":
        bank = random.integers(len(_BOTH_SIDES))
    noise = float(np.exp(random.uniform(np.log(2e-4), np.log(6e-3))))
    if random.random() < 0.12:
        noise = 0.0
    return Seen(
        bank=int(bank),
        noise=noise,
        gain=float(random.uniform(0, 4e-5)) if random.random() < 0.2 else 0.0,
        blur_px=float(random.uniform(0.15, 0.6)) if random.random() < 0.4 else 0.0,
        scale=float(random.normal(1, 0.006)),
        eight_bits=bool(random.random() < 0.1),
        known=bool(random.random() < 0.25),
    )


@lru_cache(maxsize=256)
def bank_of(mask: str, side: str, index: int, folder: Path) -> FilterBank:
    """Return a bank for all blur sizes of a side, or of both sides; kept in a folder."""
    both = side == "both"
    path = folder / f"{mask}_{'both' if both else 'one'}_{index}.npz"
    if path.exists():
        return load_bank(path)
    window, step = (_BOTH_SIDES if both else _BANKS)[index]
    if both:
        count = int(16.5 / step)
        sizes = np.arange(-count, count + 1) * step
    else:
        sizes = np.arange(0.9, _LARGEST_PX, step)
    bank = learn_bank(render_psf_stack(mask_of(mask), sizes), LearnConfig(window_px=window))
    folder.mkdir(parents=True, exist_ok=True)
    save_bank(bank, path)
    return bank


def recorded(light: np.ndarray, how: Seen, number: int) -> np.ndarray:
    """Return the frame with the noise and the flaws of a camera."""
    random = np.random.default_rng([9, number])
    if how.blur_px:
        light = cv2.GaussianBlur(light, (0, 0), how.blur_px)
    noise = np.sqrt(how.noise**2 + how.gain * light)
    frame = light + noise * random.standard_normal(light.shape, dtype=np.float32)
    if how.eight_bits:
        frame = np.rint(frame * 255) / 255
    return frame.astype(np.float32)


def costs(number: int, light: np.ndarray, folder: Path) -> dict[str, np.ndarray]:
    """Return what the likelihood says of frame `number`."""
    what = drawn(number)
    how = seen(number, what.side)
    frame = recorded(light, how, number)
    bank = bank_of(what.mask, what.side, how.bank, folder)
    noise = max(np.hypot(how.noise, 0.0011 * how.eight_bits), 2e-4) if how.known else 0.0
    estimator = DepthEstimator(bank, DepthConfig(noise=float(noise), regularize="semiglobal"))
    observed = estimator.observe(frame)
    cost = estimator.cost(observed, observed.grey)
    estimator.close()
    # A bank of one side serves both: the power of a PSF turned around is the same.
    sizes = bank.blur_sizes_px * how.scale * (-1 if what.side == "near" else 1)
    return {
        "volume": np.minimum(cost.volume, 6e4).astype(np.float16),
        "misfit": cost.misfit.astype(np.float16),
        "frame": np.rint(np.clip(frame, 0, 1) / LIGHT_STEP).astype(np.uint16),
        "noise": np.float32(observed.noise.typical),
        "sizes": sizes.astype(np.float32),
        "grid": np.array(
            [observed.grid.top, observed.grid.left, observed.grid.window_px], np.int32
        ),
    }


def cost_shard(shard: int, light: np.ndarray, folder: Path | None) -> dict[str, np.ndarray]:
    """Return what the likelihood says of all frames of a shard; names end in their index."""
    folder = folder or Path(tempfile.gettempdir()) / "coded_aperture_training_banks"
    arrays = {}
    for index, frame in enumerate(light):
        number = shard * FRAMES_PER_SHARD + index
        found = costs(number, frame.astype(np.float32) * np.float32(LIGHT_STEP), folder)
        arrays.update({f"{name}_{index}": value for name, value in found.items()})
    return arrays


def main() -> None:
    """Compute the shards that are not there yet, of the scenes that are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, required=True)
    add_shard_options(parser)
    args = parser.parse_args()
    # Other machines keep the banks that they learn to themselves.
    folder = None if args.scheduler else args.output / "banks"

    def read(shard: int, source: Path) -> tuple[int, np.ndarray, Path | None]:
        return shard, np.load(source)["light"], folder

    tasks = [
        (args.output / f"costs_{shard:04d}.npz", partial(read, shard, source))
        for shard in range(*args.shards)
        if (source := args.scenes / f"scenes_{shard:04d}.npz").exists()
    ]
    compute(cost_shard, tasks, ("shards.py", "scenes.py", "costs.py"), args.scheduler)


if __name__ == "__main__":
    # Workers know the functions of modules, not those of this program.
    from costs import main

    main()
