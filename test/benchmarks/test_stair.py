"""The stair of blur sizes, its textures, the thesis' numbers beside it, and reliability."""

import numpy as np
import pytest
from coded_aperture_benchmarks.datasets import textures as module
from coded_aperture_benchmarks.datasets.textures import load_textures, training_textures
from coded_aperture_benchmarks.thesis.reference.subspace_distances import LETTER_OF_MASK
from coded_aperture_benchmarks.thesis.stair import (
    area_psf_stack,
    blur_stack,
    level_error,
    make_stair,
    noise_behind,
    spread_per_step,
)
from coded_aperture_benchmarks.thesis.tables import LETTERS, METHODS, thesis_error
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.io import write_image
from coded_aperture_ros.metrics import Reliability
from coded_aperture_ros.optics import MASK_NAMES, Mask

FOUR_HOLE, LEVIN = Mask.named("four_hole"), Mask.named("levin")
RANDOM = load_textures("random")
SMALL = {"levels": 3, "side_px": 20}


class Marked(Textures):
    """Black crops with one white pixel each."""

    def __init__(self, row, column):
        super().__init__("marked", ())
        object.__setattr__(self, "place", (row, column))

    def crops(self, count, rows, columns, random):
        crops = np.zeros((count, rows, columns), np.float32)
        crops[(slice(None), *self.place)] = 1
        return crops


def test_the_stair_has_the_size_of_the_thesis():
    stair = make_stair(FOUR_HOLE, RANDOM)
    assert stair.coded.shape == stair.level.shape == (4875, 125)
    assert stair.coded.dtype == np.float32
    np.testing.assert_allclose(stair.stack.blur_sizes_px, np.linspace(7, 30, 39))
    np.testing.assert_array_equal(stair.level[::125, 0], np.arange(39))
    assert (stair.level == stair.level[:, :1]).all()


