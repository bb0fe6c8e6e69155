"""Planes with little blur, rendered at twice the pixels: their depth is right, and published."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from coded_aperture_ros.depth import DepthEstimator
from coded_aperture_ros.design.choice import Wanted, load_offer
from coded_aperture_ros.design.relief import flat_scene, part_of_image
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.likelihood.bank.for_camera import guarded_range
from coded_aperture_ros.optics import Mask

_CAMERA = Path(__file__).parents[2] / "config" / "cameras" / "cmount_25mm_f1.4.yaml"
_NEAREST_PX, _FARTHEST_PX = 1.5, 12.0


@pytest.mark.parametrize(
    ("mask", "blur_px"), [("four_hole", 2.0), ("four_hole", 3.0), ("levin", 2.5), ("levin", 3.5)]
)
@pytest.mark.parametrize("seed", [1, 4])
def test_planes_of_small_blur_have_depth(mask, blur_px, seed):
    offer = load_offer(_CAMERA)
    camera = dataclasses.replace(offer.camera, mask=Mask.named(mask), diffraction=True)
    near_m, far_m, true_m = camera.depth_m([_NEAREST_PX, _FARTHEST_PX, blur_px]).tolist()
    bank = learn_bank_for_camera(camera, *guarded_range(camera, near_m, far_m, 30))
    scene = flat_scene(seed, 0.0)
    part = part_of_image(camera, scene.pixel_place.shape)
    exposure = Wanted(near_m, far_m, illuminance_lux=300, rate_hz=20).exposure(offer.sensor)
    light = scene.light(part, true_m, far_m)
    frame = exposure.exposed(light, camera, np.random.default_rng(seed))
    estimator = DepthEstimator(bank, camera=part)
    depth_m = np.asarray(estimator.estimate(frame).depth_m)
    estimator.close()
    known = np.isfinite(depth_m)
    assert known.mean() >= 0.7
    assert np.median(np.abs(depth_m[known] / true_m - 1)) <= 0.03
