"""Does a frame fit its bank at all: spectra, evidence, health."""

import dataclasses

import cv2
import numpy as np
import pytest

from coded_aperture_ros.core.arrays import quantiles
from coded_aperture_ros.depth import (
    CAUSES,
    DepthConfig,
    DepthEstimator,
    Health,
    model_notes,
    unchecked_note,
)
from coded_aperture_ros.depth.quality import FitCheck, evidence, unchecked_reason
from coded_aperture_ros.depth.quality.evidence import HypothesisTest
from coded_aperture_ros.depth.quality.spectra import (
    NAMES,
    SLOPES,
    WINDOW_PX,
    PsfHypotheses,
    alternatives,
    bank_levels,
    equivalent_sizes_px,
    frequencies,
    levels_beyond,
    negative_log_likelihood,
    power_spectra,
)
from coded_aperture_ros.depth.quality.statistics import frame_statistics
from coded_aperture_ros.likelihood.bank import LearnConfig, WindowedFourierBasis, learn_bank
from coded_aperture_ros.likelihood.choose import new_model
from coded_aperture_ros.optics import Camera, Mask, PsfStack, render_psf, render_psf_stack
from coded_aperture_ros.simulation.layered import random_scene

SIZES_PX = np.arange(2.0, 18.0, 0.55)
NOISE = 0.001


@pytest.fixture(scope="module")
def levin():
    return Mask.named("levin")


@pytest.fixture(scope="module")
def stack(levin):
    return render_psf_stack(levin, SIZES_PX)


@pytest.fixture(scope="module")
def bank(stack):
    return learn_bank(stack, LearnConfig(window_px=48))


@pytest.fixture(scope="module")
def scene(levin):
    return random_scene(1_000_011, levin, shape=(288, 320))


def recorded(light, seed=0, noise=NOISE):
    random = np.random.default_rng(seed)
    return (light + noise * random.standard_normal(light.shape)).astype(np.float32)


def health_of(bank, frame, **config):
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0, **config))
    estimate = estimator.estimate(frame)
    estimator.close()
    return estimate


def test_expected_spectra_are_those_of_the_bank_s_basis():
    psf = render_psf(Mask.named("levin"), 9.3)
    basis = WindowedFourierBasis(WINDOW_PX)
    used = frequencies().used.ravel()
    exact = np.array([basis.expected_power(psf, slope)[used] for slope in SLOPES])
    found = PsfHypotheses.from_psfs([psf])
    share = frequencies().share
    # The strongest texture hides the noise.
    power = share / found.weights[-1]
    difference = np.abs(np.log(power / (1e5 * exact + 1)))
    # Steep textures leak from low frequencies beyond what is convolved with.
    assert difference.max() < 0.5
    assert difference.mean() < 0.01


def test_a_hypothesis_explains_its_own_texture_best(stack):
    random = np.random.default_rng(3)
    some = [4, 14, 24]
    hypotheses = PsfHypotheses.from_psfs([stack.psfs[level] for level in some])
    textures = cv2.GaussianBlur(random.standard_normal((400, 400)), (0, 0), 1.0)
    for number, level in enumerate(some):
        image = cv2.filter2D(textures, -1, stack.psfs[level])[60:-60, 60:-60]
        image = (image / image.std() + 1e-3 * random.standard_normal(image.shape)).astype("f4")
        windows = np.lib.stride_tricks.sliding_window_view(image, (WINDOW_PX,) * 2)[::60, ::60]
        power = power_spectra(windows.reshape(-1, WINDOW_PX, WINDOW_PX)) / 1e-6
        found = negative_log_likelihood(power.astype(np.float32), hypotheses).min(axis=1)
        chosen = found.argmin(axis=1) // len(SLOPES)
        assert (chosen == number).mean() > 0.9


def test_powers_of_white_noise_are_its_variance():
    random = np.random.default_rng(0)
    windows = 0.3 * random.standard_normal((200, WINDOW_PX, WINDOW_PX)).astype(np.float32)
    assert power_spectra(windows).mean() == pytest.approx(0.09, rel=0.02)


def test_alternatives_are_known_by_their_names(stack):
    found = alternatives(bank_levels(stack))
    assert set(found) <= set(NAMES)
    assert {"disc", "sharp", "rot45", "inverted"} <= set(found)
    assert levels_beyond(bank_levels(stack)).psfs
    share = frequencies().share
    for hypotheses in found.values():
        assert hypotheses.weights.shape[2] == len(share)
        assert np.isfinite(hypotheses.weights).all()
        assert hypotheses.weights.shape[:2] == hypotheses.log_determinants.shape


def test_every_level_of_small_blur_is_tried_and_some_of_the_others():
    sizes_px = np.arange(1.5, 16.1, 0.25)
    found = bank_levels(render_psf_stack(Mask.named("four_hole"), sizes_px))
    assert set(sizes_px[sizes_px < 4]) <= set(found.sizes_px)
    assert found.sizes_px.max() == 16.0
    assert 0.5 < np.diff(found.sizes_px)[-8:].max() < 1.1


