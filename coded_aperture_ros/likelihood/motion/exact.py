"""Energies of motions from the spectra themselves, without a common basis.

A basis that all motions share leaves out a little of each, which decides between neighbouring
motions where there is hardly any noise. But it is exact enough for the slope and the contrast of a
patch's texture: under that texture all motions are compared exactly, and the best few again under
other textures.
"""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.likelihood import take_logarithm
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.likelihood.motion.bank import MotionBank, expected_powers
from coded_aperture_ros.likelihood.motion.kernels import Motions
from coded_aperture_ros.likelihood.plan import Plan, functions_of_products
from coded_aperture_ros.likelihood.scoring import MIN_EXCESS, MIN_NOISE_SHARE

# The best few of each patch are compared under so many contrasts, around the most likely one.
_CONTRASTS = 3
# Patches whose hypotheses are compared at a time.
_PATCHES = 128
# Number of ratios whose weights are kept beyond those that a frame needs: noise varies.
_SPARE_RATIOS = 2
# First step of the search for a motion, px.
_STEP_PX = 0.5
# A search takes about so many patches into account.
_SEARCH_PATCHES = 100


class ExactEnergies:
    """Energies of pairs of motion and level for all patches of a frame.

    The weights of all ratios of contrast and noise would be large; those of the ratios that are
    plausible under the frame's noise are made when they are needed, and kept.
    """

    def __init__(self, bank: MotionBank, plan: Plan, workers: Workers) -> None:
        self._bank = bank
        self._plan = plan
        self._workers = workers
        self._weights: dict[int, FloatArray] = {}
        self._spectra = np.empty((0, 0), np.float32)
        self._textureless = np.empty(0, np.float32)
        self._texture = np.empty((2, 0), np.intp)
        self._ratios = slice(0, 0)
        size = plan.features.shape[1] + 1
        slopes, motions, levels, _ = bank.expected.shape
        excess = max(motions, _CONTRASTS * slopes) * levels * _PATCHES
        self._group_spectra = np.empty((workers.threads, _PATCHES, size), np.float32)
        self._excess = np.empty((workers.threads, excess), np.float32)

    def take(self, spectra: FloatArray, texture: IndexArray, ratios: slice) -> None:
        """Take the patches of a frame.

        Parameters
        ----------
        spectra : ndarray, float32 [patches, F + 1]
            The plan's products of transforms in units of the noise, and 1.
        texture : ndarray, int [patches]
            Most likely texture of each, ``ratio * slopes + slope``, counted from the first of the
            `ratios`.
        ratios : slice
            Ratios that are plausible under the frame's noise.
        """
        ratio, slope = np.divmod(texture, len(self._bank.expected))
        self._spectra, self._texture = spectra, np.array([ratio + ratios.start, slope])
        self._textureless = spectra @ np.append(self._plan.features[-1], MIN_NOISE_SHARE)
        self._ratios = ratios
        self._make_weights()

    def all_energies(self, energies: FloatArray) -> None:
        """Write the energies of all motions under each patch's texture [M, L, patches]."""
        pairs = energies.reshape(-1, energies.shape[2])

        def compute(patches: IndexArray, thread: int) -> None:
            ratio, slope = self._texture[:, patches[0]]
            block = self._weights[int(ratio)][slope].reshape(len(pairs), -1)
            pairs[:, patches] = self._least([block], patches, len(pairs), thread)

        self._workers.each(compute, group_equal_rows(self._texture.T))

    def energies_for(self, motions: IndexArray) -> FloatArray:
        """Energies of `motions` [k, patches] under each patch's texture [k, L, patches]."""
        count, levels = len(motions), self._bank.defocus.levels
        energies = np.empty((count * levels, motions.shape[1]), np.float32)
        keys = np.vstack([motions, self._texture])

        def compute(patches: IndexArray, thread: int) -> None:
            ratio, slope = self._texture[:, patches[0]]
            block = self._weights[int(ratio)][slope, motions[:, patches[0]]]
            block = block.reshape(len(energies), -1)
            energies[:, patches] = self._least([block], patches, len(energies), thread)

        self._workers.each(compute, group_equal_rows(keys.T))
        return energies.reshape(count, levels, -1)

    def compare_best(
        self, energies: FloatArray, motions: IndexArray, seeded: BoolArray, count: int
    ) -> None:
        """Lower the energies of the best few motions to the least under several textures.

        Parameters
        ----------
        energies : ndarray, float32 [k, L, patches]
            As from `all_energies`; changed in place.
        motions : ndarray, int [k, patches]
            Indices of the motions.
        seeded : ndarray, bool [k, patches]
            Motions that are always among the best.
        count : int
            Motions of each patch that are compared.
        """
        best = energies.min(axis=1)
        best[seeded] = -np.inf
        count = min(count, len(best))
        rows = np.argpartition(best, count - 1, axis=0)[:count].T.ravel()
        patches = np.repeat(np.arange(best.shape[1]), count)
        contrasts = min(_CONTRASTS, self._ratios.stop - self._ratios.start)
        first = self._texture[0, patches] - contrasts // 2
        first = np.clip(first, self._ratios.start, self._ratios.stop - contrasts)
        keys = np.array([motions[rows, patches], first])
        found = np.empty((len(patches), self._bank.defocus.levels), np.float32)

        def compute(members: IndexArray, thread: int) -> None:
            motion, first = keys[:, members[0]].tolist()
            blocks = [
                weights[motion]
                for ratio in range(first, first + contrasts)
                for weights in self._weights[ratio]
            ]
            found[members] = self._least(blocks, patches[members], found.shape[1], thread).T

        self._workers.each(compute, group_equal_rows(keys.T))
        energies[rows, :, patches] = found

    def _least(
        self, blocks: list[FloatArray], patches: IndexArray, count: int, thread: int
    ) -> FloatArray:
        """Energies of patches [count, n]: the least of all blocks of weights [count, F + 1]."""
        spectra = self._group_spectra[thread, : len(patches)]
        np.take(self._spectra, patches, axis=0, out=spectra)
        excess = self._excess[thread, : len(blocks) * count * len(patches)]
        excess = excess.reshape(len(blocks), count, len(patches))
        for block, out in zip(blocks, excess, strict=True):
            np.matmul(block, spectra.T, out=out)
        least = excess[0] if len(blocks) == 1 else excess.min(axis=0)
        return take_logarithm(least, self._textureless[patches], self._plan.count)

    def _make_weights(self) -> None:
        """Make the weights of the ratios of the frame, and drop those of others."""
        needed = range(self._ratios.start, self._ratios.stop)
        for ratio in needed:
            if ratio not in self._weights:
                unneeded = [each for each in self._weights if each not in needed]
                if len(self._weights) >= len(needed) + _SPARE_RATIOS:
                    del self._weights[unneeded[0]]
                self._weights[ratio] = self._make_weights_for(ratio)

    def _make_weights_for(self, ratio: int) -> FloatArray:
        """Weights of the products of transforms, and 1, of a ratio [slopes, M, L, F + 1].

        See `Plan.hypotheses`, which are in the common basis.
        """
        bank, product = self._bank, self._bank.product
        multiplicity = product.fourier.multiplicity
        logarithms = product.log_determinants[ratio].astype(np.float64)
        gains = np.exp(logarithms / self._plan.count).astype(np.float32)
        gains = gains.reshape(*bank.expected.shape[:3], 1)
        size = self._plan.features.shape[1] + 1
        weights = np.empty((*bank.expected.shape[:3], size), np.float32)
        for index in np.ndindex(bank.expected.shape[:2]):
            variance = np.float32(product.ratios[ratio]) * bank.expected[index] + 1
            filters = multiplicity / variance * gains[index]
            weights[index][:, :-1] = _of_products(self._plan, filters.T).T
        weights[..., -1:] = MIN_NOISE_SHARE * gains
        return weights


