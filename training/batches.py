"""Batches for learning: what the network is shown, and the truth at half-cells."""

import dataclasses
import queue
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from costs import CELLS
from scenes import BLUR_STEP, FIRST_RARE_SHARD, FRAMES_PER_SHARD

from coded_aperture_ros.depth.decoders.network.cells import CELL_PX

# Cells a side of what is learned from at a time: a part of each frame.
_PART = 36


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """One frame as it is kept in memory.

    Attributes
    ----------
    costs, frame : ndarray, float16 [channels, rows, columns]
        See `cost_features` and `frame_features`.
    tried : ndarray, bool [blur sizes]
    blur : ndarray, int16 [height, width]
        True blur size in steps of `BLUR_STEP`; 0 if it is not known.
    corner : (int, int)
        First row and column of the cells; 0 or less.
    infinity_px : float
        Blur size of what is infinitely far.
    rare : bool
        See `scenes.drawn`.
    """

    costs: np.ndarray
    frame: np.ndarray
    tried: np.ndarray
    blur: np.ndarray
    corner: tuple[int, int]
    infinity_px: float
    rare: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Tensors of some frames: what the network takes, where levels were tried, and the truth.

    `rare` [batch] says which are, 0 or 1.
    """

    costs: torch.Tensor
    frame: torch.Tensor
    tried: torch.Tensor
    blur_px: torch.Tensor
    rare: torch.Tensor


def load(scenes: Path, costs: Path, shards: list[int], least_told: float = 0.0) -> list[Frame]:
    """Read the shards that are there; frames of which at least a share is told by the costs."""
    frames = []
    for shard in shards:
        paths = scenes / f"scenes_{shard:04d}.npz", costs / f"costs_{shard:04d}.npz"
        if not all(path.exists() for path in paths):
            continue
        truth, shown = (dict(np.load(path)) for path in paths)
        for index in range(FRAMES_PER_SHARD):
            if shown["told"][index] < least_told:
                continue
            frames.append(
                Frame(
                    shown["costs"][index],
                    shown["frame"][index],
                    shown["tried"][index],
                    truth["blur"][index],
                    tuple(shown["corner"][index].tolist()),
                    float(truth["infinity"][index]),
                    shard >= FIRST_RARE_SHARD,
                )
            )
    return frames


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
        try:
            for batch in source:
                waiting.put(batch)
        finally:
            waiting.put(None)

    threading.Thread(target=prepare, daemon=True).start()
    while (batch := waiting.get()) is not None:
        yield batch


def true_blur_px(frame: Frame) -> np.ndarray:
    """Return the signed blur size at every pixel of the cells; NaN where it is not known."""
    blur = frame.blur * np.float32(BLUR_STEP)
    blur[frame.blur == 0] = np.nan
    whole = np.full((CELLS * CELL_PX,) * 2, np.nan, np.float32)
    top, left = frame.corner
    whole[-top:, -left:][: blur.shape[0], : blur.shape[1]] = blur
    return whole


def _sample(frame: Frame, random: np.random.Generator, augment: bool) -> tuple[np.ndarray, ...]:
    costs, texture, truth = frame.costs, frame.frame, np.abs(true_blur_px(frame))
    down, right = random.integers(CELLS - _PART + 1, size=2) if augment else (0, 0)
    costs, texture, truth = (
        values[..., n * down : n * (down + _PART), n * right : n * (right + _PART)]
        for values, n in ((costs, 1), (texture, 2), (truth, CELL_PX))
    )
    if augment:
        costs, texture, truth = _turned(costs, texture, truth, random)
    # One pixel of each quarter of a half-cell.
    down, right = random.integers(2, size=2)
    return (
        costs.astype(np.float32),
        texture.astype(np.float32),
        frame.tried,
        truth[down::2, right::2].copy(),
        np.float32(frame.rare),
    )


def _turned(
    costs: np.ndarray, texture: np.ndarray, truth: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    return costs, squares.reshape(side * side, rows, columns), truth
