"""The methods we compare with: deconvolution with every level's PSF, least error wins."""

import dataclasses
import functools

import numpy as np
import pytest
import scipy.fft
import scipy.signal
from coded_aperture_benchmarks.thesis.reference import (
    REFERENCE_METHODS,
    HypothesisPlanes,
    deconvolve,
)
from coded_aperture_benchmarks.thesis.stair import area_psf_stack

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank import power_spectrum
from coded_aperture_ros.optics import Mask

STACK = area_psf_stack(Mask.named("levin"), [7, 10, 13, 16])
MARGIN = STACK.psfs.shape[1] // 2
IDENTITY = np.ones((1, 1), np.float32)


def texture(shape, seed):
    """Return a random picture [h, w] with the spectrum of photographs, about 0.05 to 0.95."""
    spectrum = scipy.fft.rfft2(np.random.default_rng(seed).standard_normal(shape))
    picture = scipy.fft.irfft2(spectrum * np.sqrt(power_spectrum(2.4, shape)), shape)
    picture -= picture.mean()
    return (0.5 + 0.15 * picture / picture.std()).clip(0.05, 0.95)


def plane(level, side=96, seed=0, noise=0.0):
    """Return a coded plane [side, side] at one level of STACK."""
    sharp = texture((side + 2 * MARGIN,) * 2, seed)
    coded = scipy.signal.fftconvolve(sharp, STACK.psfs[level], mode="valid")
    rng = np.random.default_rng(seed + 1000)
    return (coded + noise * rng.standard_normal(coded.shape)).astype(np.float32)


@functools.cache
def staircase(seed, noise=0.0):
    """Return planes of all levels below each other, four textures each, and the true levels."""
    rows = [
        np.hstack([plane(level, 64, seed + 10 * level + k, noise) for k in range(4)])
        for level in range(len(STACK))
    ]
    return np.vstack(rows), np.repeat(np.arange(len(STACK)), 64)[:, None] * np.ones((1, 256), int)


def mean_error(planes, coded, true):
    return np.abs(planes.levels(coded) - true).mean()


@pytest.mark.parametrize("method", REFERENCE_METHODS)
def test_learned_weights_find_the_level_of_a_plane(method):
    planes = HypothesisPlanes(method, STACK, 0.0, window_px=31)
    planes = planes.with_learned_weights(*staircase(seed=100))
    for level in (0, 2):
        found = planes.levels(plane(level, seed=7))
        assert np.mean(found == level) > 0.9, level


@pytest.mark.parametrize("method", REFERENCE_METHODS)
def test_learning_reduces_the_error_on_its_picture_and_on_another(method):
    noise = 0.002
    planes = HypothesisPlanes(method, STACK, noise, window_px=31)
    training, test = staircase(100, noise), staircase(500, noise)
    learned = planes.with_learned_weights(*training)
    assert mean_error(learned, *training) < mean_error(planes, *training)
    assert mean_error(learned, *test) < min(0.5, mean_error(planes, *test))


def restoration_error(method, sharp, psf, noise):
    """Return the root mean square errors of a deconvolved and of the coded picture."""
    margin = len(psf) // 2
    coded = scipy.signal.fftconvolve(sharp, psf, mode="valid")
    coded += noise * np.random.default_rng(1).standard_normal(coded.shape)
    restored = deconvolve(method, coded.astype(np.float32), psf, noise)
    assert restored.shape == coded.shape
    sharp = sharp[margin:-margin, margin:-margin]
    inner = (slice(margin, -margin),) * 2
    return [np.sqrt(np.mean((p - sharp)[inner] ** 2)) for p in (restored, coded)]


@pytest.mark.parametrize("method", REFERENCE_METHODS)
def test_the_true_psf_sharpens(method):
    # A mask without any symmetry: its PSF must be undone, not applied once more.
    psf = area_psf_stack(Mask.named("veeraraghavan"), [12.0]).psfs[0]
    restored, coded = restoration_error(method, texture((120, 120), 3), psf, 0.0)
    assert restored < 0.9 * coded


def test_the_sparse_prior_restores_edges_better():
    blocks = np.kron(np.random.default_rng(2).uniform(0.1, 0.9, (6, 6)), np.ones((20, 20)))
    sparse, smooth = (
        restoration_error(method, blocks, STACK.psfs[1], 0.002)[0]
        for method in ("levin", "gaussian")
    )
    assert sparse < 0.75 * smooth


@pytest.mark.parametrize("method", REFERENCE_METHODS)
def test_nothing_to_undo_leaves_the_picture(method):
    picture = texture((50, 70), 1).astype(np.float32)
    restored = deconvolve(method, picture, IDENTITY, 0.0)
    assert np.abs(restored - picture).max() < 0.05
    assert abs(float(restored.mean() - picture.mean())) < 1e-3


