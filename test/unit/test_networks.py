"""What runs the networks: OpenCV, and ONNX Runtime, which computes in whole numbers."""

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest

from coded_aperture_ros.core import networks
from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.networks import network_of
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.decoders.network import network as refinement
from coded_aperture_ros.depth.decoders.network.network import Calibration, log_odds
from coded_aperture_ros.likelihood.bank import learn_bank
from coded_aperture_ros.metrics import psnr_db
from coded_aperture_ros.optics import Mask, render_psf_stack
from coded_aperture_ros.simulation.layered import random_scene

NOISE = 0.002
needs_onnxruntime = pytest.mark.skipif(
    networks.find_spec("onnxruntime") is None, reason="needs onnxruntime"
)


@pytest.fixture(scope="module")
def seen():
    scene = random_scene(1_000_123, Mask.named("levin"), "far", (192, 240))
    noise = np.random.default_rng(0).standard_normal(scene.shape, np.float32)
    return scene, scene.coded() + np.float32(NOISE) * noise


@pytest.fixture(scope="module")
def bank():
    return learn_bank(render_psf_stack(Mask.named("levin"), np.arange(0.9, 20, 0.6)))


@needs_onnxruntime
def test_depth_of_both_is_alike(seen, bank):
    scene, frame = seen
    found = {}
    for network in ("opencv", "onnxruntime"):
        estimator = DepthEstimator(
            bank, DepthConfig(network=network, noise=NOISE, confidence_threshold=0)
        )
        found[network] = estimator.estimate(frame)
        estimator.close()
    exact, rounded = found.values()
    assert not np.array_equal(exact.level, rounded.level)  # they are two
    assert np.mean(np.abs(exact.level - rounded.level) < 0.5) > 0.97
    assert np.mean(np.abs(exact.confidence - rounded.confidence)) < 0.02
    right = [np.mean(np.abs(e.blur_size_px - scene.blur_size_px()) < 1) for e in found.values()]
    assert right[1] > right[0] - 0.01


@needs_onnxruntime
def test_pictures_of_both_are_alike(seen, bank):
    scene, frame = seen
    sharp, blur_px = scene.all_in_focus(), scene.blur_size_px()
    gains = []
    for network in ("opencv", "onnxruntime"):
        deblurrer = Deblurrer(bank.stack, DeblurConfig(noise=NOISE, network=network))
        gains.append(psnr_db(deblurrer.deblur(frame, blur_px), sharp))
    assert gains[0] != gains[1]
    assert gains[1] > gains[0] - 0.1


@needs_onnxruntime
def test_a_deblurrer_changes_over_while_it_works(seen, bank):
    scene, frame = seen
    config = DeblurConfig(noise=NOISE, network="onnxruntime")
    deblurrer = Deblurrer(bank.stack, config)
    first = deblurrer.deblur(frame, scene.blur_size_px())
    deblurrer.reconfigure(dataclasses.replace(config, network="opencv"))
    assert not np.array_equal(deblurrer.deblur(frame, scene.blur_size_px()), first)
    deblurrer.reconfigure(config)
    assert np.array_equal(deblurrer.deblur(frame, scene.blur_size_px()), first)


@needs_onnxruntime
def test_any_number_of_threads_says_the_same(seen, bank):
    _, frame = seen
    found = []
    for threads in (1, 2):
        config = DepthConfig(network="onnxruntime", noise=NOISE, threads=threads)
        estimator = DepthEstimator(bank, config)
        found.append(estimator.estimate(frame).level)
        estimator.close()
    assert found[0] == pytest.approx(found[1], abs=0.1, nan_ok=True)


def test_what_is_installed_decides_unless_one_is_named(monkeypatch):
    arrays = read_shipped(
        refinement.__file__, "refinement.npz", refinement.SCHEMA, refinement.SCHEMA_VERSION
    )
    asked = []
    monkeypatch.setattr(
        networks, "_network_by_onnxruntime", lambda model, threads: asked.append(threads)
    )
    for installed in (None, object()):
        monkeypatch.setattr(networks, "find_spec", lambda name, found=installed: found)
        network_of(arrays, "levels", "auto", 3)
        assert asked == ([] if installed is None else [3])
        network_of(arrays, "levels", "opencv", 1)
    assert asked == [3]


