"""From PSFs measured at some depths to a stack of equally spaced blur sizes."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coded_aperture_ros.errors import InputError
from coded_aperture_ros.optics import Mask, PsfStack, render_psf_stack

# PSFs whose blur sizes differ less are one: a level between them is not told apart.
_CLOSEST_PX = 0.02


def equally_spaced_stack(
    psfs: list[NDArray[np.float64]],
    blur_sizes_px: ArrayLike,
    levels: int | None = None,
    depths_m: ArrayLike | None = None,
    mask: Mask | None = None,
) -> PsfStack:
    """Interpolate measured PSFs to equally spaced blur sizes.

    Between two measured PSFs, each is weighted by how near its blur size is: good for steps of up
    to a pixel. With a mask, only the difference from the mask's rendered PSFs is interpolated,
    which is good for any step.

    Parameters
    ----------
    psfs : list of ndarray, float [k, k]
        Centred, odd widths.
    blur_sizes_px : array of float, shape [N]
        Signed; in any order.
    levels : int, optional
        By default as many as there are PSFs.
    depths_m : array of float, shape [N], optional
        The stack then knows its depths: between two, the inverse depth is linear in blur size.
    mask : Mask, optional

    Returns
    -------
    PsfStack
        Blur sizes from the smallest to the largest measured.

    Raises
    ------
    InputError
        If two PSFs have one blur size, or depths and blur sizes do not go up or down together.
    """
    sizes = np.asarray(blur_sizes_px, np.float64)
    order = np.argsort(sizes)
    sizes = sizes[order]
    if len(sizes) > 1 and np.diff(sizes).min() < _CLOSEST_PX:
        raise InputError(
            f"two PSFs have the same blur size of {sizes[np.diff(sizes).argmin()]:.2f} px: take "
            "one picture for each depth, all on one side of the focus"
        )
    inverse = None
    if depths_m is not None:
        inverse = 1 / np.asarray(depths_m, np.float64)[order]
        if len(sizes) > 2 and np.unique(np.sign(np.diff(inverse))).size > 1:
            raise InputError(
                "the blur does not grow with the distance from one focus: check the order of the "
                "depths, and that all lie on one side of the focus"
            )
    count = len(sizes) if levels is None else levels
    wanted = np.linspace(sizes[0], sizes[-1], count) if count > 1 else sizes[:1]
    width = max(len(psf) for psf in psfs)
    measured = np.stack([_padded(psfs[number], width) for number in order])
    base = np.zeros((count, width, width))
    if mask is not None:
        base = _rendered(mask, wanted, width)
        measured = measured - _rendered(mask, sizes, width)
    found = base + np.stack([_between(measured, sizes, size) for size in wanted])
    found = np.maximum(found, 0)
    found /= found.sum(axis=(1, 2), keepdims=True)
    return PsfStack(
        wanted,
        found.astype(np.float32),
        None if inverse is None else 1 / np.interp(wanted, sizes, inverse),
    )


def _padded(psf: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    return np.pad(psf, (width - len(psf)) // 2)


def _rendered(mask: Mask, sizes: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    psfs = render_psf_stack(mask, sizes).psfs.astype(np.float64)
    margin = (psfs.shape[1] - width) // 2
    if margin > 0:
        psfs = psfs[:, margin:-margin, margin:-margin]
    return np.stack([_padded(psf, width) for psf in psfs])


def _between(
    psfs: NDArray[np.float64], sizes: NDArray[np.float64], size: float
) -> NDArray[np.float64]:
    """Return the PSF of a blur size from the two measured next to it."""
    above = int(np.clip(np.searchsorted(sizes, size), 1, max(len(sizes) - 1, 1)))
    if len(sizes) == 1:
        return psfs[0]
    below = above - 1
    share = (size - sizes[below]) / (sizes[above] - sizes[below])
    return np.asarray((1 - share) * psfs[below] + share * psfs[above])
