"""From residual energies of hypotheses to the cost of every level."""

from collections.abc import Sequence

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, namespace

# The noise of a patch is at least this share of the variance that was expected: without noise,
# rounding and the rank of the basis would decide.
MIN_NOISE_SHARE = np.float32(0.05)
MIN_EXCESS = np.float32(1e-3)
# The likelihood treats the windows' frequencies as independent and the model as perfect: the
# temperature of the posterior makes up for what that overstates; chosen on ray-traced scenes.
TEMPERATURE = 4.0
# Largest cost of one frame beside those of others.
_MAX_FRAME_COST = 12.0


def take_logarithm(excess: FloatArray, textureless: FloatArray, count: float) -> FloatArray:
    """Energy of every level, in place: twice the negative log-likelihood, but for a constant.

    The noise of each patch has its most likely value.

    Parameters
    ----------
    excess : ndarray, float32 [..., patches]
        Residual of the best hypothesis of every level over the expected noise; overwritten.
    textureless : ndarray, float32 [patches]
        The same without any texture: what noise alone explains better says nothing about the level.
    count : float
        Numbers that a patch consists of.

    Returns
    -------
    ndarray, float32 [..., patches]
        `excess` itself.

    Examples
    --------
    >>> import numpy as np
    >>> take_logarithm(np.float32([[1.0], [0.5]]), np.float32([1.0]), 100).round().tolist()
    [[0.0], [-69.0]]
    """
    np.clip(excess, MIN_EXCESS, np.maximum(textureless, MIN_EXCESS), out=excess)
    np.log(excess, out=excess)
    excess *= np.float32(count)
    return excess


def relative_cost(
    energies: FloatArray,
    window_correlation: float,
    usable: BoolArray | None = None,
    least: FloatArray | None = None,
) -> FloatArray:
    """Negative log-likelihood of every level, 0 for the likeliest.

    Parameters
    ----------
    energies : ndarray, float32 [rows, columns, L]
        See `take_logarithm`.
    window_correlation : float
        How many numbers of a patch are one independent measurement: windows correlate them.
    usable : ndarray, bool [rows, columns], optional
        Patches that count; elsewhere all levels cost 0.
    least : ndarray, float32 [rows, columns, 1], optional
        Energy that costs 0; by default the least of each patch.

    Returns
    -------
    ndarray, float32 [rows, columns, L]

    Examples
    --------
    >>> import numpy as np
    >>> relative_cost(np.float32([[[8.0, 24.0]]]), window_correlation=2.0).tolist()
    [[[0.0, 1.0]]]
    """
    xp = namespace(energies)
    cost = energies - (xp.amin(energies, -1, keepdims=True) if least is None else least)
    cost *= 0.5 / (window_correlation * TEMPERATURE)
    if usable is not None and xp is np:
        cost[~usable] = 0
    elif usable is not None:
        cost *= usable[..., None]
    return cost


def bounded_cost(volume: FloatArray) -> FloatArray:
    """Cost of one frame [..., L], limited so that no frame outweighs several others.

    Examples
    --------
    >>> import numpy as np
    >>> bounded_cost(np.float32([0.0, 5.0, 40.0])).tolist()
    [0.0, 5.0, 12.0]
    """
    bounded: FloatArray = namespace(volume).clip(volume, None, _MAX_FRAME_COST)
    return bounded


def plausible_ratios(ratios: DoubleArray, contrasts: Sequence[float], noise: float) -> slice:
    """Slice of the ratios that belong to the contrasts under a noise.

    Parameters
    ----------
    ratios : ndarray, float64 [S]
        Contrast over noise variance, in half decades.
    contrasts : sequence of float
        Variances of texture, in the same steps, at most S.
    noise : float
        Standard deviation, linear light, > 0.

    Examples
    --------
    >>> import numpy as np
    >>> plausible_ratios(10.0 ** np.arange(6), (0.01, 0.1), noise=0.01)
    slice(2, 4, None)
    """
    count = len(contrasts)
    wanted = min(contrasts) / noise**2
    first = int(np.argmin(np.abs(np.log(ratios / wanted))))
    first = min(first, len(ratios) - count)
    return slice(first, first + count)