def test_the_calibration_is_in_the_weights_file(bank, seen, monkeypatch):
    arrays = read_shipped(
        refinement.__file__, "refinement.npz", refinement.SCHEMA, refinement.SCHEMA_VERSION
    )
    shipped = Calibration.from_weights(arrays)
    assert [layer.dtype for layer in shipped.layers] == 3 * [np.float32]
    assert shipped.deviation.dtype == np.float32
    for name, values in arrays.items():
        if name.startswith("confidence"):
            np.testing.assert_array_equal(values, shipped.layers[int(name[-1])])

    scene, frame = seen
    found = []
    last = shipped.layers[-1].copy()
    last[0, -1] -= 1
    other = {"confidence2": last, "deviation": 2 * shipped.deviation}
    for changed in ({}, other):
        monkeypatch.setattr(refinement, "read_shipped", lambda *_, new=changed: arrays | new)
        config = DepthConfig(noise=NOISE, confidence_threshold=0, check_fit=False)
        estimator = DepthEstimator(bank, config, scene.camera)
        found.append(estimator.estimate(frame))
        estimator.close()
    sure, less_sure = found
    assert less_sure.confidence.mean() < sure.confidence.mean() - 0.05
    finite = np.isfinite(sure.std_dev_m)
    ratio = less_sure.std_dev_m[finite] / sure.std_dev_m[finite]
    assert np.median(ratio) == pytest.approx(2, rel=1e-3)


def test_the_check_of_fit_is_given_what_it_has_learned_with(bank, seen, monkeypatch):
    """Whatever confidence is published, the health of a frame is the same."""
    arrays = read_shipped(
        refinement.__file__, "refinement.npz", refinement.SCHEMA, refinement.SCHEMA_VERSION
    )
    assert arrays["checked"].shape == (1, 4)
    scene, frame = seen
    found = []
    for last in (0, 3):
        changed = arrays | {
            "confidence2": arrays["confidence2"] - np.float32(np.eye(1, 17, 16) * last)
        }
        monkeypatch.setattr(refinement, "read_shipped", lambda *_, new=changed: new)
        estimator = DepthEstimator(bank, DepthConfig(noise=NOISE), scene.camera)
        found.append(estimator.estimate(frame))
        estimator.close()
    assert found[1].confidence.mean() < found[0].confidence.mean() - 0.2
    assert found[1].health == found[0].health


def test_weights_without_a_calibration_have_the_probabilities_of_the_network():
    """As they have before `training/train.py refinement calibrate`."""
    calibration = Calibration.from_weights({})
    assert calibration.layers == () and calibration.deviation == 1
    probability = np.float32([[0.01, 0.3, 0.9]])
    features = np.stack([log_odds(probability), np.float32([[4, 9, 20]])])
    np.testing.assert_allclose(calibration.confidence(features), probability, rtol=1e-5)


def test_the_confidence_is_a_small_network_of_the_features():
    hidden = np.float32([[2, 0.1, -1, 0.5], [-1, 0, 0, 0]])
    calibration = Calibration((hidden, np.float32([[1, -3, 0.25]])), np.float32(1))
    features = np.float32([[-1, 0.5, 2], [4, 4, 4], [1, 1, 1]])
    by_hand = [-3 * 1 + 0.25, (2 * 0.5 + 0.4 - 1 + 0.5) + 0.25, (4 + 0.4 - 1 + 0.5) + 0.25]
    np.testing.assert_allclose(log_odds(calibration.confidence(features)), by_hand, rtol=1e-4)


@pytest.mark.parametrize("config", [DepthConfig, DeblurConfig])
def test_a_runtime_that_is_not_installed_is_refused_at_the_start(config, monkeypatch):
    monkeypatch.setattr(networks, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"not installed: .*'\.\[fast\]', or use opencv"):
        config(network="onnxruntime")
    assert config(network="auto").network == "auto"
    with pytest.raises(
        InputError, match="network: 'abacus' is not allowed, use one of auto, opencv"
    ):
        config(network="abacus")


@needs_onnxruntime
def test_nothing_is_reported_to_the_maker_of_the_runtime():
    """It would say that it cannot store the identifier of this machine."""
    program = (
        "from coded_aperture_ros.core.archive import read_shipped\n"
        "from coded_aperture_ros.core.networks import network_of\n"
        "from coded_aperture_ros.deblur.blend import blend\n"
        "shipped = blend.WEIGHTS, blend.SCHEMA, blend.SCHEMA_VERSION\n"
        "network_of(read_shipped(blend.__file__, *shipped), 'blend', 'onnxruntime', 1)\n"
    )
    environment = {**os.environ, "HOME": "/proc/nothing", "PYTHONPATH": os.pathsep.join(sys.path)}
    environment.pop("ORT_DISABLE_TELEMETRY", None)
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
