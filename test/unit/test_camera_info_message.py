"""What a camera_info says of a frame's part of the view."""

from types import SimpleNamespace

import pytest

from coded_aperture_ros.frames import View
from coded_aperture_ros.io.messages import (
    choose_camera_info,
    region_matrices,
    view_from_camera_info,
)
from coded_aperture_ros.optics import Camera, Mask


def info(focal_px=600.0, **roi):
    region = {"x_offset": 0, "y_offset": 0, "width": 0, "height": 0} | roi
    k = [focal_px, 0.0, 320.0, 0.0, focal_px, 240.0, 0.0, 0.0, 1.0 if focal_px else 0.0]
    return SimpleNamespace(
        width=640,
        height=480,
        binning_x=0,
        binning_y=0,
        roi=SimpleNamespace(**region),
        k=k,
        p=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
    )


@pytest.fixture
def camera():
    return Camera(
        focal_length_px=600.0,
        focus_distance_m=1.0,
        image_width=640,
        image_height=480,
        mask=Mask.named("levin"),
        mask_extent_mm=20.0,
    )


@pytest.mark.parametrize("offset", [{"x_offset": 100}, {"y_offset": 60}])
def test_a_region_without_a_size_is_all_of_the_view_whatever_its_offset(camera, offset):
    assert view_from_camera_info(info(**offset), 640, 480, camera) == View.whole(640, 480)
    assert region_matrices(info(**offset), 320, 240) == region_matrices(info(), 320, 240)


def test_a_region_is_a_part_of_the_view(camera):
    region = {"x_offset": 100, "y_offset": 60, "width": 320, "height": 240}
    view = view_from_camera_info(info(**region), 320, 240, camera)
    assert (view.left, view.top) == (100, 60)
    k, p = region_matrices(info(**region), 320, 240)
    assert (k[2], k[5]) == (p[2], p[6]) == (320 - 100, 240 - 60)


REGION = {"x_offset": 100, "y_offset": 60, "width": 320, "height": 240}
# Message, size of the frame, whether it is the model of the frame, and what is complained of.
CHOICES = {
    "none": (None, (640, 480), False, ""),
    "whole": (info(), (640, 480), True, ""),
    "half as large": (info(), (320, 240), True, ""),
    "region": (info(**REGION), (320, 240), True, ""),
    "not calibrated": (info(0.0), (640, 480), False, ""),
    "region, not calibrated": (info(0.0, **REGION), (320, 240), False, ""),
    "a little off": (info(630.0), (640, 480), True, ""),
    "in mm": (info(3.0), (640, 480), False, "3 px, the camera file 600 px"),
    "binned twice": (info(300.0), (640, 480), False, "300 px, the camera file 600 px"),
    "other proportions": (info(), (640, 360), False, "does not have the proportions"),
    "region of other proportions": (info(**REGION), (320, 200), False, "is for 320x240"),
}


@pytest.mark.parametrize("case", CHOICES)
def test_the_drivers_model_or_that_of_the_camera_file(camera, case):
    message, size, is_used, complaint = CHOICES[case]
    chosen, told = choose_camera_info(message, *size, camera)
    assert chosen is (message if is_used else None)
    assert complaint in told and bool(complaint) == bool(told)
