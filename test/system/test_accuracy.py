"""What the library promises, on ray-traced scenes and on a real photograph."""

import numpy as np
import pytest
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from coded_aperture_benchmarks.methods.depth import CameraBank

from coded_aperture_ros.deblur import Deblurrer
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood.bank import learn_bank
from coded_aperture_ros.metrics import depth_error, psnr_db
from coded_aperture_ros.optics import PsfStack

NOISE = 0.002
LEVELS = 30
NEAR_EDGE_PX = 16


@pytest.mark.parametrize("noise", [0.0, 0.0005, 0.001, 0.002], ids=lambda noise: f"{noise:g}")
def test_the_psf_of_a_real_photograph_is_recognised(data_dir, noise):
    """Of a flat page nine measured PSFs compete at every position; one of them is its own."""
    folder = data_dir / "real_photo"
    with np.load(folder / "levin_letters.npz") as photograph:
        image, own = photograph["image"], photograph["psf"]
    with np.load(folder / "measured_psfs.npz") as measured:
        psfs = np.concatenate([measured["psfs"], own[None]])
    psfs = psfs / psfs.sum(axis=(1, 2), keepdims=True)
    stack = PsfStack(np.arange(float(len(psfs))), psfs.astype(np.float32), in_pixels=False)
    config = DepthConfig(confidence_threshold=0.0, stride_px=4, noise=noise)
    estimate = DepthEstimator(learn_bank(stack), config).estimate(image.astype(np.float32))
    assert (np.rint(estimate.level) == len(psfs) - 1).mean() >= 0.99


@pytest.mark.parametrize("scene", ["desk", "corridor"])
def test_depth_and_deblurring_of_ray_traced_scenes(data_dir, scene):
    """The bank is learned from the mask and the camera alone."""
    seen = RayTracedScene.load(data_dir / "rendered" / scene, "levin")
    bank = CameraBank.of_scene(seen.camera, seen.depth_m, LEVELS).learn()
    noise = np.random.default_rng(0).normal(0, NOISE, seen.coded.shape)
    coded = seen.coded + noise.astype(np.float32)
    config = DepthConfig(confidence_threshold=0.0, regularize="semiglobal")
    estimate = DepthEstimator(bank, config, seen.camera).estimate(coded)
    confident = depth_error(estimate.depth_m, estimate.confidence, seen.depth_m, 0.7)
    assert confident.median_relative <= 0.05
    sharp = Deblurrer(bank.stack).deblur(coded, estimate.blur_size_px)
    away = seen.edge_distance_px() > NEAR_EDGE_PX
    before_db, after_db = (psnr_db(one[away], seen.sharp[away]) for one in (coded, sharp))
    assert after_db - before_db >= 2.0
