"""The registry of benchmarks, and depth maps that are kept from run to run."""

import dataclasses

import numpy as np
import pytest
from cli_scene import call_benchmarks, json_of_benchmarks, texture
from coded_aperture_benchmarks.methods import depth
from coded_aperture_benchmarks.methods.depth import CameraBank, StackBank, predict
from coded_aperture_benchmarks.registry import BENCHMARKS, OF_THE_PROGRAM, Group
from coded_aperture_benchmarks.run import PREDICTIONS

from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.likelihood.bank import LearnConfig
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack

LEARN = LearnConfig(window_px=32, rank=16)
BANK = StackBank(render_psf_stack(Mask.named("levin"), [3.0, 5.0, 7.0, 9.0]), LEARN)
CONFIG = DepthConfig(confidence_threshold=0.0, regularize="none")
FRAME = texture(64, 80)


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setenv(PREDICTIONS, str(tmp_path))
    return lambda: sorted(tmp_path.iterdir())


def test_a_prediction_is_kept_and_found_again(kept, monkeypatch):
    first = predict(FRAME, BANK, CONFIG)
    assert len(kept()) == 1
    monkeypatch.setattr(depth, "DepthEstimator", pytest.fail)  # nothing is estimated again
    second = predict(FRAME.copy(), BANK, CONFIG)
    np.testing.assert_array_equal(second.blur_size_px, first.blur_size_px)
    np.testing.assert_array_equal(second.confidence, first.confidence)
    assert second.noise == first.noise


def test_whatever_a_prediction_follows_from_tells_it_from_others(kept, monkeypatch):
    predict(FRAME, BANK, CONFIG)
    predict(FRAME + np.float32(0.001), BANK, CONFIG)
    predict(FRAME, BANK, dataclasses.replace(CONFIG, noise=0.01))
    predict(FRAME, StackBank(BANK.stack, LearnConfig(window_px=32, rank=17)), CONFIG)
    camera = Camera(400.0, 1.0, 80, 64, Mask.named("levin"), 40.0)
    predict(FRAME, BANK, CONFIG, camera)
    assert len(kept()) == 5
    monkeypatch.setattr(depth, "_source_digest", lambda: "of another day")
    predict(FRAME, BANK, CONFIG)
    assert len(kept()) == 6


def test_depth_that_remembers_past_frames_is_not_kept(kept):
    predict(FRAME, BANK, dataclasses.replace(CONFIG, temporal_frames=4.0))
    assert kept() == []


def test_nothing_is_kept_unless_it_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.delenv(PREDICTIONS, raising=False)
    monkeypatch.chdir(tmp_path)
    predict(FRAME, BANK, CONFIG)
    assert list(tmp_path.iterdir()) == []


def test_a_bank_for_a_scene_reaches_a_little_beyond_it():
    camera = Camera(400.0, 1.0, 80, 64, Mask.named("levin"), 40.0)
    depth_m = np.array([[1.5, np.nan], [2.0, 3.0]], np.float32)
    bank = CameraBank.of_scene(camera, depth_m, 8)
    assert (bank.near_m, bank.far_m) == (pytest.approx(1.47), pytest.approx(3.06))
    assert bank.learn() is CameraBank.of_scene(camera, depth_m, 8).learn()


def test_the_option_keeps_predictions(tmp_path, capsys, monkeypatch):
    pytest.importorskip("numba", reason="random scenes need numba")
    monkeypatch.delenv(PREDICTIONS, raising=False)
    words = ("accuracy", "scenes", "--random", 1, "--size", "96x80", "--levels", 6, "--jobs", 1)
    folder = tmp_path / "predictions"
    before = json_of_benchmarks(capsys, *words, "--predictions", folder)
    assert len(list(folder.iterdir())) == 1
    after = json_of_benchmarks(capsys, *words, "--predictions", folder)
    assert after["cells"] == before["cells"]
    assert len(list(folder.iterdir())) == 1


def entries():
    for name, described in BENCHMARKS.items():
        if isinstance(described, Group):
            yield from (((name, suite), entry) for suite, entry in described.suites.items())
        else:
            yield (name,), described


@pytest.mark.parametrize("words, entry", list(entries()), ids=lambda value: str(value)[:40])
def test_every_benchmark_says_what_it_is(capsys, words, entry):
    suite = entry.load()
    assert suite.description and suite.examples
    text = call_benchmarks(capsys, *words, "--help").out
    assert " ".join(words) in text
    assert max(map(len, text.splitlines())) <= 110


def test_the_program_offers_what_the_contract_names():
    assert list(OF_THE_PROGRAM) == ["accuracy", "deblur", "speed"]
    assert set(OF_THE_PROGRAM) < set(BENCHMARKS)
