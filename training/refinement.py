"""The refinement of depth, and the large network that teaches it."""

import copy
import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from calibration import calibration_arrays, confidence_calibration, deviation_calibration
from costs import CELLS, COSTS, on_all_cells
from loop import (
    Problem,
    Schedule,
    averaged_weights,
    check_enough,
    device_of,
    on_device,
    shuffled,
    turned,
)
from networks import fold, load_folded, onnx_weights, recording, renormalise, round_weights, to_onnx
from places import frame_places
from refinement_loss import Batch, divergence, true_losses, weighted_sum
from refinement_network import BINS, Refinement, large_network
from scenes import BLUR_STEP, FIRST_RARE_SHARD, SCENES
from shards import Arrays
from task import Options, Task
from weights_file import package_weights, read_weights

from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network import network as package
from coded_aperture_ros.depth.decoders.network.cells import CELL_PX
from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_SIZES_PX,
    COST_CHANNELS,
    FRAME_CELL_PX,
    SCALARS,
)
from coded_aperture_ros.depth.decoders.network.probabilities import HalfCells

_BATCH = 8
# Cells a side of what is learned from at a time: a part of each frame.
_PART = 36
_RATE = 2e-3
_FURTHER_RATE = 6e-4
# What passes through the network that is fitted on is learned from so many batches.
_RENORMALISED_BATCHES = 24
# What the truth counts beside the teacher, who says as well what else it might be.
_TRUTH_SHARE = 0.5
# Of the weights before, in an average with those that were fitted further from them.
_FORMER_SHARE = 0.3
# Sizes that are written into the file; OpenCV takes others, too.
_ROWS = 64
_COLUMNS = 84
_LEVELS = 30
# One frame in so many of a few shards tells the ranges of the layers as well.
_QUANTISED_EVERY = 3
_QUANTISED_SHARDS = 4
# Least tolerance, px: its logarithm must be finite.
_LEAST_PX = 1e-3


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


def load_frames(folder: Path, shards: tuple[int, ...], least_told: float = 0.0) -> list[Frame]:
    """Frames of the shards that are there of which at least a share is told by the costs."""
    frames = []
    for shard in shards:
        if not (COSTS.exists(folder, shard) and SCENES.exists(folder, shard)):
            continue
        scenes, costs = SCENES.read(folder, shard), COSTS.read(folder, shard)
        for index in np.flatnonzero(costs["told"] >= least_told):
            frames.append(
                Frame(
                    costs["costs"][index],
                    costs["frame"][index],
                    costs["tried"][index],
                    scenes["blur"][index],
                    costs["corner"][index],
                    float(scenes["infinity"][index]),
                    shard >= FIRST_RARE_SHARD,
                )
            )
    return frames


def _sample(frame: Frame, random: np.random.Generator, augment: bool) -> tuple[np.ndarray, ...]:
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
        np.float32(frame.rare),
    )


def _batch(frames: list[Frame], random: np.random.Generator, augment: bool) -> Batch:
    samples = [_sample(frame, random, augment) for frame in frames]
    return Batch(*(torch.from_numpy(np.stack(parts)) for parts in zip(*samples, strict=True)))


def batches(frames: list[Frame], seed: int) -> Iterator[Batch]:
    """Batches of parts of all frames in random order, turned at random, without an end."""
    random = np.random.default_rng(seed)
    for some in shuffled(frames, _BATCH, random):
        yield _batch(some, random, augment=True)


