"""Refinements that are fitted further to a bank, and how banks keep and use them."""

import dataclasses
import importlib
import json
import sys

import numpy as np
import pytest
from cli_scene import call

from coded_aperture_ros.calibration.psf import nominal, simulated
from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.decoders.network import network as package
from coded_aperture_ros.likelihood.bank import learn_bank, load_bank, save_bank
from coded_aperture_ros.optics import Mask, render_psf_stack

PARTS = "coded_aperture_ros.calibration.fine_tuning"
SIZES_PX = np.linspace(3, 9, 13)


def shipped_weights():
    return read_shipped(package.__file__, package.WEIGHTS, package.SCHEMA, package.SCHEMA_VERSION)


def part(name):
    return importlib.import_module(f"{PARTS}.{name}")


@pytest.fixture(scope="module")
def bank():
    return learn_bank(render_psf_stack(Mask.named("levin"), SIZES_PX))


@pytest.fixture(scope="module")
def frame():
    return 0.9 * np.random.default_rng(0).random((96, 128), np.float32)


def with_own(bank, **changed):
    """Bank with the weights that ship as its own, some of them changed."""
    names = [name for name in shipped_weights() if not name.startswith("schema")]
    return dataclasses.replace(
        bank, refinement={name: shipped_weights()[name] for name in names} | changed
    )


def levels(bank, frame, **settings):
    settings = {"network": "opencv", "confidence_threshold": 0.0, **settings}
    return DepthEstimator(bank, DepthConfig(**settings)).estimate(frame).level


def test_the_same_weights_give_the_same_depth_from_a_file_too(bank, frame, tmp_path):
    save_bank(with_own(bank), tmp_path / "bank.npz")
    own = load_bank(tmp_path / "bank.npz")
    assert set(own.refinement) == set(with_own(bank).refinement)
    assert np.array_equal(levels(own, frame), levels(bank, frame))
    save_bank(bank, tmp_path / "bank.npz")
    assert load_bank(tmp_path / "bank.npz").refinement is None


def test_a_bank_is_refined_by_its_own_weights(bank, frame):
    # All of the last layer's weight on one blur size.
    bias = np.zeros_like(shipped_weights()["size_bias"])
    bias[4 * 12 : 4 * 13] = 1e3  # 6 px
    own = with_own(bank, size_bias=bias)
    assert levels(own, frame) == pytest.approx(6, abs=0.1)  # the level of 6 px
    assert np.array_equal(
        levels(own, frame, regularize="semiglobal"), levels(bank, frame, regularize="semiglobal")
    )


def test_no_second_surface_is_told_by_other_weights(bank, frame):
    config = DepthConfig(second_surface=True, network="opencv")
    estimate = DepthEstimator(with_own(bank), config).estimate(frame)
    assert np.isnan(estimate.layers["second_share"].values).all()


def test_without_pytorch_a_line_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    for name in [name for name in sys.modules if name.startswith(f"{PARTS}.")]:
        monkeypatch.delitem(sys.modules, name)
    words = ["--mask", "levin", "--blur-sizes", 3, 9, 13, "--train", 1]
    result = call(capsys, "learn", *words, "-o", tmp_path / "bank.npz")
    assert result.status == 1
    assert "--train needs torch: " in result.err and result.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--remap", "bank.npz", "--camera", "camera.yaml", "--train", 1], "--remap"),
        (["--device", "cuda"], "--train"),
        (["--train", 0], "--train"),
    ],
)
def test_what_does_not_go_together_is_said(words, said, capsys):
    mask = [] if "--remap" in words else ["--mask", "levin", "--blur-sizes", 3, 9, 13]
    result = call(capsys, "learn", *mask, *words, "-o", "bank.npz")
    assert result.status == 2
    assert said in result.err


@pytest.fixture
def small(monkeypatch):
    """Training on a few small frames, in this process."""
    pytest.importorskip("torch", reason="training needs PyTorch")
    pytest.importorskip("onnx", reason="torch writes networks by it")
    pytest.importorskip("numba", reason="random scenes need numba")
    monkeypatch.setattr(simulated, "_SCENE_PX", 96)
    monkeypatch.setattr(nominal, "SCENES", 1)
    monkeypatch.setattr(part("tune"), "COMPARED_SCENES", range(1000, 1001))
    monkeypatch.setattr(part("simulated"), "processors", lambda: 1)
    for name in ("tune", "frames"):
        monkeypatch.setattr(part(name), "BATCH", 1)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of torch, about its own way to write a network
def test_training_goes_on_where_it_was_stopped_and_for_its_psfs_only(small, tmp_path, capsys):
    output = tmp_path / "bank.npz"
    said = []
    for mask, minutes in (("levin", 0.2), ("levin", 0.4), ("zhou", 0.4)):
        words = ["--mask", mask, "--blur-sizes", 3, 9, 13, "--train", minutes, "--json"]
        said.append(call(capsys, "learn", *words, "-o", output))
    first, second, other = said
    assert first.status == second.status == 0
    reports = [json.loads(one.out) for one in (first, second)]
    for name in ("training_frames", "training_steps"):
        assert 0 < reports[0][name] < reports[1][name]
    assert other.status == 1 and "for another bank: remove it" in other.err
    kept = load_bank(output).refinement is not None
    assert kept == reports[1]["refinement_kept"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("gain", [0.1, 0.0])
def test_only_what_gains_is_kept_with_its_own_confidence(
    small, bank, frame, tmp_path, monkeypatch, gain
):
    shares = iter([0.5, 0.5 + gain])
    monkeypatch.setattr(part("tune"), "right_share", lambda bank, progress: next(shares))
    tuned = part("tune").tune_refinement(bank, 0.2, tmp_path / "training")
    assert tuned.gains == (gain > 0)
    if not gain:
        assert tuned.bank is bank
        return
    assert len(tuned.bank.reliability) == 3
    save_bank(tuned.bank, tmp_path / "bank.npz")
    stored = load_bank(tmp_path / "bank.npz")
    by_runtime = [levels(stored, frame, network=name) for name in ("opencv", "onnxruntime")]
    assert by_runtime[0] == pytest.approx(by_runtime[1], abs=0.01)


def test_a_bank_that_the_refinement_does_not_know_is_refused(small, bank, tmp_path):
    coarse = learn_bank(render_psf_stack(Mask.named("levin"), [3.0, 6.0, 9.0]))
    with pytest.raises(Exception, match="cannot be fitted to this bank: its levels are"):
        part("tune").tune_refinement(coarse, 1, tmp_path / "training")
    assert not (tmp_path / "training").exists()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["bank.npz", "frame_0_0.npz", "fit.pt"])
def test_what_is_damaged_is_named(small, tmp_path, capsys, name):
    output = tmp_path / "bank.npz"
    words = ["learn", "--mask", "levin", "--blur-sizes", 3, 9, 13, "-o", output, "--train"]
    assert call(capsys, *words, 0.2).status == 0
    damaged = tmp_path / "bank.training" / name
    assert damaged.exists()
    damaged.write_bytes(damaged.read_bytes()[:100])
    result = call(capsys, *words, 0.4)
    assert result.status == 1
    assert str(damaged) in result.err.splitlines()[-1] and "Traceback" not in result.err
