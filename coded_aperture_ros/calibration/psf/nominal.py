"""Banks of PSFs without sizes: nominal sizes, and a confidence and check of fit of their own.

The confidence of the decoders is right for masks, on which they were fitted. Other PSFs, such as
those of phase masks, may tell less apart, which costs do not show. So simulated scenes are rendered
with the PSFs, and the confidence becomes the share of depths that are right there.
"""

import dataclasses

import numpy as np
import scipy.optimize

from coded_aperture_ros.calibration.psf.own_fit import fitting_share, measured_fit
from coded_aperture_ros.calibration.psf.simulated import SCENES, is_right, simulated_frames
from coded_aperture_ros.core.arrays import BoolArray, DoubleArray
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.stages.reliability import reliability_terms
from coded_aperture_ros.likelihood.bank import (
    FilterBank,
    LearnConfig,
    NaturalImagePrior,
    learn_bank,
)
from coded_aperture_ros.optics import PsfStack
from coded_aperture_ros.optics.nominal import grows_evenly, with_nominal_sizes

# Side of the patches for PSFs that do not grow as those of a mask, px: they tell less apart, so
# that more of the frame has to.
_WIDE_WINDOW_PX = 64
# The network of the check suffices for PSFs that grow evenly if so many of their frames pass.
_FITTING_SHARE = 0.9
# Every so many pixels of a map count: neighbours say the same.
_SPARSE = 4
# Penalty of the squared coefficient of the noise, which is undetermined where that is known.
_RIDGE = 1e-3


def learn_nominal_bank(
    stack: PsfStack,
    config: LearnConfig,
    prior: NaturalImagePrior,
    learned_from: str,
    progress: Progress = iter,
) -> FilterBank:
    """Bank of PSFs without sizes in px, with nominal sizes; its own confidence, check if needed.

    PSFs that grow evenly are as those of a mask, and too few have no nominal sizes: both make a
    bank as `learn_bank` does. Of the former the check is the bank's own only where the network is
    too strict, as with soft PSFs.

    Parameters
    ----------
    stack : PsfStack
        Its sizes are not in px.
    config, prior, learned_from, progress
        See `learn_bank`.

    Raises
    ------
    InputError
        As `learn_bank`.
    """
    sized = with_nominal_sizes(stack)
    if not sized.nominal:
        return learn_bank(sized, config, prior, learned_from, progress=progress)
    if grows_evenly(stack):
        bank = learn_bank(sized, config, prior, learned_from, progress=progress)
        if fitting_share(bank, progress) >= _FITTING_SHARE:
            return bank
        return dataclasses.replace(bank, own_fit=measured_fit(bank, progress))
    if not config.window_px:
        window_px = max(config.for_blur(0.0, stack.psfs.shape[-1]).window_px, _WIDE_WINDOW_PX)
        config = dataclasses.replace(config, window_px=window_px)
    bank = learn_bank(sized, config, prior, learned_from, progress=progress)
    bank = dataclasses.replace(bank, own_fit=measured_fit(bank, progress))
    return dataclasses.replace(bank, reliability=measured_reliability(bank, progress))


def measured_reliability(bank: FilterBank, progress: Progress = iter) -> tuple[float, ...]:
    """Coefficients of the `reliability_terms` that make the confidence right for a bank.

    Parameters
    ----------
    bank : FilterBank
    progress : callable, optional
        Progress callback around the iteration over scenes.
    """
    plain = dataclasses.replace(bank, reliability=())
    estimator = DepthEstimator(plain, DepthConfig(confidence_threshold=0.0, check_fit=False))
    sparse = np.s_[::_SPARSE, ::_SPARSE]
    terms, right = [], []
    for seed in progress(range(SCENES)):
        for frame, level in simulated_frames(plain, seed):
            estimate = estimator.estimate(frame)
            confidence = estimate.confidence[sparse]
            known = confidence > 0
            terms.append(reliability_terms(confidence[known], estimate.noise))
            right.append(is_right(bank.stack, estimate.level[sparse], level[sparse])[known])
    estimator.close()
    return _logistic_fit(np.concatenate(terms, axis=1), np.concatenate(right))


def _logistic_fit(terms: DoubleArray, right: BoolArray) -> tuple[float, ...]:
    """Coefficients of the terms [3, n] under which `right` [n] is the likeliest."""

    def cost(coefficients: DoubleArray) -> float:
        odds = coefficients @ terms
        likelihood = np.mean(np.logaddexp(0, odds) - right * odds)
        return float(likelihood + _RIDGE * coefficients[2] ** 2)

    # Confidence never falls where the decoder's rises.
    bounds = [(-20, 20), (0.05, 10), (-5, 5)]
    found = scipy.optimize.minimize(cost, [0.0, 1.0, 0.0], bounds=bounds)
    return tuple(found.x.tolist())
