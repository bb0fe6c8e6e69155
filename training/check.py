"""The check of whether frames fit: how likely the depth is right, and why it is not."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from misfits import MISFITS_DATA
from shards import Arrays
from states import check_enough
from task import Options, Task
from torch import nn
from torch.nn import functional

from coded_aperture_ros.calibration.fine_tuning.loop import Problem, Schedule, on_device
from coded_aperture_ros.depth import CAUSES
from coded_aperture_ros.depth.quality import health as package

_BATCH = 256
_HIDDEN = 256
_RATE = 4e-3
# So many networks, from other beginnings, are fitted, and the mean of their outputs is taken.
_MEMBERS = 4
# How much fitting frames, and wrong depth that would be published, count beside the rest.
_FITS_FACTOR = 12.0
_WRONG_FACTOR = 6.0
# What is the easiest to overlook counts so many times, where its depth is wrong.
_OVERLOOKED = {"all in focus": 45.0, "no mask": 4.0} | dict.fromkeys(
    ("smoothed", "enlarged linearly", "other mask", "correlated noise", "mask inverted"), 2.0
)
_COVERED = 0.1
# What is published is right if its error exceeds that of the same scene, where it fits, by less
# than the first, and wrong from the second on: many scenes are near infinity, and hard to measure.
_RIGHT = 0.06
_WRONG = 0.12
_NOISE = 0.2
_DROPPED = 0.5
_EPOCHS = 60
_WARM_SHARE = 0.3


class Members(nn.Module):
    """Networks with two hidden layers, side by side, and what standardises their features.

    Takes standardised features [members, batch, features], gives the logit of the depth being
    right, and then those of the causes [members, batch, outputs].
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("scale", torch.ones(features))
        self.networks = nn.ModuleList(
            nn.Sequential(
                nn.Linear(features, _HIDDEN),
                nn.ReLU(),
                nn.Dropout(_DROPPED),
                nn.Linear(_HIDDEN, _HIDDEN // 2),
                nn.ReLU(),
                nn.Linear(_HIDDEN // 2, 1 + len(CAUSES)),
            )
            for _ in range(_MEMBERS)
        )

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        pairs = zip(self.networks, values, strict=True)
        return torch.stack([network(given) for network, given in pairs])

    def standardised(self, features: np.ndarray) -> torch.Tensor:
        """Features [frames, features] as the networks take them."""
        values = (_clipped(features) - self.mean.numpy()) / self.scale.numpy()
        limit = package.SCALED_LIMIT
        return torch.tensor(np.clip(values, -limit, limit).astype(np.float32))


def _clipped(features: np.ndarray) -> np.ndarray:
    return np.clip(features, -package.LIMIT, package.LIMIT)


def load_rows(folder: Path, shards: tuple[int, ...]) -> Arrays:
    """Rows of the shards that are there, see `misfits`."""
    there = [shard for shard in shards if MISFITS_DATA.exists(folder, shard)]
    found = [MISFITS_DATA.read(folder, shard) for shard in there]
    found = [rows for rows in found if len(rows["error"])]
    if not found:
        raise SystemExit(f"no frames of shards {shards[:1]} to {shards[-1:]}: make data before")
    return {name: np.concatenate([rows[name] for rows in found]) for name in found[0]}


def excess_error(rows: Arrays) -> np.ndarray:
    """By how much the error of what is published exceeds that of the same scene where it fits."""
    fits, number = rows["cause"] < 0, rows["number"]
    count = np.bincount(number[fits], minlength=number.max() + 1)
    total = np.bincount(number[fits], rows["error"][fits], minlength=number.max() + 1)
    own = (total / np.maximum(count, 1))[number]
    return np.where(rows["coverage"] > _COVERED, rows["error"], 0) - own


def targets(rows: Arrays) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """How right each frame is, how much that counts, its cause, and how much that counts."""
    fits, cause = rows["cause"] < 0, rows["cause"]
    wrong = np.clip((excess_error(rows) - _RIGHT) / (_WRONG - _RIGHT), 0, 1)
    wrong[fits] = 0
    counts = np.where(fits, _FITS_FACTOR, np.where(wrong > 0.5, _WRONG_FACTOR, 1))
    counts[~fits & (rows["coverage"] < _COVERED)] = 0.3
    overlooked = np.array([_OVERLOOKED.get(str(kind), 1.0) for kind in rows["kind"]])
    counts *= np.where(wrong > 0.5, overlooked, 1)
    cause_counts = np.where(fits, 0, np.where(wrong > 0, 1, 0.3))
    frequency = np.bincount(cause[~fits], minlength=len(CAUSES))
    cause_counts *= (frequency.mean() / np.maximum(frequency, 1))[cause] ** 0.6
    found = (1 - wrong, counts, np.maximum(cause, 0), cause_counts)
    right, counts, cause, cause_counts = (torch.tensor(values) for values in found)
    return right.float(), counts.float(), cause, cause_counts.float()


def batches(count: int, seed: int) -> Iterator[torch.Tensor]:
    """Rows for each of the members [members, batch], in random orders, without an end."""
    randoms = [np.random.default_rng([seed, member]) for member in range(_MEMBERS)]
    size = min(_BATCH, count)
    while True:
        orders = np.stack([random.permutation(count) for random in randoms])
        for start in range(0, count - size + 1, size):
            yield torch.from_numpy(orders[:, start : start + size])


def _score(outputs: np.ndarray, rows: Arrays) -> dict[str, Any]:
    """How good the outputs [frames, outputs] are: over all, and of each kind of misfit.

    `false_alarms`: share of the fitting frames that are said not to fit; `wrong`: share of the
    others whose depth is wrong, before and after the check; `cause`: how often it is right.
    """
    alarmed = outputs[:, 0] < np.log(package.FIT_THRESHOLD / (1 - package.FIT_THRESHOLD))
    fits = rows["cause"] < 0
    wrong = ~fits & (excess_error(rows) > 0.1) & (rows["coverage"] > 0.2)
    right_cause = outputs[:, 1:].argmax(1) == rows["cause"]

    def of_some(some: np.ndarray) -> dict[str, Any]:
        named = some & alarmed
        return {
            "frames": int(some.sum()),
            "wrong": [_share(wrong[some]), _share((wrong & ~alarmed)[some])],
            "alarms": _share(alarmed[some]),
            "cause": _share(right_cause[named]),
        }

    kinds = {str(kind): of_some(rows["kind"] == kind) for kind in np.unique(rows["kind"][~fits])}
    return {"false_alarms": _share(alarmed[fits]), **of_some(~fits), "kinds": kinds}


def _share(values: np.ndarray) -> float | None:
    return round(float(values.mean()), 4) if values.size else None


class CheckTask(Task):
    """Fit what tells whether frames fit."""

    module = package

    def problem(self, options: Options) -> Problem:
        rows = load_rows(options.folder, options.shards)
        held_back = load_rows(options.folder, options.held_back)
        count = len(rows["error"])
        check_enough(range(count), held_back["error"], 2, 1)
        features = _clipped(rows["features"])
        network = Members(features.shape[1])
        network.mean.copy_(torch.tensor(features.mean(0)))
        network.scale.copy_(torch.tensor(features.std(0) + 1e-3))
        values, shown = map(network.standardised, (features, held_back["features"]))
        values, shown = on_device((values, shown), options.device)
        right, counts, cause, cause_counts = on_device(targets(rows), options.device)

        def loss(
            members: nn.Module, some: torch.Tensor
        ) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
            given = values[some]
            outputs = members(given + _NOISE * torch.randn_like(given)).flatten(0, 1)
            of = some.flatten()
            health = functional.binary_cross_entropy_with_logits(
                outputs[:, 0], right[of], reduction="none"
            )
            named = functional.cross_entropy(outputs[:, 1:], cause[of], reduction="none")
            parts = {
                "health": (counts[of] * health).mean(),
                "cause": (cause_counts[of] * named).mean(),
            }
            # A sum over members: each is fitted by itself.
            return _MEMBERS * (parts["health"] + 0.5 * parts["cause"]), parts

        def score(members: nn.Module) -> dict[str, Any]:
            with torch.no_grad():
                outputs = members(shown.expand(_MEMBERS, -1, -1)).mean(0).cpu().numpy()
            return _score(outputs, held_back)

        steps = _EPOCHS * (count // _BATCH + 1)
        schedule = Schedule(
            options.minutes,
            options.rate or _RATE,
            warm_steps=int(_WARM_SHARE * steps),
            decay=1e-2,
            average=0.0,
            steps=steps,
        )
        return Problem(network, schedule, lambda seed: batches(count, seed), loss, score)

    def arrays(self, weights: dict[str, torch.Tensor], options: Options) -> dict[str, Any]:
        members = Members(len(weights["mean"]))
        members.load_state_dict(weights)
        arrays = {name: np.tile(weights[name].numpy(), (_MEMBERS, 1)) for name in ("mean", "scale")}
        each = ([part for part in one if isinstance(part, nn.Linear)] for one in members.networks)
        for number, layers in enumerate(zip(*each, strict=True)):
            arrays[f"weight{number}"] = torch.stack([one.weight.data for one in layers]).numpy()
            arrays[f"bias{number}"] = torch.stack([one.bias.data for one in layers]).numpy()
        return stored(arrays)


def stored(arrays: Arrays) -> Arrays:
    """Arrays as the weights' file has them: weights in 8 bits, by a scale for each row, rest in 16.

    Health changes by less than 0.01.
    """
    small = {}
    for name, values in arrays.items():
        if name.startswith("weight"):
            scale = np.abs(values).max(axis=-1, keepdims=True).astype(np.float16) / np.float16(127)
            small[f"{name}_scale"] = scale
            values = np.rint(values / scale.astype(np.float32)).clip(-127, 127).astype(np.int8)
        small[name] = values if values.dtype == np.int8 else values.astype(np.float16)
    return small
