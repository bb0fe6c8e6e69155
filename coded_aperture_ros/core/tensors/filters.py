"""OpenCV's filters for tensors: functions of the same names, on the device of the tensor.

Each is linear and separable, and so a product with a matrix for each axis. The matrix is what
OpenCV makes of unit vectors: borders, fractional areas and centres are those of OpenCV. Only what
is largest and smallest around a pixel is not linear; it is found axis by axis.
"""

import itertools
from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
import torch
from cv2 import (
    BORDER_CONSTANT,
    BORDER_REFLECT,
    BORDER_REFLECT_101,
    BORDER_REPLICATE,
    INTER_AREA,
    INTER_LINEAR,
    INTER_NEAREST,
    INTER_NEAREST_EXACT,
)
from numpy.typing import NDArray
from torch.nn import functional

__all__ = [
    "BORDER_CONSTANT",
    "BORDER_REFLECT",
    "BORDER_REFLECT_101",
    "BORDER_REPLICATE",
    "INTER_AREA",
    "INTER_LINEAR",
    "INTER_NEAREST",
    "INTER_NEAREST_EXACT",
    "GaussianBlur",
    "absdiff",
    "accumulateProduct",
    "bilateralFilter",
    "blur",
    "boxFilter",
    "copyMakeBorder",
    "dilate",
    "erode",
    "medianBlur",
    "resize",
    "sepFilter2D",
    "subtract",
]

FloatArray = NDArray[np.float32]
# Matrices of the axes of a few frame sizes, each at most some MB.
_KEPT = 256


def blur(
    picture: torch.Tensor, size: tuple[int, int], *, borderType: int = BORDER_REFLECT_101
) -> torch.Tensor:
    """Mean over a box around every pixel; see ``cv2.blur``."""
    return _filtered(picture, ("blur", size[1], borderType), ("blur", size[0], borderType))


def boxFilter(  # noqa: N802  OpenCV's name
    picture: torch.Tensor, depth: int, size: tuple[int, int], *, normalize: bool, borderType: int
) -> torch.Tensor:
    """Sum, or mean, over a box around every pixel; see ``cv2.boxFilter``."""
    down, across = (("box", side, normalize, borderType) for side in size[::-1])
    return _filtered(picture, down, across)


def GaussianBlur(  # noqa: N802  OpenCV's name
    picture: torch.Tensor, size: tuple[int, int], sigma: float
) -> torch.Tensor:
    """Gaussian mean around every pixel; see ``cv2.GaussianBlur``."""
    return _filtered(picture, ("gaussian", sigma), ("gaussian", sigma))


def sepFilter2D(  # noqa: N802  OpenCV's name
    picture: torch.Tensor, depth: int, across: FloatArray, down: FloatArray
) -> torch.Tensor:
    """Picture filtered along both axes, of its own type; see ``cv2.sepFilter2D``."""
    return _filtered(picture, ("kernel", *down.tolist()), ("kernel", *across.tolist()))


def subtract(one: torch.Tensor, other: torch.Tensor, dst: torch.Tensor) -> torch.Tensor:
    """Difference; see ``cv2.subtract``."""
    return torch.sub(one, other, out=dst)


def accumulateProduct(  # noqa: N802  OpenCV's name
    one: torch.Tensor, other: torch.Tensor, dst: torch.Tensor
) -> None:
    """Add the product to the last tensor; see ``cv2.accumulateProduct``."""
    dst.addcmul_(one, other)


