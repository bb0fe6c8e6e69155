"""A bank with a refinement that was fitted further to its PSFs, if that finds more."""

import dataclasses
import itertools
import pickle
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from coded_aperture_ros.calibration.fine_tuning.frames import BATCH, Frame, batches, score
from coded_aperture_ros.calibration.fine_tuning.loop import Fit, Problem, Schedule, on_device
from coded_aperture_ros.calibration.fine_tuning.loss import Batch, true_losses, weighted_sum
from coded_aperture_ros.calibration.fine_tuning.network import Refinement
from coded_aperture_ros.calibration.fine_tuning.onnx_form import fold, renormalise, round_weights
from coded_aperture_ros.calibration.fine_tuning.simulated import claim, made_frames
from coded_aperture_ros.calibration.fine_tuning.weights import network_arrays, network_of_arrays
from coded_aperture_ros.calibration.psf.nominal import measured_reliability
from coded_aperture_ros.calibration.psf.simulated import is_right, simulated_frames
from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.decoders.network import choose_decoder
from coded_aperture_ros.depth.decoders.network import network as package
from coded_aperture_ros.depth.decoders.regularize import LEARNED
from coded_aperture_ros.likelihood.bank import FilterBank

# Scenes that both ways are compared on. Those that the confidence is measured on, and that are
# learned from, have other numbers.
COMPARED_SCENES = range(1000, 1012)
# Of the minutes, what scenes are made in.
_DATA_SHARE = 0.45
# One scene in so many is only scored.
_HELD_BACK_EVERY = 12
_RATE = 8e-4
_RENORMALISED_BATCHES = 12
# Least gain, share of the pixels, for which new weights are kept.
LEAST_GAIN = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class Tuned:
    """What came of it.

    Attributes
    ----------
    bank : FilterBank
        With its own refinement, or as it was if that gains nothing.
    before, after : float
        Share of the pixels of simulated scenes, kept apart, whose level is right: to one level or,
        where depths are known, 5 % of the depth.
    frames, steps : int
        What was learned from, and how often.
    """

    bank: FilterBank
    before: float
    after: float
    frames: int
    steps: int

    @property
    def gains(self) -> bool:
        """Whether the new weights are worth keeping."""
        return self.after >= self.before + LEAST_GAIN


def tune_refinement(
    bank: FilterBank,
    minutes: float,
    folder: Path,
    *,
    device: str = "cpu",
    say: Callable[[str], None] = lambda _: None,
    progress: Progress = iter,
) -> Tuned:
    """Fit the refinement further to frames that are simulated with a bank's PSFs.

    Parameters
    ----------
    bank : FilterBank
        The refinement supports it.
    minutes : float
        Nearly half of it for simulating frames, the rest for fitting; with what was spent before if
        the folder is there.
    folder : Path
        Of the frames and of what was reached; it goes on from them.
    device : str
        That fits: `cpu`, or `cuda`.
    say : callable
        Called with a line, about once in a minute.
    progress : callable, optional
        Progress callback around the iterations over the scenes that are measured.

    Raises
    ------
    InputError
        If the bank is not supported, the device is not there, or the folder is of another bank.
    """
    reason = choose_decoder(bank, LEARNED, bank.stride_px).reason
    if reason:
        raise InputError(f"--train: the refinement cannot be fitted to this bank: {reason}")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: PyTorch sees no GPU here: use --device cpu")
    claim(folder, bank)
    frames = list(made_frames(bank, 60 * minutes * _DATA_SHARE, folder, say))
    fit = _fit(frames, minutes * (1 - _DATA_SHARE), folder / "fit.pt", device, say)
    fitted = Refinement()
    fitted.load_state_dict(fit.averaged_weights)
    fold(fitted)
    round_weights(fitted)
    # What is calibrated stays, on which the bank's own reliability is put.
    left_out = ("schema", "levels_int8", "cells_int8")
    kept = {name: each for name, each in shipped_weights().items() if not name.startswith(left_out)}
    tuned = dataclasses.replace(bank, refinement=kept | network_arrays(fitted))
    before, after = (right_share(one, progress) for one in (bank, tuned))
    found = Tuned(bank, before, after, len(frames), fit.steps)
    if not found.gains:
        return found
    tuned = dataclasses.replace(tuned, reliability=measured_reliability(tuned, progress))
    return dataclasses.replace(found, bank=tuned)


def shipped_weights() -> Mapping[str, Any]:
    """Arrays of the refinement that ships."""
    return read_shipped(package.__file__, package.WEIGHTS, package.SCHEMA, package.SCHEMA_VERSION)


def right_share(bank: FilterBank, progress: Progress = iter) -> float:
    """Share of the pixels of simulated scenes whose level a bank finds right; all are judged."""
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0, check_fit=False))
    right = []
    for seed in progress(COMPARED_SCENES):
        for frame, level in simulated_frames(bank, seed):
            found = estimator.estimate(frame).level
            right.append(is_right(bank.stack, found, level).mean())
    estimator.close()
    return float(np.mean(right))


def _fit(
    frames: Sequence[Frame], minutes: float, state: Path, device: str, say: Callable[[str], None]
) -> Fit:
    """Fit the refinement that ships to frames; one scene in some is only scored."""
    learned = [frame for index, frame in enumerate(frames) if index % _HELD_BACK_EVERY > 1]
    held_back = [frame for index, frame in enumerate(frames) if index % _HELD_BACK_EVERY <= 1]
    if min(len(learned), len(held_back)) < BATCH:
        raise InputError(f"--train: {len(frames)} frames are too few: give it more minutes")
    network = network_of_arrays(shipped_weights()).to(device)
    some = itertools.islice(batches(learned, 0), _RENORMALISED_BATCHES)
    given = (on_device((batch.costs, batch.frame), device) for batch in some)
    renormalise(network, given)
    problem = Problem(
        network,
        Schedule(minutes, _RATE, 50, decay=1e-2, largest_gradient=2.0, average=0.995),
        lambda seed: batches(learned, seed),
        _loss,
        lambda average: score(average, held_back),
        say,
    )
    try:
        fit = Fit(problem, state, device=device)
    except (RuntimeError, KeyError, pickle.UnpicklingError) as error:
        raise InputError(f"{state}: no state of a training: remove it to begin anew") from error
    fit.run()
    return fit


def _loss(network: torch.nn.Module, batch: Batch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    outputs = network(
        batch.costs.contiguous(memory_format=torch.channels_last),
        batch.frame.contiguous(memory_format=torch.channels_last),
    )
    parts = true_losses(outputs, batch, *batch.true_quarters())
    return weighted_sum(parts), parts
