"""Types of arrays, and the functions for arrays of a kind: of NumPy, or tensors of PyTorch."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]
DoubleArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]
Uploads = Callable[[NDArray[Any]], Any]  # copies an array to a device
PerPatch = float | FloatArray  # a number for a whole frame, or one for each patch
Shape = tuple[int, int]  # rows and columns


def as_floats(values: NDArray[Any]) -> FloatArray:
    """Contiguous float32 array of numbers; copied only if they are not one already."""
    return np.ascontiguousarray(values, np.float32)


def namespace(array: Any) -> Any:
    """Module whose functions take an array: NumPy, or `core.tensors.functions` for tensors.

    Only functions that have one meaning in both serve both, such as `where`, `clip`, `stack`,
    `amin` and `argmax`, with axes by position, and with arrays or tensors as their first argument.
    """
    of_numpy = isinstance(array, np.ndarray)
    return np if of_numpy else import_module("coded_aperture_ros.core.tensors.functions")


def filters(array: Any) -> Any:
    """Module whose filters take an array: OpenCV, or `core.tensors.filters` for tensors."""
    of_numpy = isinstance(array, np.ndarray)
    return import_module("cv2" if of_numpy else "coded_aperture_ros.core.tensors.filters")


def constant(values: NDArray[Any], like: Any) -> Any:
    """Array as another one is: itself, or a tensor on the other's device, which is kept there."""
    if isinstance(like, np.ndarray):
        return values
    from coded_aperture_ros.core.tensors.constants import kept_on_device

    return kept_on_device(values, like.device)


def in_memory(array: Any) -> Any:
    """Array of NumPy of an array or tensor; waits for the device that computes it."""
    return array if isinstance(array, np.ndarray) else array.cpu().numpy()


def zeros(shape: tuple[int, ...], like: Any) -> Any:
    """Zeros of the kind of another array, on its device."""
    return np.zeros(shape, like.dtype) if isinstance(like, np.ndarray) else like.new_zeros(shape)


def quantiles(values: NDArray[Any], *shares: float, where: BoolArray | None = None) -> NDArray[Any]:
    """Quantiles along the first axis [shares, ...], as from ``np.quantile``.

    That takes several times as long for a few dozen numbers, and a frame needs many. With `where`
    [n], of these values only.
    """
    xp, last = namespace(values), len(values) - 1
    if where is not None:
        values = xp.where(where.reshape(-1, *[1] * (values.ndim - 1)), values, np.inf)
        last = where.sum() - 1
    ordered = xp.sort(values, axis=0)
    at = constant(np.array(shares), values) * last
    below = xp.asarray(at, dtype=xp.int64)
    above = xp.minimum(below + 1, last)
    part = (at - below).reshape(-1, *[1] * (values.ndim - 1))
    found: NDArray[Any] = ordered[below] + part * (ordered[above] - ordered[below])
    return found
