"""Whether a mask found from planes is one that is known, and how large it is then.

A mask found from power spectra has soft edges, so that its extent is uncertain by a cell. A known
mask with the same spectra has an exact one.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.mask.fit import MaskFit, normalised
from coded_aperture_ros.calibration.mask.likelihood import MaskLikelihood
from coded_aperture_ros.optics import Mask

# Extents to try, relative to the grid of the fit; a mask may have a closed rim beyond it.
_EXTENTS = np.geomspace(0.4, 1.35, 11)
_REFINEMENTS = 3
# Every so many-th plane is enough to find the two best masks.
_EVERY = 3
# A mask is recognised if it falls short of the free fit by no more than this share of what the
# next best mask falls short.
_CLEARLY_BETTER = 0.6


def recognised_mask(
    likelihood: MaskLikelihood, fit: MaskFit, masks: Sequence[Mask]
) -> tuple[Mask, float] | None:
    """Return the mask that explains the planes nearly as well as the fit, and its extent.

    Parameters
    ----------
    likelihood : MaskLikelihood
    fit : MaskFit
        The free fit; its focus is kept.
    masks : sequence of Mask
        At least two, or there is nothing to compare the best with.

    Returns
    -------
    (Mask, float) or None
        With the extent of the mask's grid at the most blurred plane, px. None if no mask is
        clearly better than the others.
    """
    few = range(0, len(fit.inverse_depths), _EVERY)
    guesses = _EXTENTS[:, None] * fit.blur_sizes_px
    coarse = [likelihood.scores(_cells(mask), guesses, fit.log_noise, few).min() for mask in masks]
    found = {int(i): fitted_extent(likelihood, fit, masks[i]) for i in np.argsort(coarse)[:2]}
    best, second = sorted(found, key=lambda i: found[i][1])
    shortfall, second_shortfall = (found[i][1] - fit.score for i in (best, second))
    if shortfall > _CLEARLY_BETTER * second_shortfall:
        return None
    return masks[best], found[best][0]


def fitted_extent(likelihood: MaskLikelihood, fit: MaskFit, mask: Mask) -> tuple[float, float]:
    """Return the likeliest extent of a mask at the most blurred plane, px, and its score."""
    cells = _cells(mask)

    def score(extent: float) -> float:
        return likelihood.score(cells, extent * fit.blur_sizes_px, fit.log_noise)

    extents = list(_EXTENTS)
    scores = likelihood.scores(cells, _EXTENTS[:, None] * fit.blur_sizes_px, fit.log_noise)
    best = int(np.clip(np.argmin(scores), 1, len(extents) - 2))
    near = [(extents[i], scores[i]) for i in (best - 1, best, best + 1)]
    for _ in range(_REFINEMENTS):
        (low, _), (middle, _), (high, _) = near
        between = [(extent, score(extent)) for extent in ((low + middle) / 2, (middle + high) / 2)]
        near = sorted([*near, *between])
        best = int(np.clip(np.argmin([value for _, value in near]), 1, len(near) - 2))
        near = near[best - 1 : best + 2]
    extent, value = _vertex(near)
    return extent * fit.extent_px, value


def _cells(mask: Mask) -> NDArray[np.float64]:
    return normalised(_square(mask)[None])


def _vertex(points: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the minimum of the parabola through three points, or the lowest of them."""
    x, y = np.array(points).T
    a, b, c = np.polyfit(x - x[1], y, 2)
    lowest = int(np.argmin(y))
    if lowest != 1 or a <= 0:
        return float(x[lowest]), float(y[lowest])
    return float(x[1] - b / (2 * a)), float(c - b**2 / (4 * a))


def _square(mask: Mask) -> NDArray[np.float64]:
    """Return the cells on a square grid, as the longer side spans the extent."""
    cells = mask.transmission.astype(np.float64)
    rows, columns = cells.shape
    side = max(rows, columns)
    # Twice as fine, so that any margin is a whole number of cells.
    fine = np.zeros((2 * side, 2 * side))
    top, left = side - rows, side - columns
    fine[top : top + 2 * rows, left : left + 2 * columns] = cells.repeat(2, 0).repeat(2, 1)
    return fine
