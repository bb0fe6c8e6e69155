"""The thesis' projectors, and what a common basis costs them."""

import numpy as np
import pytest
from coded_aperture_benchmarks.thesis.reference.subspace import learn_subspace_bank
from coded_aperture_benchmarks.thesis.stair import area_psf_stack
from scipy.signal import fftconvolve
from textures import blurred_texture

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank
from coded_aperture_ros.likelihood.scoring import TEMPERATURE
from coded_aperture_ros.optics import Mask

SIZES = np.linspace(3.0, 9.0, 5)
PATCH, RANK = 15, 60


@pytest.fixture(scope="module")
def stack():
    return area_psf_stack(Mask.named("levin"), SIZES)


@pytest.fixture(scope="module")
def exact(stack):
    return learn_subspace_bank(stack, PATCH, RANK, basis=None)


def found(bank, image, noise=1e-3):
    return bank.energies(image, 5, noise).argmin(axis=-1)


def test_energy_is_the_distance_to_the_subspace_of_the_level(stack):
    random = np.random.default_rng(0)
    sharp = random.normal(size=(60, 60)).astype(np.float32)
    bank = learn_subspace_bank(stack, PATCH, RANK, basis=None, images=[sharp])
    image = random.random((40, 46)).astype(np.float32)
    noise = 0.01
    grid = PatchGrid.covering(image.shape, PATCH, 7)
    energies = bank.energies(image, 7, noise)
    assert energies.shape == (4, 5, 5)
    blurred = fftconvolve(sharp, stack.psfs[2], "valid")
    windows = np.lib.stride_tricks.sliding_window_view(blurred, (PATCH, PATCH))
    patches = windows[::3, ::3].reshape(-1, PATCH**2)
    left, _, _ = np.linalg.svd((patches - patches.mean(axis=1, keepdims=True)).T)
    outside = left[:, RANK:]
    row, column = grid.row_centres[1], grid.column_centres[3]
    patch = image[row - 7 : row + 8, column - 7 : column + 8].ravel().astype(float)
    distance = np.sum((outside.T @ (patch - patch.mean())) ** 2)
    assert energies[1, 3, 2] * noise**2 == pytest.approx(distance, rel=1e-3)


def test_noise_of_each_patch_sets_the_unit(exact):
    frame = np.random.default_rng(1).random((30, 33)).astype(np.float32)
    noise = np.full(exact.energies(frame, 7, 0.01).shape[:2], 0.01, np.float32)
    noise[1, 2] = 0.02
    same, each = exact.energies(frame, 7, 0.01), exact.energies(frame, 7, noise)
    assert each[1, 2] == pytest.approx(same[1, 2] / 4, rel=1e-5)
    assert each[0] == pytest.approx(same[0], rel=1e-5)


def test_levels_are_found_without_noise(stack, exact):
    for level in (0, 2, 4):
        image = blurred_texture(stack.psfs[level], noise=0, size=96)
        assert np.mean(np.abs(found(exact, image) - level)) < 0.5


def test_joint_basis_keeps_more_of_what_differs_than_the_leading_vectors(stack, exact):
    assert exact.truncation_error < 1e-3
    assert exact.basis_vectors == PATCH**2 - 1
    errors = {
        name: [
            learn_subspace_bank(stack, PATCH, RANK, name, vectors).truncation_error
            for vectors in (20, 60, 120)
        ]
        for name in ("svd", "joint")
    }
    for name in errors:
        assert errors[name] == sorted(errors[name], reverse=True)
    for svd, joint in zip(errors["svd"][:2], errors["joint"][:2], strict=True):
        assert joint < svd - 0.05


def test_truncation_error_is_that_of_the_projectors(stack, exact):
    def differences(bank):
        projectors = bank.basis @ bank.forms @ bank.basis.T
        return projectors - projectors.mean(axis=0)

    bank = learn_subspace_bank(stack, PATCH, RANK, "joint", 50)
    whole = differences(exact)
    lost = np.linalg.norm(differences(bank) - whole) / np.linalg.norm(whole)
    assert bank.truncation_error == pytest.approx(lost, rel=1e-3)


def test_joint_basis_finds_the_levels_that_the_whole_finds(stack, exact):
    joint = learn_subspace_bank(stack, PATCH, RANK, "joint", 120)
    image = blurred_texture(stack.psfs[3], noise=0, size=96)
    assert np.mean(np.abs(found(joint, image) - found(exact, image))) < 0.15


def test_estimator_takes_a_subspace_bank_in_place_of_the_filter_bank(stack, exact):
    image = blurred_texture(stack.psfs[3], noise=0, size=96)
    estimate = DepthEstimator(exact, DepthConfig(confidence_threshold=0)).estimate(image)
    assert estimate.level.shape == image.shape
    assert np.median(estimate.blur_size_px) == pytest.approx(SIZES[3], abs=0.7)
    # None of a patch's values tells again what another does.
    energies = exact.energies(image, 8, 0.01)
    volume = exact.plan(image.shape, 8).cost(image, 0.01).volume
    relative = energies - energies.min(axis=-1, keepdims=True)
    assert volume == pytest.approx(relative / (2 * TEMPERATURE), rel=1e-5)
    filters = learn_bank(stack, LearnConfig(window_px=16, rank=8))
    assert filters.basis_vectors == 8
    # A Hann window spreads each frequency over 35/18 of them, in both directions.
    assert filters.window_correlation == pytest.approx((35 / 18) ** 2, rel=1e-3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"patch_px": 16}, "patch_px: expected an odd number from 9 to 65, got 16"),
        ({"patch_px": 67}, "patch_px"),
        ({"patch_px": 9, "rank": 81}, "rank: expected 1 to 80 for 9 px patches, got 81"),
        ({"rank": 0}, "rank"),
        ({"basis": "wavelet"}, "basis: expected one of svd, joint or None, got 'wavelet'"),
        ({"patch_px": 7}, "patch_px"),
        ({"images": [np.zeros((20, 90), np.float32)]}, "90x20 px is too small.*at least 41 px"),
    ],
)
def test_impossible_settings_are_refused(stack, settings, message):
    with pytest.raises(InputError, match=message):
        learn_subspace_bank(stack, **settings)


def test_unusable_levels_are_refused():
    mask = Mask.named("disc")
    with pytest.raises(InputError, match="at least 2 levels, got 1"):
        learn_subspace_bank(area_psf_stack(mask, [5.0]))
    with pytest.raises(InputError, match="a PSF of 21 px does not fit the 15 px patch"):
        learn_subspace_bank(area_psf_stack(mask, [5.0, 20.0]), 15)
