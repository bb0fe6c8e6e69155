"""How sure the refinement may be: measured and fitted on frames that it has not learned from."""

import dataclasses
import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from coded_aperture_benchmarks.datasets.cameras import camera_for_blur
from coded_aperture_benchmarks.datasets.room import random_room, walk
from scipy.optimize import minimize
from shards import Arrays, Data, make
from weights_file import package_weights

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.decoders.network import network as package
from coded_aperture_ros.depth.decoders.network import unsupported_reason
from coded_aperture_ros.depth.decoders.network.cells import CELL_PX, Cells
from coded_aperture_ros.depth.decoders.network.network import Calibration, log_odds
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.layered import random_scene

FRAMES_PER_SHARD = 25
_MASKS = ("levin", "levin", "four_hole", "zhou", "levin", "veeraraghavan")
_NOISE = (0.0, 0.0005, 0.001, 0.002, 0.002, 0.003, 0.005)
_SIZE = (384, 480)
_LEVELS = 30
_PLACES = 1500  # of every frame
_FIRST_ROOM = 1000
_FIRST_SCENE = 1_500_000
_KINDS = ("room", "empty", "layered")
# Share of the frames whose bank is wrong, and the standard deviation of its blur's relative error.
_MISFIT_SHARE = 0.3
_MISFIT = 0.006
_RIGHT = 0.05
_PUBLISHED = 0.55
_LEAST_PX = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class _View:
    """A frame without noise, and the truth: its kind of scene, depth range, and camera."""

    kind: int
    coded: np.ndarray
    depth_m: np.ndarray
    range_m: tuple[float, float]
    camera: Camera


