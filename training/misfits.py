"""What the check of fit is shown: fitting and misfitting frames, through the package's estimator.

python training/misfits.py --scenes DIR --output DIR --shards 0 40
"""

import argparse
import dataclasses
import os
import tempfile
from collections.abc import Iterator
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from coded_aperture_benchmarks.datasets.fitting_frames import Fitting, Recorded, recorded
from coded_aperture_benchmarks.datasets.misfits import MISFITS
from costs import with_levels
from scenes import (
    BLUR_STEP,
    FIRST_FENCED_SHARD,
    FRAME_PX,
    FRAMES_PER_SHARD,
    LIGHT_STEP,
    drawn,
    mask_of,
    scene_of,
)
from shards import add_shard_options, compute

from coded_aperture_ros.depth import CAUSES, DepthConfig, DepthEstimator
from coded_aperture_ros.depth.decoders.network import small_bank
from coded_aperture_ros.depth.decoders.network.small import SMALL_PX, keep_small_bank
from coded_aperture_ros.depth.quality import FitCheck
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig, learn_bank
from coded_aperture_ros.likelihood.bank.file import load_bank, save_bank
from coded_aperture_ros.optics import Camera, Mask, PsfStack, render_psf_stack
from coded_aperture_ros.simulation.layered import LayeredScene

# Levels of all banks; each frame is shown to some of them.
_SIZES_PX = np.arange(0.6, 22.01, 0.55)
_FEWEST = 8
# Of every kind of misfit, in how many frames it is tried; what changes PSFs needs banks of its own.
_SHARE, _SHARE_OF_PSFS = 0.3, 0.25
# Where something stands before a room, in fewer: such frames are shown as what may well fit.
_OF_FENCED = 0.4
_OF_PSFS = (
    "other mask",
    "mask inverted",
    "mask with an open margin",
    "part of the mask covered",
    "mask turned",
    "mask mirrored",
)
_STEPS = 5
_FITTING_FRAMES = 3
# Small parts are shown beside: of every fitting frame, and of some of the others.
_SMALL_PX, _SHARE_OF_SMALL = (96, 160), 0.5
_WINDOW_PX, _CONFIDENT, _ENOUGH = 48, 0.55, 200
_NEAR_INFINITY_PX = 3.0
# Share of the banks that end where the scene does.
_EXACT = 0.3
FITS = "fits"
# How often the estimator knows the camera, and thus what 5 % of a depth are in px.
_OF_CAMERAS = 0.6
# One frame in so many shows a board that fills it, and one comes through a badly cut mask.
_OF_BOARDS, _OF_BADLY_CUT = 6, 6
_NARROWEST_PX, _BADLY_CUT = 1.2, (0.08, 0.18)


@dataclasses.dataclass(frozen=True, eq=False)
class _Shown:
    """The levels of a bank that a frame is shown to."""

    bank: FilterBank
    small: FilterBank

    @cached_property
    def check(self) -> FitCheck:
        """Compare frames with them."""
        return FitCheck(self.bank.stack)


@lru_cache(maxsize=64)
def _banks_of(name: str, folder: Path) -> _Shown | None:
    """Return the bank for all sizes of a mask, or of one changed: `mask+kind+step`."""
    paths = folder / f"{name}.npz", folder / f"{name}_small.npz"
    if not all(path.exists() for path in paths):
        mask, _, change = name.partition("+")
        stack: PsfStack | None = render_psf_stack(mask_of(mask), _SIZES_PX)
        if change:
            kind, _, step = change.partition("+")
            stack = _changed(stack, kind, int(step))
        if stack is None:
            return None
        bank = learn_bank(stack, LearnConfig(window_px=_WINDOW_PX))
        folder.mkdir(parents=True, exist_ok=True)
        for path, one in zip(paths, (bank, small_bank(bank)), strict=True):
            # Two processes may learn the same bank at once.
            part = path.with_suffix(f".{os.getpid()}.npz")
            save_bank(one, part)
            part.rename(path)
    return _Shown(*(load_bank(path) for path in paths))


