"""From energies to a blur level: the minimum, a parabola through it, and how sure it is."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank import FilterBank, WindowedFourierBasis

# The likelihood treats the windows' frequencies as independent and the model as perfect. Dividing
# the evidence by this factor makes up for what that overstates; chosen on ray-traced scenes.
_TEMPER = 4.0


def refine_level(energies: NDArray[np.float32], level: NDArray[np.intp]) -> NDArray[np.float32]:
    """Refine whole levels by the parabola through each level's energy and its neighbours'.

    At most half a level is added or taken away. At the ends of the range, and where the energy
    is not convex, the level stays whole.
    """
    last = energies.shape[-1] - 1
    if last < 2:
        return level.astype(np.float32)
    inner = np.clip(level, 1, last - 1)[..., None]
    below, here, above = (
        np.take_along_axis(energies, inner + step, axis=-1)[..., 0] for step in (-1, 0, 1)
    )
    curvature = below - 2 * here + above
    convex = (curvature > 0) & (inner[..., 0] == level)
    vertex = np.divide(below - above, 2 * curvature, out=np.zeros_like(here), where=convex)
    return (level + np.clip(vertex, -0.5, 0.5)).astype(np.float32)


def level_probability(
    energies: NDArray[np.float32], fourier: WindowedFourierBasis
) -> NDArray[np.float32]:
    """Return the probability of every level, each patch for itself.

    Parameters
    ----------
    energies : ndarray, float32 [rows, columns, L]
    fourier : WindowedFourierBasis
        Says how far the windowed frequencies repeat each other.

    Returns
    -------
    ndarray, float32 [rows, columns, L]
        Sums to one over the levels.
    """
    # A window spreads each frequency over its neighbours: so many coefficients tell one thing.
    window = fourier.window.astype(np.float64)
    repeated = (len(window) * np.sum(window**4)) ** 2
    excess = energies - energies.min(axis=-1, keepdims=True)
    likelihood = np.exp(excess * np.float32(-0.5 / (repeated * _TEMPER)))
    return likelihood / likelihood.sum(axis=-1, keepdims=True)


def confidence_of(
    level: NDArray[np.float32],
    probability: NDArray[np.float32],
    agreement: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return the probability that the true level agrees with the estimated one.

    Parameters
    ----------
    level : ndarray, float32 [rows, columns]
        Estimated fractional level.
    probability : ndarray, float32 [rows, columns, L]
        See `level_probability`. Where it is flat, nothing is known and the confidence is 0.
    agreement : ndarray, float32 [L, L]
        1 where two levels are as good as the same; see `agreeing_levels`.

    Returns
    -------
    ndarray, float32 [rows, columns]
        In [0, 1].
    """
    nearest = np.rint(level).astype(np.intp)
    confidence = np.einsum("ijl,ijl->ij", probability, agreement[nearest])
    flat = probability.max(axis=-1) <= 1.0001 / probability.shape[-1]
    return np.where(flat, np.float32(0), np.minimum(confidence, 1)).astype(np.float32)


def agreeing_levels(
    bank: FilterBank, depths_m: NDArray[np.float64] | None, tolerance: float = 0.05
) -> NDArray[np.float32]:
    """Return which levels are so near each other that either may stand for the other.

    Parameters
    ----------
    bank : FilterBank
    depths_m : ndarray, float64 [L], or None
        Depth of every level. Levels agree if their depths differ by at most `tolerance`; where
        depths are not known, neighbouring levels agree.
    tolerance : float, optional
        Relative.

    Returns
    -------
    ndarray, float32 [L, L]
        Row: estimated level; column: true level.
    """
    index = np.arange(bank.levels)
    if depths_m is None:
        return (np.abs(index[:, None] - index) <= 1).astype(np.float32)
    # By inverse depth, so that levels at or beyond the blur size of infinity agree too.
    inverse = np.abs(1 / depths_m)
    near = np.abs(inverse[:, None] - inverse) <= tolerance * inverse[:, None]
    return (near | (index[:, None] == index)).astype(np.float32)
