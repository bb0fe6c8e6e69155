"""Figures of merit, against hand-computed values."""

import cv2
import numpy as np
import pytest
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene, load_sharp

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.metrics.errors import depth_error, psnr_db
from coded_aperture_ros.optics import Camera, Mask


def test_depth_error_is_relative_and_a_median():
    truth = np.full((1, 5), 2.0)
    depth = np.array([[2.0, 2.2, 1.6, 2.02, 8.0]])
    error = depth_error(depth, np.ones((1, 5)), truth)
    assert error.median_relative == pytest.approx(0.1)
    assert error.coverage == 1.0


def test_depth_error_takes_the_most_confident():
    truth = np.ones((1, 10))
    depth = np.where(np.arange(10) < 7, 1.01, 3.0)[None]
    confidence = np.linspace(1.0, 0.1, 10)[None]
    assert depth_error(depth, confidence, truth).median_relative == pytest.approx(0.01)
    worst_first = confidence[:, ::-1]
    assert depth_error(depth, worst_first, truth, 0.3).median_relative == pytest.approx(2.0)


def test_unknown_depth_lowers_the_coverage_only():
    truth = np.array([[1.0, 1.0, 1.0, np.nan]])
    depth = np.array([[1.0, np.nan, np.inf, 1.0]])
    error = depth_error(depth, np.array([[1.0, 0.0, 0.0, 1.0]]), truth, 1.0)
    assert error.median_relative == 0.0
    assert error.coverage == pytest.approx(1 / 3)


def test_depth_error_of_nothing():
    nothing = np.full((2, 2), np.nan)
    error = depth_error(nothing, np.zeros((2, 2)), np.ones((2, 2)))
    assert np.isnan(error.median_relative)
    assert error.coverage == 0.0


def test_psnr():
    reference = np.zeros((4, 4), np.float32)
    assert psnr_db(reference + 0.1, reference) == pytest.approx(20.0, abs=1e-4)
    assert psnr_db(reference, reference) == float("inf")
    assert np.isnan(psnr_db(reference * np.nan, reference))


def test_no_pixel_of_a_plane_is_near_a_depth_edge():
    picture = np.zeros((6, 8, 3), np.float32)
    camera = Camera(800.0, 0.9, 8, 6, Mask.named("levin"), 20.0)
    scene = RayTracedScene(picture, picture, np.full((6, 8), 2.0, np.float32), camera)
    assert np.isinf(scene.edge_distance_px()).all()


def test_shapes_must_agree():
    with pytest.raises(InputError, match="one shape"):
        psnr_db(np.zeros((2, 2)), np.zeros((2, 3)))
    with pytest.raises(InputError, match="one shape"):
        depth_error(np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((4, 4)))


def test_depth_that_is_not_reliable_is_unknown(tmp_path):
    depth = np.full((2, 3), 20000, np.uint16)
    depth[0, 1] = 0
    valid = np.full((2, 3), 255, np.uint8)
    valid[1, 2] = 0
    pictures = {"depth_0.1mm": depth, "valid": valid, "aif_linear": np.zeros((2, 3, 3), np.uint16)}
    for name, picture in pictures.items():
        assert cv2.imwrite(str(tmp_path / f"{name}.png"), picture)
    _, depth_m = load_sharp(tmp_path)
    assert np.isnan(depth_m).tolist() == [[False, True, False], [False, False, True]]
