"""Frames as the refinement is given them, with their true blur sizes, and batches of them."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from coded_aperture_ros.calibration.fine_tuning.cells import BLUR_STEP, CELLS, on_all_cells
from coded_aperture_ros.calibration.fine_tuning.loop import device_of, on_device, shuffled, turned
from coded_aperture_ros.calibration.fine_tuning.loss import Batch, true_losses
from coded_aperture_ros.depth.decoders.network import network as package
from coded_aperture_ros.depth.decoders.network.cells import CELL_PX
from coded_aperture_ros.depth.decoders.network.features import FRAME_CELL_PX

BATCH = 8
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
    corner : ndarray, int [2]
        First row and column of the cells; 0 or less.
    infinity_px : float
        Blur size of what is infinitely far.
    rare : bool
        See `scenes.scene_plan`.
    """

    costs: np.ndarray
    frame: np.ndarray
    tried: np.ndarray
    blur: np.ndarray
    corner: np.ndarray
    infinity_px: float
    rare: bool

    def true_blur_px(self) -> np.ndarray:
        """Signed blur size at every pixel of the cells; NaN where it is not known."""
        blur = self.blur * np.float32(BLUR_STEP)
        blur[self.blur == 0] = np.nan
        return on_all_cells(blur, self.corner, np.nan)

    def run(self, network: package.Network) -> package.Logits:
        """What a network of the package says of the frame."""
        return network(self.costs.astype(np.float32), self.frame.astype(np.float32))


def _sample(frame: Frame, random: np.random.Generator, augment: bool) -> tuple[NDArray[Any], ...]:
    """Arrays of a `Batch`, of one frame; a random part of it, turned at random, if `augment`."""
    down, right = random.integers(CELLS - _PART + 1, size=2) if augment else (0, 0)

    def part(values: np.ndarray, per_cell: int) -> np.ndarray:
        top, left, size = per_cell * down, per_cell * right, per_cell * _PART
        return values[..., top : top + size, left : left + size]

    costs, texture = part(frame.costs, 1), part(frame.frame, 2)
    truth = part(np.abs(frame.true_blur_px()), CELL_PX)
    if augment:
        flip, turns = random.random() < 0.5, int(random.integers(4))
        costs, truth = (turned(values, flip, turns) for values in (costs, truth))
        texture = turned(texture, flip, turns, FRAME_CELL_PX)
    # One pixel of each quarter of a half-cell.
    down, right = random.integers(2, size=2)
    return (
        costs.astype(np.float32),
        texture.astype(np.float32),
        frame.tried,
        truth[down::2, right::2].copy(),
        np.array(frame.rare, np.float32),
    )


def batch_of(frames: list[Frame], random: np.random.Generator, augment: bool) -> Batch:
    """Batch of frames, or of random parts of them if `augment`."""
    samples = [_sample(frame, random, augment) for frame in frames]
    return Batch(*(torch.from_numpy(np.stack(parts)) for parts in zip(*samples, strict=True)))


def batches(frames: list[Frame], seed: int) -> Iterator[Batch]:
    """Batches of parts of all frames in random order, turned at random, without an end."""
    random = np.random.default_rng(seed)
    for some in shuffled(frames, BATCH, random):
        yield batch_of(some, random, augment=True)


def score(network: torch.nn.Module, frames: list[Frame]) -> dict[str, float]:
    """Mean losses of frames that are not learned from."""
    random = np.random.default_rng(0)
    sums: dict[str, float] = {}
    starts = range(0, len(frames) - BATCH + 1, BATCH)
    device = device_of(network)
    with torch.no_grad():
        for start in starts:
            batch = batch_of(frames[start : start + BATCH], random, augment=False)
            batch = on_device(batch, device)
            outputs = network(batch.costs, batch.frame)
            for name, value in true_losses(outputs, batch, *batch.true_quarters()).items():
                sums[name] = sums.get(name, 0.0) + float(value)
    return {name: round(value / len(starts), 4) for name, value in sums.items()}
