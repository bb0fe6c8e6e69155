"""What the speed costs in accuracy: errors on the thesis' stair of blur sizes."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.speed.setting import MASK, Setting
from coded_aperture_benchmarks.thesis.stair import LEVELS, blur_stack, level_error, make_stair
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthEstimator
from coded_aperture_ros.likelihood.bank import FilterBank, learn_bank
from coded_aperture_ros.optics import Mask

# Behind an open aperture: a mask leaves more.
_SIGMA = 0.001
_SEEDS = (0, 1)
_REFERENCE_STRIDE_PX = 4
# Nothing is left out or smoothed, so that the bank alone is compared.
_RAW: dict[str, Any] = {"regularize": "none", "confidence_threshold": 0.0, "saturation": 2.0}
_OWN, _REFERENCE = "own", "reference"


def has_test_pictures() -> bool:
    """Return whether the pictures that the stair is made of are installed."""
    try:
        load_textures("natural")
    except InputError:
        return False
    return True


class StairAccuracy:
    """Mean error of a configuration, and of a bank of the same window that spares no time.

    The reference has filters as they are, all frequencies and a patch every 4 px. There are 39
    levels, whatever the frames are timed with.
    """

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        self._errors: dict[str, list[float]] = {}
        self._estimators: dict[str, DepthEstimator] = {}

    def steps(self) -> list[Callable[[], None]]:
        """Return the work: one bank after the other, and one stair at a time, to save memory."""
        steps: list[Callable[[], None]] = []
        for name, learn in ((_OWN, self._learn_own), (_REFERENCE, self._learn_reference)):
            measure = [partial(self._measure, name, seed) for seed in _SEEDS]
            steps += [learn, *measure, partial(self._close, name)]
        return steps

    def results(self) -> dict[str, float]:
        """Return both errors, in levels, and how many times the reference's the own one is."""
        own, reference = (float(np.mean(self._errors[name])) for name in (_OWN, _REFERENCE))
        return {"level_error": own, "reference_level_error": reference, "ratio": own / reference}

    def _learn_own(self) -> None:
        self._estimators[_OWN] = _estimator(_bank(self._setting), self._setting)

    def _learn_reference(self) -> None:
        setting = dataclasses.replace(
            self._setting,
            rank=1,  # whatever it is, all filters take its place
            highest_frequency=1.0,
            stride_px=_REFERENCE_STRIDE_PX,
        )
        self._estimators[_REFERENCE] = _estimator(with_all_filters(_bank(setting)), setting)

    def _measure(self, name: str, seed: int) -> None:
        stair = make_stair(Mask.named(MASK), load_textures("natural"), _SIGMA, seed)
        # Whole numbers, as all estimates of the thesis are.
        level = np.rint(self._estimators[name].estimate(stair.coded).level)
        error = level_error(level, stair.level, LEVELS).mean
        self._errors.setdefault(name, []).append(error)

    def _close(self, name: str) -> None:
        self._estimators.pop(name).close()


def _bank(setting: Setting) -> FilterBank:
    mask = Mask.named(MASK)
    return learn_bank(blur_stack(mask), setting.learn_config, mask=mask)


def _estimator(bank: FilterBank, setting: Setting) -> DepthEstimator:
    config = dataclasses.replace(setting.depth_config, temporal_frames=0.0, **_RAW)
    return DepthEstimator(bank, config)


def with_all_filters(bank: FilterBank) -> FilterBank:
    """Return a bank of full rank: its basis are the frequencies that count, one by one.

    `learn_bank` comes to the same filters with the largest rank, but finds the best basis of them,
    which takes a minute for a window of 64 px.

    Parameters
    ----------
    bank : FilterBank
        Of any rank, learned from PSFs with the natural-image prior.
    """
    powers = [
        [bank.fourier.expected_power(psf, slope) for psf in bank.stack.psfs]
        for slope in bank.prior.slopes
    ]
    expected = np.array(powers) + bank.prior.model_error**2  # [slopes, L, K]
    counting = np.flatnonzero(bank.fourier.multiplicity)
    variances = bank.ratios[:, None, None, None] * expected[..., counting] + 1
    weights = bank.fourier.multiplicity[counting] / variances  # [S, slopes, L, R]
    basis = np.zeros((bank.fourier.size, len(counting)), np.float32)
    basis[counting, np.arange(len(counting))] = 1
    return dataclasses.replace(
        bank,
        basis=basis,
        coefficients=np.moveaxis(weights, -1, 0).astype(np.float32),
        truncation_error=0.0,
    )
