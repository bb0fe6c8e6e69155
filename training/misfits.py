"""What the check of fit is given: fitting and misfitting frames, through the estimator."""

import dataclasses
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from banks import BankPair, kept_banks
from boards import board_scene, shows_boards_only
from coded_aperture_benchmarks.datasets.fitting_frames import Fitting, Recorded, recorded
from coded_aperture_benchmarks.datasets.misfits import MISFITS
from misfit_shares import PSF_MISFITS, share_tried
from other_optics import (
    OTHER_CAUSES,
    OTHER_FILTER,
    OTHER_OPTICS,
    OTHER_SCALE,
    filtered,
    random_optics,
    resampled,
)
from scenes import (
    FRAME_PX,
    SCENES,
    build_scene,
    frame_numbers,
    is_measured,
    light_and_blur,
    mask_named,
    measured_view,
    scene_plan,
    uneven_mask,
)
from shards import Arrays, Data

from coded_aperture_ros.depth import CAUSES, DepthConfig, DepthEstimator
from coded_aperture_ros.depth.decoders.network.small import SMALL_PX, keep_small_bank
from coded_aperture_ros.depth.quality import FitCheck, given_of
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig, learn_bank
from coded_aperture_ros.optics import Camera, Mask, PsfStack, render_psf_stack
from coded_aperture_ros.simulation.layered import LayeredScene

# Levels of all banks; each frame is shown to some of them.
_SIZES_PX = np.arange(0.6, 22.01, 0.55)
_FEWEST = 8
_STEPS = 5
_FITTING_FRAMES = 3
# In how many scenes there is a frame of another focus, and how it differs in scale.
_BREATHING_SHARE = 0.4
_BREATHING = (0.93, 1.07)
# Small parts are shown beside: of every fitting frame, and of some of the others.
_SMALL_PX = (96, 160)
_SMALL_SHARE = 0.5
_WINDOW_PX = 48
_CONFIDENT = 0.55
_ENOUGH = 200  # confident pixels, for a median of their errors
_NEAR_INFINITY_PX = 3.0
# Share of the banks that end where the scene does.
_EXACT = 0.3
FITS = "fits"
# How often the estimator knows the camera, and thus what 5 % of a depth are in px.
_CAMERA_SHARE = 0.6
# One frame in so many shows a board that fills it, and one comes through a badly cut mask.
_BOARD_EVERY = 6
_BADLY_CUT_EVERY = 6
_BADLY_CUT = (0.08, 0.18)


@lru_cache(maxsize=64)
def _named_banks(name: str, folder: Path) -> BankPair | None:
    """Banks for all sizes of a mask, or of PSFs that were changed: `mask+kind+step`."""

    def learn() -> FilterBank | None:
        mask, _, change = name.partition("+")
        psfs: PsfStack | None = render_psf_stack(mask_named(mask), _SIZES_PX)
        if change:
            kind, _, step = change.partition("+")
            psfs = _changed(psfs, kind, int(step))
        return None if psfs is None else learn_bank(psfs, LearnConfig(window_px=_WINDOW_PX))

    return kept_banks(name, folder, learn)


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


@lru_cache(maxsize=1)
def _scene(number: int, folder: Path) -> LayeredScene:
    plan = scene_plan(number)
    if is_measured(number):
        # As it was rendered.
        random = np.random.default_rng([6, number])
        return measured_view(plan, folder.parent / "measured", random)[0]
    scene, _ = build_scene(plan)
    if not _shows_board(number):
        return scene
    return board_scene(number, plan, scene, folder.parent / "photographs")


def _shows_board(number: int) -> bool:
    scene = not (scene_plan(number).fence or is_measured(number))
    every = number % _BOARD_EVERY == 0 and scene
    return every or shows_boards_only(number)