def test_a_bank_with_all_sizes_has_none_beyond():
    sizes_px = np.arange(1.5, 22.4, 1.0)
    assert not levels_beyond(bank_levels(render_psf_stack(Mask.named("zhou"), sizes_px))).psfs


def test_evidence_is_of_textured_windows_without_unusable_pixels(stack, scene):
    frame = recorded(scene.coded())
    unusable = np.zeros(frame.shape, bool)
    unusable[:, :160] = True
    found = HypothesisTest(stack).score(frame, NOISE, unusable)
    assert found.columns.min() >= 160
    assert found.weight.sum() == pytest.approx(1)
    assert np.isfinite(found.features).all()
    assert HypothesisTest(stack).score(frame, NOISE, np.ones(frame.shape, bool)) is None
    assert HypothesisTest(stack).score(frame[:40, :40], NOISE, None) is None


def test_fewer_windows_are_asked_first_and_more_where_these_leave_doubt(stack, scene, monkeypatch):
    asked = []
    ask = HypothesisTest.score

    def counted(self, grey, noise, unusable, cells):
        asked.append(cells)
        return ask(self, grey, noise, unusable, cells)

    monkeypatch.setattr(HypothesisTest, "score", counted)
    bank = learn_bank(stack, LearnConfig(window_px=48))
    assert health_of(bank, recorded(scene.coded())).health.fits
    assert len(asked) == 1
    asked.clear()
    assert not health_of(bank, recorded(scene.all_in_focus())).health.fits
    assert asked == sorted(set(asked))
    assert len(asked) == 2


def test_loops_and_numpy_tally_residuals_alike():
    random, at = np.random.default_rng(0), frequencies()
    count = len(at.radius)
    residual = random.exponential(size=(30, count)).astype(np.float32)
    weight = random.random(30)
    sizes_px = random.uniform(1, 22, 30)
    found = []
    for tally in (evidence._tally_loop, evidence._tally.plain, evidence._tally):
        sums = np.zeros((2, 13 * 4)), np.zeros((3, 31 * 15))
        arrays = at.radius, at.vertical, at.horizontal, at.directions(4)
        tally(residual, sizes_px, weight, arrays, sums)
        found.append(sums)
    for sums in found[1:]:
        for one, other in zip(sums, found[0], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)
    assert found[0][1][2].sum() == 30 * count


@pytest.mark.parametrize("shape", [(7,), (25, 3), (1,)])
def test_quantiles_are_those_of_numpy(shape):
    values = np.random.default_rng(0).standard_normal(shape)
    shares = 0.05, 0.5, 0.9, 1.0
    np.testing.assert_allclose(quantiles(values, *shares), np.quantile(values, shares, axis=0))


@pytest.mark.parametrize("frame", [np.zeros((60, 60)), np.full((96, 128), 0.5), np.eye(99)])
def test_odd_frames_have_finite_traces(frame):
    assert np.isfinite(frame_statistics(frame.astype(np.float32), NOISE, 0.0)).all()


def test_a_fitting_frame_keeps_its_confidence(bank, scene):
    frame = recorded(scene.coded())
    checked, unchecked = (health_of(bank, frame, check_fit=check) for check in (True, False))
    assert checked.health.fits
    assert checked.health.cause == ""
    assert unchecked.health is None
    np.testing.assert_array_equal(checked.confidence, unchecked.confidence)
    assert checked.seconds["quality of fit"] > 0


def test_a_frame_without_noise_fits(scene, bank):
    """As simulated ones are; what is enlarged has none at the highest frequencies, either."""
    light = scene.coded()
    assert health_of(bank, light).health.fits
    large = cv2.resize(recorded(light), None, fx=2.5, fy=2.5, interpolation=cv2.INTER_CUBIC)
    assert not health_of(bank, large).health.fits


@pytest.fixture(scope="module")
def own_healths(levin, bank):
    """Return scenes, and the health of their frames through the bank's own mask."""
    scenes = [random_scene(seed, levin, shape=(288, 320)) for seed in range(1_000_030, 1_000_036)]
    return [(scene, health_of(bank, recorded(scene.coded())).health) for scene in scenes]


@pytest.mark.slow
@pytest.mark.parametrize("mask", ["four_hole", "disc"])
def test_frames_through_another_mask_do_not_fit(bank, own_healths, mask):
    """Not all small frames tell."""
    healths = []
    for scene, own in own_healths:
        frame = recorded(scene.coded(Mask.named(mask)))
        other = health_of(bank, frame)
        healths.append((own.value, other.health.value))
        if not other.health.fits:
            assert other.health.cause in CAUSES
            unchecked = health_of(bank, frame, check_fit=False)
            assert other.confidence.mean() < unchecked.confidence.mean()
    own_values, other_values = np.array(healths).T
    assert (own_values >= 0.5).mean() >= 0.8
    assert (other_values < 0.5).mean() >= 0.5
    assert np.median(own_values - other_values) > 0.3


