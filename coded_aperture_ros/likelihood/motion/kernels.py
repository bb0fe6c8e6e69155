"""Motion blur along a straight line at constant speed during the exposure."""

import dataclasses
import math

import numpy as np
import scipy.signal
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError


def motion_kernel(motion_px: tuple[float, float]) -> FloatArray:
    """PSF of a point that moves during the exposure: ``h_m`` of thesis eq. 7.2.

    A pixel's value is the share of the exposure that the point spends near it, counted by linear
    interpolation between pixels. The weights are polynomials between the places where the point
    passes rows and columns of pixels, and integrated exactly: the kernel is smooth in the motion,
    and its mean and direction are those of the line, however short that is.

    Parameters
    ----------
    motion_px : (float, float)
        Displacement during the exposure, px, to the right and down; the opposite one has the same
        kernel.

    Returns
    -------
    ndarray, float32 [k, k]
        Of unit sum; the odd width k is the smallest that holds the trace.

    Raises
    ------
    InputError
        If the motion is not finite.

    References
    ----------
    Martinello 2012, eq. 7.2.

    Examples
    --------
    >>> motion_kernel((2.0, 0.0)).round(3).tolist()
    [[0.0, 0.0, 0.0], [0.25, 0.5, 0.25], [0.0, 0.0, 0.0]]
    """
    right, down = (float(part) for part in motion_px)
    if not (math.isfinite(right) and math.isfinite(down)):
        raise InputError(f"motion: expected finite numbers of pixels, got {motion_px!r}")
    longest = max(abs(right), abs(down))
    reach = math.ceil(longest / 2 - 1e-9)
    width = 2 * reach + 1
    # When, in shares of the exposure, the point passes a row or a column of pixels.
    lines = np.arange(-reach, reach + 1)
    crossings = [lines / way + 0.5 for way in (right, down) if abs(way) > 1e-9]
    times = np.unique(np.clip(np.concatenate([[0.0, 1.0], *crossings]), 0.0, 1.0))
    begin, end = times[:-1], times[1:]
    middle = (begin + end) / 2
    kernel = np.zeros((width + 2, width + 2))  # the outermost only ever get zeros
    left, top = (np.floor((middle - 0.5) * way).astype(np.intp) for way in (right, down))
    for at, share in ((begin, 1 / 6), (middle, 4 / 6), (end, 1 / 6)):  # Simpson's rule
        x, y = ((at - 0.5) * way - first for way, first in ((right, left), (down, top)))
        for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
            weight = (y if row else 1 - y) * (x if column else 1 - x) * (end - begin) * share
            np.add.at(kernel, (top + row + reach + 1, left + column + reach + 1), weight)
    kernel = np.maximum(kernel[1:-1, 1:-1], 0)
    return (kernel / kernel.sum()).astype(np.float32)


def blurred_psf(
    psf: FloatArray, motion_px: tuple[float, float], width_px: int | None = None
) -> FloatArray:
    """PSF of defocus and motion together, ``h_d * h_m`` (thesis eq. 7.2).

    Parameters
    ----------
    psf : ndarray, float32 [k, k]
        PSF of defocus; k is odd.
    motion_px : (float, float)
        See `motion_kernel`.
    width_px : int, optional
        Odd width n of the result, at least that of the full convolution, which is the default.

    Returns
    -------
    ndarray, float32 [n, n]
        Of the same sum.

    References
    ----------
    Martinello 2012, eq. 7.2.

    Examples
    --------
    >>> import numpy as np
    >>> blurred_psf(np.ones((1, 1), np.float32), (0.0, 2.0))[:, 1].tolist()
    [0.25, 0.5, 0.25]
    """
    full = scipy.signal.convolve2d(psf, motion_kernel(motion_px))
    margin = 0 if width_px is None else (width_px - len(full)) // 2
    return np.pad(full, margin).astype(np.float32)


@dataclasses.dataclass(frozen=True, eq=False)
class Motions:
    """Motions that are distinguished.

    Examples
    --------
    >>> Motions.grid(2, [3.0], static=False).vectors_px.round(6).tolist()
    [[3.0, 0.0], [0.0, 3.0]]
    """

    # [M, 2]; displacement during the exposure, px: to the right, and down. Blur does not show the
    # sign, so no two of them are opposite. A vector of zeros is no motion.
    vectors_px: DoubleArray

    def __post_init__(self) -> None:
        vectors = np.array(self.vectors_px, np.float64)
        if vectors.ndim != 2 or vectors.shape[1] != 2 or not len(vectors):
            raise InputError(f"motions: expected the shape [M, 2], got {list(vectors.shape)}")
        if not np.isfinite(vectors).all():
            raise InputError("motions: all must be finite")
        vectors.setflags(write=False)
        object.__setattr__(self, "vectors_px", vectors)

    @staticmethod
    def grid(directions: int, lengths_px: ArrayLike, static: bool = True) -> "Motions":
        """Motions in equally spaced directions, each in all lengths.

        Parameters
        ----------
        directions : int
            Number of directions from 0 degrees, to the right, to 180.
        lengths_px : array_like of float
            Lengths, px, > 0.
        static : bool
            Whether no motion is the first of them.
        """
        lengths = np.atleast_1d(np.asarray(lengths_px, np.float64))
        if directions < 1 or not (lengths > 0).all() or not lengths.size:
            raise InputError(
                f"motions: expected a direction and lengths above 0 px, got {directions} and "
                f"{lengths.tolist()}"
            )
        angle = np.pi * np.arange(directions) / directions
        unit = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        vectors = (unit[:, None] * lengths[:, None]).reshape(-1, 2)
        return Motions(np.concatenate([np.zeros((int(static), 2)), vectors]))

    def __len__(self) -> int:
        return len(self.vectors_px)

    @property
    def longest_px(self) -> float:
        """Length of the longest motion, px."""
        return float(np.hypot(*self.vectors_px.T).max())

    def distances_px(self, to_px: ArrayLike) -> DoubleArray:
        """Distance of motions `to_px` [..., 2] from each of these [..., M], px, without sign."""
        right, down = np.moveaxis(np.asarray(to_px, np.float64)[..., None, :], -1, 0)
        own_right, own_down = self.vectors_px.T
        squared = (right - own_right) ** 2 + (down - own_down) ** 2
        opposite = (right + own_right) ** 2 + (down + own_down) ** 2
        return np.asarray(np.sqrt(np.minimum(squared, opposite)))
