"""Fit networks that see the frame itself to fresh scenes, for a time; go on where it was stopped.

example:
  python training/fit_raw.py --photographs pictures --measured scenes --seconds 500 --device cuda
"""

import argparse
import copy
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from raw.cameras import random_camera
from raw.network import LEVELS, AnyOptics, OneOptics
from raw.planes import light_through
from raw.samples import Sample, Sources, batches, lights, load_photographs, sample
from raw.scenes import Slices, load_slices
from torch import nn
from torch.nn import functional

from coded_aperture_ros.calibration.fine_tuning.loop import Schedule
from coded_aperture_ros.calibration.fine_tuning.loss import APART_PX, dilated

_SLICES = 24
_ONE_MASK = "levin"
# Of the network for one mask: the blur sizes of its outputs.
ONE_SIZES_PX = np.linspace(0.5, 22, LEVELS, dtype=np.float32)
_RATES = {"any": 2e-3, "one": 2e-3}
_WARM_STEPS = 100
_AVERAGE = 0.998
_REPORT_S = 30
# Narrow things before something more or less blurred count more.
_MORE_FOR_NARROW = 3.0


class Member:
    """A network, its running average, and its optimizer."""

    def __init__(self, network: nn.Module, rate: float) -> None:
        self.network = network
        self.run: Callable[..., torch.Tensor] = network
        self.average = copy.deepcopy(network).eval()
        self.optimizer = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=1e-2)
        self.schedule = Schedule(0, rate, _WARM_STEPS, 1e-2, average=_AVERAGE)
        self.steps = 0

    def improve(self, loss: torch.Tensor, progress: float) -> None:
        """Take a step against the gradient."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.schedule.rate_at(self.steps, progress)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), 2.0)
        if not bool(torch.isfinite(norm)):
            print("a gradient that is no number: step left out", flush=True)
            return
        self.optimizer.step()
        self.steps += 1
        keep = min(_AVERAGE, (self.steps + 1) / (self.steps + 20))
        pairs = zip(
            self.average.state_dict().values(), self.network.state_dict().values(), strict=True
        )
        with torch.no_grad():
            for mean, value in pairs:
                if mean.is_floating_point():
                    mean.lerp_(value, 1 - keep)
                else:
                    mean.copy_(value)


def losses(
    logits: torch.Tensor, sizes_px: torch.Tensor, seen: Sample
) -> tuple[torch.Tensor, torch.Tensor]:
    """Cross-entropy with a truth between two levels, and the share right within 1 px."""
    known = torch.isfinite(seen.blur_px)
    truth = torch.nan_to_num(seen.blur_px)
    first, last = sizes_px[:, 0, None, None], sizes_px[:, -1, None, None]
    place = ((truth - first) * (LEVELS - 1) / (last - first)).clamp(0, LEVELS - 1.001)
    below = place.floor()
    share = place - below
    log_p = functional.log_softmax(logits.float(), 1)
    low = torch.gather(log_p, 1, below.long()[:, None])[:, 0]
    high = torch.gather(log_p, 1, below.long()[:, None] + 1)[:, 0]
    counted = known * (1 + _MORE_FOR_NARROW * _narrow(truth, known, seen.near))
    entropy = -((1 - share) * low + share * high).clamp(min=-30)
    loss = (entropy * counted).sum() / counted.sum().clamp(min=1)
    right = ((blur_sizes(logits.detach(), sizes_px) - truth).abs() < 1) & known
    return loss, right.sum() / known.sum().clamp(min=1)


def blur_sizes(logits: torch.Tensor, sizes_px: torch.Tensor) -> torch.Tensor:
    """Mean blur size around the likeliest, px [batch, rows, columns]."""
    best = logits.argmax(1, keepdim=True)
    around = best + torch.arange(-2, 3, device=logits.device).view(1, -1, 1, 1)
    around = around.clamp(0, LEVELS - 1)
    near = torch.gather(logits.float(), 1, around)
    sizes = sizes_px[:, :, None, None].expand(-1, -1, *logits.shape[-2:])
    return (functional.softmax(near, 1) * torch.gather(sizes, 1, around)).sum(1)


def _narrow(truth: torch.Tensor, known: torch.Tensor, near: torch.Tensor) -> torch.Tensor:
    """Where something narrow is before something more distant."""
    away = (truth * (1 - 2 * near[:, None, None])).masked_fill(~known, -30.0)[:, None]
    closed = -dilated(-dilated(away))
    return (closed - away > APART_PX)[:, 0].float()


def _logits(
    network: Callable[..., torch.Tensor], seen: Sample, device: torch.device
) -> torch.Tensor:
    with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
        return network(seen.given, seen.sizes_px, seen.near)


def _scores(members: dict[str, Member], held_back: list[tuple[str, Sample]]) -> dict[str, Any]:
    """Loss and share right of what is held back, a row for each batch."""
    rows: dict[str, Any] = {}
    for name, member in members.items():
        for label, seen in held_back:
            if name == "one" and not label.endswith(_ONE_MASK):
                continue
            with torch.no_grad():
                logits = _logits(member.average, seen, seen.blur_px.device)
                loss, right = losses(logits, _sizes(name, seen), seen)
            rows[f"{name} {label}"] = [round(float(loss), 3), round(float(right), 3)]
    return rows


def _sizes(name: str, seen: Sample) -> torch.Tensor:
    """Blur sizes of a network's outputs."""
    if name == "one":
        return torch.from_numpy(ONE_SIZES_PX).to(seen.sizes_px.device).expand(len(seen.near), -1)
    return seen.sizes_px


