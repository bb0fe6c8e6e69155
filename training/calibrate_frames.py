"""Fit how sure the refinement may be, on whole frames of rooms and layered scenes.

    python training/calibrate_frames.py --frames 0 500 2 --output build/training/sure_0.npz &
    python training/calibrate_frames.py --frames 1 500 2 --output build/training/sure_1.npz; wait
    python training/calibrate_frames.py --fit build/training/sure_*.npz

Looks at frames as a robot's are: the bank is learned from the camera, and in a third of the frames
its blur is wrong by 0.6 %. Prints the constants `calibration` of `refinement.npz`,
and, for each kind of scene, how well a fit on the other kinds does.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np
from coded_aperture_benchmarks.datasets.cameras import camera_for_blur
from coded_aperture_benchmarks.datasets.room import random_room, walk
from scipy.optimize import minimize
from tqdm import tqdm

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.decoders.network import unsupported_reason
from coded_aperture_ros.depth.decoders.network.cells import CELL_PX, Cells
from coded_aperture_ros.depth.decoders.network.network import Calibration, log_odds
from coded_aperture_ros.depth.stage import Work
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.optics import Camera, load_mask
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.layered import random_scene

_MASKS = ("levin", "levin", "four_hole", "zhou", "levin", "veeraraghavan")
_NOISE = (0.0, 0.0005, 0.001, 0.002, 0.002, 0.003, 0.005)
_SIZE = (384, 480)
_LEVELS, _PLACES = 30, 1500
_FIRST_ROOM, _FIRST_SCENE = 1000, 1_500_000
_KINDS = ("room", "empty", "layered")
_MISFIT, _BY = 0.3, 0.006
_RIGHT, _PUBLISHED = 0.05, 0.55


@dataclasses.dataclass(frozen=True, eq=False)
class _Shown:
    """A frame without noise, and the truth: a kind, a depth range, and its camera."""

    kind: int
    coded: np.ndarray
    depth_m: np.ndarray
    range_m: tuple[float, float]
    camera: Camera


def shown(index: int, random: np.random.Generator) -> _Shown:
    """Return what a frame shows."""
    mask = load_mask(_MASKS[index // 2 % len(_MASKS)])
    if random.random() < 0.4:
        near_m, far_m = random.uniform(0.7, 1.0), random.uniform(6, 8)
        blur_px = random.uniform(1, 5), random.uniform(8, 19)
        focal_px = float(random.uniform(400, 800))
        camera = camera_for_blur(mask, focal_px, _SIZE, (near_m, far_m), blur_px)
        room, poses = random_room(_FIRST_ROOM + index // 4), walk(_FIRST_ROOM + index // 4, 10, 0.5)
        pose = poses[random.integers(len(poses))]
        _, depth_m = room.seen(camera, pose)
        range_m = near_m * random.uniform(0.9, 1), far_m * random.uniform(1, 1.2)
        return _Shown(0, room.coded(camera, pose), depth_m, range_m, camera)
    empty = random.random() < 0.25
    side = "far" if random.random() < 0.85 else "near"
    scene = random_scene(_FIRST_SCENE + index, mask, side, _SIZE, empty=empty)
    depth_m = scene.depth_m()
    range_m = (
        float(np.nanmin(depth_m)) * random.uniform(0.8, 0.98),
        float(np.nanmax(depth_m)) * random.uniform(1.02, 1.3),
    )
    return _Shown(1 if empty else 2, scene.coded(), depth_m, range_m, scene.camera)


def measured(index: int) -> np.ndarray | None:
    """Return odds, blur size, logarithm of tolerance, error and kind of places [5, n]."""
    random = np.random.default_rng([99, index])
    noise = _NOISE[random.integers(len(_NOISE))]
    one = shown(index, random)
    camera = one.camera
    if random.random() < _MISFIT:
        wrong = camera.mask_extent_mm * (1 + _BY * random.standard_normal())
        camera = dataclasses.replace(camera, mask_extent_mm=wrong)
    coded = np.dstack([one.coded] * 3) if random.random() < 0.5 else one.coded
    frame = np.clip(SensorModel(noise).expose(coded, random), 0, None)
    try:
        bank = learn_bank_for_camera(camera, *one.range_m, _LEVELS)
    except InputError:  # too shallow
        return None
    if unsupported_reason(bank, bank.stride_px):
        return None
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0), camera)
    work = estimator.run_front(frame)
    told = _told(estimator, work)
    estimator.close()
    cells = Cells.covering(_SIZE, work.observation.grid)
    starts = cells.top, cells.left
    at, middles = zip(*map(_within, starts, told[0].shape, _SIZE), strict=True)
    truth_m = one.depth_m[np.ix_(*middles)]
    odds, size_px, tolerance_px = (values[np.ix_(*at)] for values in told)
    side = np.sign(bank.blur_sizes_px.mean())
    error = np.abs(np.asarray(camera.depth_m(side * size_px)) / truth_m - 1)
    kind = np.full(error.shape, one.kind)
    places = np.stack([odds, size_px, np.log(tolerance_px), error, kind])[:, truth_m > 0]
    return places[:, random.permutation(places.shape[1])[:_PLACES]]


def _within(first: int, count: int, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Return which half-cells of an axis have their middle in the frame, and where that is."""
    half_px = CELL_PX // 2
    middles = first + half_px * np.arange(count) + half_px // 2
    inside = np.flatnonzero((middles >= 0) & (middles < length))
    return inside, middles[inside]


