"""From what hypotheses leave unexplained to the cost of every level: the clip and the logarithm."""

from collections.abc import Sequence

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray

# A patch without any noise of its own is treated as having this share of the variance that was
# expected: without noise, rounding and the rank of the basis would decide.
OWN_NOISE = np.float32(0.05)
LEAST_EXCESS = np.float32(1e-3)
# The likelihood treats the windows' frequencies as independent and the model as perfect: the
# temperature of the posterior makes up for what that overstates; chosen on ray-traced scenes.
TEMPERATURE = 4.0
# Cost of one frame beside those of others counts up to here.
_LARGEST_COST = 12.0


def take_logarithm(excess: FloatArray, textureless: FloatArray, count: float) -> FloatArray:
    """Turn the least excess of every level into its energy, in place; of `count` numbers a patch.

    The energy is twice the negative log-likelihood, with the patch's own noise at its best value.
    The excess [..., patches] is what the best hypothesis of a level leaves of a patch, over the
    expected noise; `textureless` [patches] the same without any texture: what noise alone explains
    better says nothing about the level.
    """
    np.clip(excess, LEAST_EXCESS, np.maximum(textureless, LEAST_EXCESS), out=excess)
    np.log(excess, out=excess)
    excess *= np.float32(count)
    return excess


def relative_cost(
    energies: FloatArray,
    window_correlation: float,
    usable: BoolArray | None = None,
    least: FloatArray | None = None,
) -> FloatArray:
    """Return the cost volume: the negative log-likelihood of every level, 0 for the likeliest.

    Of `energies` [rows, columns, L]; see `take_logarithm`. `window_correlation` says how many of a
    patch's numbers tell one thing, for windows correlate them. Where `usable` is False, nothing is
    known: all levels cost 0. With `least` [rows, columns, 1], that energy costs 0.
    """
    cost = energies - (energies.min(axis=-1, keepdims=True) if least is None else least)
    cost *= np.float32(0.5 / (window_correlation * TEMPERATURE))
    if usable is not None:
        cost[~usable] = 0
    return cost


def bounded_cost(volume: FloatArray) -> FloatArray:
    """Cost of one frame [..., L] as far as it counts beside those of others."""
    return np.minimum(volume, np.float32(_LARGEST_COST))


def plausible_ratios(ratios: DoubleArray, contrasts: Sequence[float], noise: float) -> slice:
    """Return which of `ratios` [S] belong to contrasts under a noise (standard deviation, > 0).

    Ratios are contrast over noise variance, in half decades; the contrasts, in the steps of these,
    at most S variances.
    """
    count = len(contrasts)
    wanted = min(contrasts) / noise**2
    first = int(np.argmin(np.abs(np.log(ratios / wanted))))
    first = min(first, len(ratios) - count)
    return slice(first, first + count)