class RefinementTask(Task):
    """Fit the network that ships: by the truth, and by the teacher if there is one."""

    module = package

    def problem(self, options: Options) -> Problem:
        frames = load_frames(options.folder, options.shards, options.least_told)
        held_back = load_frames(options.folder, options.held_back)
        check_enough(frames, held_back, _BATCH, _BATCH)
        network = self._new_network()
        if options.further:
            network = shipped_network(options.further).to(options.device)
            some = itertools.islice(batches(frames, 0), _RENORMALISED_BATCHES)
            some = (on_device(batch, options.device) for batch in some)
            renormalise(network, ((batch.costs, batch.frame) for batch in some))
        rate = options.rate or (_FURTHER_RATE if options.further else _RATE)
        schedule = Schedule(options.minutes, rate, warm_steps=100, decay=1e-2, largest_gradient=2.0)
        loss = _Loss(self._teacher(network, options), only_ordinary=options.further is not None)
        return Problem(
            network,
            schedule,
            lambda seed: batches(frames, seed),
            loss,
            lambda average: _score(average, held_back),
        )

    def _new_network(self) -> Refinement:
        return Refinement()

    def _teacher(self, network: Refinement, options: Options) -> Refinement | None:
        if options.truth_only:
            return None
        if options.further:  # learns what it found before
            return copy.deepcopy(network).eval()
        path = options.folder / "state" / "teacher.pt"
        if not path.exists():
            print(f"{path}: no such file, so the truth alone is learned from", flush=True)
            return None
        teacher = large_network().to(memory_format=torch.channels_last).eval()
        teacher.load_state_dict(averaged_weights(path))
        return teacher.to(options.device)

    def arrays(self, weights: dict[str, torch.Tensor], options: Options) -> dict[str, Any]:
        network = Refinement()
        network.load_state_dict(weights)
        fold(network)
        if options.further:
            former = shipped_network(options.further)
            fold(former)
            for parameter, other in zip(network.parameters(), former.parameters(), strict=True):
                parameter.data.lerp_(other.data, _FORMER_SHARE)
        round_weights(network)
        return network_arrays(network)

    def quantisation_inputs(self, options: Options) -> dict[str, list[Arrays]]:
        inputs: dict[str, list[Arrays]] = {"levels": [], "cells": []}
        frames = load_frames(options.folder, options.shards[:_QUANTISED_SHARDS])
        for frame in frames[::_QUANTISED_EVERY]:
            network = package.Network(frame.tried, Workers(), "opencv")
            network.level_network = recording(network.level_network, inputs["levels"])
            network.cell_network = recording(network.cell_network, inputs["cells"])
            frame.run(network)
        return inputs

    def calibration(self, options: Options) -> dict[str, Any]:
        frames = load_frames(options.folder, options.held_back)
        check_enough(frames, frames, 1, 1)
        places = frame_places(options.weights, options.folder, options.frames, options.processes)
        calibration = confidence_calibration(places)
        with package_weights(options.weights, package):
            found = [frame_errors(frame) for frame in frames]
        return calibration_arrays(deviation_calibration(found, calibration))


class TeacherTask(RefinementTask):
    """Fit the large network, by the truth alone; it does not ship."""

    def _new_network(self) -> Refinement:
        return large_network()

    def _teacher(self, network: Refinement, options: Options) -> Refinement | None:
        return None


@dataclasses.dataclass(frozen=True, eq=False)
class _Loss:
    """What the network gets wrong, against the truth and, if there is one, a teacher.

    A network that ships knows nothing of what is rare: with `only_ordinary` the truth counts alone
    in rare frames.
    """

    teacher: Refinement | None
    only_ordinary: bool

    def __call__(
        self, network: torch.nn.Module, batch: Batch
    ) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        given = (
            batch.costs.contiguous(memory_format=torch.channels_last),
            batch.frame.contiguous(memory_format=torch.channels_last),
        )
        outputs = network(*given)
        quarters, counted = batch.true_quarters()
        if self.teacher is None:
            parts = true_losses(outputs, batch, quarters, counted)
            return weighted_sum(parts), parts
        taught = 1 - batch.rare if self.only_ordinary else torch.ones_like(batch.rare)
        taught = taught.view(-1, 1, 1, 1)
        of_truth = 1 - taught * (1 - _TRUTH_SHARE)
        parts = true_losses(outputs, batch, quarters, counted * of_truth)
        with torch.no_grad():
            of_teacher = self.teacher(*given)
        parts["taught"] = divergence(outputs, of_teacher, batch, counted * taught)
        return of_truth.mean() * weighted_sum(parts) + taught.mean() * parts["taught"], parts


