"""The loop that fits a network for a time, goes on where it was stopped, and keeps the average."""

import copy
import dataclasses
import json
import math
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

_REPORT_S = 60
_SAVE_S = 300
Item = Any
Batch = Any


def _print(line: str) -> None:
    print(line, flush=True)  # noqa: T201


@dataclasses.dataclass(frozen=True)
class Schedule:
    """How a network is fitted.

    Attributes
    ----------
    minutes : float
        How long, with what was spent before it was stopped.
    rate : float
        Of learning. It rises in the beginning, and falls to 0 in the end.
    warm_steps : int
        Steps in which the rate rises.
    decay : float
        Of the weights.
    largest_gradient : float
        Norm to which larger ones are shortened.
    average : float
        What the mean of the weights keeps of itself in each step; 0: it is the last weights.
    steps : int
        Fitting ends after so many steps, if the minutes last; 0: it ends with the minutes.
    """

    minutes: float
    rate: float
    warm_steps: int
    decay: float
    largest_gradient: float = math.inf
    average: float = 0.998
    steps: int = 0

    def progress(self, step: int, spent_s: float) -> float:
        """Share of the time, or of the steps, that is over."""
        of_time = spent_s / (60 * self.minutes)
        return max(of_time, step / self.steps) if self.steps else of_time

    def rate_at(self, step: int, progress: float) -> float:
        """Rate of a step, at a `progress`."""
        warm = min(1.0, (step + 1) / self.warm_steps)
        return self.rate * warm * (0.5 + 0.5 * math.cos(math.pi * progress)) + 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """What a task gives to the loop.

    Attributes
    ----------
    network : torch.nn.Module
    schedule : Schedule
    batches : callable
        Batches without an end, in an order that follows from a seed; on the processor.
    loss : callable
        From the network and a batch, both on the device, to what is minimised, and to what is
        printed.
    score : callable
        From a network, wherever it is, to what is printed of the data held back.
    say : callable
        Prints a line.
    """

    network: torch.nn.Module
    schedule: Schedule
    batches: Callable[[int], Iterator[Batch]]
    loss: Callable[[torch.nn.Module, Batch], tuple[torch.Tensor, dict[str, torch.Tensor]]]
    score: Callable[[torch.nn.Module], dict[str, Any]]
    say: Callable[[str], None] = _print


class Fit:
    """A network that is fitted, and the running average of its weights, which is what is used.

    Parameters
    ----------
    problem : Problem
    path : Path
        File of what was reached. If it is there, fitting goes on from it.
    start : dict of str to Tensor, optional
        Weights of another fit that are started from.
    device : str
        What computes, as PyTorch names it. Files of what was reached fit every device.
    """

    def __init__(
        self,
        problem: Problem,
        path: Path,
        start: dict[str, torch.Tensor] | None = None,
        device: str = "cpu",
    ) -> None:
        self._problem = problem
        self._path = path
        self._device = device
        self._network = problem.network.to(device, memory_format=torch.channels_last)
        self._average = copy.deepcopy(self._network)
        self._step = 0
        self._spent_s = 0.0
        schedule = problem.schedule
        self._optimizer = torch.optim.AdamW(
            self._network.parameters(), lr=schedule.rate, weight_decay=schedule.decay
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        if start:
            self._network.load_state_dict(start)
            self._average.load_state_dict(self._network.state_dict())
        if path.exists():
            self._resume(torch.load(path, weights_only=True))

    @property
    def steps(self) -> int:
        """Steps so far."""
        return self._step

    @property
    def averaged_weights(self) -> dict[str, torch.Tensor]:
        """What is used, on the processor."""
        weights: dict[str, torch.Tensor] = on_device(self._average.state_dict(), "cpu")
        return dict(weights)

    def run(self) -> None:
        """Fit until the time is spent; print what is lost, and save, every few minutes."""
        problem = self._problem
        started = time.perf_counter() - self._spent_s
        saved = reported = time.perf_counter()
        sums: dict[str, float] = {}
        count = 0
        batches = (on_device(each, self._device) for each in problem.batches(self._step + 1))
        for batch in prepared(batches):
            self._spent_s = time.perf_counter() - started
            progress = problem.schedule.progress(self._step, self._spent_s)
            if progress >= 1:
                break
            self._network.train()
            loss, parts = problem.loss(self._network, batch)
            self._improve(loss, progress)
            for name, value in parts.items():
                sums[name] = sums.get(name, 0.0) + float(value.detach())
            count += 1
            now = time.perf_counter()
            if now - reported > _REPORT_S:
                means = " ".join(f"{name} {value / count:.4f}" for name, value in sums.items())
                problem.say(f"{self._spent_s / 60:.1f} min, step {self._step}: {means}")
                sums, count, reported = {}, 0, now
            if now - saved > _SAVE_S:
                self._save()
                saved = time.perf_counter()
        self._save()

    def _improve(self, loss: torch.Tensor, progress: float) -> None:
        """Take a step against the gradient."""
        schedule = self._problem.schedule
        for group in self._optimizer.param_groups:
            group["lr"] = schedule.rate_at(self._step, progress)
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._network.parameters(), schedule.largest_gradient)
        self._optimizer.step()
        self._step += 1
        keep = min(schedule.average, (self._step + 1) / (self._step + 20))
        means = self._average.state_dict().values()
        with torch.no_grad():
            for mean, value in zip(means, self._network.state_dict().values(), strict=True):
                if mean.is_floating_point():
                    mean.lerp_(value, 1 - keep)

    def _resume(self, state: dict[str, Any]) -> None:
        self._network.load_state_dict(state["network"])
        self._average.load_state_dict(state["average"])
        self._optimizer.load_state_dict(state["optimizer"])
        self._spent_s = state["spent"]
        self._step = state["step"]

    def _save(self) -> None:
        state = {
            "network": self._network.state_dict(),
            "average": self._average.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "spent": self._spent_s,
            "step": self._step,
        }
        part = self._path.with_suffix(".part")
        torch.save(on_device(state, "cpu"), part)
        part.rename(self._path)
        self._problem.say(f"held back: {json.dumps(self._problem.score(self._average.eval()))}")


