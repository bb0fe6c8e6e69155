"""Flicker of depth and all-in-focus frames of still surfaces, in walks of the benchmark."""

import numpy as np
import pytest
from coded_aperture_benchmarks.metrics.flicker import Deblurring, Flicker, Seen, changes

from coded_aperture_ros.depth import DepthEstimate
from coded_aperture_ros.depth.moving import Pinhole
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack

SHAPE, WALL_M, NOISE = (96, 128), 2.0, 0.002
CAMERA = Camera(300.0, 0.7, SHAPE[1], SHAPE[0], Mask.named("levin"), 20.0)
VIEW = Pinhole.of_map(CAMERA, SHAPE)


def estimate(depth_m):
    ones = np.ones(SHAPE, np.float32)
    return DepthEstimate(
        level=ones,
        blur_size_px=np.asarray(CAMERA.blur_size_px(depth_m), np.float32),
        confidence=ones,
        noise=NOISE,
        depth_m=depth_m,
        std_dev_m=ones,
    )


@pytest.fixture(scope="module")
def deblurring():
    sizes = CAMERA.blur_size_px(np.array([1.5, WALL_M, 3.0]))
    made = Deblurring(render_psf_stack(CAMERA.mask, np.linspace(sizes[0], sizes[-1], 12)), NOISE)
    yield made
    made.close()


def flicker_of(deblurring, off):
    """Flicker before a still wall, with depths that are off by shares, one for each frame."""
    random, flicker = np.random.default_rng(0), Flicker(deblurring, VIEW)
    wall = np.full(SHAPE, WALL_M, np.float32)
    light = random.random(SHAPE, np.float32)
    for index, share in enumerate(off):
        pose = np.eye(4)
        pose[0, 3] = WALL_M / VIEW.focal_px[0] * index  # a pixel a frame
        coded = np.roll(light, -index, axis=1)
        clear = deblurring.by_truth(CAMERA, coded, wall)
        flicker.add(coded, Seen(pose, wall, clear), estimate(wall * np.float32(1 + share)))
    return flicker.result()


def test_what_does_not_change_does_not_flicker(deblurring):
    assert flicker_of(deblurring, [0.0] * 4)["light_flicker"] == 0
    still, to_and_fro = flicker_of(deblurring, [0.1] * 4), flicker_of(deblurring, [0.1, -0.1] * 2)
    assert still["depth_flicker"] < 1e-3
    assert still["light_flicker"] < 0.2 * to_and_fro["light_flicker"]


def test_depth_that_goes_to_and_fro_flickers_by_so_much(deblurring):
    assert flicker_of(deblurring, [0.02, -0.02] * 2)["depth_flicker"] == pytest.approx(0.04, 1e-2)


def test_what_another_surface_hides_is_no_change():
    near = np.full(SHAPE, WALL_M, np.float32)
    near[30:60, 40:70] = 1.0
    seen = tuple(Seen(np.eye(4), depth, depth) for depth in (np.full_like(near, WALL_M), near))
    found = changes(np.zeros(SHAPE, np.float32), (near == 1.0).astype(np.float32), seen, VIEW)
    assert not found.any() and found.size == near.size - 30 * 30


def test_depth_that_is_unknown_in_places_does_not_count(deblurring):
    off = np.full(SHAPE, 0.02)
    off[:8, :8] = np.nan
    assert flicker_of(deblurring, [off, -off] * 2)["depth_flicker"] == pytest.approx(0.04, 1e-2)
