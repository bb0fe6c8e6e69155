"""Likelihood ratio of a bank's PSFs against other optics."""

import dataclasses

import cv2
import numpy as np
import pytest
from textures import natural_texture

from coded_aperture_ros.calibration.psf import optics_limits
from coded_aperture_ros.calibration.psf.optics_limits import with_optics_limits
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.quality import (
    HypothesisTest,
    OpticsFit,
    OpticsTest,
    fitted_limits,
    optics_test,
)
from coded_aperture_ros.depth.quality.optics_test import surprise
from coded_aperture_ros.depth.quality.spectra import NAMES
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank, load_bank, save_bank
from coded_aperture_ros.optics import Mask, render_psf_stack

SIZES_PX = np.arange(2.0, 18.0, 0.55)
NOISE = 0.001


@pytest.fixture(scope="module")
def bank():
    stack = render_psf_stack(Mask.named("levin"), SIZES_PX)
    return with_optics_limits(learn_bank(stack, LearnConfig(window_px=48)))


def recorded(light):
    noise = NOISE * np.random.default_rng(0).standard_normal(light.shape)
    return (light + noise).astype(np.float32)


def surprise_of(bank, frame):
    gains = OpticsTest(HypothesisTest(bank.stack)).gains(frame, NOISE, None)
    return surprise(gains, bank.optics_limits)


def seen_through(mask, size_px, seed=1):
    texture = np.clip(natural_texture((288, 320), seed, 0.05), 0, 1)
    return recorded(cv2.filter2D(texture, -1, render_psf_stack(mask, [size_px]).psfs[0]))


@pytest.fixture(scope="module")
def ring():
    """Aperture that is no alternative of the test."""
    radius = np.hypot(*np.meshgrid(*[np.linspace(-1, 1, 66)] * 2))
    return Mask("ring", ((radius < 1) & (radius > 0.45)).astype(np.float32))


def test_other_optics_surprise_and_the_bank_s_own_do_not(bank, ring):
    own = seen_through(Mask.named("levin"), 6.3)
    large = cv2.resize(own, None, fx=1.4, fy=1.4, interpolation=cv2.INTER_CUBIC)
    assert surprise_of(bank, own) < 0.5
    assert surprise_of(bank, seen_through(Mask.named("levin"), 11.2, seed=2)) < 0.5
    assert surprise_of(bank, seen_through(ring, 6.3)) > 2
    assert surprise_of(bank, seen_through(Mask.named("disc"), 9.0)) > 2
    assert surprise_of(bank, large) > 2


def test_texture_with_directions_does_not_surprise(bank):
    lines = np.zeros((288, 320), np.float32)
    lines[:, :] = 0.3 + 0.4 * (np.random.default_rng(5).random(320) > 0.5)
    lines += 0.02 * np.random.default_rng(6).standard_normal(lines.shape)
    psf = render_psf_stack(Mask.named("levin"), [6.3]).psfs[0]
    assert surprise_of(bank, recorded(cv2.filter2D(lines.astype(np.float32), -1, psf))) < 1


def test_health_falls_with_the_surprise_alone(bank, ring):
    sure = np.array([2.0, 0.0, 1.0], np.float32)
    unfit = np.array([-1.0, 0.0, 1.0], np.float32)
    hypotheses, fit = HypothesisTest(bank.stack), OpticsFit(bank.optics_limits)
    for mask, low, high in ((Mask.named("levin"), 0.0, 0.5), (ring, 2.5, 3.01)):
        frame = {"grey": seen_through(mask, 6.3), "noise": NOISE, "unusable": None}
        lowered = fit(sure, hypotheses, frame)
        assert low <= sure[0] - lowered[0] < high
        np.testing.assert_array_equal(lowered[1:], sure[1:])
        assert fit(unfit, hypotheses, frame) is unfit
    plain = np.full((96, 96), 0.4, np.float32)
    assert fit(sure, hypotheses, frame | {"grey": plain}) is sure
    surer = np.array([3.9, 0.0, 1.0], np.float32)
    assert fit(surer, hypotheses, frame) is surer  # it would stay trusted


@pytest.mark.parametrize("middle_only", [False, True])
def test_frames_on_a_device_are_looked_at_in_memory(bank, middle_only):
    torch = pytest.importorskip("torch", reason="needs PyTorch")
    hypotheses = HypothesisTest(bank.stack)
    sure = np.array([2.0, 0.0, 1.0], np.float32)
    given = {"grey": seen_through(Mask.named("disc"), 9.0), "unusable": np.zeros((288, 320), bool)}
    tensors = {name: torch.from_numpy(array) for name, array in given.items()}
    fit = OpticsFit(bank.optics_limits, middle_only)
    found = [fit(sure, hypotheses, each | {"noise": NOISE}) for each in (given, tensors)]
    assert found[0][0] == -1
    np.testing.assert_array_equal(*found)


def test_the_estimator_heeds_the_limits_of_its_bank(bank, monkeypatch):
    monkeypatch.setattr(optics_test, "_SURE", np.inf)  # the networks are very sure here

    def health(limits):
        model = dataclasses.replace(bank, optics_limits=limits)
        estimator = DepthEstimator(model, DepthConfig(confidence_threshold=0.0))
        found = estimator.estimate(seen_through(Mask.named("levin"), 6.3)).health.value
        estimator.close()
        return found

    plain = health(())
    strict = health((*bank.optics_limits[:-1], 1e-3))
    assert health(bank.optics_limits) == pytest.approx(plain, abs=0.05)
    logit = np.log(plain / (1 - plain))
    assert strict == pytest.approx(1 / (1 + np.exp(3 - logit)), abs=1e-3)


def test_limits_are_kept_in_the_file_and_measured_once(bank, tmp_path):
    save_bank(bank, tmp_path / "bank.npz")
    loaded = load_bank(tmp_path / "bank.npz")
    assert loaded.optics_limits == pytest.approx(bank.optics_limits)
    assert with_optics_limits(loaded) is loaded
    again = with_optics_limits(dataclasses.replace(bank, optics_limits=()))
    assert again.optics_limits == bank.optics_limits
    own = dataclasses.replace(bank, own_fit=(1.0,), optics_limits=())
    assert with_optics_limits(own) is own


def test_limits_are_above_all_but_a_share_of_the_frames():
    random = np.random.default_rng(3)
    gains = random.normal(size=(200, len(NAMES) + 2))
    gains[:, 4] = np.nan  # the bank has no such alternative
    limits = fitted_limits(gains, 0.05)
    assert len(limits) == 2 * gains.shape[1] + 1
    assert np.mean([surprise(each, limits) > 1 for each in gains]) == pytest.approx(0.05)
    assert surprise(gains[0] + 5, limits) > 1 > surprise(gains[0] - 5, limits)


def test_simulated_frames_show_all_levels(bank):
    frames = list(optics_limits._frames(bank.stack.psfs))
    assert len(frames) == 60
    for frame, noise in frames:
        assert frame.shape == (240, 240) and frame.dtype == np.float32
        assert 0.0008 <= noise <= 0.006 and 0 <= frame.min() < frame.max() <= 1
