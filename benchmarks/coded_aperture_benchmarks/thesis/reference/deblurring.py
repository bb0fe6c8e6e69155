"""What others deblur with, one plane at a time, each pixel taken from the plane of its own level.

scikit-image's Lucy-Richardson and Wiener deconvolution, and the deconvolution with a sparse prior
of Levin et al. (2007), written out here. None of them knows a blur that changes from pixel to
pixel: the frame is deconvolved with the PSF of every level that there is, and cut together.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_benchmarks.metrics.restoration import missing_scikit_image
from coded_aperture_benchmarks.thesis.reference.deconvolution import (
    PeriodicPicture,
    SparseDescent,
    sparse_descent,
)
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import transfer_function
from coded_aperture_ros.optics import PsfStack

# A level that is found here and there is not worth deconvolving everything in between.
_TILE_PX = 128
# Less light counts as that much: Lucy-Richardson multiplies, and knows no negative light.
_LUCY_DARKEST = np.float32(1e-4)

# A picture with a margin [h, w], its PSF and the strength give the sharp picture [h, w].
Deconvolver = Callable[[NDArray[np.float32], NDArray[np.float32], float], NDArray[np.floating]]


@dataclasses.dataclass(frozen=True)
class PlaneMethod:
    """A way to deconvolve one plane.

    Attributes
    ----------
    deconvolve : callable
        Takes a grey picture, a PSF and a strength.
    parameter : str
        What the strength is.
    ladder : tuple of float
        The strengths that are worth trying, in order.
    margin_widths : float
        How far around its pixels a plane is deconvolved, in widths of the PSF. The best on stairs
        of photographs that are not scored: wide where what lies beyond is taken for black or
        periodic, narrow where the blur of other planes, which does not fit, is all that is won.
    beyond_border : bool
        Whether the frame has to go on beyond its border, as its last pixels do.
    """

    deconvolve: Deconvolver
    parameter: str
    ladder: tuple[float, ...]
    margin_widths: float = 2.0
    beyond_border: bool = True

    def margin_px(self, psf: NDArray[np.float32]) -> int:
        """Return the margin for a PSF [k, k]."""
        return int(np.ceil(self.margin_widths * len(psf)))


def _richardson_lucy(
    picture: NDArray[np.float32], psf: NDArray[np.float32], iterations: float
) -> NDArray[np.floating]:
    restoration = _scikit_image()
    # Measured PSFs have a little noise below 0, which the method has no use for.
    light = np.maximum(psf, 0)
    sharp: NDArray[np.floating] = restoration.richardson_lucy(
        np.maximum(picture, _LUCY_DARKEST), light / light.sum(), num_iter=int(iterations)
    )
    return sharp


def _wiener(
    picture: NDArray[np.float32], psf: NDArray[np.float32], balance: float
) -> NDArray[np.floating]:
    # It takes the picture for periodic. The PSF has to be given as such: a transfer function is
    # taken for one only if its shape is right, and is stripped of its imaginary part.
    periodic = PeriodicPicture.of(picture, len(psf))
    height, width = picture.shape
    sharp: NDArray[np.floating] = _scikit_image().wiener(periodic.extended, psf, balance)
    return sharp[:height, :width]


def _levin(
    picture: NDArray[np.float32], psf: NDArray[np.float32], strength: float
) -> NDArray[np.floating]:
    """Minimise ``|g - h * f|^2 + m sum |grad f|^0.8`` over both directions of the gradient.

    The sharp picture reaches half a PSF beyond the coded one, where nothing is known of it, so
    that no border is invented.

    It is thorough where `deconvolution.levin`, made to tell levels apart, is quick.
    """
    reach = len(psf) // 2
    height, width = picture.shape
    shape = tuple(scipy.fft.next_fast_len(side + 2 * reach, real=True) for side in picture.shape)
    seen = (slice(reach, reach + height), slice(reach, reach + width))
    below, right = (side - reach - of for side, of in zip(shape, picture.shape, strict=True))
    start = np.pad(picture, ((reach, below), (reach, right)), mode="edge")
    periodic = PeriodicPicture(start, (height, width))
    transfer = transfer_function(psf, (shape[0], shape[1]))

    def back(residual: NDArray[np.float32]) -> NDArray[np.float32]:
        """Transpose of blurring and looking at what is seen."""
        whole = np.zeros(shape, np.float32)
        whole[seen] = residual
        return periodic.back(np.conj(transfer) * scipy.fft.rfft2(whole))

    sharp = sparse_descent(
        periodic,
        start,
        back(picture),
        lambda image: back(periodic.back(transfer * scipy.fft.rfft2(image))[seen]),
        transfer.real**2 + transfer.imag**2,
        SparseDescent(np.float32(strength), np.float32(0.01), reweightings=4, steps=8),
    )
    return sharp[seen]


def _steps(first: float, last: float, count: int) -> tuple[float, ...]:
    return tuple(float(f"{value:.3g}") for value in np.geomspace(first, last, count))


PLANE_METHODS: dict[str, PlaneMethod] = {
    "richardson_lucy": PlaneMethod(
        _richardson_lucy, "iterations", (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
    ),
    "wiener": PlaneMethod(_wiener, "balance", _steps(1e-8, 10, 19)),
    "levin": PlaneMethod(
        _levin, "strength", _steps(1e-7, 0.1, 13), margin_widths=0.5, beyond_border=False
    ),
}
DEBLURRING_METHODS = tuple(PLANE_METHODS)


def deblur_by_planes(
    method: str,
    coded: NDArray[np.float32],
    level: NDArray[np.integer],
    stack: PsfStack,
    strength: float,
) -> NDArray[np.float32]:
    """Deblur a frame with the PSF of every pixel's level.

    Parameters
    ----------
    method : str
        One of `DEBLURRING_METHODS`.
    coded : ndarray of float32, shape [rows, columns] or [rows, columns, channels]
        Intensities, 0 to 1. Beyond the border the last pixel goes on.
    level : ndarray of integer, shape [rows, columns]
        Index into the stack.
    strength : float
        What it is depends on the method; see `PlaneMethod.parameter`.

    Returns
    -------
    ndarray of float32, like `coded`
        In [0, 1].
    """
    plane_method = _method(method)
    if level.shape != coded.shape[:2]:
        raise InputError(
            f"levels: expected one for each pixel, {list(coded.shape[:2])}, "
            f"got the shape {list(level.shape)}"
        )
    if level.dtype.kind not in "iu" or level.min() < 0 or level.max() >= len(stack):
        raise InputError(f"levels: expected integers from 0 to {len(stack) - 1}")
    channels = coded[..., None] if coded.ndim == 2 else coded
    psfs = [_trimmed(psf) for psf in stack.psfs]
    border = max(map(plane_method.margin_px, psfs)) if plane_method.beyond_border else 0
    extended = np.pad(channels, ((border, border), (border, border), (0, 0)), mode="edge")
    sharp = np.empty_like(channels)
    for index, box in _boxes(level):
        margin = plane_method.margin_px(psfs[index])
        # The box with its margin in the extended frame, and the box in what is cut out there.
        around = tuple(
            slice(max(side.start + border - margin, 0), side.stop + border + margin) for side in box
        )
        inside = tuple(
            slice(side.start + border - outer.start, side.stop + border - outer.start)
            for side, outer in zip(box, around, strict=True)
        )
        here = level[box] == index
        for channel, patch in enumerate(np.moveaxis(extended[around], -1, 0)):
            found = plane_method.deconvolve(np.ascontiguousarray(patch), psfs[index], strength)
            sharp[(*box, channel)][here] = found[inside][here]
    return np.clip(sharp, 0, 1).reshape(coded.shape)


def best_strength(method: str, error: Callable[[float], float]) -> float:
    """Return the strength of least error on a method's ladder, with one minimum.

    Parameters
    ----------
    method : str
        One of `DEBLURRING_METHODS`.
    error : callable
        The error that a strength leaves, on a frame that is not scored.
    """
    ladder = _method(method).ladder
    known: dict[int, float] = {}

    def at(step: int) -> float:
        if not 0 <= step < len(ladder):
            return float("inf")
        if step not in known:
            known[step] = error(ladder[step])
        return known[step]

    step = len(ladder) // 2
    way = 1 if at(step + 1) < at(step) else -1
    while at(step + way) < at(step):
        step += way
    return ladder[step]


def _method(name: str) -> PlaneMethod:
    if name not in PLANE_METHODS:
        raise InputError(
            f"unknown reference method {name!r}: use one of {', '.join(DEBLURRING_METHODS)}"
        )
    return PLANE_METHODS[name]


def _boxes(level: NDArray[np.integer]) -> Iterator[tuple[int, tuple[slice, slice]]]:
    """Yield, tile by tile, every level in it and the box of the level's pixels."""
    for top in range(0, level.shape[0], _TILE_PX):
        for left in range(0, level.shape[1], _TILE_PX):
            tile = level[top : top + _TILE_PX, left : left + _TILE_PX]
            for index in np.unique(tile):
                here = tile == index
                down, across = (np.flatnonzero(here.any(axis=axis)) for axis in (1, 0))
                rows = slice(top + int(down[0]), top + int(down[-1]) + 1)
                yield int(index), (rows, slice(left + int(across[0]), left + int(across[-1]) + 1))


def _trimmed(psf: NDArray[np.float32]) -> NDArray[np.float32]:
    """Cut off the border of zeros that PSFs of a stack have for the sake of the widest."""
    middle = len(psf) // 2
    rows, columns = np.nonzero(psf)
    reach = int(max(np.abs(rows - middle).max(), np.abs(columns - middle).max()))
    inside = slice(middle - reach, middle + reach + 1)
    return np.ascontiguousarray(psf[inside, inside])


def _scikit_image() -> Any:
    try:
        from skimage import restoration
    except ImportError as error:
        raise missing_scikit_image("Lucy-Richardson and Wiener deconvolution") from error
    return restoration
