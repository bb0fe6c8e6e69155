"""Fit the refinement network; goes on where it was stopped.

python training/fit.py --scenes DIR --costs DIR --output DIR --minutes 60 --large
python training/fit.py --scenes DIR --costs DIR --output DIR2 --minutes 60 --teacher DIR/state.pt
python training/fit.py --scenes DIR --costs DIR --output DIR --minutes 60 --rate 5e-4 \
    --shipped coded_aperture_ros/depth/decoders/network/refinement.npz
"""

import argparse
import copy
import dataclasses
import itertools
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from batches import Batch, ahead, batches, load
from network import BINS, NEIGHBOURS, Refinement
from shards import shards_of
from shipped import normalised, shipped
from teacher import teacher as large_network
from torch.nn import functional

from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_SIZES_PX,
    BLUR_STEP_PX,
    LARGEST_PX,
)
from coded_aperture_ros.depth.decoders.network.probabilities import REACH

_BATCH = 8
_AVERAGE = 0.998
_REPORT_S, _SAVE_S = 60, 300
_UNTRIED = -1e4
# What passes through the network that ships is learned from so many batches.
_NORMALISE = 24
# What the truth counts beside the teacher, who says as well what else it might be.
_OF_TRUTH = 0.5
_RIGHT_PX = 1.5
# Narrow things before something at least so much more or less blurred count more: a network that
# is right for most pixels would leave them out, and they are what a robot runs into. The side of
# what they fit into, in squares of 2 px.
_MORE_FOR_NARROW, _APART_PX, _NARROW = 4.0, 1.0, 13


def blur_sizes(logits: torch.Tensor) -> torch.Tensor:
    """Return the mean blur size around the likeliest [batch, rows, columns]."""
    sizes = torch.from_numpy(BLUR_SIZES_PX).float()
    best = logits.argmax(1, keepdim=True)
    around = (best + torch.arange(-REACH, REACH + 1).view(1, -1, 1, 1)).clamp(0, BINS - 1)
    near = torch.gather(logits, 1, around)
    return (functional.softmax(near, 1) * sizes[around]).sum(1)


def narrow(blur_px: torch.Tensor, known: torch.Tensor, near: torch.Tensor) -> torch.Tensor:
    """Return where something narrow is before something more distant, 0 or 1.

    Takes and gives quarters of half-cells [batch, 4, rows, columns]; `near` as `cost_features` has
    it. What is narrow is what a morphological closing of the distance takes away.
    """
    away = functional.pixel_shuffle(blur_px * (1 - 2 * near.view(-1, 1, 1, 1)), 2)
    known = functional.pixel_shuffle(known.float(), 2) > 0
    closed = -_widened(-_widened(away.masked_fill(~known, -LARGEST_PX)))
    return functional.pixel_unshuffle((closed - away > _APART_PX).float(), 2)


