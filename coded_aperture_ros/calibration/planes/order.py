"""Order of planes: pairs of neighbours whose pictures suit each other's depths better.

A mask that was found from planes in a wrong order explains that order in part: of twelve planes,
the fourth and the fifth exchanged, each was measured where its wrong depth put it. So each pair of
neighbours is judged by a mask and a lens that were found from other planes.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from coded_aperture_ros.calibration.mask.likelihood import MaskLikelihood
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.calibration.planes.search import LensFit, MaskSearch
from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError

Pair = tuple[int, int]

# Of fewer planes, those that remain do not tell the mask.
_MIN_PLANES = 5
# With so many planes half of the pairs that do not touch are left out together: 3 remain at least.
_MANY_PLANES = 8
# Exchanged depths have to be likelier by so much, as a logarithm for each window. Of 38 right lists
# five pairs had more than 0, at most 25: the two most blurred, by half a window. Of 58 lists with
# neighbours exchanged, 49 had 32 or more, pairs of the sample's planes 118 or more.
_MIN_GAIN = 30.0
# Blur sizes that differ by less, px, are not told apart; nor are the depths wrong by much then.
_MIN_STEP_PX = 0.3


def exchange_gains(search: MaskSearch, mixture: LensFit) -> dict[Pair, float]:
    """Gain in log-likelihood of a window if two neighbours are exchanged, by the other planes.

    Parameters
    ----------
    search : MaskSearch
    mixture : LensFit
        As `search` has found it from all planes: its side of the focus, its sizes, to start from,
        and its noise.

    Returns
    -------
    dict of (int, int) to float
        By the places of the two planes, from the nearest on. Positive: the exchanged depths are
        likelier. Pairs of about the same blur are left out, and all pairs of few planes.
    """
    gains = {}
    inverse = mixture.sizes.inverse_depths
    for pairs in search.progress(list(_left_out_together(len(inverse)))):
        found = search.without([plane for pair in pairs for plane in pair], mixture)
        lens = found.sizes.lens
        for pair in pairs:
            sizes_px = np.abs(lens.slope_px_m * (lens.inverse_focus - inverse[list(pair)]))
            sizes_px = np.clip(sizes_px, 0, search.likelihood.widest_px)
            if abs(sizes_px[1] - sizes_px[0]) >= _MIN_STEP_PX:
                gains[pair] = _gain(search.likelihood, found, pair, sizes_px, mixture.log_noise)
    return gains


def refuse_exchanged(planes: Planes, gains: Mapping[Pair, float]) -> None:
    """Raise `InputError` with the planes that are likelier in another order."""
    exchanged = sorted(pair for pair, gain in gains.items() if gain > _MIN_GAIN)
    if not exchanged:
        return
    depths = planes.depths_m
    if len(exchanged) == 1:
        first, second = exchanged[0]
        raise InputError(
            f"{planes.names[first]} and {planes.names[second]}: their depths, {depths[first]:g} "
            f"and {depths[second]:g} m, seem to be swapped: the blur suits the other planes' if "
            "they are exchanged"
        )
    concerned = sorted({plane for pair in exchanged for plane in pair})
    raise InputError(
        f"{', '.join(planes.names[plane] for plane in concerned)}: their depths, "
        f"{', '.join(f'{depths[plane]:g}' for plane in concerned)} m, seem to be in another "
        "order: the blur suits the other planes' if neighbours are exchanged; check that every "
        "depth belongs to its picture"
    )


def _left_out_together(count: int) -> Iterator[list[Pair]]:
    """Groups of pairs of neighbours; every pair is in one group."""
    if count < _MIN_PLANES:
        return
    if count < _MANY_PLANES:
        yield from ([(first, first + 1)] for first in range(count - 1))
        return
    for offset in range(4):
        yield [(first, first + 1) for first in range(offset, count - 1, 4)]


def _gain(
    likelihood: MaskLikelihood,
    found: LensFit,
    pair: Pair,
    sizes_px: DoubleArray,
    log_noise: DoubleArray,
) -> float:
    first, second = (
        likelihood.plane_scores(plane, found.parts, sizes_px, log_noise[plane]) for plane in pair
    )
    # Scores are twice the negative log-likelihood.
    return float(first[0] + second[1] - first[1] - second[0]) / 2
