"""What the refinement finds in whole frames that are kept apart, and whether it is right."""

import copy
import dataclasses
import hashlib
import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from coded_aperture_benchmarks.datasets.cameras import camera_for_blur
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from coded_aperture_benchmarks.datasets.room import Room, random_room, walk
from measured import load_measured, measured_scene
from shards import Arrays, Data, make
from weights_file import package_weights

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator
from coded_aperture_ros.depth.decoders.network import network as package
from coded_aperture_ros.depth.decoders.network import unsupported_reason
from coded_aperture_ros.depth.decoders.network.cells import HALF_CELL_PX, Cells
from coded_aperture_ros.depth.decoders.network.network import Calibration
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.layered import random_scene
from coded_aperture_ros.simulation.layered.scene import LayeredScene

FRAMES_PER_SHARD = 10
_MASKS = ("levin", "levin", "four_hole", "zhou", "levin", "veeraraghavan")
_PHOTOGRAPH_MASKS = (
    "levin",
    "zhou",
    "four_hole",
    "levin",
    "three_wide",
    "veeraraghavan",
    "levin",
    "four_wide",
)
_CODED_MASKS = ("levin", "zhou", "four_hole")
_NOISE = (0.0, 0.0005, 0.001, 0.002, 0.002, 0.003, 0.005)
_CODED_NOISE = (0.002, 0.0005, 0.005)
_SIZE = (384, 480)
_LEVELS = 30
_PLACES = 450  # of every frame
_FIRST_ROOM = 1000
_FIRST_SCENE = 1_500_000
# Kinds of frames: the generator's three, parts of photographs with measured disparity through
# random cameras, and whole ones that another renderer has coded.
KINDS = ("room", "empty", "layered", "photograph", "coded")
PHOTOGRAPH, _CODED = 3, 4
# Share of the frames whose bank is wrong, and the standard deviation of its blur's relative error.
_MISFIT_SHARE = 0.3
_MISFIT = 0.006
_RIGHT = 0.05
# Share of the frames in colour; how much colours of surfaces differ at most; and how often a
# surface has the colour of the one before: a piece of furniture is many boards.
_COLOUR_SHARE = 0.5
_TINT = (0.6, 1.6)
_SAME_LAYER, _SAME_BOARD = 0.25, 0.7
# Rows of places after the features: share of a half-cell's pixels that are right to 5 and to 10 %,
# the mean error in standard deviations, the kind, and the number of the photograph or room.
LABELS = 5


@dataclasses.dataclass(frozen=True, eq=False)
class _View:
    """A frame without noise, and the truth: its kind of scene, depth range, and camera.

    The frame is grey [rows, columns], or in colour [rows, columns, 3].
    """

    kind: int
    coded: np.ndarray
    depth_m: np.ndarray
    range_m: tuple[float, float]
    camera: Camera
    group: int  # frames of one photograph or room have one number


