"""Fit the refinement network; goes on where it was stopped.

python training/fit.py --scenes DIR --costs DIR --output DIR --minutes 60 --large
python training/fit.py --scenes DIR --costs DIR --output DIR2 --minutes 60 --teacher DIR/state.pt
"""

import argparse
import copy
import json
import math
import time
from pathlib import Path

import torch
from batches import Batch, ahead, batches, load
from network import BINS, NEIGHBOURS, Refinement
from teacher import teacher as large_network
from torch.nn import functional

from coded_aperture_ros.depth.refine.features import BLUR_SIZES_PX, BLUR_STEP_PX, LARGEST_PX
from coded_aperture_ros.depth.refine.probabilities import REACH

_BATCH = 8
_RATE = 2e-3
_AVERAGE = 0.998
_UNTRIED = -1e4
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
    return functional.max_pool2d(values, _NARROW, 1, _NARROW // 2)


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


def main() -> None:
    """Fit, and keep what was reached every few minutes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, required=True)
    parser.add_argument("--costs", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--shards", type=int, nargs=2, default=(4, 400))
    parser.add_argument("--validate", type=int, nargs=2, default=(0, 4))
    parser.add_argument("--start", type=Path, help="weights to start from")
    parser.add_argument("--large", action="store_true", help="fit the teacher")
    parser.add_argument("--teacher", type=Path, help="state of a large network to learn from")
    parser.add_argument("--rate", type=float, default=_RATE)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--least-told", type=float, default=0.0)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    args.output.mkdir(parents=True, exist_ok=True)
    frames = load(args.scenes, args.costs, list(range(*args.shards)), args.least_told)
    held = load(args.scenes, args.costs, list(range(*args.validate)))
    for what, some in (("learn from: --shards", frames), ("look at: --validate", held)):
        if len(some) < _BATCH:
            raise SystemExit(f"{len(some)} frames to {what} needs at least {_BATCH}")
    print(f"{len(frames)} frames to learn from, {len(held)} to look at", flush=True)
    network = large_network() if args.large else Refinement()
    network = network.to(memory_format=torch.channels_last)
    teacher = None
    if args.teacher:
        teacher = large_network().to(memory_format=torch.channels_last).eval()
        teacher.load_state_dict(torch.load(args.teacher)["average"])
    average = copy.deepcopy(network)
    optimizer = torch.optim.AdamW(network.parameters(), lr=args.rate, weight_decay=1e-2)
    spent, step = 0.0, 0
    state_path = args.output / "state.pt"
    if args.start:
        network.load_state_dict(torch.load(args.start)["average"])
        average.load_state_dict(network.state_dict())
    if state_path.exists():
        state = torch.load(state_path)
        network.load_state_dict(state["network"])
        average.load_state_dict(state["average"])
        optimizer.load_state_dict(state["optimizer"])
        spent, step = state["spent"], state["step"]
    started = time.perf_counter() - spent
    saved = reported = time.perf_counter()
    sums: dict[str, float] = {}
    since = 0
    for batch in ahead(batches(frames, _BATCH, step + 1)):
        spent = time.perf_counter() - started
        progress = spent / (60 * args.minutes)
        if progress >= 1:
            break
        warm = min(1.0, (step + 1) / 100)
        for group in optimizer.param_groups:
            group["lr"] = args.rate * warm * (0.5 + 0.5 * math.cos(math.pi * progress)) + 1e-6
        network.train()
        shown = (
            batch.costs.contiguous(memory_format=torch.channels_last),
            batch.frame.contiguous(memory_format=torch.channels_last),
        )
        size, choice = network(*shown)
        quarters, counted = true_quarters(batch)
        parts = losses(size, choice, batch, quarters, counted)
        loss = total(parts)
        if teacher is not None:
            with torch.no_grad():
                told = teacher(*shown)
            parts["taught"] = taught(size, choice, told, batch, counted)
            loss = _OF_TRUTH * loss + parts["taught"]
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimizer.step()
        step += 1
        keep = min(_AVERAGE, (step + 1) / (step + 20))
        with torch.no_grad():
            for mean, value in zip(
                average.state_dict().values(), network.state_dict().values(), strict=True
            ):
                if mean.is_floating_point():
                    mean.lerp_(value, 1 - keep)
        for name, value in parts.items():
            sums[name] = sums.get(name, 0.0) + float(value.detach())
        since += 1
        now = time.perf_counter()
        if now - reported > 60:
            means = " ".join(f"{name} {value / since:.4f}" for name, value in sums.items())
            print(f"{spent / 60:.1f} min, step {step}: {means}", flush=True)
            sums, since, reported = {}, 0, now
        if now - saved > 300:
            _save(state_path, network, average, optimizer, spent, step)
            print("held out:", json.dumps(validated(average, held)), flush=True)
            saved = time.perf_counter()
    _save(state_path, network, average, optimizer, spent, step)
    print("held out:", json.dumps(validated(average, held)), flush=True)


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


def _save(path: Path, network, average, optimizer, spent: float, step: int) -> None:
    part = path.with_suffix(".part")
    torch.save(
        {
            "network": network.state_dict(),
            "average": average.state_dict(),
            "optimizer": optimizer.state_dict(),
            "spent": spent,
            "step": step,
        },
        part,
    )
    part.rename(path)


if __name__ == "__main__":
    main()
