"""The check of whether frames fit: how likely the depth is right, and why it is not."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from members import MEMBERS, Members, merged, stored, unpacked
from misfits import MISFITS_DATA
from other_optics import OTHER_FILTER, OTHER_OPTICS, OTHER_SCALE
from scenes import FIRST_BOARD_SHARD, FIRST_MEASURED_SHARD, FIRST_NEAR_SHARD, FRAMES_PER_SHARD
from shards import Arrays
from states import check_enough
from task import Options, Task
from torch import nn
from torch.nn import functional
from weights_file import read_weights

from coded_aperture_ros.calibration.fine_tuning.loop import Problem, Schedule, on_device
from coded_aperture_ros.depth import CAUSES
from coded_aperture_ros.depth.quality import health as package

_BATCH = 512
# Features of few windows, and of more.
_LOOKS = ("few_windows", "features")
# How much fitting frames, and wrong depth that would be published, count beside the rest; and how
# many times as much where they are rare or hard to tell: photographs, and boards of small blur.
_FITS_FACTOR = 24.0
_FITTING_PHOTOGRAPH_FACTOR = 2.0
_SMALL_BLUR_FACTOR = 2.0
_WRONG_FACTOR = 6.0
_WRONG_PHOTOGRAPH_FACTOR = 6.0
# What is said of few windows counts less.
_FEW_FACTOR = 0.5
# What is the easiest to overlook counts so many times, where its depth is wrong.
_OVERLOOKED = {
    "all in focus": 45.0,
    "no mask": 6.0,
    "enlarged": 4.0,
    "enlarged linearly": 4.0,
    "smoothed": 2.0,
    "other mask": 2.0,
    "correlated noise": 2.0,
    "mask inverted": 2.0,
    OTHER_OPTICS: 4.0,
    OTHER_SCALE: 4.0,
    OTHER_FILTER: 2.0,
}
# Frames all in focus come out at the near end, where the error of the inverse depth is small
# whatever the truth; it counts so many times.
_FOCUS_FACTOR = 2.0
# How much it counts that the mean goes on to say what it said before it was fitted further: of
# fitting frames that it let pass, and of wrong depth that it withheld.
_KEPT_FIT = 24.0
_KEPT_WRONG = 6.0
_COVERED = 0.1
# What is published is right if its error exceeds that of the same scene, where it fits, by less
# than the first, and wrong from the second on: many scenes are near infinity, and hard to measure.
_RIGHT = 0.06
_WRONG = 0.12


@dataclasses.dataclass(frozen=True)
class _Course:
    """How members are fitted.

    Attributes
    ----------
    fixed : int
        The first so many members stay as they are.
    twins : int
        So many times all members are fitted, with other noise; the mean of the weights is taken.
    share : float
        How far from the weights before to the fitted ones those are that are used.
    rate, decay, average
        See `Schedule`.
    epochs : int
    warm_share : float
        Of the steps.
    """

    fixed: int
    twins: int
    share: float
    rate: float
    decay: float
    average: float
    epochs: int
    warm_share: float


_NEW = _Course(
    fixed=0, twins=1, share=1.0, rate=4e-3, decay=1e-2, average=0.0, epochs=60, warm_share=0.3
)
# Half of the members stay, so that what they have learned from is not lost.
_FURTHER = _Course(
    fixed=4, twins=2, share=0.6, rate=2e-3, decay=0.0, average=0.998, epochs=16, warm_share=0.05
)


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
    error = excess_error(rows) * np.where(rows["kind"] == "all in focus", _FOCUS_FACTOR, 1)
    wrong = np.clip((error - _RIGHT) / (_WRONG - _RIGHT), 0, 1)
    wrong[fits] = 0
    counts = np.where(fits, _FITS_FACTOR, np.where(wrong > 0.5, _WRONG_FACTOR, 1))
    counts[~fits & (rows["coverage"] < _COVERED)] = 0.3
    overlooked = np.array([_OVERLOOKED.get(str(kind), 1.0) for kind in rows["kind"]])
    counts *= np.where(wrong > 0.5, overlooked, 1)
    photograph, small = (test(rows["number"]) for test in (_is_photograph, _is_small_blur))
    counts *= np.where(fits & small, _SMALL_BLUR_FACTOR, 1)
    counts *= np.where(fits & photograph, _FITTING_PHOTOGRAPH_FACTOR, 1)
    counts *= np.where((wrong > 0.5) & photograph, _WRONG_PHOTOGRAPH_FACTOR, 1)
    cause_counts = np.where(fits, 0, np.where(wrong > 0, 1, 0.3))
    frequency = np.bincount(cause[~fits], minlength=len(CAUSES))
    cause_counts *= (frequency.mean() / np.maximum(frequency, 1))[cause] ** 0.6
    found = (1 - wrong, counts, np.maximum(cause, 0), cause_counts)
    right, counts, cause, cause_counts = (torch.tensor(values) for values in found)
    return right.float(), counts.float(), cause, cause_counts.float()


def _is_photograph(number: np.ndarray) -> np.ndarray:
    shard = number // FRAMES_PER_SHARD
    return (shard >= FIRST_MEASURED_SHARD) & (shard < FIRST_BOARD_SHARD)


def _is_small_blur(number: np.ndarray) -> np.ndarray:
    return number >= FIRST_NEAR_SHARD * FRAMES_PER_SHARD


def batches(count: int, seed: int) -> Iterator[torch.Tensor]:
    """Rows [batch], in random order, without an end."""
    random = np.random.default_rng(seed)
    size = min(_BATCH, count)
    while True:
        order = torch.from_numpy(random.permutation(count))
        for start in range(0, count - size + 1, size):
            yield order[start : start + size]


def _score(few: np.ndarray, more: np.ndarray, rows: Arrays) -> dict[str, Any]:
    """How good the outputs [frames, outputs] are: over all, and of each kind of misfit.

    More windows are asked where few leave doubt.

    `false_alarms`: share of the fitting frames that are said not to fit; `wrong`: share of the
    others whose depth is wrong, before and after the check; `cause`: how often it is right.
    """
    outputs = np.where(few[:, :1] > _logit(package.TRUSTED), few, more)
    alarmed = outputs[:, 0] < _logit(package.FIT_THRESHOLD)
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


def _logit(probability: float) -> float:
    return float(np.log(probability / (1 - probability)))


def _share(values: np.ndarray) -> float | None:
    return round(float(values.mean()), 4) if values.size else None


@dataclasses.dataclass(frozen=True, eq=False)
class _Learned:
    """What is learned from, of every row: of few windows, and then of more.

    Attributes
    ----------
    features : Tensor [rows, features]
    right, cause : Tensor [rows]
    counts, cause_counts : Tensor [rows]
        How much each counts.
    before, kept : Tensor [rows]
        What the members said before, 0 to 1, and how much that counts.
    """

    features: torch.Tensor
    right: torch.Tensor
    counts: torch.Tensor
    cause: torch.Tensor
    cause_counts: torch.Tensor
    before: torch.Tensor
    kept: torch.Tensor

    @classmethod
    def of_rows(cls, rows: Arrays, members: "Members | None") -> "_Learned":
        """Of rows, for members that are fitted further, or for new ones."""
        features = torch.cat([torch.tensor(rows[name]) for name in _LOOKS]).float()
        right, counts, cause, cause_counts = (torch.cat([each] * 2) for each in targets(rows))
        fits = torch.tensor(rows["cause"] < 0).repeat(2)
        few = torch.arange(len(fits)) < len(fits) // 2
        before, kept = torch.zeros(len(fits)), torch.zeros(len(fits))
        if members is not None:
            before = members.eval().means(features)[:, 0].sigmoid()
            kept = _KEPT_FIT * (fits & (before > 0.5)) + _KEPT_WRONG * (
                (right < 0.5) & (before < 0.5)
            )
        factors = torch.where(few, _FEW_FACTOR, 1.0)
        return cls(
            features, right, factors * counts, cause, factors * cause_counts, before, kept.float()
        )


class _Loss:
    """Loss of members: each by itself, or, where they are fitted further, that of their mean."""

    def __init__(self, learned: _Learned, of_mean: bool) -> None:
        self._learned = learned
        self._of_mean = of_mean

    def __call__(
        self, members: nn.Module, some: torch.Tensor
    ) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        of = self._learned
        outputs = members(of.features[some])
        if self._of_mean:
            outputs = outputs.unflatten(0, (-1, MEMBERS)).mean(1)
        count = len(outputs)
        health, causes = outputs[:, :, 0], outputs[:, :, 1:].flatten(0, 1)

        def entropy(wanted: torch.Tensor) -> torch.Tensor:
            return functional.binary_cross_entropy_with_logits(
                health, wanted[some].expand(count, -1), reduction="none"
            )

        named = functional.cross_entropy(causes, of.cause[some].repeat(count), reduction="none")
        parts = {
            "health": (of.counts[some] * entropy(of.right)).mean(),
            "cause": (of.cause_counts[some].repeat(count) * named).mean(),
        }
        total = parts["health"] + 0.5 * parts["cause"]
        if self._of_mean:
            parts["kept"] = (of.kept[some] * entropy(of.before)).mean()
            total = total + parts["kept"]
        # A sum over members: each is fitted by itself.
        return count * total, parts


class CheckTask(Task):
    """Fit what tells whether frames fit."""

    module = package

    def problem(self, options: Options) -> Problem:
        rows = load_rows(options.folder, options.shards)
        held_back = load_rows(options.folder, options.held_back)
        check_enough(range(len(rows["error"])), held_back["error"], 2, 1)
        course = _FURTHER if options.further else _NEW
        members = Members.random(rows["features"])
        if options.further:
            arrays = unpacked(read_weights(options.further, package))
            twins = {name: np.concatenate([each] * course.twins) for name, each in arrays.items()}
            members = Members(twins, course.fixed)
        learned = _Learned.of_rows(rows, members if options.further else None)
        learned = on_device(learned, options.device)
        shown = [torch.tensor(held_back[name]) for name in _LOOKS]

        def score(network: nn.Module) -> dict[str, Any]:
            mean = Members(self._used(network.state_dict(), options)).eval()
            few, more = (mean.means(each).numpy() for each in shown)
            return _score(few, more, held_back)

        count = len(learned.features)
        steps = course.epochs * max(count // _BATCH, 1)
        schedule = Schedule(
            options.minutes,
            options.rate or course.rate,
            warm_steps=max(int(course.warm_share * steps), 1),
            decay=course.decay,
            average=course.average,
            steps=steps,
        )
        loss = _Loss(learned, of_mean=options.further is not None)
        return Problem(members, schedule, lambda seed: batches(count, seed), loss, score)

    def arrays(self, weights: dict[str, torch.Tensor], options: Options) -> dict[str, Any]:
        return stored(self._used(weights, options))

    def _used(self, weights: dict[str, torch.Tensor], options: Options) -> Arrays:
        fitted = merged(weights)
        if not options.further:
            return fitted
        before, share = unpacked(read_weights(options.further, package)), _FURTHER.share
        return {name: before[name] + share * (fitted[name] - before[name]) for name in fitted}