def test_every_step_shows_a_point_as_its_own_psf():
    side, reach = 40, 15
    mask = Mask("lopsided", np.array([[1, 1, 1], [0, 1, 0], [0, 0, 0]], np.float32))
    stair = make_stair(mask, Marked(reach + side // 2, reach + side // 2), levels=4, side_px=side)
    for step, size in enumerate(stair.stack.blur_sizes_px):
        psf = area_psf_stack(mask, [size]).psfs[0]
        expected = np.zeros((side, side))
        half = len(psf) // 2
        around = slice(side // 2 - half, side // 2 + half + 1)
        expected[around, around] = psf
        picture = stair.coded[step * side : (step + 1) * side]
        np.testing.assert_allclose(picture, expected, atol=1e-6)


def test_light_crosses_the_boundary_of_two_steps():
    """A point at the end of a step is seen from the next, blurred as there (eq. 6.1)."""
    side, reach = 40, 15
    stair = make_stair(
        FOUR_HOLE, Marked(reach + side - 1, reach + side // 2), **{**SMALL, "side_px": side}
    )
    psf = stair.stack.psfs[1]
    seen = stair.coded[side : side + reach, side // 2 - reach : side // 2 + reach + 1]
    np.testing.assert_allclose(seen, psf[reach + 1 :], atol=1e-6)
    assert seen.sum() > 0.2


def test_light_beyond_the_frame_is_that_of_the_crop():
    bright = Textures("bright", (np.ones((80, 80), np.float32),))
    np.testing.assert_allclose(make_stair(LEVIN, bright, **SMALL).coded, 1, atol=1e-5)


def test_the_same_seed_gives_the_same_crops_and_noise_for_all_masks():
    def parts(mask, sigma, seed):
        clean, noisy = (make_stair(mask, RANDOM, s, seed, **SMALL).coded for s in (0.0, sigma))
        return clean, noisy - clean

    clean, noise = parts(FOUR_HOLE, 0.01, 1)
    again, stronger = parts(FOUR_HOLE, 0.02, 1)
    np.testing.assert_array_equal(clean, again)
    np.testing.assert_allclose(stronger, 2 * noise, atol=1e-6)
    other_mask = parts(LEVIN, 0.01, 1)[1]
    ratio = FOUR_HOLE.open_fraction / LEVIN.open_fraction
    np.testing.assert_allclose(other_mask, ratio * noise, atol=1e-6)
    assert np.abs(parts(FOUR_HOLE, 0.01, 2)[0] - clean).mean() > 0.01


def test_noise_grows_as_the_mask_closes():
    """Eq. 6.29."""
    assert noise_behind(FOUR_HOLE, 0.001) == pytest.approx(0.001 / (4 * (8 / 34) ** 2))
    stair = make_stair(
        FOUR_HOLE, Textures("grey", (np.full((60, 60), 0.5, np.float32),)), 0.01, **SMALL
    )
    assert stair.coded.std() == pytest.approx(stair.noise, rel=0.05)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"sigma": -1.0}, "noise"),
        ({"sigma": float("nan")}, "noise"),
        ({"levels": 1}, "levels"),
        ({"side_px": 0}, "side"),
    ],
)
def test_impossible_stairs_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        make_stair(LEVIN, RANDOM, **{**SMALL, **values})


def test_crops_are_not_selected(monkeypatch):
    """All pictures take part equally often, and all places of a picture, flat or not."""
    pictures = tuple(np.full((12, 15), value, np.float32) for value in (0, 1, 2))
    crops = Textures("flat", pictures).crops(30, 12, 15, np.random.default_rng(0))
    assert [(crops[:, 0, 0] == value).sum() for value in (0, 1, 2)] == [10, 10, 10]
    ramp = np.arange(400, dtype=np.float32).reshape(20, 20)
    corners = Textures("ramp", (ramp,)).crops(3000, 16, 16, np.random.default_rng(0))[:, 0, 0]
    assert len(np.unique(corners)) == 25


def test_pictures_that_are_too_small_are_left_out_or_named():
    large, small = np.ones((30, 40), np.float32), np.zeros((30, 39), np.float32)
    crops = Textures("mixed", (large, small)).crops(9, 30, 40, np.random.default_rng(0))
    assert (crops == 1).all()
    with pytest.raises(InputError, match="40 columns"):
        Textures("small", (small,)).crops(1, 30, 40, np.random.default_rng(0))


def test_random_texture_is_white_and_uniform():
    crop = RANDOM.crops(1, 200, 200, np.random.default_rng(0))[0]
    assert crop.mean() == pytest.approx(0.5, abs=0.01)
    assert crop.var() == pytest.approx(1 / 12, rel=0.03)
    assert abs(np.corrcoef(crop[1:].ravel(), crop[:-1].ravel())[0, 1]) < 0.02


def test_built_in_pictures_are_grey_as_stored():
    pytest.importorskip("skimage")
    pytest.importorskip("sklearn")
    pictures = load_textures("natural").pictures
    assert len(pictures) == len(module.TEST_PICTURES)
    for picture in pictures:
        assert picture.ndim == 2
        assert picture.dtype == np.float32
        assert picture.min() >= 0
        assert 0.3 < picture.max() <= 1
    from skimage.data import astronaut

    stored = astronaut().mean(axis=2) / 255
    np.testing.assert_allclose(pictures[1], stored, atol=1e-6)


def test_soft_pictures_are_averages_of_four_pixels(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (8, 10), np.uint8)
    write_image(tmp_path / "one.png", image)
    (full,) = load_textures("natural", tmp_path).pictures
    (soft,) = load_textures("soft", tmp_path).pictures
    np.testing.assert_allclose(full, image / 255, atol=1e-6)
    np.testing.assert_allclose(soft, ndimage.uniform_filter(full, 2)[1::2, 1::2], atol=1e-6)


def test_test_and_training_pictures_are_disjoint():
    pytest.importorskip("skimage")
    assert not set(module.TEST_PICTURES) & set(module.TRAINING_PICTURES)
    assert len(training_textures().pictures) == len(module.TRAINING_PICTURES)


def test_a_folder_with_a_training_picture_is_refused(tmp_path):
    write_image(tmp_path / "Coffee.png", np.zeros((8, 8), np.uint8))
    with pytest.raises(InputError, match=f"{tmp_path}.*[Cc]offee"):
        load_textures("natural", tmp_path)


@pytest.mark.parametrize("folder", ["missing", "empty", "file"])
def test_a_folder_without_pictures_is_named(tmp_path, folder):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=folder):
        load_textures("natural", tmp_path / folder)


def test_an_unknown_texture_is_refused():
    with pytest.raises(InputError, match="natural, random, soft"):
        load_textures("unnatural")


def test_level_error_is_the_mean_of_absolute_errors():
    """Errors of opposite sign do not cancel."""
    true = np.full((2, 2), 5.0)
    level = np.array([[4.0, 6.0], [5.0, 8.0]])
    confidence = np.array([[0.9, 0.2], [0.8, 0.1]])
    error = level_error(level, true, 11, confidence)
    assert (error.mean, error.mean_confident, error.known) == (1.25, 0.5, 1.0)
    assert np.isnan(level_error(level, true, 11).mean_confident)


