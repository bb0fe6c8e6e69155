"""Depth errors of masks, predicted from pictures."""

import numpy as np
import pytest
from cli_scene import texture
from scipy.signal import fftconvolve

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.design.scores.pictures import (
    PictureScorer,
    WindowSpectra,
    likeliest_levels,
    patch_side_px,
)
from coded_aperture_ros.design.scores.spectra import SceneConfig
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank
from coded_aperture_ros.optics import Mask, render_psf_stack

WINDOW_PX = 48
SCENE = SceneConfig(levels=8)
SIDE_PX = patch_side_px(SCENE, WINDOW_PX)
TEXTURES = Textures("natural", tuple(texture(256, 256, seed) for seed in range(4)))


def crops(textures, count, side, seed=0):
    return textures.crops(count, side, side, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def patches():
    return crops(TEXTURES, 160, SIDE_PX)


def scorer_of(patches, sigmas=(0.001,), **changes):
    return PictureScorer(patches, SCENE, sigmas, window_px=WINDOW_PX, **changes)


def blurred_windows(scorer, patches, psfs):
    """Blur every patch with its level by convolution; keep the window in its middle."""
    margin = (SIDE_PX - WINDOW_PX) // 2
    middle = slice(margin, margin + WINDOW_PX)
    levels = zip(patches, scorer.true_levels, strict=True)
    return np.array(
        [fftconvolve(patch, psfs[level], "same")[middle, middle] for patch, level in levels],
        np.float32,
    )


def test_what_makes_masks_better_and_worse(patches):
    scorer = scorer_of(patches, (0.001, 0.005))
    four_hole = scorer.depth_error(Mask.named("four_hole"))
    disc = scorer.depth_error(Mask.named("disc"))
    assert four_hole.shape == (2,)
    assert four_hole.dtype == np.float64
    assert (1.5 * four_hole < disc).all()
    assert four_hole[1] > four_hole[0]  # noise
    assert disc[1] > disc[0]
    # The same pattern behind a grey filter passes a quarter of the light.
    grey = Mask("grey", Mask.named("four_hole").transmission / 4)
    assert scorer.depth_error(grey)[1] > 1.2 * four_hole[1]


def test_the_same_seed_gives_the_same_error(patches):
    mask = Mask.named("disc")
    error = scorer_of(patches).depth_error(mask)
    np.testing.assert_array_equal(scorer_of(patches).depth_error(mask), error)
    other = scorer_of(patches, seed=1)
    assert (other.true_levels != scorer_of(patches).true_levels).any()
    assert other.depth_error(mask) != error


def test_levels_are_as_frequent_as_each_other(patches):
    counts = np.bincount(scorer_of(patches).true_levels)
    assert counts.tolist() == [len(patches) // SCENE.levels] * SCENE.levels


@pytest.mark.parametrize("name", ["levin", "zhou", "three_wide"])
def test_cost_is_that_of_the_filter_bank(patches, name):
    mask, sigma = Mask.named(name), 0.001
    stack = render_psf_stack(mask, SCENE.blur_sizes_px)
    scorer = scorer_of(patches, (sigma,))
    noise = sigma / mask.open_fraction
    random = np.random.default_rng(1)
    windows = blurred_windows(scorer, patches, stack.psfs)
    windows += noise * random.standard_normal(windows.shape, np.float32)

    every = WINDOW_PX * (WINDOW_PX // 2 + 1)
    bank = learn_bank(stack, LearnConfig(WINDOW_PX, every, highest_frequency=0.35))
    of_bank = bank.energies(windows.reshape(-1, WINDOW_PX), WINDOW_PX, noise)[:, 0].copy()

    spectra = WindowSpectra(WINDOW_PX)
    power = np.abs(spectra.transform(windows)) ** 2
    cost = spectra.cost(power, spectra.expected(stack.psfs), noise)
    levels = likeliest_levels(cost)
    assert np.mean(levels == of_bank.argmin(axis=1)) > 0.85
    # Half of the frequencies each way say nearly as much of every level, by frequency.
    of_bank /= bank.fourier.multiplicity.sum()
    assert np.median(np.abs(cost - of_bank)) < 0.1
    # And what is predicted is the error of the bank.
    error = np.abs(of_bank.argmin(axis=1) - scorer.true_levels).mean()
    assert scorer.depth_error(mask)[0] == pytest.approx(error, abs=0.25)


def test_patches_are_blurred_around_their_middle(patches):
    """An asymmetric mask shows a PSF that is shifted or turned."""
    mask = Mask.named("three_wide")
    scorer = scorer_of(patches)
    psfs = render_psf_stack(mask, SCENE.blur_sizes_px).psfs
    expected = scorer.spectra.transform(blurred_windows(scorer, patches, psfs))
    np.testing.assert_allclose(scorer._blurred(psfs), expected, atol=1e-4)


def test_expected_power_is_that_of_the_bank():
    spectra = WindowSpectra(WINDOW_PX)
    stack = render_psf_stack(Mask.named("levin"), SCENE.blur_sizes_px[:2])
    bank = learn_bank(stack, LearnConfig(WINDOW_PX, 8, highest_frequency=0.35))
    half = (WINDOW_PX, WINDOW_PX // 2 + 1)
    counts = (bank.fourier.multiplicity.reshape(half) > 0)[::2, ::2]
    for slope, expected in zip(bank.prior.slopes, spectra.expected(stack.psfs), strict=True):
        for psf, power in zip(stack.psfs, expected, strict=True):
            exact = bank.fourier.expected_power(psf, slope).reshape(half)[::2, ::2][counts]
            np.testing.assert_allclose(
                power, exact + bank.prior.model_error**2, rtol=0.1, atol=4e-4
            )


def test_white_noise_has_the_power_of_its_variance():
    windows = 3 * np.random.default_rng(0).standard_normal((200, 50, 50), np.float32)
    spectra = WindowSpectra(50)
    power = np.abs(spectra.transform(windows)) ** 2
    assert power.shape[1] == len(spectra.multiplicity)
    assert power.mean() == pytest.approx(9, rel=0.02)


def test_where_nothing_is_known_the_middle_level_counts():
    cost = np.array([[1.0, 1.0, 1.0, 1.0], [2.0, 1.0, 0.0, 1.0]], np.float32)
    assert likeliest_levels(cost).tolist() == [1.5, 2.0]


@pytest.mark.parametrize("largest_px", [30.0, 60.0])
def test_patches_have_room_for_the_largest_blur(largest_px):
    scene = SceneConfig(levels=4, largest_px=largest_px)
    side = patch_side_px(scene)
    width = render_psf_stack(Mask.named("disc"), scene.blur_sizes_px).psfs.shape[-1]
    assert side % 2 == 0
    assert side - 96 >= width
    patches = crops(TEXTURES, 16, side)
    assert 0 <= PictureScorer(patches, scene).depth_error(Mask.named("levin"))[0] < 3


def test_patches_of_pictures_are_cut_from_them():
    ramp = np.arange(100 * 120, dtype=np.float32).reshape(100, 120)
    patches = crops(Textures("natural", (ramp,)), 5, 80, seed=3)
    corners = patches[:, 0, 0].astype(int)
    assert len(set(corners)) > 1
    for patch, corner in zip(patches, corners, strict=True):
        top, left = divmod(corner, 120)
        np.testing.assert_array_equal(patch, ramp[top : top + 80, left : left + 80])
    with pytest.raises(InputError, match="no picture has the 101 rows"):
        crops(Textures("natural", (ramp,)), 5, 101)


def test_what_cannot_be_predicted_is_refused(patches):
    for wrong in (patches[:0], patches[0], patches[:, :-1], patches[:, 2:, 2:]):
        with pytest.raises(InputError, match=f"shape .N, {SIDE_PX}, {SIDE_PX}."):
            scorer_of(wrong)
    with pytest.raises(InputError, match="sigmas"):
        scorer_of(patches, (0.0,))
    with pytest.raises(InputError, match="even"):
        PictureScorer(patches, SCENE, window_px=47)
    with pytest.raises(InputError, match="31 px does not fit the 30 px window"):
        PictureScorer(patches, SCENE, window_px=30)
    for name in ("motion_px", "diffraction_px"):
        with pytest.raises(InputError, match=f"{name}: not supported by the prediction"):
            PictureScorer(patches, SceneConfig(levels=8, **{name: 1.0}), window_px=WINDOW_PX)
    full = Mask("full", np.ones((5, 5)))
    with pytest.raises(InputError, match="mask full: all cells have one colour"):
        scorer_of(patches).depth_error(full)
