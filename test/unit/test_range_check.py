"""Depths from elsewhere that are not metres within the range of the bank."""

import numpy as np
import pytest

from coded_aperture_ros.depth import range_complaint
from coded_aperture_ros.depth.range_check import depth_range_m
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack

RANGE_M = 2.1, 5.1
DEPTH_M = np.random.default_rng(0).uniform(*RANGE_M, (40, 60))
DEPTH_M[:5] = np.nan


@pytest.mark.parametrize(
    ("depth", "unit"),
    [
        (1000 * DEPTH_M, "mm"),
        (100 * DEPTH_M, "cm"),
        (10_000 * DEPTH_M, "0.1 mm"),
        (DEPTH_M / 0.3048, "feet"),
        (1 / DEPTH_M, "1/m (inverse depth)"),
    ],
)
def test_the_unit_is_named(depth, unit):
    # In feet, the nearest half of the scene is within the range.
    depth = np.where(depth > 8, depth, np.nan) if unit == "feet" else depth
    complaint = range_complaint(depth, RANGE_M)
    assert "is within the range of" in complaint
    assert complaint.endswith(f"they seem to be in {unit}")


@pytest.mark.parametrize("depth", [255 * (DEPTH_M - 2) / 3.2, 40 + DEPTH_M, 0.01 * DEPTH_M])
def test_other_numbers_are_refused_without_a_guess(depth):
    depth = np.where((depth > 1) & (depth < 8), 20.0, depth)
    complaint = range_complaint(depth, RANGE_M)
    assert complaint.startswith("none of the depths")
    assert complaint.endswith("give them in metres")


@pytest.mark.parametrize(
    "depth",
    [
        DEPTH_M,
        DEPTH_M * 1.2,
        np.where(np.arange(60) < 55, 40.0, DEPTH_M),  # most of a scene is far away
        np.where(np.arange(60) < 55, np.inf, DEPTH_M),
        np.full((4, 4), np.inf),
        np.full((4, 4), np.nan),
        np.zeros((4, 4)),
    ],
)
def test_metres_are_accepted(depth):
    assert range_complaint(depth, RANGE_M) == ""


def test_the_range_is_that_of_measured_planes_or_else_of_the_camera():
    camera = Camera(1000.0, 1.5, 64, 48, Mask.named("levin"), mask_extent_mm=10.0)
    stack = render_psf_stack(camera.mask, camera.blur_size_px(np.array([2.1, 3.0, 5.1])))
    levels = type("Levels", (), {"stack": stack, "mask_digest": "a"})()
    assert depth_range_m(levels, camera) == pytest.approx(RANGE_M, rel=1e-4)
    assert depth_range_m(levels, None) is None