def _score(network: torch.nn.Module, frames: list[Frame]) -> dict[str, float]:
    """Mean losses of frames that are not learned from."""
    random = np.random.default_rng(0)
    sums: dict[str, float] = {}
    starts = range(0, len(frames) - _BATCH + 1, _BATCH)
    device = device_of(network)
    with torch.no_grad():
        for start in starts:
            batch = _batch(frames[start : start + _BATCH], random, augment=False)
            batch = on_device(batch, device)
            outputs = network(batch.costs, batch.frame)
            for name, value in true_losses(outputs, batch, *batch.true_quarters()).items():
                sums[name] = sums.get(name, 0.0) + float(value)
    return {name: round(value / len(starts), 4) for name, value in sums.items()}


def network_arrays(network: Refinement) -> dict[str, Any]:
    """Arrays of the weights' file, of a network whose normalisations are folded."""
    first = network.every_level.layers.first
    of_level = torch.zeros(_LEVELS, first.out_channels, _ROWS // 2, _COLUMNS // 2)
    of_cells = {
        "costs": torch.zeros(1, COST_CHANNELS + SCALARS, _ROWS, _COLUMNS),
        "frame": torch.zeros(1, FRAME_CELL_PX**2, 2 * _ROWS, 2 * _COLUMNS),
        "levels": torch.zeros(1, BINS, _ROWS, _COLUMNS),
    }
    arrays = {
        "levels_onnx": to_onnx(_AfterFirst(network), {"levels": of_level}, "found"),
        "cells_onnx": to_onnx(_Trunk(network), of_cells, "cells"),
        "trust": network.trust.detach().numpy(),
    }
    for name, layer in (("first", first), ("size", network.size), ("choice", network.choice)):
        arrays[f"{name}_weights"] = layer.weight.detach().numpy()[:, :, 0, 0]
        arrays[f"{name}_bias"] = layer.bias.detach().numpy()
    return arrays


def shipped_network(path: Path) -> Refinement:
    """Network of a weights' file in the form in which it can be fitted further."""
    arrays = read_weights(path, package)
    weights: Arrays = {"trust": arrays["trust"]}
    # Of the modules that were written, and where they are in the network.
    for model, prefix, place in (
        ("levels_onnx", "layers.", "every_level.layers."),
        ("cells_onnx", "network.", ""),
    ):
        for name, value in onnx_weights(arrays[model]).items():
            if name.startswith(prefix):
                weights[place + name.removeprefix(prefix)] = value
    layers = {"first": "every_level.layers.first", "size": "size", "choice": "choice"}
    for name, layer in layers.items():
        weights[f"{layer}.weight"] = arrays[f"{name}_weights"][:, :, None, None]
        weights[f"{layer}.bias"] = arrays[f"{name}_bias"]
    network = Refinement()
    load_folded(network, weights)
    return network


def frame_errors(frame: Frame) -> Arrays:
    """What is found of every half-cell of a frame, and how wrong it is, px.

    `features` of the confidence; the `tolerance`, which is 5 % of the depth; the `error` of the
    blur size, and its `deviation` without calibration.
    """
    logits = frame.run(package.Network(frame.tried, Workers()))
    found = HalfCells.from_logits(logits, BLUR_SIZES_PX[frame.tried].astype(np.float32))
    truth = frame.true_blur_px()[2::4, 2::4]
    tolerance = 0.05 * np.abs(frame.infinity_px - np.sign(truth) * found.size_px)
    known = np.maximum(np.nan_to_num(tolerance), _LEAST_PX).astype(np.float32)
    arrays = {
        "features": found.confidence_features(known),
        "tolerance": tolerance,
        "error": np.abs(found.size_px - np.abs(truth)),
        "deviation": found.deviation_px(),
    }
    return {name: values[..., np.isfinite(truth)] for name, values in arrays.items()}


class _AfterFirst(torch.nn.Module):
    """What is done to every blur size, but for the first layer."""

    def __init__(self, network: Refinement) -> None:
        super().__init__()
        self.layers = network.every_level.layers

    def forward(self, first: torch.Tensor) -> torch.Tensor:
        found: torch.Tensor = self.layers.after_first(first)
        return found


class _Trunk(torch.nn.Module):
    """All but the last layer."""

    def __init__(self, network: Refinement) -> None:
        super().__init__()
        self.network = network

    def forward(
        self, costs: torch.Tensor, frame: torch.Tensor, levels: torch.Tensor
    ) -> torch.Tensor:
        return self.network.trunk(costs, frame, levels)