def _view(index: int, random: np.random.Generator) -> _View:
    """What a frame shows: a furnished room, an empty one, or layers."""
    mask = Mask.named(_MASKS[index // 2 % len(_MASKS)])
    colour = random.random() < _COLOUR_SHARE
    if random.random() < 0.4:
        near_m, far_m = random.uniform(0.7, 1.0), random.uniform(6, 8)
        blur_px = random.uniform(1, 5), random.uniform(8, 19)
        focal_px = float(random.uniform(400, 800))
        camera = camera_for_blur(mask, focal_px, _SIZE, (near_m, far_m), blur_px)
        room, poses = random_room(_FIRST_ROOM + index // 4), walk(_FIRST_ROOM + index // 4, 10, 0.5)
        pose = poses[random.integers(len(poses))]
        _, depth_m = room.seen(camera, pose)
        range_m = near_m * random.uniform(0.9, 1), far_m * random.uniform(1, 1.2)
        rooms = _tinted_rooms(room, random) if colour else [room]
        coded = np.dstack([each.coded(camera, pose) for each in rooms]).squeeze()
        return _View(0, coded, depth_m, range_m, camera, index // 4)
    empty = random.random() < 0.25
    side = "far" if random.random() < 0.85 else "near"
    scene = random_scene(_FIRST_SCENE + index, mask, side, _SIZE, empty=empty)
    depth_m, kind = scene.depth_m(), 1 if empty else 2
    scenes = _tinted_scenes(scene, random) if colour else [scene]
    coded = np.dstack([each.coded() for each in scenes]).squeeze()
    return _View(kind, coded, depth_m, _wider(depth_m, random), scene.camera, index // 4)


def _tints(count: int, same: float, random: np.random.Generator) -> np.ndarray:
    """Colours of surfaces [count, 3], 1 at most; a share have that of the one before."""
    tints = random.uniform(*np.log(_TINT), (count, 3)) * random.random((count, 1))
    for number in np.flatnonzero(random.random(count) < same):
        tints[number] = tints[max(number - 1, 0)]
    return np.asarray(np.exp(tints - tints.max(axis=1, keepdims=True)), np.float32)


def _tinted_rooms(room: Room, random: np.random.Generator) -> list[Room]:
    """A room as each channel sees it."""
    tints = _tints(len(room.boards), _SAME_BOARD, random)
    return [
        Room(
            tuple(
                dataclasses.replace(board, tone=board.tone * float(share))
                for board, share in zip(room.boards, channel, strict=True)
            )
        )
        for channel in tints.T
    ]


def _tinted_scenes(scene: LayeredScene, random: np.random.Generator) -> list[LayeredScene]:
    """A scene as each channel sees it."""
    tints = _tints(len(scene.layers), _SAME_LAYER, random)
    return [
        dataclasses.replace(
            scene,
            layers=tuple(
                dataclasses.replace(layer, light=layer.light * share)
                for layer, share in zip(scene.layers, channel, strict=True)
            ),
        )
        for channel in tints.T
    ]


def _photograph_view(
    number: int, photographs: Sequence[Path], random: np.random.Generator
) -> _View:
    """Part of a photograph with measured disparity, through a random camera."""
    mask = Mask.named(_PHOTOGRAPH_MASKS[random.integers(len(_PHOTOGRAPH_MASKS))])
    near_px = random.uniform(1, 5)
    far_px = random.uniform(near_px + 4, 20)
    blur_px = (near_px, far_px) if random.random() < 0.85 else (-far_px, -near_px)
    channels = range(3) if random.random() < _COLOUR_SHARE else [None]
    measured = load_measured(photographs[number])
    seen = [
        # The same part of it in all channels.
        measured_scene(measured, mask, blur_px, _SIZE, copy.deepcopy(random), channel)
        for channel in channels
    ]
    scene, known = seen[0]
    depth_m = np.where(known, scene.depth_m(), np.nan)
    coded = np.dstack([each.coded() for each, _ in seen]).squeeze()
    return _View(PHOTOGRAPH, coded, depth_m, _wider(depth_m, random), scene.camera, number)


def _coded_view(number: int, folder: Path, mask: str) -> _View:
    """A photograph that another renderer has coded."""
    scene = RayTracedScene.load(folder, mask)
    near_m, far_m = float(np.nanmin(scene.depth_m)), float(np.nanmax(scene.depth_m))
    range_m = near_m * 0.98, far_m * 1.02
    return _View(_CODED, scene.coded, scene.depth_m, range_m, scene.camera, number)


def _wider(depth_m: np.ndarray, random: np.random.Generator) -> tuple[float, float]:
    """Range of a bank that is somewhat wider than the depths that there are."""
    return (
        float(np.nanmin(depth_m)) * random.uniform(0.8, 0.98),
        float(np.nanmax(depth_m)) * random.uniform(1.02, 1.3),
    )


def measure_places(index: int, _: Sequence[Path] = ()) -> np.ndarray | None:
    """Places of a frame: features of the confidence, and labels [features + 4, places].

    As a robot's frames are: the bank is learned from the camera, and in a third of the frames its
    blur is wrong. None if the frame's depth range is none for the network.
    """
    random = np.random.default_rng([99, index])
    noise = _NOISE[random.integers(len(_NOISE))]
    return _places_of_recording(_view(index, random), noise, random, index)


def measure_photograph(index: int, photographs: Sequence[Path]) -> np.ndarray | None:
    """Places of a part of a photograph through a random camera; see `measure_places`."""
    random = np.random.default_rng([98, index])
    noise = _NOISE[random.integers(len(_NOISE))]
    view = _photograph_view(index % len(photographs), photographs, random)
    return _places_of_recording(view, noise, random, index)


def measure_coded(index: int, photographs: Sequence[Path]) -> np.ndarray | None:
    """Places of a photograph that another renderer has coded; see `measure_places`."""
    cases = itertools.product(_CODED_NOISE, _CODED_MASKS, enumerate(photographs))
    noise, mask, (number, folder) = next(itertools.islice(cases, index, None))
    view = _coded_view(number, folder, mask)
    random = np.random.default_rng([97, index])
    return _places(view, view.camera, noise, random, index)


def _places_of_recording(
    view: _View, noise: float, random: np.random.Generator, index: int
) -> np.ndarray | None:
    """Places of a view, in a third of all with a bank that is slightly wrong."""
    camera = view.camera
    if random.random() < _MISFIT_SHARE:
        wrong = camera.mask_extent_mm * (1 + _MISFIT * random.standard_normal())
        camera = dataclasses.replace(camera, mask_extent_mm=wrong)
    return _places(view, camera, noise, random, index)


def _places(
    view: _View, camera: Camera, noise: float, random: np.random.Generator, index: int
) -> np.ndarray | None:
    """Places of a view, with the bank of a camera."""
    frame = np.clip(SensorModel(noise).expose(view.coded, random), 0, None)
    try:
        bank = learn_bank_for_camera(camera, *view.range_m, _LEVELS)
    except InputError:  # too shallow
        return None
    if unsupported_reason(bank, bank.stride_px):
        return None
    config = DepthConfig(confidence_threshold=0.0, check_fit=False, threads=1)
    estimator = DepthEstimator(bank, config, camera)
    with _recorded_features() as inputs:
        work = estimator.run_front(frame)
        estimator.run_back(work)
    cells = Cells.covering(view.depth_m.shape, work.observation.grid)
    estimator.close()
    return _choose_places(cells, inputs[0], work.estimate(), view, index)


def _choose_places(
    cells: Cells, features: np.ndarray, found: DepthEstimate, view: _View, index: int
) -> np.ndarray:
    """Some half-cells of a frame whose truth is known all over [features + 5, places]."""
    with np.errstate(invalid="ignore"):
        error = np.abs(found.depth_m - view.depth_m)
        shares = [_share(cells, error <= bound * view.depth_m) for bound in (_RIGHT, 2 * _RIGHT)]
        deviations = _share(cells, error / found.std_dev_m)
    whole = _share(cells, np.isfinite(view.depth_m)) == 1
    kinds = (np.full(whole.shape, number) for number in (view.kind, view.group))
    places = np.concatenate([features, [*shares, deviations, *kinds]])[:, whole]
    chosen = np.random.default_rng(index).permutation(places.shape[1])[:_PLACES]
    return np.asarray(places[:, chosen], np.float32)


def _share(cells: Cells, where: np.ndarray) -> np.ndarray:
    """Mean over the pixels of every half-cell, or their share; those beyond the frame are 0."""
    height, width = where.shape
    whole = np.zeros((cells.rows * 2 * HALF_CELL_PX, cells.columns * 2 * HALF_CELL_PX))
    whole[-cells.top : height - cells.top, -cells.left : width - cells.left] = where
    squares = whole.reshape(2 * cells.rows, HALF_CELL_PX, 2 * cells.columns, HALF_CELL_PX)
    return np.asarray(squares.mean(axis=(1, 3)))


@contextmanager
def _recorded_features() -> Iterator[list[np.ndarray]]:
    """List of what the package calibrates the confidence of each frame by."""
    inputs: list[np.ndarray] = []
    usual = Calibration.confidence

    def confidence(own: Calibration, features: np.ndarray) -> np.ndarray:
        inputs.append(features)
        return usual(own, features)

    Calibration.confidence = confidence  # type: ignore[method-assign]
    try:
        yield inputs
    finally:
        Calibration.confidence = usual  # type: ignore[method-assign]


def _compute_shard(
    shard: int,
    _: dict[str, Arrays],
    __: Path,
    weights: Path,
    measure: Callable[[int, Sequence[Path]], np.ndarray | None],
    photographs: Sequence[Path],
    count: int,
) -> Arrays:
    first = shard * FRAMES_PER_SHARD
    numbers = range(first, min(first + FRAMES_PER_SHARD, count))
    with package_weights(weights, package):
        found = [measure(number, photographs) for number in numbers]
    kept = [places for places in found if places is not None]
    return {"places": np.concatenate(kept, axis=1) if kept else np.empty((0, 0), np.float32)}


def frame_places(weights: Path, folder: Path, frames: int, processes: int) -> np.ndarray:
    """Places of many frames, by a weights' file; see `measure_places` and `measure_coded`.

    Photographs are those of the folders in `measured` in the folder of the data, each with
    `sharp_srgb.png` and `disparity.npz`; coded ones those with `meta.json`, too.
    """
    checksum = hashlib.sha256(weights.read_bytes()).hexdigest()[:8]
    photographs = sorted(path.parent for path in (folder / "measured").glob("*/disparity.npz"))
    coded = [path for path in photographs if (path / "meta.json").is_file()]
    found = []
    for name, measure, folders, count in (
        ("places", measure_places, (), frames),
        ("photographs", measure_photograph, photographs, frames if photographs else 0),
        ("coded", measure_coded, coded, len(coded) * len(_CODED_MASKS) * len(_CODED_NOISE)),
    ):
        compute = partial(
            _compute_shard, weights=weights, measure=measure, photographs=folders, count=count
        )
        data = Data(f"{name}_{checksum}_{count}", compute)
        shards = range(-(-count // FRAMES_PER_SHARD))
        make(data, folder, shards, processes)
        found += [data.read(folder, shard)["places"] for shard in shards]
    found = [places for places in found if places.size]
    if not found:
        raise SystemExit("none of these frames is one for the network: use more with --frames")
    return np.concatenate(found, axis=1)
