"""Two frames of one view at two focus settings."""

import cv2
import numpy as np
import pytest
from textures import natural_texture

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.focus_pair import FocusPair
from coded_aperture_ros.likelihood.bank import learn_bank, learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack
from coded_aperture_ros.simulation import render_coded_frame

SHAPE, NEAR_M, FAR_M, NOISE = (160, 224), 1.7, 3.4, 0.002
RANGE_M = 1.5, 4.0
# In the middle of the scene, and before it.
MIDDLE_M, BEFORE_M = 2.4, 1.2


def camera_at(focus_m, side, **more):
    mask = Mask.named("levin")
    return Camera(400.0, focus_m, SHAPE[1], SHAPE[0], mask, 80.0, side=side, **more)


def frame_of(camera, depth_m, noise=NOISE, seed=1):
    sharp = np.clip(natural_texture(SHAPE, seed=2, contrast=0.03), 0.05, 1)
    coded = render_coded_frame(sharp, depth_m, camera)
    return (coded + np.random.default_rng(seed).normal(0, noise, SHAPE)).astype(np.float32)


@pytest.fixture(scope="module")
def truth_m():
    depth = np.full(SHAPE, FAR_M, np.float32)
    depth[40:130, 50:150] = NEAR_M
    return depth


def right(estimate, truth_m):
    error = np.abs(estimate.depth_m / truth_m - 1)
    return float((error <= 0.1).mean())


@pytest.mark.slow
@pytest.mark.parametrize("second_m", [BEFORE_M, 1.9])
def test_sides_are_told_without_an_asymmetric_mask(truth_m, second_m):
    """By a second frame focused before the scene, and by one whose focus is within it too."""
    camera = camera_at(MIDDLE_M, "both")
    bank = learn_bank_for_camera(camera, *RANGE_M, 30)
    config = DepthConfig(confidence_threshold=0.0)
    estimator = DepthEstimator(bank, config, camera)
    first = frame_of(camera, truth_m)
    second = frame_of(camera_at(second_m, "both"), truth_m, seed=3)
    # Which side a frame alone finds is a matter of its noise.
    alone = min(
        right(estimator.estimate(frame_of(camera, truth_m, seed=seed)), truth_m)
        for seed in (1, 2, 7)
    )
    pair = FocusPair(estimator, second_m)
    both = pair.estimate(first, second)
    half = pair.estimate(first, second, (80, 112))
    pair.close()
    assert alone < 0.75 < right(both, truth_m)
    assert both.depth_m.shape == both.confidence.shape == SHAPE
    assert half.depth_m.shape == (80, 112)


def test_costs_of_the_same_depths_are_added(truth_m):
    """With the second focus where the first is, that is a frame of more exposure."""
    camera = camera_at(BEFORE_M, "far")
    bank = learn_bank_for_camera(camera, *RANGE_M, 30)
    for regularize in ("learned", "semiglobal"):
        config = DepthConfig(confidence_threshold=0.0, regularize=regularize)
        estimator = DepthEstimator(bank, config, camera)
        frames = [frame_of(camera, truth_m, 0.01, seed) for seed in (1, 2)]
        pair = FocusPair(estimator, BEFORE_M)
        found, alone = pair.estimate(*frames), estimator.estimate(frames[0])
        assert right(found, truth_m) >= right(alone, truth_m) - 0.01
        assert found.confidence.mean() > alone.confidence.mean()
        pair.close()


@pytest.mark.parametrize(("first_m", "second_m"), [(BEFORE_M, 6.0), (6.0, BEFORE_M)])
def test_focus_breathing_is_undone(truth_m, first_m, second_m):
    """Also where the second frame shows less of the scene: what it did not see is left out."""
    side = {BEFORE_M: "far", 6.0: "near"}
    camera = camera_at(first_m, side[first_m], focal_length_mm=75.0)
    bank = learn_bank_for_camera(camera, *RANGE_M, 30)
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0), camera)
    pair = FocusPair(estimator, second_m)
    scale = camera.refocused(second_m).focal_length_px / camera.focal_length_px
    assert abs(scale - 1) > 0.04
    as_first = frame_of(camera_at(second_m, side[second_m]), truth_m, 0.0)
    middle = np.array([camera.image_width, camera.image_height]) / 2 - 0.5
    moved = np.column_stack([np.eye(2) * scale, middle * (1 - scale)])
    second = cv2.warpAffine(as_first, moved, SHAPE[::-1], borderMode=cv2.BORDER_REFLECT)
    second += np.random.default_rng(4).normal(0, NOISE, SHAPE).astype(np.float32)
    found = pair.estimate(frame_of(camera, truth_m), second)
    assert found.health is None or found.health.fits
    assert right(found, truth_m) > 0.85
    pair.close()


def test_a_second_frame_that_does_not_fit_is_told(truth_m):
    camera = camera_at(BEFORE_M, "far")
    bank = learn_bank_for_camera(camera, *RANGE_M, 30)
    estimator = DepthEstimator(bank, DepthConfig(), camera)
    pair = FocusPair(estimator, 6.0)
    first = frame_of(camera, truth_m)
    sharp = np.clip(natural_texture(SHAPE, seed=9, contrast=0.03), 0.05, 1).astype(np.float32)
    fitting = pair.estimate(first, frame_of(camera_at(6.0, "near"), truth_m, seed=3))
    assert fitting.health.fits
    found = pair.estimate(first, sharp)  # all in focus
    assert not found.health.fits
    assert np.isfinite(found.depth_m).mean() < np.isfinite(fitting.depth_m).mean()
    with pytest.raises(InputError, match="two of one size"):
        pair.estimate(first, first[:-8])
    pair.close()


def test_what_is_no_pair():
    camera = camera_at(BEFORE_M, "far")
    bank = learn_bank_for_camera(camera, *RANGE_M, 30)
    with pytest.raises(InputError, match="the camera file that it is for"):
        FocusPair(DepthEstimator(bank, DepthConfig()), 6.0)
    measured = learn_bank(render_psf_stack(camera.mask, bank.blur_sizes_px))
    with pytest.raises(InputError, match="learned from the camera file's mask"):
        FocusPair(DepthEstimator(measured, DepthConfig(), camera), 6.0)


def test_levels_beyond_infinity_are_refused():
    camera = camera_at(BEFORE_M, "far")
    largest = camera.blur_at_infinity_px
    bank = learn_bank(
        render_psf_stack(camera.mask, np.linspace(largest - 6, largest + 1, 12)), mask=camera.mask
    )
    with pytest.raises(InputError, match="without levels at or beyond infinity"):
        FocusPair(DepthEstimator(bank, camera=camera), 3.0)
