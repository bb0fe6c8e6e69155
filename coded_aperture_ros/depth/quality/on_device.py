"""Features of the check of fit on a device: recorded, and a row of numbers comes back."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import in_memory
from coded_aperture_ros.core.tensors.functions import hstack
from coded_aperture_ros.core.tensors.recorded import Recorded, Tensors


class RecordedNumbers:
    """Features of frames whose maps are tensors; waits for the device.

    Parameters
    ----------
    numbers : callable
        See `FitCheck.numbers`.
    """

    def __init__(self, numbers: Callable[[int, dict[str, Any]], list[Any] | None]) -> None:
        self._numbers = numbers
        self._steps: dict[tuple[Any, ...], Recorded] = {}

    def __call__(self, cells: int, given: dict[str, Any]) -> list[float]:
        """See `FitCheck.numbers`."""
        inputs = {name: values for name, values in given.items() if values is not None}
        for name in ("noise", "known"):
            inputs[name] = np.array(given[name], np.float32)
        shapes = ((name, tuple(values.shape)) for name, values in inputs.items())
        key = cells, *shapes
        if key not in self._steps:
            device = given["grey"].device.type
            self._steps[key] = Recorded(partial(self._row, cells), device)
        found = self._steps[key](inputs)
        row: list[float] = in_memory(found["numbers"]).tolist()
        return row

    @property
    def is_recorded(self) -> bool:
        """Whether all its work so far is a CUDA graph."""
        steps = self._steps.values()
        return bool(steps) and all(step.is_recorded for step in steps)

    def _row(self, cells: int, inputs: Tensors) -> Tensors:
        """Row of the numbers; without any textured window that of their number alone."""
        numbers = self._numbers(cells, {"unusable": None, **inputs})
        return {"numbers": hstack(numbers or [inputs["grey"].new_zeros(1)])}