def _widened(values: torch.Tensor) -> torch.Tensor:
    down = functional.max_pool2d(values, (_NARROW, 1), 1, (_NARROW // 2, 0))
    return functional.max_pool2d(down, (1, _NARROW), 1, (0, _NARROW // 2))


def true_quarters(batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
    """Return true blur sizes and how much they count, quarters [batch, 4, rows, columns]."""
    truth = torch.nan_to_num(batch.blur_px).clamp(0, LARGEST_PX - 1e-3)
    quarters = functional.pixel_unshuffle(truth[:, None], 2)
    known = torch.isfinite(batch.blur_px)
    counted = functional.pixel_unshuffle(known[:, None].float(), 2)
    of_narrow = narrow(quarters, counted > 0, batch.costs[:, -1, 0, 0])
    return quarters, counted * (1 + _MORE_FOR_NARROW * of_narrow)


def losses(
    size: torch.Tensor,
    choice: torch.Tensor,
    batch: Batch,
    quarters: torch.Tensor,
    counted: torch.Tensor,
) -> dict[str, torch.Tensor]:
    """Return what the network got wrong: blur sizes, their spread, and the choice of half-cells."""
    logits = size[:, :BINS].masked_fill(~batch.tried[:, :, None, None], _UNTRIED)
    log_width = size[:, BINS].clamp(-5, 2)
    place = quarters / BLUR_STEP_PX
    below = place.floor()
    share = place - below
    log_p = functional.log_softmax(logits, 1)
    low = torch.gather(log_p, 1, below.long())
    high = torch.gather(log_p, 1, below.long() + 1)
    # Two-hot: a truth between two bins belongs to both; a bin that was not tried gives its share.
    low, high = (
        torch.where(part < _UNTRIED / 2, other, part) for part, other in ((low, high), (high, low))
    )
    crossed = -((1 - share) * low + share * high).clamp(min=-30)
    count = counted.sum().clamp(min=1)
    entropy = (crossed * counted).sum() / count

    found = blur_sizes(logits)
    error = (found[:, None] - quarters).abs()
    right = (error < _RIGHT_PX) * counted
    spread = (log_width[:, None] + error / log_width[:, None].exp()) * right
    spread = spread.sum() / count

    around = functional.unfold(
        functional.pad(found.detach()[:, None], (1, 1, 1, 1), "replicate"), 3
    )
    around = around.view(len(found), NEIGHBOURS, *found.shape[1:])
    weights = functional.log_softmax(choice.view(len(found), 4, NEIGHBOURS, *found.shape[1:]), 2)
    fit = -(around[:, None] - quarters[:, :, None]).abs().clamp(max=6) / 0.7
    chosen = -torch.logsumexp(weights + fit, 2)
    best = fit.amax(2)
    chosen = ((chosen + best) * counted).sum() / count
    within = ((error < 1.0) * counted).sum() / count
    return {"entropy": entropy, "spread": spread, "choice": chosen, "within_1px": within}


def total(parts: dict[str, torch.Tensor]) -> torch.Tensor:
    """Return the weighted sum of the losses."""
    return parts["entropy"] + 0.2 * parts["spread"] + 0.3 * parts["choice"]


def taught(
    size: torch.Tensor,
    choice: torch.Tensor,
    told: tuple[torch.Tensor, torch.Tensor],
    batch: Batch,
    counted: torch.Tensor,
) -> torch.Tensor:
    """Return the divergence from the probabilities that a teacher gives."""
    counted = counted.mean(1)
    counted = counted / counted.mean().clamp(min=1e-3)
    untried = ~batch.tried[:, :, None, None]
    log_p, log_q = (
        functional.log_softmax(values[:, :BINS].masked_fill(untried, _UNTRIED), 1)
        for values in (size, told[0])
    )
    of_size = ((log_q.exp() * (log_q - log_p)).sum(1) * counted).mean()
    log_p, log_q = (
        functional.log_softmax(values.unflatten(1, (4, NEIGHBOURS)), 2)
        for values in (choice, told[1])
    )
    of_choice = ((log_q.exp() * (log_q - log_p)).sum(2).mean(1) * counted).mean()
    return of_size + 0.3 * of_choice


def add_fit_options(parser: argparse.ArgumentParser, minutes: float, held: int) -> None:
    """Add what all scripts that fit a network have in common; `held` shards are only looked at."""
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=minutes)
    pairs = "first and last + 1; several such pairs, one after the other"
    parser.add_argument("--shards", type=int, nargs="+", default=(held, 400), help=pairs)
    parser.add_argument("--validate", type=int, nargs="+", default=(0, held), help=pairs)
    parser.add_argument("--start", type=Path, help="weights to start from")
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--threads", type=int, default=2)


def check_enough(
    learned: list, held: list, least: int, least_held: int, what: str = "frames"
) -> None:
    """Print how many frames there are; end the program if they are too few."""
    for use, some, needed in (
        ("learn from: --shards", learned, least),
        ("look at: --validate", held, least_held),
    ):
        if len(some) < needed:
            raise SystemExit(f"{len(some)} {what} to {use} needs at least {needed}")
    print(f"{len(learned)} {what} to learn from, {len(held)} to look at", flush=True)


@dataclasses.dataclass(frozen=True)
class Schedule:
    """How a network is fitted.

    Attributes
    ----------
    minutes : float
        How long, with what was spent before it was stopped.
    rate : float
        Of learning. It rises during the first steps, and falls to 0 in the end.
    warm_steps : int
    decay : float
        Of the weights.
    largest_gradient : float
        Norm to which larger ones are shortened.
    """

    minutes: float
    rate: float
    warm_steps: int
    decay: float
    largest_gradient: float

    def rate_at(self, step: int, progress: float) -> float:
        """Return the rate of a step, when a share of the time is spent."""
        warm = min(1.0, (step + 1) / self.warm_steps)
        return self.rate * warm * (0.5 + 0.5 * math.cos(math.pi * progress)) + 1e-6


class Fit:
    """A network that is fitted, and the running average of its weights, which is what is used.

    Parameters
    ----------
    network : torch.nn.Module
    how : Schedule
    folder : Path
        What was reached is kept in its `state.pt`. If that is there, fitting goes on from it.
    start : Path or None
        State of another fit, whose weights are started from.
    """

    def __init__(
        self, network: torch.nn.Module, how: Schedule, folder: Path, start: Path | None
    ) -> None:
        self.network = network.to(memory_format=torch.channels_last)
        self.average = copy.deepcopy(self.network)
        self.step = 0
        self._how = how
        self._spent_s = 0.0
        self._optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=how.rate, weight_decay=how.decay
        )
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / "state.pt"
        if start:
            self.network.load_state_dict(torch.load(start)["average"])
            self.average.load_state_dict(self.network.state_dict())
        if self._path.exists():
            self._go_on(torch.load(self._path))

    def run(
        self,
        batches: Iterator[Any],
        lost: Callable[[Any], tuple[torch.Tensor, dict[str, torch.Tensor]]],
        validated: Callable[[], dict[str, float]],
    ) -> None:
        """Fit until the time is spent; print what is lost, and save, every few minutes.

        Parameters
        ----------
        batches : iterator
            Without an end; they are prepared in another thread.
        lost : callable
            From a batch to what is minimised, and to what is printed.
        validated : callable
            Returns what is printed of frames that are not learned from.
        """
        started = time.perf_counter() - self._spent_s
        saved = reported = time.perf_counter()
        sums: dict[str, float] = {}
        since = 0
        for batch in ahead(batches):
            self._spent_s = time.perf_counter() - started
            progress = self._spent_s / (60 * self._how.minutes)
            if progress >= 1:
                break
            self.network.train()
            loss, parts = lost(batch)
            self._improve(loss, progress)
            for name, value in parts.items():
                sums[name] = sums.get(name, 0.0) + float(value.detach())
            since += 1
            now = time.perf_counter()
            if now - reported > _REPORT_S:
                means = " ".join(f"{name} {value / since:.4f}" for name, value in sums.items())
                print(f"{self._spent_s / 60:.1f} min, step {self.step}: {means}", flush=True)
                sums, since, reported = {}, 0, now
            if now - saved > _SAVE_S:
                self._save(validated)
                saved = time.perf_counter()
        self._save(validated)

    def _improve(self, loss: torch.Tensor, progress: float) -> None:
        """Take a step against the gradient."""
        for group in self._optimizer.param_groups:
            group["lr"] = self._how.rate_at(self.step, progress)
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self._how.largest_gradient)
        self._optimizer.step()
        self.step += 1
        keep = min(_AVERAGE, (self.step + 1) / (self.step + 20))
        with torch.no_grad():
            for mean, value in zip(
                self.average.state_dict().values(), self.network.state_dict().values(), strict=True
            ):
                if mean.is_floating_point():
                    mean.lerp_(value, 1 - keep)

    def _go_on(self, state: dict[str, Any]) -> None:
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self._optimizer.load_state_dict(state["optimizer"])
        self._spent_s, self.step = state["spent"], state["step"]

    def _save(self, validated: Callable[[], dict[str, float]]) -> None:
        part = self._path.with_suffix(".part")
        torch.save(
            {
                "network": self.network.state_dict(),
                "average": self.average.state_dict(),
                "optimizer": self._optimizer.state_dict(),
                "spent": self._spent_s,
                "step": self.step,
            },
            part,
        )
        part.rename(self._path)
        print("held out:", json.dumps(validated()), flush=True)


def main() -> None:
    """Fit, and keep what was reached every few minutes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, required=True)
    parser.add_argument("--costs", type=Path, required=True)
    add_fit_options(parser, minutes=60.0, held=4)
    parser.add_argument("--large", action="store_true", help="fit the teacher")
    parser.add_argument("--teacher", type=Path, help="state of a large network to learn from")
    parser.add_argument(
        "--shipped", type=Path, help="go on from this file, which teaches what is not rare"
    )
    parser.add_argument(
        "--truth-only", action="store_true", help="with --shipped: it does not teach"
    )
    parser.add_argument("--bfloat16", action="store_true", help="faster, not with --large")
    parser.add_argument("--least-told", type=float, default=0.0)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    frames = load(args.scenes, args.costs, shards_of(args.shards), args.least_told)
    held = load(args.scenes, args.costs, shards_of(args.validate))
    check_enough(frames, held, _BATCH, _BATCH)
    how = Schedule(args.minutes, args.rate, warm_steps=100, decay=1e-2, largest_gradient=2.0)
    network = large_network() if args.large else Refinement()
    teacher = None
    if args.shipped:
        network = shipped(args.shipped)
        normalised(network, itertools.islice(batches(frames, _BATCH, 0), _NORMALISE))
        teacher = None if args.truth_only else copy.deepcopy(network).eval()
    elif args.teacher:
        teacher = large_network().to(memory_format=torch.channels_last).eval()
        teacher.load_state_dict(torch.load(args.teacher)["average"])
    fit = Fit(network, how, args.output, args.start)

    def lost(batch: Batch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        shown = (
            batch.costs.contiguous(memory_format=torch.channels_last),
            batch.frame.contiguous(memory_format=torch.channels_last),
        )
        with torch.autocast("cpu", torch.bfloat16, enabled=args.bfloat16):
            size, choice = (found.float() for found in fit.network(*shown))
        quarters, counted = true_quarters(batch)
        if teacher is None:
            parts = losses(size, choice, batch, quarters, counted)
            return total(parts), parts
        # The network that ships knows nothing of what is rare: there, the truth counts alone.
        heard = (1 - batch.rare if args.shipped else torch.ones_like(batch.rare)).view(-1, 1, 1, 1)
        of_truth = 1 - heard * (1 - _OF_TRUTH)
        parts = losses(size, choice, batch, quarters, counted * of_truth)
        with torch.no_grad():
            told = teacher(*shown)
        parts["taught"] = taught(size, choice, told, batch, counted * heard)
        return of_truth.mean() * total(parts) + heard.mean() * parts["taught"], parts

    fit.run(batches(frames, _BATCH, fit.step + 1), lost, lambda: validated(fit.average, held))


def validated(network: Refinement, frames: list) -> dict[str, float]:
    """Return the mean losses on frames that are not learned from."""
    network.eval()
    sums: dict[str, float] = {}
    count = 0
    with torch.no_grad():
        for batch in batches(frames, _BATCH, 0, augment=False):
            found = network(batch.costs, batch.frame)
            for name, value in losses(*found, batch, *true_quarters(batch)).items():
                sums[name] = sums.get(name, 0.0) + float(value)
            count += 1
    return {name: round(value / max(count, 1), 4) for name, value in sums.items()}


if __name__ == "__main__":
    main()
