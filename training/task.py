"""What a task is: one network of the package, and how it is fitted, written and calibrated."""

import dataclasses
from abc import ABC, abstractmethod
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from shards import Arrays

if TYPE_CHECKING:  # PyTorch is loaded with the task that is chosen
    import torch

    from coded_aperture_ros.calibration.fine_tuning.loop import Problem


@dataclasses.dataclass(frozen=True)
class Options:
    """What the command line says; see `train.py --help`. `state` is the file of the fit."""

    folder: Path
    state: Path
    weights: Path
    shards: tuple[int, ...]
    held_back: tuple[int, ...]
    minutes: float
    rate: float | None
    further: Path | None
    start: Path | None
    truth_only: bool
    least_told: float
    frames: int
    processes: int
    scheduler: str
    threads: int
    device: str


class Task(ABC):
    """A network of the package.

    A task whose plan has the step `quantise` or `calibrate` has the method for it, too.

    Attributes
    ----------
    module : module
        Of the package, which reads the weights' file.
    exact : tuple of str
        Layers, by a part of their names, that are not quantised.
    """

    module: ModuleType
    exact: tuple[str, ...] = ()

    @abstractmethod
    def problem(self, options: Options) -> "Problem":
        """Network, data, loss and score for the loop."""

    @abstractmethod
    def arrays(self, weights: "dict[str, torch.Tensor]", options: Options) -> dict[str, Any]:
        """Arrays of the weights' file, from the weights that were fitted."""

    def quantisation_inputs(self, options: Options) -> dict[str, list[Arrays]]:
        """Inputs of the networks in the weights' file for some frames; the package runs them."""
        raise NotImplementedError("this task has no step quantise")

    def calibration(self, options: Options) -> dict[str, Any]:
        """Constants of the weights' file that are fitted by data held back."""
        raise NotImplementedError("this task has no step calibrate")