def _view(index: int, random: np.random.Generator) -> _View:
    """What a frame shows: a furnished room, an empty one, or layers."""
    mask = Mask.named(_MASKS[index // 2 % len(_MASKS)])
    if random.random() < 0.4:
        near_m, far_m = random.uniform(0.7, 1.0), random.uniform(6, 8)
        blur_px = random.uniform(1, 5), random.uniform(8, 19)
        focal_px = float(random.uniform(400, 800))
        camera = camera_for_blur(mask, focal_px, _SIZE, (near_m, far_m), blur_px)
        room, poses = random_room(_FIRST_ROOM + index // 4), walk(_FIRST_ROOM + index // 4, 10, 0.5)
        pose = poses[random.integers(len(poses))]
        _, depth_m = room.seen(camera, pose)
        range_m = near_m * random.uniform(0.9, 1), far_m * random.uniform(1, 1.2)
        return _View(0, room.coded(camera, pose), depth_m, range_m, camera)
    empty = random.random() < 0.25
    side = "far" if random.random() < 0.85 else "near"
    scene = random_scene(_FIRST_SCENE + index, mask, side, _SIZE, empty=empty)
    depth_m = scene.depth_m()
    range_m = (
        float(np.nanmin(depth_m)) * random.uniform(0.8, 0.98),
        float(np.nanmax(depth_m)) * random.uniform(1.02, 1.3),
    )
    return _View(1 if empty else 2, scene.coded(), depth_m, range_m, scene.camera)


def measure_places(index: int) -> np.ndarray | None:
    """Places of a frame: log odds, blur size, logarithm of tolerance, error and kind [5, places].

    As a robot's frames are: the bank is learned from the camera, and in a third of the frames its
    blur is wrong. None if the frame's depth range is none for the network.
    """
    random = np.random.default_rng([99, index])
    noise = _NOISE[random.integers(len(_NOISE))]
    view = _view(index, random)
    camera = view.camera
    if random.random() < _MISFIT_SHARE:
        wrong = camera.mask_extent_mm * (1 + _MISFIT * random.standard_normal())
        camera = dataclasses.replace(camera, mask_extent_mm=wrong)
    coded = np.dstack([view.coded] * 3) if random.random() < 0.5 else view.coded
    frame = np.clip(SensorModel(noise).expose(coded, random), 0, None)
    try:
        bank = learn_bank_for_camera(camera, *view.range_m, _LEVELS)
    except InputError:  # too shallow
        return None
    if unsupported_reason(bank, bank.stride_px):
        return None
    config = DepthConfig(confidence_threshold=0.0, check_fit=False)
    estimator = DepthEstimator(bank, config, camera)
    with _recorded_inputs() as inputs:
        work = estimator.run_front(frame)
        estimator.run_back(work)
    cells = Cells.covering(_SIZE, work.observation.grid)
    estimator.close()
    starts = cells.top, cells.left
    at, middles = zip(*map(_within, starts, inputs[0][0].shape, _SIZE), strict=True)
    truth_m = view.depth_m[np.ix_(*middles)]
    odds, size_px, tolerance_px = (values[np.ix_(*at)] for values in inputs[0])
    side = np.sign(bank.blur_sizes_px.mean())
    error = np.abs(np.asarray(camera.depth_m(side * size_px)) / truth_m - 1)
    kind = np.full(error.shape, view.kind)
    places = np.stack([odds, size_px, np.log(tolerance_px), error, kind])[:, truth_m > 0]
    return places[:, random.permutation(places.shape[1])[:_PLACES]]


def _within(first: int, count: int, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Half-cells of an axis that have their middle in the frame, and where that is."""
    half_px = CELL_PX // 2
    middles = first + half_px * np.arange(count) + half_px // 2
    inside = np.flatnonzero((middles >= 0) & (middles < length))
    return inside, middles[inside]


@contextmanager
def _recorded_inputs() -> Iterator[list[tuple[np.ndarray, ...]]]:
    """List of what the package calibrates the confidence of each frame from."""
    inputs: list[tuple[np.ndarray, ...]] = []
    usual = Calibration.confidence

    def confidence(
        own: Calibration, probability: np.ndarray, size_px: np.ndarray, tolerance_px: np.ndarray
    ) -> np.ndarray:
        inputs.append((log_odds(probability), size_px, tolerance_px))
        return usual(own, probability, size_px, tolerance_px)

    Calibration.confidence = confidence  # type: ignore[method-assign]
    try:
        yield inputs
    finally:
        Calibration.confidence = usual  # type: ignore[method-assign]


def _compute_shard(shard: int, _: dict[str, Arrays], __: Path, weights: Path) -> Arrays:
    numbers = range(shard * FRAMES_PER_SHARD, (shard + 1) * FRAMES_PER_SHARD)
    with package_weights(weights, package):
        found = [measure_places(number) for number in numbers]
    kept = [places for places in found if places is not None]
    return {"places": np.concatenate([np.empty((5, 0)), *kept], axis=1).astype(np.float32)}


def frame_places(weights: Path, folder: Path, frames: int, processes: int) -> np.ndarray:
    """Places of many frames [5, places], by a weights' file; see `measure_places`."""
    checksum = hashlib.sha256(weights.read_bytes()).hexdigest()[:8]
    data = Data(f"places_{checksum}", partial(_compute_shard, weights=weights))
    shards = range(-(-frames // FRAMES_PER_SHARD))
    make(data, folder, shards, processes)
    places = np.concatenate([data.read(folder, shard)["places"] for shard in shards], axis=1)
    if not places.size:
        raise SystemExit("none of these frames is one for the network: use more with --frames")
    return places


def confidence_calibration(places: np.ndarray) -> Calibration:
    """Calibration of the confidence by places; print how it does on kinds that were left out."""
    given = np.vstack([np.ones(places.shape[1]), places[:3]])
    error, kind = places[3:]
    right = error < _RIGHT
    for number, name in enumerate(_KINDS):
        left_out = kind == number
        if left_out.all() or not left_out.any():
            continue
        found = _logistic_fit(given[:, ~left_out], right[~left_out]) @ given[:, left_out]
        said, really = 1 / (1 + np.exp(-found)), right[left_out]
        published = said >= _PUBLISHED
        print(
            f"{name}, by the others: cross-entropy "
            f"{np.mean(np.logaddexp(0, found) - really * found):.3f}, said {said.mean():.2f}, "
            f"right {really.mean():.2f}, published {published.mean():.2f}, of these right to 10 % "
            f"{np.mean(error[left_out][published] < 2 * _RIGHT):.2f}"
        )
    coefficients = _logistic_fit(given, right)
    print("calibration: " + ", ".join(f"{value:.3g}" for value in coefficients))
    return Calibration(coefficients.astype(np.float32), np.float32(1))


def _logistic_fit(given: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Coefficients of the values given [n, places] that make what is right the likeliest."""

    def unlikelihood(coefficients: np.ndarray) -> float:
        values = coefficients @ given
        return float(np.mean(np.logaddexp(0, values) - right * values))

    return np.asarray(minimize(unlikelihood, [0.0, 1.0, 0.0, 0.0], method="BFGS").x)


def deviation_calibration(found: Sequence[Arrays], calibration: Calibration) -> Calibration:
    """Calibration with the factor of the standard deviation, by the errors of small frames.

    Prints how well the confidence holds on them. `found` has of each frame what was found of the
    places in it: `probability`, `size`, `tolerance`, `error` and `deviation`, px.
    """
    all_of = {name: np.concatenate([one[name] for one in found]) for name in found[0]}
    error, tolerance = all_of["error"], all_of["tolerance"]
    confidence = calibration.confidence(
        all_of["probability"], all_of["size"], np.maximum(tolerance, _LEAST_PX)
    )
    published = confidence >= _PUBLISHED
    if not published.any():
        raise SystemExit("the network is sure of nothing: fit it for longer")
    right, twice = error <= tolerance, error <= 2 * tolerance
    print(f"right to 5 %: {right.mean():.3f}, to 10 %: {twice.mean():.3f}")
    print(f"published {published.mean():.3f}, of these to 10 %: {twice[published].mean():.3f}")
    for low in np.arange(0, 1, 0.1):
        part = (confidence >= low) & (confidence < low + 0.1)
        if part.any():
            means = (confidence[part].mean(), right[part].mean(), part.mean())
            print(f"{low:.1f}: " + " ".join(f"{mean:.3f}" for mean in means))
    factor = np.quantile((error / all_of["deviation"])[published], 0.68)
    print(f"deviation: {factor:.3f}")
    return dataclasses.replace(calibration, deviation=np.float32(factor))