def _save(members: dict[str, Member], spent_s: float, folder: Path) -> None:
    """Write what was reached, each file as small as it may be."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, member in members.items():
        average = _shortened(member.average.state_dict(), torch.float16)
        torch.save(average, folder / f"{name}_average.pt")
        torch.save(member.network.state_dict(), folder / f"{name}_network.pt")
        moments = _shortened(member.optimizer.state_dict(), torch.bfloat16)
        torch.save(moments, folder / f"{name}_moments.pt")
    steps = {name: member.steps for name, member in members.items()}
    (folder / "reached.json").write_text(json.dumps({"steps": steps, "seconds": spent_s}))


def _shortened(value: Any, kind: torch.dtype) -> Any:
    """The same with numbers of a kind of 16 bits, for tensors of more than one dimension."""
    if isinstance(value, torch.Tensor):
        return value.to(kind) if value.is_floating_point() and value.ndim > 1 else value
    if isinstance(value, dict):
        return {key: _shortened(part, kind) for key, part in value.items()}
    return [_shortened(part, kind) for part in value] if isinstance(value, list) else value


def _resume(members: dict[str, Member], folder: Path) -> float:
    """Go on from the files of a folder; seconds that were spent before."""
    reached = folder / "reached.json"
    if not reached.exists():
        return 0.0
    found = json.loads(reached.read_text())
    for name, member in members.items():
        if name not in found["steps"]:
            continue
        for part, kept in (
            ("network", member.network),
            ("average", member.average),
            ("moments", member.optimizer),
        ):
            path = folder / f"{name}_{part}.pt"
            kept.load_state_dict(torch.load(path, weights_only=True, map_location="cpu"))
        member.steps = found["steps"][name]
    return float(found["seconds"])


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--photographs", type=Path, required=True, help="folder of sharp pictures")
    parser.add_argument("--measured", type=Path, help="folder of folders with disparity.npz")
    parser.add_argument("--held-back", nargs="*", default=[], help="folders that are only scored")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--whole-seconds", type=float, help="of the schedule, over all runs")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--networks", nargs="*", default=["any", "one"])
    parser.add_argument("--noises", type=int, default=2, help="how often scenes are recorded")
    parser.add_argument("--one-share", type=float, default=0.3, help="of steps, for one mask")
    parser.add_argument("--measured-share", type=float, default=0.33)
    parser.add_argument("--compile", action="store_true", help="what is run often; takes a minute")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("build/raw"))
    return parser.parse_args()


def main() -> None:
    """Run the program."""
    started = time.perf_counter()
    options = _arguments()
    device = torch.device(options.device)
    torch.backends.cuda.matmul.allow_tf32 = True
    torch.backends.cudnn.benchmark = True
    sources, kept = _sources(options, device)
    members = {
        name: Member(kind().to(device, memory_format=torch.channels_last), _RATES[name])
        for name, kind in (("any", AnyOptics), ("one", OneOptics))
        if name in options.networks
    }
    before = _resume(members, options.out)
    if options.compile and "any" in members:  # the other one takes a third of its time
        member = members["any"]
        member.run = torch.compile(member.network, dynamic=False)
    whole = options.whole_seconds or before + options.seconds
    torch.manual_seed(options.seed + int(before))
    random = np.random.default_rng([options.seed, int(before)])
    held_back = _held_back(kept, options.batch)
    print(f"{time.perf_counter() - started:.0f} s to begin", flush=True)
    sums: dict[str, list[float]] = {}
    reported = saved = time.perf_counter()
    while (now := time.perf_counter()) - started < options.seconds:
        progress = (before + now - started) / whole
        name = "one" if "one" in members and random.random() < options.one_share else "any"
        name = name if name in members else next(iter(members))
        member = members[name]
        member.network.train()
        for kind, seen in batches(sources, options, random, _ONE_MASK if name == "one" else None):
            loss, right = losses(_logits(member.run, seen, device), _sizes(name, seen), seen)
            member.improve(loss, min(progress, 1.0))
            sums.setdefault(f"{name} {kind}", []).append(float(loss.detach()))
            sums.setdefault(f"{name} {kind} right", []).append(float(right))
        if now - reported > _REPORT_S:
            means = ", ".join(f"{key} {np.mean(each):.3f}" for key, each in sorted(sums.items()))
            steps = " ".join(f"{key} {member.steps}" for key, member in members.items())
            print(f"{now - started:.0f} s, steps {steps}: {means}", flush=True)
            sums, reported = {}, now
        if now - saved > 150:
            _save(members, before + now - started, options.out)
            print("held back:", json.dumps(_scores(members, held_back)), flush=True)
            saved = now
    _save(members, before + time.perf_counter() - started, options.out)
    print("held back:", json.dumps(_scores(members, held_back)), flush=True)


def _sources(options: argparse.Namespace, device: torch.device) -> tuple[Sources, Sources]:
    """What is learned from, and what is held back."""
    photographs = load_photographs(options.photographs, device)
    learned, held_back = [], []
    for folder in sorted(options.measured.iterdir()) if options.measured else []:
        if (folder / "disparity.npz").exists():
            slices = load_slices(folder, _SLICES)
            slices = Slices(slices.painted.to(device), slices.away.to(device))
            (held_back if folder.name in options.held_back else learned).append(slices)
    through = torch.compile(light_through, dynamic=False) if options.compile else light_through
    return (
        Sources(photographs, learned, through),
        Sources(photographs, held_back or learned, light_through),
    )


def _held_back(sources: Sources, batch: int) -> list[tuple[str, Sample]]:
    """Batches that are only scored; the same in every run."""
    torch.manual_seed(77)
    random = np.random.default_rng(77)
    held_back = []
    for mask in (_ONE_MASK, "zhou"):
        for measured in (False, True):
            if measured and not sources.measured:
                continue
            camera = random_camera(random, mask)
            found = lights([camera], sources, max(batch // 2, 1), measured, random)
            seen = sample(camera, *found[0])
            held_back.append((f"{'measured' if measured else 'random'} {mask}", seen))
    return held_back


if __name__ == "__main__":
    sys.exit(main())