def _changed(stack: PsfStack | None, kind: str, step: int) -> PsfStack | None:
    dark = np.zeros((8, 8), np.float32)
    fitting = Fitting(dark, lambda: dark, lambda _: dark, stack, dark, 0.0)
    one = MISFITS[kind].change(fitting, step / (_STEPS - 1), np.random.default_rng(0))
    if one is None:
        return None
    # Small patches have to hold the PSFs: of a mask with a margin, the largest do not fit.
    middle = one.stack.psfs.shape[-1] // 2
    reach = min(middle, (SMALL_PX - 1) // 2)
    inner = np.s_[middle - reach : middle + reach + 1]
    psfs = one.stack.psfs[:, inner, inner]
    whole = psfs.sum(axis=(1, 2)) > 1 - 1e-6
    return PsfStack(one.stack.blur_sizes_px[whole], psfs[whole])


def _some_levels(shown: _Shown, low_px: float, high_px: float) -> _Shown:
    sizes_px = shown.bank.blur_sizes_px
    kept = np.flatnonzero((low_px <= sizes_px) & (high_px >= sizes_px))
    return _Shown(with_levels(shown.bank, kept), with_levels(shown.small, kept))


@lru_cache(maxsize=1)
def _scene(number: int) -> LayeredScene:
    what = drawn(number)
    scene, _ = scene_of(what)
    if not _shows_board(number):
        return scene
    # As where a lens is calibrated: no other surface tells the bank's other levels from beyond.
    widest = float(np.nanmax(np.abs(scene.blur_size_px())))
    random = np.random.default_rng([22, number])
    size = float(np.exp(random.uniform(*np.log([_NARROWEST_PX, max(widest, 2.0)]))))
    sign = -1.0 if what.side == "near" else 1.0
    board = dataclasses.replace(scene.layers[-1], blur_px=(sign * size, 0, 0), relief_px=None)
    return LayeredScene((board,), scene.camera)


def _shows_board(number: int) -> bool:
    return number % _OF_BOARDS == 0 and not drawn(number).fence


def _light(number: int, light: np.ndarray, blur_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a frame of a shard and the blur sizes that it shows, some of them made anew."""
    badly_cut = number % _OF_BADLY_CUT == 1
    if not badly_cut and not _shows_board(number):
        return light, blur_px
    mask, scene = mask_of(drawn(number).mask), _scene(number)
    random = np.random.default_rng([23, number])
    strength = random.uniform(*_BADLY_CUT) if badly_cut else random.uniform(0, 0.08)
    cells = mask.transmission * (1 + strength * random.standard_normal(mask.transmission.shape))
    light = scene.coded(Mask(mask.name, np.clip(cells, 0, 1).astype(np.float32)))
    if _shows_board(number):
        blur_px = np.abs(scene.blur_size_px())
    return np.clip(light, 0, 1), blur_px


def _range(blur_px: np.ndarray, random: np.random.Generator) -> tuple[float, float]:
    """Return the blur sizes of a bank for about the scene's depth range."""
    low, high = np.nanmin(blur_px), np.nanmax(blur_px)
    if high - low < 1e-3:  # a board somewhere in the range
        low, high = low - random.exponential(1.0), high + random.uniform(2, 16)
        if random.random() < 0.4:
            low = max(low - random.uniform(2, 16), 0)
            high = float(np.nanmax(blur_px)) + random.exponential(1.0)
        return low, max(high, low + 3.5)
    beyond = random.exponential(1.0, 2) * (random.random() > _EXACT)
    ends = np.array([low, high]) + beyond * [-1, 1]
    if random.random() < 0.3:
        ends += [-8, 8]
    low = min(ends[0], low)
    return low, max(ends[1], high, low + 3.5)


def _frames(
    number: int, light: np.ndarray, blur_px: np.ndarray, folder: Path
) -> Iterator[tuple[str, float, Recorded, _Shown]]:
    """Yield what is made of a frame: kind, strength, what is recorded, and the bank's levels."""
    random = np.random.default_rng([21, number])
    what = drawn(number)
    own = _banks_of(what.mask, folder)
    ends = _range(blur_px, random)
    if own is None:
        return
    levels = _some_levels(own, *ends)
    light = light * np.float32(random.uniform(0.35, 1))
    if random.random() < 0.3:
        light = cv2.GaussianBlur(light, (0, 0), random.uniform(0.15, 0.5))

    def ordinary(extent: float) -> np.ndarray:
        disc = Mask.named("disc").transmission
        margin = int(len(disc) * max(1 / extent - 1, 0) / 2)
        return _scene(number).coded(Mask("lens", np.pad(disc, margin)))

    noise = float(np.exp(random.uniform(np.log(3e-4), np.log(5e-3))))
    fitting = Fitting(
        light, lambda: _scene(number).all_in_focus(), ordinary, own.bank.stack, blur_px, noise
    )
    for index in range(_FITTING_FRAMES):
        share, factor = random.uniform(0.3, 1), np.exp(random.normal(0, 0.5))
        other = dataclasses.replace(fitting, noise=noise * factor)
        one = recorded(other, light * np.float32(share), random)
        frame = one.frame
        if index == 1:
            side = int(random.integers(150, FRAME_PX + 1))
            one = dataclasses.replace(
                one, frame=frame[:side, -side:], blur_size_px=blur_px[:side, -side:]
            )
        elif index == 2 and random.random() < 0.5:
            eighth = np.rint(frame * 255).astype(np.float32) / 255
            one = dataclasses.replace(one, frame=eighth)
        elif index == 2:
            one = dataclasses.replace(
                one, known_noise=noise * factor * np.exp(random.normal(0, 0.1))
            )
        yield FITS, 0.0, one, levels
    often = _OF_FENCED if number >= FIRST_FENCED_SHARD * FRAMES_PER_SHARD else 1.0
    for kind, misfit in MISFITS.items():
        share = often * (_SHARE_OF_PSFS if kind in _OF_PSFS else _SHARE)
        if not misfit.traced or random.random() > share:
            continue
        if kind in _OF_PSFS:
            step = int(random.integers(_STEPS))
            other_bank = _banks_of(f"{what.mask}+{kind}+{step}", folder)
            if other_bank is not None:
                of_bank = _some_levels(other_bank, *ends)
                yield kind, step / (_STEPS - 1), recorded(fitting, light, random), of_bank
            continue
        strength = float(random.random())
        one = misfit.change(fitting, strength, random)
        if one is None:
            continue
        of_bank = levels
        if len(one.stack) < len(_SIZES_PX):  # out of range
            sizes = one.stack.blur_sizes_px
            span = max(ends[1] - ends[0], 5.0)
            low = sizes[0] if sizes[0] > ends[0] else max(sizes[-1] - span, sizes[0])
            of_bank = _some_levels(own, low, min(low + span, sizes[-1]))
        yield kind, strength, one, of_bank


def _with_small_part(one: Recorded, fits: bool, random: np.random.Generator) -> Iterator[Recorded]:
    """Yield what is recorded and, often, a small part of it, as a region of interest is."""
    yield one
    if not fits and random.random() > _SHARE_OF_SMALL:
        return
    cut = []
    for length in one.frame.shape:
        size = min(int(random.integers(*_SMALL_PX)), length)
        first = int(random.integers(length - size + 1))
        cut.append(slice(first, first + size))
    frame, truth = one.frame[tuple(cut)], one.blur_size_px[tuple(cut)]
    if not one.known_noise and random.random() < 0.5:
        frame = np.rint(frame * 255).astype(np.float32) / 255
    yield dataclasses.replace(one, frame=frame, blur_size_px=truth)


def _told(
    one: Recorded, shown: _Shown, infinity_px: float, camera: Camera | None
) -> tuple[np.ndarray, float, float] | None:
    """Return features, the error of what is sure, and how much of the frame that is."""
    if min(one.frame.shape) < 2 * _WINDOW_PX or len(shown.bank.stack) < _FEWEST:
        return None
    config = DepthConfig(
        confidence_threshold=0.0, noise=one.known_noise, threads=1, check_fit=False
    )
    # Of levels beyond infinity a camera knows nothing.
    if camera is not None and shown.bank.blur_sizes_px[0] > 0.95 * camera.blur_at_infinity_px:
        camera = None
    estimator = DepthEstimator(shown.bank, config, camera)
    keep_small_bank(shown.bank, shown.small)
    work = estimator.run_front(one.frame)
    estimator.run_back(work)
    estimate = work.estimate()
    estimator.close()
    size_px, confidence = estimate.blur_size_px, estimate.confidence
    *_, features = [
        None,
        *shown.check.looks(work.observation, work.frame_cost.misfit, estimate.level, confidence),
    ]
    if features is None:
        return None
    # The inverse depth is linear in the blur size; near infinity nothing is told apart.
    left_px = np.maximum(np.abs(infinity_px - size_px), _NEAR_INFINITY_PX)
    error = np.abs(size_px - one.blur_size_px) / left_px
    known = np.isfinite(error)
    sure = known & (confidence >= _CONFIDENT)
    median = float(np.median(error[sure])) if sure.sum() > _ENOUGH else 0.0
    return features, median, float(sure.sum() / max(known.sum(), 1))


def shown_shard(
    shard: int, light: np.ndarray, blur: np.ndarray, infinity: np.ndarray, folder: Path | None
) -> dict[str, np.ndarray]:
    """Return what is told of all frames of a shard."""
    folder = folder or Path(tempfile.gettempdir()) / "coded_aperture_misfit_banks"
    found: dict[str, list[Any]] = {name: [] for name in _ARRAYS}
    for index, (frame, sizes) in enumerate(zip(light, blur, strict=True)):
        number = shard * FRAMES_PER_SHARD + index
        blur_px = np.abs(sizes * np.float32(BLUR_STEP))
        blur_px[sizes == 0] = np.nan  # seams between two surfaces
        if not np.isfinite(blur_px).any():
            continue
        far = -1 if drawn(number).side == "near" else 1
        infinity_px = far * max(abs(float(infinity[index])), 1.2 * float(np.nanmax(blur_px)))
        frame, blur_px = _light(number, frame * np.float32(LIGHT_STEP), blur_px)
        of_parts = np.random.default_rng([24, number])
        # Banks have sizes of one sign.
        camera = _scene(number).camera if drawn(number).side == "far" else None
        for kind, strength, whole, shown in _frames(number, frame, blur_px, folder):
            causes = MISFITS[kind].causes if kind != FITS else ()
            cause = list(CAUSES).index(causes[0]) if causes else -1
            for one in _with_small_part(whole, kind == FITS, of_parts):
                known = camera if of_parts.random() < _OF_CAMERAS else None
                if (told := _told(one, shown, infinity_px, known)) is None:
                    continue
                row = (*told, cause, kind, strength, number)
                for name, value in zip(_ARRAYS, row, strict=True):
                    found[name].append(value)
    return {name: np.array(values) for name, values in found.items()}


_ARRAYS = ("features", "error", "coverage", "cause", "kind", "strength", "number")


def main() -> None:
    """Compute the shards that are not there yet, of the scenes that are."""
    cv2.setNumThreads(1)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, required=True)
    add_shard_options(parser)
    args = parser.parse_args()
    # Other machines keep the banks that they learn to themselves.
    folder = None if args.scheduler else args.output / "banks"

    def read(shard: int, source: Path) -> tuple[Any, ...]:
        with np.load(source) as scenes:
            return shard, scenes["light"], scenes["blur"], scenes["infinity"], folder

    tasks = [
        (args.output / f"misfits_{shard:04d}.npz", partial(read, shard, source))
        for shard in range(*args.shards)
        if (source := args.scenes / f"scenes_{shard:04d}.npz").exists()
    ]
    compute(
        shown_shard, tasks, ("shards.py", "scenes.py", "costs.py", "misfits.py"), args.scheduler
    )


if __name__ == "__main__":
    # Workers know the functions of modules, not those of this program.
    from misfits import main

    main()