def on_device(values: Any, device: str | torch.device) -> Any:
    """The same with all tensors on a device: of a dataclass, dict, list, tuple, or one tensor."""
    if isinstance(values, torch.Tensor):
        return values.to(device)
    if dataclasses.is_dataclass(values) and not isinstance(values, type):
        names = (field.name for field in dataclasses.fields(values))
        parts = {name: on_device(getattr(values, name), device) for name in names}
        return dataclasses.replace(values, **parts)
    if isinstance(values, dict):
        return {name: on_device(each, device) for name, each in values.items()}
    if isinstance(values, list | tuple):
        return type(values)(on_device(each, device) for each in values)
    return values


def device_of(network: torch.nn.Module) -> torch.device:
    """Device of a network's weights."""
    return next(network.parameters()).device


def shuffled(items: Sequence[Item], size: int, random: np.random.Generator) -> Iterator[list[Item]]:
    """So many items at a time, all of them in random order, without an end."""
    while True:
        order = random.permutation(len(items))
        for start in range(0, len(order) - size + 1, size):
            yield [items[index] for index in order[start : start + size]]


def turned(values: np.ndarray, flip: bool, turns: int, side: int = 1) -> np.ndarray:
    """Maps [..., rows, columns] mirrored, and turned by right angles.

    With a `side`, channels [n * side**2, rows, columns] are the pixels of squares, row by row,
    which are turned as well.
    """
    values = values[..., ::-1] if flip else values
    whole = np.ascontiguousarray(np.rot90(values, turns, axes=(-2, -1)))
    if side == 1:
        return whole
    order = turned(np.arange(side**2).reshape(side, side), flip, turns).ravel()
    squares = whole.reshape(-1, side**2, *whole.shape[1:])
    return squares[:, order].reshape(whole.shape)


def prepared(source: Iterator[Batch], count: int = 3) -> Iterator[Batch]:
    """Batches that a thread prepares, so that none has to be waited for."""
    waiting: queue.Queue[Batch] = queue.Queue(count)
    end = StopIteration()

    def prepare() -> None:
        try:
            for batch in source:
                waiting.put(batch)
            waiting.put(end)
        except Exception as error:  # raised where batches are taken
            waiting.put(error)

    threading.Thread(target=prepare, daemon=True).start()
    while (batch := waiting.get()) is not end:
        if isinstance(batch, Exception):
            raise batch
        yield batch