def test_saying_nothing_scores_the_middle():
    true = np.array([[0.0, 10.0]])
    error = level_error(np.array([[np.nan, 10.0]]), true, 11)
    assert (error.mean, error.known) == (2.5, 0.5)


def test_arrays_of_different_shapes_are_refused():
    with pytest.raises(InputError, match="shape"):
        level_error(np.zeros((2, 2)), np.zeros((2, 3)), 5)
    with pytest.raises(InputError, match="shape"):
        level_error(np.zeros((2, 2)), np.zeros((2, 2)), 5, np.zeros(2))


def test_spread_is_that_of_each_step():
    level = np.repeat([1.0, 3.0], 4)[:, None] + np.array([-1.0, 1.0])
    mean, deviation = spread_per_step(level, 2)
    np.testing.assert_allclose(mean, [1, 3])
    np.testing.assert_allclose(deviation, [1, 1])


def test_the_thesis_finds_its_own_method_best_on_photographs():
    """As its text says of every mask and noise; a mistyped table hardly would."""
    for sigma in (0.0, 0.001, 0.002, 0.005):
        for letter in LETTERS:
            errors = [thesis_error("natural", sigma, method, letter) for method in METHODS]
            best = min(errors[:-1])
            # Without noise, regularised filtering has a single better number, in column (f).
            assert errors[-1] < best or (sigma, letter) == (0.0, "f")


def test_the_numbers_of_the_thesis_by_our_names():
    assert thesis_error("natural", 0.001, "thesis", "four_hole") == 7.8
    assert thesis_error("random", 0.0, "levin", "levin") == 1.4
    assert thesis_error("random", 0.005, "wiener", "two_hole") == 15.4
    assert thesis_error("natural", 0.0, "regularized", "f") == 11.4
    assert set(LETTER_OF_MASK) < set(MASK_NAMES)
    for unknown in (
        ("soft", 0.0, "thesis", "levin"),
        ("natural", 0.003, "thesis", "levin"),
        ("natural", 0.0, "another", "levin"),
        ("natural", 0.0, "thesis", "disc"),
        ("natural", 0.0, "thesis", "ab"),
    ):
        assert thesis_error(*unknown) is None


def test_a_confidence_that_keeps_its_promise_has_no_calibration_error():
    random = np.random.default_rng(0)
    confidence = random.random(200_000)
    honest = Reliability.from_estimates(confidence, random.random(200_000) < confidence)
    assert honest.expected_calibration_error < 0.01
    np.testing.assert_allclose(honest.share_right, honest.mean_confidence, atol=0.02)
    boaster = Reliability.from_estimates(confidence, random.random(200_000) < confidence / 2)
    assert boaster.expected_calibration_error == pytest.approx(0.25, abs=0.01)


def test_too_timid_and_too_bold_do_not_cancel():
    confidence = np.repeat([0.25, 0.75], 4)
    mixed = Reliability.from_estimates(confidence, np.tile([True, False], 4))
    assert mixed.expected_calibration_error == pytest.approx(0.25)


@given(
    st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=30), st.integers(0, 30)
)
def test_diagrams_add_up(estimates, cut):
    confidence, right = (np.array(column) for column in zip(*estimates, strict=True))
    whole = Reliability.from_estimates(confidence, right)
    parts = [
        Reliability.from_estimates(confidence[part], right[part])
        for part in (slice(cut), slice(cut, None))
    ]
    total = Reliability.total(parts)
    np.testing.assert_array_equal(total.count, whole.count)
    np.testing.assert_array_equal(total.right, whole.right)
    np.testing.assert_allclose(total.confidence_sum, whole.confidence_sum)
    assert sum(row["count"] for row in whole.rows()) == len(estimates)
    assert 0 <= whole.expected_calibration_error <= 1


def test_confidences_outside_their_range_are_refused():
    for confidence in (1.1, -0.1, np.nan):
        with pytest.raises(InputError, match="confidence"):
            Reliability.from_estimates(np.array([confidence]), np.array([True]))
    with pytest.raises(InputError, match="shape"):
        Reliability.from_estimates(np.zeros(2), np.zeros(3, bool))


def test_levels_are_blur_sizes_from_7_to_30_px():
    assert blur_stack(LEVIN, 2).blur_sizes_px.tolist() == [7.0, 30.0]
