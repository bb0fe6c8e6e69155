"""NumPy's functions for tensors: PyTorch's, and where these differ, some of NumPy's meaning.

Arithmetic that is written once takes the functions from here or from NumPy; see `arrays.namespace`.
Nothing waits for a device.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from coded_aperture_ros.core.tensors.constants import kept_on_device


def __getattr__(name: str) -> Any:
    """Function of PyTorch that means what NumPy's of that name does."""
    return getattr(torch, name)


def interp(
    x: torch.Tensor, xp: NDArray[np.floating | np.integer], fp: NDArray[np.floating | np.integer]
) -> torch.Tensor:
    """Linear interpolation between constant places, float32 of the shape of `x`."""
    places, values = (kept_on_device(np.asarray(each, np.float32), x.device) for each in (xp, fp))
    after = torch.searchsorted(places, x.contiguous()).clip(1, len(places) - 1)
    share = ((x - places[after - 1]) / (places[after] - places[after - 1])).clip(0, 1)
    return torch.lerp(values[after - 1], values[after], share)


def take(a: torch.Tensor, indices: NDArray[np.integer], axis: int) -> torch.Tensor:
    """Elements along an axis at constant places."""
    return a.index_select(axis, kept_on_device(np.asarray(indices), a.device))


def take_along_axis(arr: torch.Tensor, indices: torch.Tensor, axis: int) -> torch.Tensor:
    """Elements along an axis at the places of a tensor."""
    return torch.take_along_dim(arr, indices, axis)


def repeat(a: torch.Tensor, repeats: int, axis: int) -> torch.Tensor:
    """Every element several times, one after the other along an axis."""
    return torch.repeat_interleave(a, repeats, axis)


def sort(a: torch.Tensor, axis: int = -1) -> torch.Tensor:
    """Values in ascending order along an axis."""
    return torch.sort(a, axis).values


def minimum(
    x1: torch.Tensor, x2: torch.Tensor | float, out: torch.Tensor | None = None
) -> torch.Tensor:
    """Smaller of tensors, or of a tensor and a number."""
    if isinstance(x2, torch.Tensor):
        return torch.minimum(x1, x2, out=out)
    return torch.clip(x1, max=x2, out=out)


def maximum(
    x1: torch.Tensor, x2: torch.Tensor | float, out: torch.Tensor | None = None
) -> torch.Tensor:
    """Larger of tensors, or of a tensor and a number."""
    if isinstance(x2, torch.Tensor):
        return torch.maximum(x1, x2, out=out)
    return torch.clip(x1, min=x2, out=out)


def copy(a: torch.Tensor) -> torch.Tensor:
    """Copy of a tensor."""
    return a.clone()


def median(a: torch.Tensor) -> torch.Tensor:
    """Median of all elements."""
    ordered = torch.sort(a.flatten()).values
    middle = ordered[(len(ordered) - 1) // 2 : len(ordered) // 2 + 1]
    return middle.mean()


def std(a: torch.Tensor) -> torch.Tensor:
    """Standard deviation of all elements."""
    return torch.std(a, correction=0)


def bincount(x: torch.Tensor, weights: torch.Tensor | None, minlength: int) -> torch.Tensor:
    """Number of every whole number below `minlength`, or sum of its weights, float64."""
    added = torch.ones_like(x) if weights is None else weights
    return x.new_zeros(minlength, dtype=torch.float64).index_add(0, x, added.double())


def ascontiguousarray(a: torch.Tensor) -> torch.Tensor:
    """Tensor whose elements lie one after the other."""
    return a.contiguous()


def hstack(some: Sequence[torch.Tensor | float]) -> torch.Tensor:
    """Tensors and numbers one after the other, float32 [n]; the first is a tensor."""
    first: Any = some[0]
    flat = [
        each.reshape(-1).float()
        if isinstance(each, torch.Tensor)
        else first.new_full((1,), each, dtype=torch.float32)
        for each in some
    ]
    return torch.cat(flat)
