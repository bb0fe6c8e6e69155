"""Light through every opening of the mask, past layers that occlude each other."""

import dataclasses
from importlib import import_module
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.optics.pixels import cell_shares

# Layers are drawn on canvases this much finer than the frame.
FINENESS = 2
# An opening of the mask is sampled where its image is at most as wide, in pixels of the frame.
_SAMPLE_PX = 0.9
# Averaging a mask over coarser cells blurs its image: narrow ones would look wider than they are.
FEWEST_CELLS = 13


@dataclasses.dataclass(frozen=True, eq=False)
class Layer:
    """A textured surface, cut out by a matte, whose blur size is linear in the picture.

    Attributes
    ----------
    top, left : float
        Where the middle of the canvas' first pixel lies, in pixels of the frame.
    light, cover : ndarray, float32 [rows, columns]
        Linear light times cover, and how much of what is behind is hidden, 0 to 1; `FINENESS` per
        pixel, each the mean over a pixel of the frame.
    blur_px : (float, float, float)
        Signed blur size at the frame's first pixel, and its change per pixel down and right. A
        plane in space has one that is exactly linear.
    relief_px : ndarray, float32 [rows, columns], or None
        What a curved surface adds to the blur size.
    """

    top: float
    left: float
    light: FloatArray
    cover: FloatArray
    blur_px: tuple[float, float, float]
    relief_px: FloatArray | None = None


def lens_samples(
    mask: Mask, widest_px: float, fewest_cells: int = FEWEST_CELLS, sample_px: float = _SAMPLE_PX
) -> FloatArray:
    """Return points of the aperture and their weights [n, 3]: down, right, share of the light.

    In units of the mask's extent, from its middle; so many that blur of a width has no gaps. A mask
    of more cells is averaged over no fewer than `fewest_cells` along a side. Samples lie at most
    `sample_px` apart in the image.
    """
    cells = max(mask.transmission.shape)
    wanted = int(np.ceil(widest_px / sample_px))
    grid: NDArray[np.floating] = mask.transmission.astype(np.float64)
    if cells > max(wanted, fewest_cells):  # finer than the sensor sees
        wanted = max(wanted, fewest_cells)
        down, across = (cell_shares(wanted, length, wanted / cells) for length in grid.shape)
        grid = down @ grid @ across.T
    else:
        grid = np.kron(grid, np.ones((max(-(-wanted // cells), 1),) * 2))
    rows, columns = np.nonzero(grid > 1e-6)
    side = max(grid.shape)
    down = (rows + 0.5 - grid.shape[0] / 2) / side
    right = (columns + 0.5 - grid.shape[1] / 2) / side
    weights = grid[rows, columns] / grid.sum()
    return np.column_stack([down, right, weights]).astype(np.float32)


def traced(layers: list[Layer], shape: tuple[int, int], samples: FloatArray) -> FloatArray:
    """Light of layers, nearest first, that reaches a sensor through an aperture.

    Parameters
    ----------
    layers : list of Layer
        The last one should cover everything.
    shape : (int, int)
        Rows and columns of the frame.
    samples : ndarray, float32 [n, 3]
        See `lens_samples`; a single one in the middle gives the all-in-focus picture.

    Returns
    -------
    ndarray, float32 [rows, columns]

    Raises
    ------
    InputError
        If numba is not installed.
    """
    return np.asarray(_kernels().trace(*_packed(layers), np.asarray(samples, np.float32), *shape))


def seen_from_centre(layers: list[Layer], shape: tuple[int, int]) -> FloatArray:
    """Signed blur size of the surface that each pixel's centre shows."""
    return np.asarray(_kernels().front(*_packed(layers), *shape))


def prefiltered(canvas: FloatArray) -> FloatArray:
    """Average a canvas over squares of one pixel of the frame, as the sensor's pixels do."""
    return np.asarray(cv2.blur(canvas, (FINENESS,) * 2, anchor=(0, 0)))


def _packed(layers: list[Layer]) -> tuple[Any, ...]:
    table = np.zeros((len(layers), 5), np.float32)
    sizes = np.zeros((len(layers), 4), np.int64)
    light = []
    cover = []
    relief = []
    offset = bumps = 0
    for index, layer in enumerate(layers):
        table[index] = (layer.top, layer.left, *layer.blur_px)
        sizes[index] = (offset, *layer.light.shape, -1 if layer.relief_px is None else bumps)
        light.append(layer.light.ravel())
        cover.append(layer.cover.ravel())
        offset += layer.light.size
        if layer.relief_px is not None:
            relief.append(layer.relief_px.ravel())
            bumps += layer.relief_px.size
    flat = [np.concatenate(parts).astype(np.float32) for parts in (light, cover)]
    bumpy = np.concatenate(relief).astype(np.float32) if relief else np.zeros(1, np.float32)
    return table, sizes, flat[0], flat[1], bumpy


def compiled(module: str, what: str) -> Any:
    """Module of compiled loops, by its full name; an `InputError` without numba."""
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(
            f"{what} need numba: pip install numba (on Ubuntu: apt install python3-numba)"
        ) from error


def _kernels() -> Any:
    return compiled("coded_aperture_ros.simulation.layered.kernels", "random scenes")
