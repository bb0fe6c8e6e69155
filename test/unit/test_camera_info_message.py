"""What a camera_info says of a frame's part of the view."""

from types import SimpleNamespace

import pytest

from coded_aperture_ros.frames import View
from coded_aperture_ros.io.messages import scaled_matrices, view_from_camera_info
from coded_aperture_ros.optics import Camera, Mask


def info(**roi):
    region = {"x_offset": 0, "y_offset": 0, "width": 0, "height": 0} | roi
    k = [600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0]
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
    assert scaled_matrices(info(**offset), 320, 240) == scaled_matrices(info(), 320, 240)


def test_a_region_is_a_part_of_the_view(camera):
    region = {"x_offset": 100, "y_offset": 60, "width": 320, "height": 240}
    view = view_from_camera_info(info(**region), 320, 240, camera)
    assert (view.left, view.top) == (100, 60)
    k, p = scaled_matrices(info(**region), 320, 240)
    assert (k[2], k[5]) == (p[2], p[6]) == (320 - 100, 240 - 60)