def test_enlarged_frames_do_not_fit_and_are_named(scene, bank):
    frame = recorded(scene.coded())
    large = cv2.resize(frame, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    estimate = health_of(bank, large)
    assert not estimate.health.fits
    assert estimate.health.cause == "scale"


def test_a_video_is_checked_now_and_then_and_remembered(bank, scene):
    check = FitCheck(bank.stack, remembers=True)
    estimator = DepthEstimator(bank, DepthConfig(check_fit=False, confidence_threshold=0.0))
    fitting, other = recorded(scene.coded()), recorded(scene.coded(Mask.named("zhou")))

    def asked(frame):
        work = estimator.run_front(frame)
        estimator.run_back(work)
        misfit = work.frame_cost.misfit
        return check(work.observation, misfit, work.level, work.confidence)

    first = asked(fitting)
    assert [asked(other) for _ in range(3)] == [first] * 3
    fifth = asked(other)
    assert fifth.value < first.value
    for _ in range(3):
        asked(other)
    assert asked(other).value < fifth.value
    check.reset()
    assert asked(fitting) == first
    estimator.close()


@pytest.mark.parametrize(
    ("value", "left"), [(0.9, 0.8), (0.7, 0.8), (0.45, 0.35), (0.2, 0.2), (0.0, 0.2)]
)
def test_what_health_leaves_of_a_confidence(value, left):
    health = Health(value, "" if value >= 0.5 else "none")
    confidence = np.array([0.8, 0.1], np.float32)
    np.testing.assert_allclose(health.limit_confidence(confidence), [left, 0.1], atol=1e-6)
    assert health.withheld == (value < 0.2)


def test_what_is_beyond_a_guarded_bank_is_its_own(stack, scene):
    frame = recorded(scene.coded())
    kept = np.abs(stack.blur_sizes_px) < 5
    some = PsfStack(stack.blur_sizes_px[kept], stack.psfs[kept])
    sizes = [
        HypothesisTest(some, guarded).score(frame, NOISE, None).size_px.max() for guarded in (0, 1)
    ]
    assert sizes[0] < 5 < sizes[1]


def test_health_in_words():
    assert str(Health(0.97)) == "fits (0.97)"
    assert str(Health(0.12, "none")) == "does not fit (0.12): no mask in the lens: put it in"


def test_only_levels_that_the_network_was_trained_for_are_checked(stack):
    assert not unchecked_reason(stack)
    large = dataclasses.replace(stack, blur_sizes_px=2 * stack.blur_sizes_px)
    assert "blur of 35.9 px is above 22.5 px" in unchecked_reason(large)
    few = PsfStack(stack.blur_sizes_px[:2], stack.psfs[:2])
    assert unchecked_reason(few) == "its 2 levels are fewer than 3"


def test_psfs_without_sizes_are_checked_by_their_widths(stack, scene, levin):
    unknown = dataclasses.replace(stack, blur_sizes_px=np.arange(len(stack)), in_pixels=False)
    assert not unchecked_reason(unknown)
    assert equivalent_sizes_px(unknown) == pytest.approx(stack.blur_sizes_px, rel=0.2)
    bank = learn_bank(unknown, LearnConfig(window_px=48))
    fits = health_of(bank, recorded(scene.coded())).health
    other = health_of(bank, recorded(scene.coded(Mask.named("disc")))).health
    assert fits.fits and not other.fits
    wide = dataclasses.replace(unknown, psfs=np.ones((len(stack), 61, 61), np.float32) / 61**2)
    assert "above 22.5 px" in unchecked_reason(wide)


def test_users_are_told_what_is_not_checked(stack, bank):
    few = learn_bank(PsfStack(stack.blur_sizes_px[:2], stack.psfs[:2]), LearnConfig(window_px=48))
    told = "frames are not checked for fit: its 2 levels are fewer than 3"
    assert told in model_notes(few, DepthConfig(), None)
    assert told not in model_notes(few, DepthConfig(check_fit=False), None)
    assert model_notes(bank, DepthConfig(), None) == []
    assert unchecked_note(new_model("motion", bank=bank)).endswith("without motion have a check")
    lens = Camera(800.0, 0.6, 640, 480, Mask.named("levin"), 8.0, focal_length_mm=16.0)
    (note,) = model_notes(bank, DepthConfig(), lens)
    assert "away from the axis is doubted" in note


def test_a_bank_s_own_check_replaces_health_only(bank, scene):
    frame = recorded(scene.coded())
    usual = health_of(bank, frame).health
    terms = len(CAUSES) + 1 + len(NAMES)
    never = dataclasses.replace(bank, own_fit=(-5.0, *[0.0] * terms))
    same = dataclasses.replace(bank, own_fit=(0.0, 1.0, *[0.0] * (terms - 1)))
    assert health_of(never, frame).health.value == pytest.approx(1 / (1 + np.exp(5)), abs=1e-4)
    assert health_of(same, frame).health.value == pytest.approx(usual.value, abs=1e-5)
    for limits, fits in (((20.0, 20.0), True), ((-20.0, 20.0), False), ((20.0, -20.0), False)):
        limited = dataclasses.replace(bank, own_fit=(*same.own_fit, *limits))
        health = health_of(limited, frame).health
        assert health.fits == fits and health.cause == ("" if fits else "turned")
