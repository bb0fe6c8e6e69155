"""Batches for learning: features as the package makes them, and the truth at half-cells."""

import dataclasses
import queue
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from scenes import BLUR_STEP, FRAMES_PER_SHARD, LIGHT_STEP, drawn

from coded_aperture_ros.depth.refine.cells import CELL_PX, Cells
from coded_aperture_ros.depth.refine.features import cost_features, frame_features, tried_sizes
from coded_aperture_ros.imaging import PatchGrid, brightness_at

STRIDE_PX = 8


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """One frame as it is kept in memory."""

    volume: np.ndarray
    misfit: np.ndarray
    light: np.ndarray
    blur: np.ndarray
    noise: float
    sizes_px: np.ndarray
    window_px: int
    infinity_px: float


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Tensors of some frames: what the network takes, where levels were tried, and the truth."""

    costs: torch.Tensor
    frame: torch.Tensor
    tried: torch.Tensor
    blur_px: torch.Tensor


def load(scenes: Path, costs: Path, shards: list[int], least_told: float = 0.0) -> list[Frame]:
    """Read the shards that are there; frames of which at least a share is told by the costs."""
    frames = []
    for shard in shards:
        paths = scenes / f"scenes_{shard:04d}.npz", costs / f"costs_{shard:04d}.npz"
        if not all(path.exists() for path in paths):
            continue
        truth, seen = (dict(np.load(path)) for path in paths)
        for index in range(FRAMES_PER_SHARD):
            if drawn(shard * FRAMES_PER_SHARD + index).side == "both":
                continue
            frames.append(
                Frame(
                    seen[f"volume_{index}"],
                    seen[f"misfit_{index}"],
                    seen[f"frame_{index}"],
                    truth["blur"][index],
                    float(seen[f"noise_{index}"]),
                    seen[f"sizes_{index}"].astype(np.float64),
                    int(seen[f"grid_{index}"][2]),
                    float(truth["infinity"][index]),
                )
            )
    return [frame for frame in frames if _told(frame) >= least_told]


def _told(frame: Frame) -> float:
    """Return in which share of the patches the least cost is that of about the right level."""
    grid = PatchGrid.covering(frame.blur.shape, frame.window_px, STRIDE_PX)
    truth = frame.blur[np.ix_(grid.row_centres, grid.column_centres)] * BLUR_STEP
    return float(np.mean(np.abs(frame.sizes_px[frame.volume.argmin(-1)] - truth) < 1))


def batches(frames: list[Frame], size: int, seed: int, augment: bool = True) -> Iterator[Batch]:
    """Yield batches of all frames in random order, for ever if `augment`."""
    random = np.random.default_rng(seed)
    while True:
        order = random.permutation(len(frames)) if augment else np.arange(len(frames))
        for start in range(0, len(order) - size + 1, size):
            some = [_sample(frames[i], random, augment) for i in order[start : start + size]]
            yield Batch(*(torch.from_numpy(np.stack(parts)) for parts in zip(*some, strict=True)))
        if not augment:
            return


def ahead(source: Iterator[Batch], count: int = 3) -> Iterator[Batch]:
    """Prepare batches in a thread, so that none has to be waited for."""
    waiting: queue.Queue[Batch | None] = queue.Queue(count)

    def prepare() -> None:
        for batch in source:
            waiting.put(batch)
        waiting.put(None)

    threading.Thread(target=prepare, daemon=True).start()
    while (batch := waiting.get()) is not None:
        yield batch


def _sample(
    frame: Frame, random: np.random.Generator, augment: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    blur = frame.blur.astype(np.float32) * np.float32(BLUR_STEP)
    blur[frame.blur == 0] = np.nan  # seams between two surfaces
    volume, sizes = frame.volume.astype(np.float32), frame.sizes_px
    if augment:
        volume, sizes = _fewer_levels(volume, sizes, blur, random)
    costs, texture, cells = looked_at(frame, volume, sizes)
    truth = np.full((cells.rows * CELL_PX, cells.columns * CELL_PX), np.nan, np.float32)
    truth[-cells.top :, -cells.left :][: blur.shape[0], : blur.shape[1]] = blur
    # One pixel of each quarter of a half-cell.
    down, right = random.integers(2, size=2)
    if augment and random.random() < 0.75:
        costs, texture, truth, (down, right) = _turned(costs, texture, truth, random)
    truth = truth[down::2, right::2]
    costs, texture = (_padded(values, n * _CELLS) for values, n in ((costs, 1), (texture, 2)))
    truth = np.abs(truth)
    return costs, texture, tried_sizes(sizes), _padded(truth, 4 * _CELLS, np.nan)


def looked_at(
    frame: Frame, volume: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Cells]:
    """Return the features of a frame's costs and of the frame, and the cells."""
    grey = frame.light.astype(np.float32) * np.float32(LIGHT_STEP)
    cells = Cells.covering(grey.shape, PatchGrid.covering(grey.shape, frame.window_px, STRIDE_PX))
    misfit = frame.misfit.astype(np.float32)
    brightness = brightness_at(grey, cells.grid)
    costs = cost_features(volume, misfit, brightness, grey, frame.noise, cells, sizes)
    return costs, frame_features(grey, frame.noise, cells), cells


def _padded(values: np.ndarray, side: int, value: float | None = None) -> np.ndarray:
    """Pad the last two axes to a common size, for batches: by the outermost values, or by one."""
    margins = [(0, 0)] * (values.ndim - 2) + [(0, side - length) for length in values.shape[-2:]]
    if value is None:
        return np.pad(values, margins, mode="edge")
    return np.pad(values, margins, constant_values=value)


# Windows of different sizes give different numbers of cells, at most so many.
_CELLS = 40


def _fewer_levels(
    volume: np.ndarray, sizes: np.ndarray, blur: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Leave out levels beyond what the scene has, as banks for a depth range do."""
    low, high = np.nanmin(blur), np.nanmax(blur)
    ends = np.array([low, high]) + random.exponential(1.0, 2) * [-1, 1]
    if random.random() < 0.3:
        ends += [-8, 8]
    keep = (sizes >= min(ends[0], low - 0.3)) & (sizes <= max(ends[1], high + 0.3))
    if keep.sum() < 8:
        return volume, sizes
    volume = volume[..., keep]
    return volume - volume.min(axis=-1, keepdims=True), sizes[keep]


def _turned(
    costs: np.ndarray, texture: np.ndarray, truth: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[int, int]]:
    """Mirror and turn by a right angle; the channels of the texture are pixels, which turn too."""
    side = int(np.sqrt(len(texture)))
    squares = texture.reshape(side, side, *texture.shape[1:]).transpose(2, 0, 3, 1)
    whole = squares.reshape(texture.shape[1] * side, -1)
    flip, turns = random.random() < 0.5, int(random.integers(4))

    def turn(values: np.ndarray) -> np.ndarray:
        values = values[..., ::-1] if flip else values
        return np.ascontiguousarray(np.rot90(values, turns, axes=(-2, -1)))

    costs, whole, truth = turn(costs), turn(whole), turn(truth)
    rows, columns = (length // side for length in whole.shape)
    squares = whole.reshape(rows, side, columns, side).transpose(1, 3, 0, 2)
    texture = np.ascontiguousarray(squares.reshape(side * side, rows, columns))
    return costs, texture, truth, tuple(random.integers(2, size=2))
