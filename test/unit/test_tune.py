"""Choosing window and stride for a time per frame."""

import dataclasses

import cv2
import numpy as np
import pytest

from coded_aperture_ros.cli.main import main, make_parser
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.depth import DepthEstimator
from coded_aperture_ros.depth import tune as tuning
from coded_aperture_ros.depth.tune import simulated_error, tune
from coded_aperture_ros.likelihood.bank import learn_bank
from coded_aperture_ros.optics import Mask, render_psf_stack


@pytest.fixture(scope="module")
def learn():
    stack = render_psf_stack(Mask.named("levin"), np.linspace(8, 20, 6))
    banks = {}

    def learned(config):
        if config not in banks:
            banks[config] = learn_bank(stack, config)
        return banks[config]

    return learned


def test_the_most_accurate_within_the_time_is_chosen(learn, monkeypatch):
    # Times that do not depend on the machine: the wider the stride the faster.
    monkeypatch.setattr(tuning, "_milliseconds", lambda bank, shape, stride, config: 100 / stride)
    bank, trials = tune(learn, (120, 160), budget_ms=6.0)
    assert {trial.window_px for trial in trials} == {48, 64, 96}
    allowed = [trial for trial in trials if trial.milliseconds <= 6]
    best = min(allowed, key=lambda trial: trial.level_error)
    assert len(allowed) < len(trials)
    assert (bank.window_px, bank.stride_px) == (best.window_px, best.stride_px)
    assert bank.level_error == best.level_error
    assert bank.highest_frequency < 1  # these blur sizes leave nothing above


def test_frames_are_timed_as_nodes_estimate_them(learn, monkeypatch):
    seen = []

    class Seen(DepthEstimator):
        def estimate(self, *args):
            found = super().estimate(*args)
            seen.append((found.level.shape, cv2.getNumThreads(), self.config))
            return found

    monkeypatch.setattr(tuning, "_WINDOWS_PX", (48,))
    monkeypatch.setattr(tuning, "simulated_error", lambda *args: 1.0)
    monkeypatch.setattr(tuning, "DepthEstimator", Seen)
    before = cv2.getNumThreads()
    tune(learn, (80, 100), budget_ms=1e6)
    assert cv2.getNumThreads() == before
    for shape, threads, config in seen:
        assert (shape, threads) == ((80, 100), thread_count(0))
        assert (config.threads, config.temporal_frames) == (0, 4)
    args = make_parser().parse_args(["learn", "--camera", "camera.yaml", "-o", "bank.npz"])
    assert args.budget_threads == 0


def test_a_time_that_cannot_be_kept_is_refused_with_the_least(learn):
    with pytest.raises(InputError, match=r"at most 0\.001 ms .* the fastest, a window of \d+ px"):
        tune(learn, (100, 120), budget_ms=0.001)


def test_frames_smaller_than_every_window_are_refused(learn):
    with pytest.raises(InputError, match=r"40x30 px are smaller than the smallest window, 48 px"):
        tune(learn, (30, 40), budget_ms=100)


def test_windows_that_the_blur_does_not_fit_are_left_out(monkeypatch):
    wide = render_psf_stack(Mask.named("levin"), np.linspace(40, 60, 4))
    monkeypatch.setattr(tuning, "_milliseconds", lambda *args: 1.0)
    bank, trials = tune(lambda config: learn_bank(wide, config), (120, 160), budget_ms=10)
    assert {trial.window_px for trial in trials} == {64, 96}
    assert bank.window_px in (64, 96)


def test_simulated_error_tells_good_banks_from_bad(learn):
    from coded_aperture_ros.likelihood.bank import LearnConfig

    good = learn(LearnConfig(window_px=48, rank=64))
    crippled = dataclasses.replace(good, coefficients=good.coefficients[..., ::-1])
    assert simulated_error(good, 12) < 0.6 * simulated_error(crippled, 12)
    assert simulated_error(good, 12) == simulated_error(good, 12)


def test_command_line_needs_a_camera_and_a_time(capsys, tmp_path):
    learn = ["learn", "--mask", "levin", "--blur-sizes", "7", "20", "8", "-o", "bank.npz"]
    with pytest.raises(SystemExit) as stopped:
        main([*learn, "--budget-ms", "30"])
    assert stopped.value.code == 2
    assert "--budget-ms needs --camera" in capsys.readouterr().err
