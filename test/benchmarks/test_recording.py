"""Cameras that exist, and the scale at which they record the same picture."""

import dataclasses

import numpy as np
import pytest
from coded_aperture_benchmarks.datasets.recording import FULL_FRAME, Kind, recording

from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.optics.pupil import exceeds_pupil

C_MOUNT = Kind("C-mount f/1.4, 1-inch sensor", 1.4, (8, 12.5, 16, 25, 35, 50), (13.1, 8.76))
# Mask, its extent in mm, focal length in px, focus in m: as of the ray-traced scenes, and others.
CAMERAS = [
    ("levin", 25.4, 800.0, 0.9),
    ("four_hole", 64.0, 440.0, 1.355),
    ("zhou", 46.0, 640.0, 1.13),
    ("disc", 4.0, 1200.0, 0.5),
    ("annulus", 26.8, 700.0, 0.75),
    ("four_wide", 84.0, 500.0, 1.0),
]


def camera_of(mask, extent_mm, focal_px, focus_m, width=480, height=360):
    return Camera(focal_px, focus_m, width, height, Mask.named(mask), mask_extent_mm=extent_mm)


@pytest.mark.parametrize("kind", [FULL_FRAME, C_MOUNT], ids=lambda kind: kind.name)
@pytest.mark.parametrize("numbers", CAMERAS, ids=lambda numbers: numbers[0])
def test_the_camera_can_be_bought_and_records_the_same_picture(numbers, kind):
    camera = camera_of(*numbers)
    found = recording(camera, 1.5, 4.0, kind)
    assert found.share <= 1
    assert not exceeds_pupil(
        camera.mask, found.mask_extent_mm, found.focal_length_mm / kind.f_number
    )
    exists = dataclasses.replace(
        camera, focus_distance_m=found.focus_m, mask_extent_mm=found.mask_extent_mm
    )
    z_m = np.array([1.5, 2.2, 4.0])
    np.testing.assert_allclose(exists.blur_size_px(found.share * z_m), camera.blur_size_px(z_m))
    np.testing.assert_allclose((found.near_m, found.far_m), found.share * z_m[[0, 2]])
    # The focal length in pixels makes the picture as wide as it was, on a sensor of this size.
    across = camera.image_width / camera.focal_length_px * found.focal_length_mm
    assert across <= kind.sensor_mm[0]


def test_a_mask_that_a_pupil_takes_leaves_the_scene_as_it_is():
    found = recording(camera_of("levin", 20.0, 800.0, 0.9), 0.95, 2.5)
    assert (found.share, found.mask_extent_mm) == (1.0, 20.0)
    assert found.range_text == "0.95 to 2.5 m"


def test_no_lens_is_as_wide_as_that():
    assert recording(camera_of("levin", 20.0, 150.0, 0.9), 1.0, 2.0) is None