def _told(estimator: DepthEstimator, work: Work) -> tuple[np.ndarray, ...]:
    """Return what the package would calibrate the confidence of a frame from."""
    taken: list[tuple[np.ndarray, ...]] = []
    usual = Calibration.confidence

    def take(own: Calibration, probability: np.ndarray, *told: np.ndarray) -> np.ndarray:
        taken.append((log_odds(probability), *told))
        return usual(own, probability, *told)

    Calibration.confidence = take
    try:
        estimator.run_back(work)
    finally:
        Calibration.confidence = usual
    return taken[0]


def fitted(told: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the constants of a logistic fit."""

    def unlikelihood(constants: np.ndarray) -> float:
        values = constants @ told
        return float(np.mean(np.logaddexp(0, values) - right * values))

    return minimize(unlikelihood, [0.0, 1.0, 0.0, 0.0], method="BFGS").x


def report(places: np.ndarray) -> None:
    """Fit, and print constants and how they do on kinds that were left out."""
    told = np.vstack([np.ones(places.shape[1]), places[:3]])
    error, kind = places[3:]
    right = error < _RIGHT
    constants = ", ".join(f"{value:.3g}" for value in fitted(told, right))
    print(f"calibration = ({constants})")
    for number, name in enumerate(_KINDS):
        left_out = kind == number
        if left_out.all() or not left_out.any():
            continue
        found = fitted(told[:, ~left_out], right[~left_out]) @ told[:, left_out]
        said, really = 1 / (1 + np.exp(-found)), right[left_out]
        published = said >= _PUBLISHED
        print(
            f"{name}, by the others: cross-entropy "
            f"{np.mean(np.logaddexp(0, found) - really * found):.3f}, said {said.mean():.2f}, "
            f"right {really.mean():.2f}, published {published.mean():.2f}, of these right to 10 % "
            f"{np.mean(error[left_out][published] < 2 * _RIGHT):.2f}"
        )


def main() -> None:
    """Look at frames, or fit."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, nargs=3, metavar=("FIRST", "END", "STEP"))
    parser.add_argument("--output", type=Path)
    parser.add_argument("--fit", type=Path, nargs="+", metavar="NPZ")
    args = parser.parse_args()
    if args.fit:
        report(np.concatenate([np.load(path)["places"] for path in args.fit], axis=1))
        return
    if args.frames is None or args.output is None:
        parser.error("expected --frames and --output, or --fit")
    found = [measured(index) for index in tqdm(range(*args.frames))]
    kept = [places for places in found if places is not None]
    if not kept:
        raise SystemExit("none of these frames can be looked at: use more")
    args.output.parent.mkdir(parents=True, exist_ok=True)
    np.savez(args.output, places=np.concatenate(kept, axis=1).astype(np.float32))


if __name__ == "__main__":
    main()
