"""Copies between the processor's memory and that of a device."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray


def upload_to(device: str) -> Callable[[NDArray[Any]], torch.Tensor]:
    """Function that copies arrays to a device; it does not wait for a GPU."""

    def upload(array: NDArray[Any]) -> torch.Tensor:
        tensor = tensor_of(array)
        if device == "cpu":
            return tensor.clone()  # as on a GPU: what changes the array later changes no tensor
        return tensor.pin_memory().to(device, non_blocking=True)

    return upload


def copy_without_waiting(target: torch.Tensor, source: torch.Tensor) -> None:
    """Copy a tensor to one on a device, which takes it in its turn; what becomes of it is free."""
    if target.device.type != "cpu" and source.device.type == "cpu":
        source = source.pin_memory()  # a copy, which is kept until the device has read it
    target.copy_(source, non_blocking=True)


def tensor_of(values: NDArray[Any] | torch.Tensor) -> torch.Tensor:
    """Tensor of an array, which need not be writable or contiguous."""
    if isinstance(values, torch.Tensor):
        return values
    array = np.ascontiguousarray(values)
    return torch.from_numpy(array if array.flags.writeable else array.copy())


def download(tensors: Mapping[str, torch.Tensor]) -> dict[str, NDArray[Any]]:
    """Arrays of tensors by name, copied at once; the device's work is finished then."""
    tensors = {name: each.contiguous() for name, each in tensors.items()}
    if all(each.device.type == "cpu" for each in tensors.values()):
        return {name: each.numpy() for name, each in tensors.items()}
    here = {
        name: torch.empty_like(each, device="cpu", pin_memory=True)
        for name, each in tensors.items()
    }
    for name, each in tensors.items():
        here[name].copy_(each, non_blocking=True)
    torch.cuda.current_stream().synchronize()
    return {name: each.numpy() for name, each in here.items()}