@pytest.mark.parametrize("method", REFERENCE_METHODS)
def test_a_flat_picture_is_explained_by_every_level(method):
    flat = np.full((60, 70), 0.3, np.float32)
    errors = HypothesisPlanes(method, STACK, 0.001).errors(flat)
    assert errors.shape == (len(STACK), 60, 70)
    assert errors.dtype == np.float32
    assert np.sqrt(errors.max()) < 1e-3


def test_more_noise_is_fitted_less():
    coded = plane(1, noise=0.02)
    # Not Lucy and Richardson's: its number of iterations is the same.
    for method in ("regularized", "wiener", "gaussian", "levin"):
        trusting, careful = (
            HypothesisPlanes(method, STACK, noise).errors(coded)[1].mean() for noise in (0, 0.2)
        )
        assert careful > 1.2 * trusting, method


def test_errors_average_over_the_window_and_keep_off_the_border():
    coded = plane(1)
    fine = HypothesisPlanes("wiener", STACK, 0.0, window_px=1).errors(coded)
    coarse = HypothesisPlanes("wiener", STACK, 0.0, window_px=9).errors(coded)
    row, column = 40, 50
    patch = fine[:, row - 4 : row + 5, column - 4 : column + 5]
    np.testing.assert_allclose(coarse[:, row, column], patch.mean(axis=(1, 2)), rtol=1e-4)
    nearest = MARGIN + 4
    np.testing.assert_array_equal(coarse[:, 0, 0], coarse[:, nearest, nearest])
    np.testing.assert_array_equal(coarse[:, -1, 50], coarse[:, -1 - nearest, 50])


def test_a_window_wider_than_the_picture_takes_all_of_it():
    errors = HypothesisPlanes("wiener", STACK, 0.0, window_px=501).errors(plane(1))
    assert (np.ptp(errors, axis=(1, 2)) < 0.05 * errors.mean(axis=(1, 2))).all()


def test_weights_favour_their_level():
    coded = plane(0)
    weights = np.ones(len(STACK))
    weights[3] = 1e-9
    assert (HypothesisPlanes("wiener", STACK, 0.0, weights).levels(coded) == 3).all()


def test_learning_is_repeatable_and_leaves_out_unknown_pixels():
    coded, true = staircase(100)
    planes = HypothesisPlanes("wiener", STACK, 0.0, window_px=31)
    first, again = (planes.with_learned_weights(coded, true).weights for _ in range(2))
    np.testing.assert_array_equal(first, again)
    partly = true.copy()
    partly[:, 128:] = -1
    learned = planes.with_learned_weights(coded, partly)
    assert np.abs(learned.levels(coded) - true)[:, :128].mean() < 0.4


def test_progress_sees_every_level():
    seen = []

    def progress(levels):
        for psf in levels:
            seen.append(psf)
            yield psf

    HypothesisPlanes("wiener", STACK, 0.0).errors(plane(0), progress)
    assert len(seen) == len(STACK)


def test_unknown_method_is_refused_with_the_choices():
    with pytest.raises(InputError, match="lucy_richardson, regularized, wiener, gaussian, levin"):
        HypothesisPlanes("blind", STACK, 0.0)
    with pytest.raises(InputError, match="blind"):
        deconvolve("blind", plane(0), STACK.psfs[0], 0.0)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"noise": -1.0}, "noise"),
        ({"noise": np.nan}, "noise"),
        ({"window_px": 10}, "odd"),
        ({"weights": np.ones(3)}, "one for each of the 4 levels"),
        ({"weights": np.array([1.0, 0, 1, 1])}, "more than 0"),
    ],
)
def test_impossible_settings_are_refused(change, reason):
    planes = HypothesisPlanes("wiener", STACK, 0.0)
    with pytest.raises(InputError, match=reason):
        dataclasses.replace(planes, **change)


@pytest.mark.parametrize(
    ("coded", "reason"),
    [
        (np.zeros((96, 96, 3), np.float32), "shape"),
        (np.zeros((10, 96), np.float32), "larger than the PSFs"),
        (np.full((96, 96), np.nan, np.float32), "finite"),
    ],
)
def test_impossible_pictures_are_refused(coded, reason):
    with pytest.raises(InputError, match=reason):
        HypothesisPlanes("wiener", STACK, 0.0).errors(coded)


@pytest.mark.parametrize(
    ("true", "reason"),
    [
        (np.zeros((96, 95), int), "shape"),
        (np.full((96, 96), 4), "less than 4"),
        (np.zeros((96, 96)), "integers"),
        (np.full((96, 96), -1), "no pixel"),
    ],
)
def test_impossible_training_levels_are_refused(true, reason):
    with pytest.raises(InputError, match=reason):
        HypothesisPlanes("wiener", STACK, 0.0).with_learned_weights(plane(0), true)