def group_equal_rows(keys: IndexArray, size: int = _PATCHES) -> list[IndexArray]:
    """Indices of equal rows of `keys` [n, k], in groups of at most `size`."""
    order = np.lexsort(keys.T[::-1])
    ends = np.flatnonzero(np.diff(keys[order], axis=0).any(axis=1)) + 1
    return [
        group[start : start + size]
        for group in np.split(order, ends)
        for start in range(0, len(group), size)
    ]


def most_likely_motion(
    bank: MotionBank,
    plan: Plan,
    spectra: FloatArray,
    ratios: slice,
    start_px: DoubleArray,
    tolerance_px: float,
) -> DoubleArray:
    """Likeliest motion of patches, px [2], beyond those of the bank.

    The search goes along a motion and across, in steps that get smaller.

    Parameters
    ----------
    bank : MotionBank
        No motion is longer than its longest.
    plan : Plan
    spectra, ratios
        See `ExactEnergies.take`.
    start_px : ndarray, float64 [2]
        First motion, px, not zeros.
    tolerance_px : float
        Last step, px.
    """
    sample = spectra[:: -(-len(spectra) // _SEARCH_PATCHES)]
    compared = bank.product.ratios[ratios]

    def energy(motion: DoubleArray) -> float:
        if np.hypot(*motion) > bank.motions.longest_px + 1e-6:
            return np.inf
        return _energy(bank.defocus, plan, sample, compared, motion)

    along = start_px / np.hypot(*start_px)
    across = np.array([-along[1], along[0]])
    best, least, step = start_px, energy(start_px), _STEP_PX
    while step >= tolerance_px:
        for direction in (along, -along, across, -across):
            neighbour = best + step * direction
            neighbour_energy = energy(neighbour)
            if neighbour_energy < least:
                best, least = neighbour, neighbour_energy
                break
        else:
            step /= 2
    return best


def _energy(
    defocus: FilterBank, plan: Plan, spectra: FloatArray, ratios: DoubleArray, motion: DoubleArray
) -> float:
    """Energy of all patches together, each at its likeliest level and texture."""
    multiplicity = defocus.fourier.multiplicity
    expected = expected_powers(defocus, Motions(motion[None])).reshape(-1, defocus.fourier.size)
    expected += np.float32(defocus.prior.model_error**2)
    least = np.full(len(spectra), np.inf, np.float32)
    for ratio in ratios:
        variance = np.float32(ratio) * expected + 1
        gains = np.exp(np.log(variance) @ multiplicity / plan.count)[:, None]
        weights = _of_products(plan, (multiplicity / variance * gains).T)
        excess = spectra[:, :-1] @ weights.astype(np.float32) + MIN_NOISE_SHARE * gains.T
        np.minimum(least, excess.min(axis=1), out=least)
    textureless = spectra @ np.append(plan.features[-1], MIN_NOISE_SHARE)
    return float(np.log(np.clip(least, MIN_EXCESS, textureless)).sum())


def _of_products(plan: Plan, functions: NDArray[np.floating]) -> NDArray[np.floating]:
    """Linear functions of the products of transforms [(2 V + U) H, n]; see `Plan.features`.

    `functions` [K, n] are those of power, in the order of ``scipy.fft.rfft2``.
    """
    columns, half = len(plan.horizontal) // 2, plan.grid.window_px // 2
    unpaired = [0, half][: len(plan.vertical) - 2 * plan.paired]
    return functions_of_products(functions, plan.grid.window_px, columns, plan.paired, unpaired)