def _light(
    number: int, light: np.ndarray, blur_px: np.ndarray, folder: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Frame of a shard and the blur sizes that it shows, some of them made anew."""
    badly_cut = number % _BADLY_CUT_EVERY == 1
    if not badly_cut and not _shows_board(number):
        return light, blur_px
    mask, scene = mask_named(scene_plan(number).mask), _scene(number, folder)
    random = np.random.default_rng([23, number])
    strength = random.uniform(*_BADLY_CUT) if badly_cut else random.uniform(0, 0.08)
    light = scene.coded(uneven_mask(mask, strength, random))
    if _shows_board(number):
        blur_px = np.abs(scene.blur_size_px())
    return np.clip(light, 0, 1), blur_px


def _range(blur_px: np.ndarray, random: np.random.Generator) -> tuple[float, float]:
    """Smallest and largest blur size, px, of a bank for about the scene's depth range."""
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


@dataclasses.dataclass(frozen=True, eq=False)
class _Levels:
    """Banks with some of the levels, and the check against their PSFs."""

    banks: BankPair
    check: FitCheck

    @classmethod
    def between(cls, banks: BankPair, low_px: float, high_px: float) -> "_Levels":
        """Levels of banks whose blur sizes are between two."""
        sizes_px = banks.bank.blur_sizes_px
        kept = np.flatnonzero((low_px <= sizes_px) & (high_px >= sizes_px))
        banks = banks.with_levels(kept)
        return cls(banks, FitCheck(banks.bank.stack))


@dataclasses.dataclass(frozen=True, eq=False)
class _Example:
    """What is made of a frame: which kind of misfit, how strong, and for which levels."""

    kind: str
    strength: float
    frame: Recorded
    levels: _Levels


def _examples(
    number: int, light: np.ndarray, blur_px: np.ndarray, folder: Path
) -> Iterator[_Example]:
    """Fitting frames, and some with misfits, of the light of a frame."""
    random = np.random.default_rng([21, number])
    own = _named_banks(scene_plan(number).mask, folder)
    ends = _range(blur_px, random)
    if own is None:
        return
    light = light * np.float32(random.uniform(0.35, 1))
    if random.random() < 0.3:
        light = cv2.GaussianBlur(light, (0, 0), random.uniform(0.15, 0.5))

    def ordinary(extent: float) -> np.ndarray:
        disc = Mask.named("disc").transmission
        margin = int(len(disc) * max(1 / extent - 1, 0) / 2)
        return _scene(number, folder).coded(Mask("lens", np.pad(disc, margin)))

    noise = float(np.exp(random.uniform(np.log(3e-4), np.log(5e-3))))
    fitting = Fitting(
        light,
        lambda: _scene(number, folder).all_in_focus(),
        ordinary,
        own.bank.stack,
        blur_px,
        noise,
    )
    levels = _Levels.between(own, *ends)
    for frame in _fitting_frames(fitting, random):
        yield _Example(FITS, 0.0, frame, levels)
    for kind, misfit in MISFITS.items():
        if not misfit.traced or random.random() > share_tried(kind, number):
            continue
        if kind in PSF_MISFITS:
            step = int(random.integers(_STEPS))
            other = _named_banks(f"{scene_plan(number).mask}+{kind}+{step}", folder)
            if other is not None:
                frame = recorded(fitting, light, random)
                yield _Example(kind, step / (_STEPS - 1), frame, _Levels.between(other, *ends))
            continue
        strength = float(random.random())
        one = misfit.change(fitting, strength, random)
        if one is None:
            continue
        known = levels
        if len(one.stack) < len(_SIZES_PX):  # out of range
            sizes = one.stack.blur_sizes_px
            span = max(ends[1] - ends[0], 5.0)
            low = sizes[0] if sizes[0] > ends[0] else max(sizes[-1] - span, sizes[0])
            known = _Levels.between(own, low, min(low + span, sizes[-1]))
        yield _Example(kind, strength, one, known)
    for kind in OTHER_CAUSES:
        if random.random() < share_tried(kind, number):
            one = _changed_at_random(kind, number, fitting, folder, random)
            yield _Example(kind, 0.0, one, levels)


def _changed_at_random(
    kind: str, number: int, fitting: Fitting, folder: Path, random: np.random.Generator
) -> Recorded:
    if kind == OTHER_OPTICS:
        optics = random_optics(mask_named(scene_plan(number).mask), random)
        light = _scene(number, folder).coded(optics) * np.float32(random.uniform(0.35, 1))
        return recorded(fitting, light, random)
    change = {OTHER_SCALE: resampled, OTHER_FILTER: filtered}[kind]
    return change(recorded(fitting, fitting.light, random), random)


def _fitting_frames(fitting: Fitting, random: np.random.Generator) -> Iterator[Recorded]:
    """Frames of different noise and brightness: whole, a part, and one that was processed."""
    for index in range(_FITTING_FRAMES):
        share, factor = random.uniform(0.3, 1), np.exp(random.normal(0, 0.5))
        noise = fitting.noise * factor
        other = dataclasses.replace(fitting, noise=noise)
        one = recorded(other, fitting.light * np.float32(share), random)
        if index == 1:
            side = int(random.integers(150, FRAME_PX + 1))
            one = dataclasses.replace(
                one,
                frame=one.frame[:side, -side:],
                blur_size_px=fitting.blur_size_px[:side, -side:],
            )
        elif index == 2 and random.random() < 0.5:
            one = dataclasses.replace(one, frame=_in_eight_bits(one.frame))
        elif index == 2:
            one = dataclasses.replace(one, known_noise=noise * np.exp(random.normal(0, 0.1)))
        yield one
    if random.random() < _BREATHING_SHARE:
        yield _breathing(recorded(fitting, fitting.light, random), random)


def _breathing(one: Recorded, random: np.random.Generator) -> Recorded:
    """Second frame of a pair of focus settings, which was brought to the scale of the first."""
    scale = random.uniform(*_BREATHING)
    shift = (np.array(one.frame.shape[::-1]) / 2 - 0.5) * (1 - scale)
    moved = np.column_stack([np.eye(2) * scale, shift])
    size = one.frame.shape[::-1]
    border = (float("nan"),) * 4
    frame = cv2.warpAffine(one.frame, moved, size, flags=cv2.INTER_LANCZOS4, borderValue=border)
    blur_px = scale * cv2.warpAffine(
        one.blur_size_px, moved, size, flags=cv2.INTER_NEAREST, borderValue=border
    )
    return dataclasses.replace(one, frame=frame, blur_size_px=blur_px)


def _in_eight_bits(frame: np.ndarray) -> np.ndarray:
    return np.rint(frame * 255).astype(np.float32) / 255


def _with_small_part(one: Recorded, fits: bool, random: np.random.Generator) -> Iterator[Recorded]:
    """What is recorded and, often, a small part of it, as a region of interest is."""
    yield one
    if not fits and random.random() > _SMALL_SHARE:
        return
    cut = []
    for length in one.frame.shape:
        size = min(int(random.integers(*_SMALL_PX)), length)
        first = int(random.integers(length - size + 1))
        cut.append(slice(first, first + size))
    frame, truth = one.frame[tuple(cut)], one.blur_size_px[tuple(cut)]
    if not one.known_noise and random.random() < 0.5:
        frame = _in_eight_bits(frame)
    yield dataclasses.replace(one, frame=frame, blur_size_px=truth)


def _features(
    one: Recorded, levels: _Levels, infinity_px: float, camera: Camera | None
) -> tuple[np.ndarray, np.ndarray, float, float] | None:
    """What the check is given, the error of what is sure, and how much of the frame that is.

    What it is given are the features of few windows, and those of more. The error is the median, as
    a share of the inverse depth. None if there is too little to see.
    """
    bank = levels.banks.bank
    if min(one.frame.shape) < 2 * _WINDOW_PX or len(bank.stack) < _FEWEST:
        return None
    config = DepthConfig(
        confidence_threshold=0.0, noise=one.known_noise, threads=1, check_fit=False
    )
    # Of levels beyond infinity a camera knows nothing.
    if camera is not None and bank.blur_sizes_px[0] > 0.95 * camera.blur_at_infinity_px:
        camera = None
    keep_small_bank(bank, levels.banks.small)
    estimator = DepthEstimator(bank, config, camera)
    work = estimator.run_front(one.frame)
    estimator.run_back(work)
    estimate = work.estimate()
    estimator.close()
    size_px, confidence = estimate.blur_size_px, estimate.confidence
    misfit = work.frame_cost.misfit
    checked = getattr(work.decoded, "checked", confidence)
    looks = list(levels.check.features(given_of(work.observation, misfit, estimate.level, checked)))
    if not looks:
        return None
    # The inverse depth is linear in the blur size; near infinity nothing is told apart.
    left_px = np.maximum(np.abs(infinity_px - size_px), _NEAR_INFINITY_PX)
    error = np.abs(size_px - one.blur_size_px) / left_px
    known = np.isfinite(error)
    sure = known & (confidence >= _CONFIDENT)
    median = float(np.median(error[sure])) if sure.sum() > _ENOUGH else 0.0
    return looks[0], looks[-1], median, float(sure.sum() / max(known.sum(), 1))


def _compute_shard(shard: int, sources: dict[str, Arrays], folder: Path) -> Arrays:
    """What the check is given of all frames of a shard: one row for each, of `_ARRAYS`."""
    scenes = sources["scenes"]
    found: dict[str, list[Any]] = {name: [] for name in _ARRAYS}
    for index, number in enumerate(frame_numbers(shard)):
        light, blur_px = light_and_blur(scenes, index)
        if not np.isfinite(blur_px).any():
            continue
        side = scene_plan(number).side
        far = -1 if side == "near" else 1
        infinity_px = far * max(
            abs(float(scenes["infinity"][index])), 1.2 * float(np.nanmax(blur_px))
        )
        light, blur_px = _light(number, light, blur_px, folder)
        random = np.random.default_rng([24, number])
        # Banks have sizes of one sign.
        camera = _scene(number, folder).camera if side == "far" else None
        for example in _examples(number, light, blur_px, folder):
            name = _CAUSES.get(example.kind)
            cause = list(CAUSES).index(name) if name else -1
            for one in _with_small_part(example.frame, example.kind == FITS, random):
                known = camera if random.random() < _CAMERA_SHARE else None
                features = _features(one, example.levels, infinity_px, known)
                if features is None:
                    continue
                row = (*features, cause, example.kind, example.strength, number)
                for name, value in zip(_ARRAYS, row, strict=True):
                    found[name].append(value)
    return {name: np.array(values) for name, values in found.items()}


_CAUSES = {kind: misfit.causes[0] for kind, misfit in MISFITS.items()} | OTHER_CAUSES
_ARRAYS = ("few_windows", "features", "error", "coverage", "cause", "kind", "strength", "number")
MISFITS_DATA = Data(
    "misfits",
    _compute_shard,
    (SCENES,),
    ("measured", "scenes", "banks", "boards", "other_optics", "misfits"),
)