def absdiff(one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    """Difference without sign; see ``cv2.absdiff``."""
    return (one - other).abs()


def medianBlur(picture: torch.Tensor, side: int) -> torch.Tensor:  # noqa: N802  OpenCV's name
    """Median of the three by three pixels around every one; see ``cv2.medianBlur``."""
    if side != 3:
        raise ValueError(f"expected a median of three by three pixels, got a side of {side}")
    rows, columns = picture.shape
    around = copyMakeBorder(picture, 1, 1, 1, 1, BORDER_REPLICATE)
    low, middle, high = _ordered(*(around[i : i + rows] for i in range(3)))

    def beside(values: torch.Tensor) -> list[torch.Tensor]:
        return [values[:, j : j + columns] for j in range(3)]

    largest = torch.maximum(torch.maximum(*beside(low)[:2]), beside(low)[2])
    least = torch.minimum(torch.minimum(*beside(high)[:2]), beside(high)[2])
    return _ordered(largest, _ordered(*beside(middle))[1], least)[1]


def _ordered(
    a: torch.Tensor, b: torch.Tensor, c: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Smallest, middle and largest of three values."""
    low, high = torch.minimum(a, b), torch.maximum(a, b)
    rest = torch.minimum(high, c)
    return torch.minimum(low, c), torch.maximum(low, rest), torch.maximum(high, c)


def bilateralFilter(  # noqa: N802  OpenCV's name
    picture: torch.Tensor, diameter: int, sigma_colour: float, sigma_px: float
) -> torch.Tensor:
    """Mean of like colours around every pixel [rows, columns, channels]; see OpenCV's."""
    reach, (rows, columns, _) = diameter // 2, picture.shape
    around = copyMakeBorder(picture, reach, reach, reach, reach, BORDER_REFLECT_101)
    total, mean = torch.zeros_like(picture[..., :1]), torch.zeros_like(picture)
    for i, j in itertools.product(range(-reach, reach + 1), repeat=2):
        squared_px = i * i + j * j
        if squared_px > reach * reach:
            continue
        theirs = around[reach + i : reach + i + rows, reach + j : reach + j + columns]
        # OpenCV adds up the channels' differences.
        apart = (theirs - picture).abs().sum(-1, keepdim=True) / sigma_colour
        weight = torch.exp(-(apart**2) / 2 - squared_px / (2 * sigma_px**2))
        total += weight
        mean += weight * theirs
    return mean / total


def resize(
    picture: torch.Tensor,
    size: tuple[int, int] | None,
    dst: torch.Tensor | None = None,
    fx: float = 0,
    fy: float = 0,
    interpolation: int = INTER_LINEAR,
) -> torch.Tensor:
    """Picture [rows, columns(, channels)] of another size (width, height); see ``cv2.resize``."""
    width, height = size or (0, 0)
    down, across = (("resize", *axis, interpolation) for axis in ((height, fy), (width, fx)))
    resized = _filtered(picture, down, across)
    return resized if dst is None else dst.copy_(resized)


def copyMakeBorder(  # noqa: N802  OpenCV's name
    picture: torch.Tensor, top: int, bottom: int, left: int, right: int, kind: int
) -> torch.Tensor:
    """Picture with a border; see ``cv2.copyMakeBorder``."""
    down = _border(picture.shape[0], top, bottom, kind, picture.device)
    across = _border(picture.shape[1], left, right, kind, picture.device)
    return picture.index_select(0, down).index_select(1, across)


def dilate(picture: torch.Tensor, square: NDArray[np.uint8]) -> torch.Tensor:
    """Largest value in a square around every pixel; see ``cv2.dilate``."""
    down, across = square.shape
    flat = picture.reshape(1, 1, *picture.shape)
    found = functional.max_pool2d(flat, (down, 1), 1, (down // 2, 0))
    return functional.max_pool2d(found, (1, across), 1, (0, across // 2))[0, 0]


def erode(picture: torch.Tensor, square: NDArray[np.uint8]) -> torch.Tensor:
    """Smallest value in a square around every pixel; see ``cv2.erode``."""
    return -dilate(-picture, square)


def _filtered(
    picture: torch.Tensor, down: tuple[object, ...], across: tuple[object, ...]
) -> torch.Tensor:
    """Picture with a filter along each axis."""
    rows = _matrix(picture.shape[0], picture.device, *down)
    columns = _matrix(picture.shape[1], picture.device, *across)
    if picture.ndim == 2:
        return rows @ picture @ columns.T
    return (rows @ picture.movedim(2, 0) @ columns.T).movedim(0, 2)


@lru_cache(_KEPT)
def _matrix(length: int, device: torch.device, kind: str, *settings: float) -> torch.Tensor:
    """Matrix of a filter along an axis of some length."""
    along = _KINDS[kind](np.eye(length, dtype=np.float32), *settings)
    return torch.tensor(along, device=device)


def _blur(unit: FloatArray, side: float, border: float) -> NDArray[np.floating]:
    return cv2.blur(unit, (1, int(side)), borderType=int(border))


def _box(unit: FloatArray, side: float, normalize: float, border: float) -> NDArray[np.floating]:
    along = (1, int(side))
    return cv2.boxFilter(unit, -1, along, normalize=bool(normalize), borderType=int(border))


def _gaussian(unit: FloatArray, sigma: float) -> NDArray[np.floating]:
    """Unit vectors filtered along their columns, by what a broad picture becomes."""
    flat = np.repeat(unit.T[:, :, None], 3, axis=2)  # constant along the other axis
    return np.stack([cv2.GaussianBlur(one, (0, 0), sigma)[:, 1] for one in flat], axis=1)


def _kernel(unit: FloatArray, *weights: float) -> NDArray[np.floating]:
    return cv2.sepFilter2D(unit, -1, np.ones(1, np.float32), np.array(weights, np.float32))


def _resize(
    unit: FloatArray, length: float, scale: float, interpolation: float
) -> NDArray[np.floating]:
    if length:
        return cv2.resize(unit, (len(unit), int(length)), interpolation=int(interpolation))
    return cv2.resize(unit, None, fx=1, fy=scale, interpolation=int(interpolation))


_KINDS: dict[str, Callable[..., NDArray[np.floating]]] = {
    "blur": _blur,
    "box": _box,
    "gaussian": _gaussian,
    "kernel": _kernel,
    "resize": _resize,
}


@lru_cache(_KEPT)
def _border(length: int, before: int, after: int, kind: int, device: torch.device) -> torch.Tensor:
    """Pixel of an axis that each pixel of the picture with a border shows."""
    index = np.arange(length, dtype=np.int32)[:, None]
    return torch.tensor(cv2.copyMakeBorder(index, before, after, 0, 0, kind)[:, 0], device=device)
