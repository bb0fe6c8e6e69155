"""A motion refined by the likelihood of all patches that have it, beyond those of the bank."""

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.likelihood.motion.bank import MotionBank, expected_powers
from coded_aperture_ros.likelihood.motion.kernels import Motions
from coded_aperture_ros.likelihood.plan import Plan
from coded_aperture_ros.likelihood.scoring import LEAST_EXCESS, OWN_NOISE

# The first step of the search, px.
_STEP_PX = 0.5
# Patches that are enough.
_MOST_PATCHES = 100


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
    some = spectra[:: -(-len(spectra) // _MOST_PATCHES)]
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
