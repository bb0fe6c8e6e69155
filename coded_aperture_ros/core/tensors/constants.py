"""Constants on a device, each copied there once."""

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

# Constants of a few frame sizes; one is at most a matrix of an axis, some MB.
_KEPT = 1024


def kept_on_device(values: NDArray[Any], device: torch.device) -> torch.Tensor:
    """Tensor of an array; equal arrays share one, which must not be changed.

    A copy from the processor's memory makes a GPU wait, and cannot be recorded.
    """
    return _copied(values.tobytes(), values.shape, values.dtype.str, device)


@lru_cache(_KEPT)
def _copied(data: bytes, shape: tuple[int, ...], dtype: str, device: torch.device) -> torch.Tensor:
    return torch.tensor(np.frombuffer(data, dtype).reshape(shape), device=device)
