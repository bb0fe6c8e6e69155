"""Constants on a device, each copied there once."""

import weakref
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

# Constants of a few frame sizes; one is at most a matrix of an axis, some MB.
_KEPT = 1024
# Arrays of so many bytes are known by themselves, too, as long as they exist: to compare the bytes
# of a map of a frame would take a millisecond.
_LARGE = 2**18
_large: dict[tuple[int, torch.device], tuple[weakref.ref[Any], torch.Tensor]] = {}


def kept_on_device(values: NDArray[Any], device: torch.device) -> torch.Tensor:
    """Tensor of an array; equal arrays share one, which must not be changed, nor the array.

    A copy from the processor's memory makes a GPU wait, and cannot be recorded.
    """
    key = id(values), device
    array, known = _large.get(key, (None, None))
    if array is not None and known is not None and array() is values:
        return known
    tensor = _copied(values.tobytes(), values.shape, values.dtype.str, device)
    if values.nbytes >= _LARGE:
        _large[key] = weakref.ref(values, lambda _: _large.pop(key, None)), tensor
    return tensor


def forget() -> None:
    """Release all tensors."""
    _copied.cache_clear()
    _large.clear()


@lru_cache(_KEPT)
def _copied(data: bytes, shape: tuple[int, ...], dtype: str, device: torch.device) -> torch.Tensor:
    return torch.tensor(np.frombuffer(data, dtype).reshape(shape), device=device)
