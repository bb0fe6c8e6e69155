"""Levels between whole ones, along surfaces."""

import numpy as np
import pytest

from coded_aperture_ros.depth.decoders.surface import fit_surfaces

LEVELS = 16
CURVATURE = 4.0


def evidence_of(level, curvature=CURVATURE):
    """A parabola around the level that every patch finds."""
    distance = np.arange(LEVELS) - level[..., None]
    half = np.broadcast_to(np.asarray(curvature) / 2, level.shape)
    return (half[..., None] * distance**2).astype(np.float32)


def slant(rows=12, columns=20):
    row, column = np.mgrid[:rows, :columns]
    return 4 + 0.31 * column + 0.13 * row


def rms(error):
    return float(np.sqrt(np.mean(np.square(error))))


@pytest.mark.parametrize("shape", [(12, 20), (1, 20), (2, 2), (20, 2), (1, 1)])
def test_slants_stay_as_they_are(shape):
    true = slant(*shape)
    found = fit_surfaces(evidence_of(true), np.rint(true).astype(int), 1.0, 8)
    assert (found.shape, found.dtype) == (shape, np.float32)
    assert found == pytest.approx(true, abs=1e-3)


def test_noise_between_levels_is_smoothed_on_a_slant():
    true = slant()
    noisy = true + np.random.default_rng(0).normal(0, 0.3, true.shape)
    chosen = np.rint(true).astype(int)
    found = fit_surfaces(evidence_of(noisy), chosen, 1.0, 8)
    assert rms(found - true) < 0.5 * rms(noisy - true)
    by_itself = fit_surfaces(evidence_of(noisy), chosen, 0.0, 8)
    assert rms(found - true) < 0.7 * rms(by_itself - true)
    # Far apart, patches say less of each other.
    assert rms(fit_surfaces(evidence_of(noisy), chosen, 1.0, 32) - true) > rms(found - true)


def test_a_depth_edge_stays():
    true = np.where(np.arange(20) < 10, 3.2, 12.4) * np.ones((12, 1))
    found = fit_surfaces(evidence_of(true), np.rint(true).astype(int), 1.0, 8)
    assert found == pytest.approx(true, abs=1e-3)


def test_a_patch_that_knows_nothing_is_on_the_surface_of_its_neighbours():
    true = slant()
    curvature = np.full(true.shape, CURVATURE)
    curvature[4:7, 8:12] = 0
    chosen = np.rint(true).astype(int)
    found = fit_surfaces(evidence_of(true, curvature), chosen, 1.0, 8)
    assert found == pytest.approx(true, abs=0.02)
    assert np.isfinite(
        fit_surfaces(np.zeros((*true.shape, LEVELS), np.float32), chosen, 1, 8)
    ).all()


def test_the_minimum_next_to_the_chosen_level_counts():
    true = np.full((6, 8), 6.8)
    found = fit_surfaces(evidence_of(true), np.full(true.shape, 6), 1.0, 8)
    assert found == pytest.approx(true, abs=1e-3)
    for end in (0.0, LEVELS - 1.0):
        at_end = np.full((6, 8), end)
        found = fit_surfaces(evidence_of(at_end), at_end.astype(int), 1.0, 8)
        assert found == pytest.approx(at_end, abs=1e-3)


@pytest.mark.parametrize("levels", [1, 2])
def test_few_levels_stay_whole(levels):
    chosen = np.full((3, 4), levels - 1)
    found = fit_surfaces(np.zeros((3, 4, levels), np.float32), chosen, 1.0, 8)
    assert found == pytest.approx(chosen)
