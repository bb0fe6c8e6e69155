"""Clouds, the nearest obstacle, and what stands where depth is unknown."""

import math

import cv2
import numpy as np
import pytest
from small_camera import CAMERA, DEPTH_M, FAR_M, NEAR_M, coded_wall

from coded_aperture_ros.depth import (
    DepthConfig,
    DepthEstimator,
    nearest_obstacle_m,
    points_of_depth,
)
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.optics.distortion import pixel_rays

K = (100.0, 0.0, 1.0, 0.0, 50.0, 2.0, 0.0, 0.0, 1.0)
WIDE = (420.0, 0.0, 310.0, 0.0, 430.0, 235.0, 0.0, 0.0, 1.0)


def test_points_lie_on_the_rays_of_their_pixels():
    depth = np.array([[2.0, np.nan, 4.0], [np.inf, -np.inf, 1.0]], np.float32)
    confidence = np.linspace(0, 1, 6, dtype=np.float32).reshape(2, 3)
    std_dev = depth / 50
    colours = np.arange(18, dtype=np.uint8).reshape(2, 3, 3) * 13
    through = pixel_rays("plumb_bob", K, (0.0,) * 5, 2, 3)
    points = points_of_depth(depth, confidence, std_dev, colours, through)
    np.testing.assert_allclose(points[0, 0, :3], [-0.02, -0.08, 2.0], rtol=1e-6)
    np.testing.assert_allclose(points[0, 2, :3], [0.04, -0.16, 4.0], rtol=1e-6)
    # As the Point Cloud Library packs colours: 0x00RRGGBB in the bits of a float.
    packed = points.view(np.uint32)[..., 3].astype(int)
    shifted = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=-1)
    np.testing.assert_array_equal(shifted, colours)
    np.testing.assert_allclose(points[..., 4], confidence)
    np.testing.assert_allclose(points[..., 5], std_dev)
    assert np.isnan(points[[0, 1, 1], [1, 0, 1], :3]).all()
    cleared = points_of_depth(depth, confidence, std_dev, colours, through, 0.5, 9.0)
    np.testing.assert_allclose(cleared[1, 0, :3], [-0.09, -0.18, 9.0], rtol=1e-6)
    np.testing.assert_allclose(cleared[1, 1, :3], [0.0, -0.01, 0.5], rtol=1e-6)
    assert np.isnan(cleared[0, 1, :3]).all()  # unknown is neither near nor far


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("plumb_bob", (-0.3, 0.1, 0.001, -0.002, 0.0)),
        ("rational_polynomial", (0.2, 0.05, 0.001, 0.0, 0.01, 0.4, 0.1, 0.02)),
        ("equidistant", (0.02, -0.01, 0.003, -0.001)),
    ],
)
def test_distortion_is_undone(model, d):
    """Points on the rays are seen where OpenCV's own projection sees them."""
    through = pixel_rays(model, WIDE, d, 480, 640)
    seen = np.dstack([through, np.ones((480, 640), np.float32)]).reshape(-1, 1, 3)
    k, none = np.reshape(WIDE, (3, 3)), np.zeros(3)
    if model == "equidistant":
        pixels, _ = cv2.fisheye.projectPoints(seen, none, none, k, np.array(d))
    else:
        pixels, _ = cv2.projectPoints(seen, none, none, k, np.array(d))
    expected = np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1)
    assert np.abs(pixels.reshape(480, 640, 2) - expected).max() < 0.01


def test_rectified_depth_suits_a_pinhole_as_points_suit_the_lens():
    """What image_proc does, by nearest neighbours, with the camera_info that depth comes with."""
    d, size = (-0.3, 0.1, 0.001, -0.002, 0.0), (480, 640)
    wall = np.float32([0.3, -0.2, 0.5])  # times a point of it: 1
    lens, pinhole = (
        np.dstack([pixel_rays("plumb_bob", WIDE, each, *size), np.ones(size, np.float32)])
        for each in (d, (0.0,) * 5)
    )
    depth = 1 / (lens @ wall)
    k = np.reshape(WIDE, (3, 3))
    where = cv2.initUndistortRectifyMap(k, np.array(d), None, k, size[::-1], cv2.CV_32FC1)
    rectified = cv2.remap(depth, *where, cv2.INTER_NEAREST, borderValue=np.nan)
    nothing = np.zeros((*size, 3), np.uint8)
    points = points_of_depth(depth, depth, depth, nothing, lens[..., :2])[..., :3]

    def off(points):
        return np.nanquantile(np.abs(points @ wall - 1), 0.99)

    assert off(points) < 1e-5
    assert off(pinhole * rectified[..., None]) < 3e-3  # half a pixel
    assert off(pinhole * depth[..., None]) > 0.02  # not rectified


def test_the_nearest_obstacle_is_not_a_speck():
    depth = np.full((100, 100), 3.0, np.float32)
    depth[10:30, 10:30] = 1.5
    depth[50, 50:54] = 0.4
    assert nearest_obstacle_m(depth, 0.005) == 1.5
    assert nearest_obstacle_m(depth, 0.0004) == pytest.approx(0.4)
    depth[80:, :] = -np.inf
    assert nearest_obstacle_m(depth, 0.005) == 0
    depth[:] = np.inf
    assert nearest_obstacle_m(depth, 0.005) == math.inf
    depth[:] = np.nan
    assert math.isnan(nearest_obstacle_m(depth, 0.005))


@pytest.mark.parametrize("side", ["far", "near"])
def test_what_is_unknown_can_be_the_nearest_plausible_depth(side):
    given = {**CAMERA, "mask": Mask.named("levin"), "side": side}
    ends = (NEAR_M, FAR_M)
    if side == "near":
        given["focus_distance_m"], ends = 5.0, (1.3, 3.0)
    camera = Camera(**given)
    bank = learn_bank_for_camera(camera, *ends, 10, LearnConfig(window_px=32, rank=48))
    frame = coded_wall(Camera(**{**CAMERA, "mask": Mask.named("levin")}))
    config = {"regularize": "none", "confidence_threshold": 0.7}
    plain = DepthEstimator(bank, DepthConfig(**config), camera).estimate(frame)
    careful = DepthEstimator(bank, DepthConfig(**config, unknown="nearest"), camera).estimate(frame)
    unknown = np.isnan(plain.depth_m)
    assert 0 < unknown.mean() < 1
    np.testing.assert_array_equal(careful.depth_m[~unknown], plain.depth_m[~unknown])
    assert np.isfinite(careful.depth_m).all()
    anything = DepthConfig(**{**config, "confidence_threshold": 0.0})
    likeliest = DepthEstimator(bank, anything, camera).estimate(frame).depth_m
    assert (careful.depth_m <= likeliest * 1.0001).all()
    np.testing.assert_array_equal(careful.confidence, plain.confidence)
    if side == "far":
        assert (careful.depth_m[unknown] > 1.1 * DEPTH_M).mean() < 0.1


def test_where_nothing_is_seen_the_nearest_depth_is_plausible():
    camera = Camera(**{**CAMERA, "mask": Mask.named("levin")})
    bank = learn_bank_for_camera(camera, NEAR_M, FAR_M, 10, LearnConfig(window_px=32, rank=48))
    blind = np.ones((96, 128), np.float32)  # saturated
    estimate = DepthEstimator(bank, DepthConfig(unknown="nearest"), camera).estimate(blind)
    np.testing.assert_allclose(estimate.depth_m, NEAR_M, rtol=1e-3)
