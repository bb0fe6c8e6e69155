"""Energies from the spectra themselves, without a common basis.

A basis that all motions share leaves out a little of each. That decides between neighbouring
motions where there is hardly any noise. But the common basis knows well how rough a patch's texture
is, and how strong: with that, all motions can be compared exactly at once, and the best few again
under other textures.
"""

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.likelihood import take_logarithm
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.likelihood.motion.bank import MotionBank, expected_powers
from coded_aperture_ros.likelihood.motion.kernels import Motions
from coded_aperture_ros.likelihood.plan import Plan
from coded_aperture_ros.likelihood.scoring import LEAST_EXCESS, OWN_NOISE

# The last few of each patch are compared under so many contrasts, around the one that suits it.
_CONTRASTS = 3
# Patches whose hypotheses are tried at a time.
_PATCHES = 128
# Ratios of contrast and noise whose weights are kept, more than one frame needs: noise varies.
_SPARE_RATIOS = 2
# First step of the search for a motion, px.
_STEP_PX = 0.5
# A search takes about so many patches into account.
_SEARCH_PATCHES = 100


class ExactEnergies:
    """Computes energies of pairs of motion and level for all patches of a frame.

    The weights of all ratios of contrast and noise would be large; those of the ratios that the
    frame's noise calls for are made when they are needed, and kept.
    """

    def __init__(self, bank: MotionBank, plan: Plan, workers: Workers) -> None:
        self._bank, self._plan, self._workers = bank, plan, workers
        self._weights: dict[int, FloatArray] = {}
        self._spectra = np.empty((0, 0), np.float32)
        self._textureless = np.empty(0, np.float32)
        self._texture = np.empty((2, 0), np.intp)
        self._tried = slice(0, 0)
        size = plan.features.shape[1] + 1
        slopes, motions, levels, _ = bank.expected.shape
        excess = max(motions, _CONTRASTS * slopes) * levels * _PATCHES
        self._seen = np.empty((workers.threads, _PATCHES, size), np.float32)
        self._excess = np.empty((workers.threads, excess), np.float32)

    def take(self, spectra: FloatArray, texture: IndexArray, tried: slice) -> None:
        """Take the patches of a frame.

        Their `spectra` [patches, F + 1] are the plan's products of transforms in units of the
        noise, and 1; `texture` [patches] is the hypothesis that suits each, ``ratio * slopes +
        slope``, counted from the first ratio that is `tried`: those that suit the frame's noise.
        """
        ratio, slope = np.divmod(texture, len(self._bank.expected))
        self._spectra, self._texture = spectra, np.array([ratio + tried.start, slope])
        self._textureless = spectra @ np.append(self._plan.features[-1], OWN_NOISE)
        self._tried = tried
        self._make_weights()

    def of_all(self, energies: FloatArray) -> None:
        """Compute the energies of all motions under each patch's texture [M, L, patches]."""
        pairs = energies.reshape(-1, energies.shape[2])

        def compute(patches: IndexArray, thread: int) -> None:
            ratio, slope = self._texture[:, patches[0]]
            block = self._weights[int(ratio)][slope].reshape(len(pairs), -1)
            pairs[:, patches] = self._least([block], patches, len(pairs), thread)

        self._workers.each(compute, alike(self._texture))

    def of_some(self, motions: IndexArray) -> FloatArray:
        """Return the energies of some motions [k, patches] likewise, [k, L, patches]."""
        count, levels = len(motions), self._bank.defocus.levels
        energies = np.empty((count * levels, motions.shape[1]), np.float32)
        keys = np.vstack([motions, self._texture])

        def compute(patches: IndexArray, thread: int) -> None:
            ratio, slope = self._texture[:, patches[0]]
            block = self._weights[int(ratio)][slope, motions[:, patches[0]]]
            block = block.reshape(len(energies), -1)
            energies[:, patches] = self._least([block], patches, len(energies), thread)

        self._workers.each(compute, alike(keys))
        return energies.reshape(count, levels, -1)

    def compare_best(
        self, energies: FloatArray, motions: IndexArray, seeded: BoolArray, count: int
    ) -> None:
        """Lower the energies of the best few motions to the least under several textures.

        Of the `energies` [k, L, patches] of `motions` [k, patches], as from `of_all`, the best
        `count` of each patch are compared, the `seeded` [k, patches] among them.
        """
        best = energies.min(axis=1)
        best[seeded] = -np.inf
        count = min(count, len(best))
        rows = np.argpartition(best, count - 1, axis=0)[:count].T.ravel()
        patches = np.repeat(np.arange(best.shape[1]), count)
        contrasts = min(_CONTRASTS, self._tried.stop - self._tried.start)
        first = self._texture[0, patches] - contrasts // 2
        first = np.clip(first, self._tried.start, self._tried.stop - contrasts)
        keys = np.array([motions[rows, patches], first])
        found = np.empty((len(patches), self._bank.defocus.levels), np.float32)

        def compute(members: IndexArray, thread: int) -> None:
            motion, first = keys[:, members[0]].tolist()
            blocks = [
                of_slope[motion]
                for ratio in range(first, first + contrasts)
                for of_slope in self._weights[ratio]
            ]
            found[members] = self._least(blocks, patches[members], found.shape[1], thread).T

        self._workers.each(compute, alike(keys))
        energies[rows, :, patches] = found

    def _least(
        self, blocks: list[FloatArray], patches: IndexArray, count: int, thread: int
    ) -> FloatArray:
        """Return the energies [count, n] of patches: the least of all blocks' [count, F + 1]."""
        seen = self._seen[thread, : len(patches)]
        np.take(self._spectra, patches, axis=0, out=seen)
        excess = self._excess[thread, : len(blocks) * count * len(patches)]
        excess = excess.reshape(len(blocks), count, len(patches))
        for block, out in zip(blocks, excess, strict=True):
            np.matmul(block, seen.T, out=out)
        least = excess[0] if len(blocks) == 1 else excess.min(axis=0)
        return take_logarithm(least, self._textureless[patches], self._plan.count)

    def _make_weights(self) -> None:
        needed = range(self._tried.start, self._tried.stop)
        for ratio in needed:
            if ratio not in self._weights:
                unneeded = [each for each in self._weights if each not in needed]
                if len(self._weights) >= len(needed) + _SPARE_RATIOS:
                    del self._weights[unneeded[0]]
                self._weights[ratio] = self._weights_of(ratio)

    def _weights_of(self, ratio: int) -> FloatArray:
        """Return the weights of all hypotheses of a ratio [slopes, M, L, F + 1].

        As `Plan.hypotheses`, but of the products of transforms.
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
            of_power = multiplicity / variance * gains[index]
            weights[index][:, :-1] = self._plan.of_products(of_power.T).T
        weights[..., -1:] = OWN_NOISE * gains
        return weights


def alike(keys: IndexArray, most: int = _PATCHES) -> list[IndexArray]:
    """Return where the keys [.., n] are equal, in parts of at most so many."""
    order = np.lexsort(keys[::-1])
    ends = np.flatnonzero(np.diff(keys[:, order]).any(axis=0)) + 1
    return [
        group[start : start + most]
        for group in np.split(order, ends)
        for start in range(0, len(group), most)
    ]


def most_likely_motion(
    bank: MotionBank,
    plan: Plan,
    spectra: FloatArray,
    tried: slice,
    start_px: DoubleArray,
    tolerance_px: float,
) -> DoubleArray:
    """Search around a motion for the likeliest one of some patches, along it and across.

    From `start_px`, not zeros, in steps that get smaller, down to `tolerance_px`; at most the
    bank's longest motion. For the `spectra` and the ratios that are `tried` see
    `ExactEnergies.take`.
    """
    some = spectra[:: -(-len(spectra) // _SEARCH_PATCHES)]
    ratios = bank.product.ratios[tried]

    def energy(motion: DoubleArray) -> float:
        if np.hypot(*motion) > bank.motions.longest_px + 1e-6:
            return np.inf
        return _energy(bank.defocus, plan, some, ratios, motion)

    along = start_px / np.hypot(*start_px)
    across = np.array([-along[1], along[0]])
    best, least, step = start_px, energy(start_px), _STEP_PX
    while step >= tolerance_px:
        for way in (along, -along, across, -across):
            there = best + step * way
            found = energy(there)
            if found < least:
                best, least = there, found
                break
        else:
            step /= 2
    return best


def _energy(
    defocus: FilterBank, plan: Plan, spectra: FloatArray, ratios: DoubleArray, motion: DoubleArray
) -> float:
    """Return the energy of all patches, each at its likeliest level and texture."""
    multiplicity = defocus.fourier.multiplicity
    expected = expected_powers(defocus, Motions(motion[None])).reshape(-1, defocus.fourier.size)
    expected += np.float32(defocus.prior.model_error**2)
    least = np.full(len(spectra), np.inf, np.float32)
    for ratio in ratios:
        variance = np.float32(ratio) * expected + 1
        gains = np.exp(np.log(variance) @ multiplicity / plan.count)[:, None]
        weights = plan.of_products((multiplicity / variance * gains).T)
        excess = spectra[:, :-1] @ weights.astype(np.float32) + OWN_NOISE * gains.T
        np.minimum(least, excess.min(axis=1), out=least)
    textureless = spectra @ np.append(plan.features[-1], OWN_NOISE)
    return float(np.log(np.clip(least, LEAST_EXCESS, textureless)).sum())
