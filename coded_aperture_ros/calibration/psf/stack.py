"""Stack of equally spaced blur sizes from PSFs measured at some depths."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coded_aperture_ros.calibration.psf.centre import CentredPsf
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import PsfStack

# PSFs whose blur sizes differ less are one: a level between them could not be distinguished.
_MIN_DISTANCE_PX = 0.02


def psf_stack(
    measured: Sequence[CentredPsf],
    level_count: int | None = None,
    depths_m: ArrayLike | None = None,
    names: Sequence[str] | None = None,
) -> PsfStack:
    """Stack of measured PSFs, in any order, interpolated to equally spaced blur sizes.

    A PSF between two measured ones is the mean of both, scaled to its size, each weighted by how
    near its size is.

    Parameters
    ----------
    measured : sequence of CentredPsf
    level_count : int, optional
        By default as many levels as PSFs.
    depths_m : array_like [N], optional
        Depth of each PSF, m. Between two, the inverse depth is linear in blur size.
    names : sequence of str, optional
        Names of the PSFs for messages.

    Raises
    ------
    InputError
        If two PSFs have one blur size, they lie on both sides of the focus, or depths and blur
        sizes do not go up or down together.
    """
    order = np.argsort([one.blur_size_px for one in measured])
    ranked = [measured[number] for number in order]
    labels = [f"PSF {number}" if names is None else names[number] for number in order]
    sizes = np.array([one.blur_size_px for one in ranked])
    if sizes[0] < 0 < sizes[-1]:
        raise InputError(
            f"{labels[0]} has a blur size of {sizes[0]:.2f} px, {labels[-1]} one of "
            f"{sizes[-1]:.2f} px: they are from both sides of the focus, measure each side alone"
        )
    for number in np.flatnonzero(np.diff(sizes) < _MIN_DISTANCE_PX):
        raise InputError(
            f"{labels[number]} and {labels[number + 1]} have the same blur size of "
            f"{sizes[number]:.2f} px: take one picture for each depth"
        )
    inverse = None
    if depths_m is not None:
        inverse = 1 / np.asarray(depths_m, np.float64)[order]
        slopes = np.diff(inverse)
        for number in np.flatnonzero(slopes * np.sum(slopes) <= 0):
            raise InputError(
                f"{labels[number]} at {1 / inverse[number]:g} m has a blur size of "
                f"{sizes[number]:.2f} px, {labels[number + 1]} at {1 / inverse[number + 1]:g} m "
                f"one of {sizes[number + 1]:.2f} px, unlike the others: check the depths, and that "
                "all lie on one side of the focus"
            )
    count = len(sizes) if level_count is None else level_count
    wanted = np.linspace(sizes[0], sizes[-1], count) if count > 1 else sizes[:1]
    width = max(one.width_px for one in measured)
    psfs = np.stack([_between(ranked, sizes, size, width) for size in wanted])
    return PsfStack(
        wanted,
        psfs.astype(np.float32),
        None if inverse is None else 1 / np.interp(wanted, sizes, inverse),
    )


def _between(ranked: list[CentredPsf], sizes: NDArray, size: float, width: int) -> NDArray:
    if len(sizes) == 1:
        return ranked[0].psf(width)
    above = int(np.clip(np.searchsorted(sizes, size), 1, len(sizes) - 1))
    share = (size - sizes[above - 1]) / (sizes[above] - sizes[above - 1])
    return np.asarray(
        (1 - share) * ranked[above - 1].psf(width, size / sizes[above - 1])
        + share * ranked[above].psf(width, size / sizes[above])
    )
