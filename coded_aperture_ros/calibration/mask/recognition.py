"""Recognition of a mask found from planes among known ones, and its extent.

A mask found from power spectra has soft edges, so that its extent is uncertain by a cell. A known
mask with the same spectra has an exact one.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.mask.cells import square_cells
from coded_aperture_ros.calibration.mask.fit import MaskFit, normalised
from coded_aperture_ros.calibration.mask.likelihood import MaskLikelihood
from coded_aperture_ros.calibration.mask.sizes import LensSizes
from coded_aperture_ros.optics import Mask

# Extents to try, relative to the grid of the fit; a mask may have a closed rim beyond it.
_EXTENTS = np.geomspace(0.4, 1.35, 11)
_TOLERANCE = 0.01
# Every so many-th plane is enough to find the two best masks.
_PLANE_STEP = 3
# A mask is recognised if it falls short of the free fit by no more than this share of what the
# next best mask falls short.
_MAX_SHORTFALL_RATIO = 0.6


def recognise_mask(
    likelihood: MaskLikelihood, fit: MaskFit[LensSizes], masks: Sequence[Mask]
) -> tuple[Mask, float] | None:
    """Mask that explains the planes nearly as well as a free fit, and its extent.

    The extent is that of the mask's grid at the most blurred plane, px. None if no mask is clearly
    better than the others.
    """
    coarse = [_scores(likelihood, fit, mask, _PLANE_STEP).min() for mask in masks]
    found = {int(i): fit_extent(likelihood, fit, masks[i]) for i in np.argsort(coarse)[:2]}
    best, second = sorted(found, key=lambda i: found[i][1])
    shortfall, second_shortfall = (found[i][1] - fit.score for i in (best, second))
    if shortfall > _MAX_SHORTFALL_RATIO * second_shortfall:
        return None
    return masks[best], found[best][0]


def fit_extent(
    likelihood: MaskLikelihood, fit: MaskFit[LensSizes], mask: Mask
) -> tuple[float, float]:
    """Likeliest extent of a mask at the most blurred plane, px, and its score."""
    import scipy.optimize

    scores = _scores(likelihood, fit, mask)
    best = int(np.clip(np.argmin(scores), 1, len(_EXTENTS) - 2))
    cells = normalised(square_cells(mask)[None])
    found = scipy.optimize.minimize_scalar(
        lambda extent: likelihood.score(cells, extent * fit.sizes_px, fit.log_noise),
        bounds=(_EXTENTS[best - 1], _EXTENTS[best + 1]),
        method="bounded",
        options={"xatol": _TOLERANCE},
    )
    return float(found.x) * fit.sizes.extent_px, float(found.fun)


def _scores(
    likelihood: MaskLikelihood, fit: MaskFit[LensSizes], mask: Mask, every: int = 1
) -> NDArray:
    """Score of every extent to try."""
    cells = normalised(square_cells(mask)[None])
    return likelihood.scores(cells, _EXTENTS[:, None] * fit.sizes_px, fit.log_noise, every)
