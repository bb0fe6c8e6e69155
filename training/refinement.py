"""The refinement of depth, and the large network that teaches it."""

import copy
import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import torch
from calibration import calibration_arrays, confidence_calibration, deviation_calibration
from costs import COSTS
from networks import recording
from places import frame_places
from scenes import FIRST_RARE_SHARD, SCENES
from shards import Arrays
from states import averaged_weights, check_enough
from task import Options, Task
from weights_file import read_weights

from coded_aperture_ros.calibration.fine_tuning.frames import BATCH, Frame, batches, score
from coded_aperture_ros.calibration.fine_tuning.loop import Problem, Schedule, on_device
from coded_aperture_ros.calibration.fine_tuning.loss import (
    Batch,
    divergence,
    true_losses,
    weighted_sum,
)
from coded_aperture_ros.calibration.fine_tuning.network import Refinement, large_network
from coded_aperture_ros.calibration.fine_tuning.onnx_form import fold, renormalise, round_weights
from coded_aperture_ros.calibration.fine_tuning.weights import network_arrays, network_of_arrays
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network import network as package

_RATE = 2e-3
_FURTHER_RATE = 6e-4
# What passes through the network that is fitted on is learned from so many batches.
_RENORMALISED_BATCHES = 24
# What the truth counts beside the teacher, who says as well what else it might be.
_TRUTH_SHARE = 0.5
# Of the weights before, in an average with those that were fitted further from them.
_FORMER_SHARE = 0.3
# One frame in so many of a few shards tells the ranges of the layers as well.
_QUANTISED_EVERY = 3
_QUANTISED_SHARDS = 4


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


class RefinementTask(Task):
    """Fit the network that ships: by the truth, and by the teacher if there is one."""

    module = package

    def problem(self, options: Options) -> Problem:
        frames = load_frames(options.folder, options.shards, options.least_told)
        held_back = load_frames(options.folder, options.held_back)
        check_enough(frames, held_back, BATCH, BATCH)
        network = self._new_network()
        if options.further:
            network = network_of_arrays(read_weights(options.further, package)).to(options.device)
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
            lambda average: score(average, held_back),
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
            former = network_of_arrays(read_weights(options.further, package))
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
        places = frame_places(options.weights, options.folder, options.frames, options.processes)
        former = package.Calibration.from_weights(read_weights(options.weights, package)).deviation
        calibration = confidence_calibration(places)
        return calibration_arrays(deviation_calibration(places, calibration, former))


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
