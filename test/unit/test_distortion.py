"""Names of distortion models, and rays where a lens model has none."""

import cv2
import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import load_intrinsics
from coded_aperture_ros.optics.distortion import distortion_model, pixel_rays

K = (400.0, 0.0, 319.5, 0.0, 400.0, 239.5, 0.0, 0.0, 1.0)
SIZE = (480, 640)
FISHEYE = (0.1, 0.02, 0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "coefficients", "expected"),
    [
        ("plumb_bob", 5, "plumb_bob"),
        ("Plumb Bob", 4, "plumb_bob"),
        ("radtan", 4, "plumb_bob"),
        ("Brown Conrady", 5, "plumb_bob"),
        ("", 5, "plumb_bob"),
        ("", 0, "plumb_bob"),
        ("double_sphere", 0, "plumb_bob"),
        ("plumb_bob", 8, "rational_polynomial"),
        ("rational_polynomial", 14, "rational_polynomial"),
        ("thin_prism", 12, "rational_polynomial"),
        ("equidistant", 4, "equidistant"),
        ("fisheye", 4, "equidistant"),
        ("Kannala_Brandt4", 4, "equidistant"),
        ("kannala-brandt", 4, "equidistant"),
        ("OPENCV_FISHEYE", 4, "equidistant"),
        ("pinhole-equi", 4, "equidistant"),
    ],
)
def test_a_model_is_known_by_its_names(name, coefficients, expected):
    assert distortion_model(name, (0.1,) * coefficients) == expected


@pytest.mark.parametrize(
    ("name", "coefficients", "phrase"),
    [
        ("", 4, "it is empty, and 4 coefficients may be of several models"),
        ("double_sphere", 4, "'double_sphere' is not known"),
        ("fov", 1, "'fov' is not known"),
        ("plumb_bob", 3, "plumb_bob has 4 or 5 or 8 or 12 or 14 numbers, got 3"),
        ("fisheye", 5, "fisheye has 4 numbers, got 5"),
    ],
)
def test_what_may_be_another_model_is_refused(name, coefficients, phrase):
    with pytest.raises(InputError, match=phrase):
        pixel_rays(name, K, (0.1,) * coefficients, *SIZE)


def test_other_names_give_the_same_rays():
    expected = pixel_rays("equidistant", K, FISHEYE, *SIZE)
    assert np.array_equal(pixel_rays("Kannala_Brandt4", K, FISHEYE, *SIZE), expected)


def test_a_fisheye_lens_without_further_coefficients_is_no_pinhole():
    rays = pixel_rays("equidistant", K, (0.0,) * 4, *SIZE)
    x, y = (np.array([0, 0]) - (319.5, 239.5)) / 400
    angle = np.hypot(x, y)
    np.testing.assert_allclose(rays[0, 0], np.tan(angle) / angle * np.array([x, y]), rtol=1e-5)


@pytest.mark.parametrize("key", ["distortion_model", "camera_model"])
def test_a_calibration_file_of_a_fisheye_lens(tmp_path, key):
    matrices = {"camera_matrix": (3, 3, K), "distortion_coefficients": (1, 4, FISHEYE)}
    lines = ["image_width: 640", "image_height: 480", f"{key}: fisheye"] + [
        f"{name}: {{rows: {rows}, cols: {columns}, data: {list(data)}}}"
        for name, (rows, columns, data) in matrices.items()
    ]
    (tmp_path / "ost.yaml").write_text("\n".join(lines))
    assert load_intrinsics(tmp_path / "ost.yaml").distortion_model == "equidistant"


def forward(model, d, rays):
    points = np.column_stack([rays, np.ones(len(rays))]).astype(np.float64).reshape(-1, 1, 3)
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    none = np.zeros(3)
    return project(points, none, none, np.reshape(K, (3, 3)), np.array(d))[0].reshape(-1, 2)


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("plumb_bob", (-0.6, 0.0, 0.0, 0.0, 0.0)),
        ("plumb_bob", (-30.0, 400.0, 0.0, 0.0, -2000.0)),
        ("plumb_bob", (0.0, 0.0, 0.3, -0.2, 0.0)),
        ("rational_polynomial", (0.0, 0.0, 0.0, 0.0, 0.0, -4.0, 0.0, 0.0)),
        ("rational_polynomial", (12.0, 3.0, 0.0, 0.0, 0.1, 12.5, 7.0, 0.8)),
        ("rational_polynomial", (-0.5, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, -0.1, 0.3, 0.1)),
        ("equidistant", (-0.5, 0.0, 0.0, 0.0)),
        ("equidistant", (0.5, -2.0, 1.0, -0.5)),
    ],
)
def test_a_ray_leads_back_to_its_pixel_or_there_is_none(model, d):
    rays = pixel_rays(model, K, d, *SIZE)
    known = np.isfinite(rays).all(axis=-1)
    assert known.any()
    assert np.isnan(rays[~known]).all()
    pixels = np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1)
    off = np.linalg.norm(forward(model, d, rays[known]) - pixels[known], axis=-1)
    assert off.max() < 0.11


@pytest.mark.parametrize("seed", range(4))
def test_rays_over_the_range_of_coefficients(seed):
    """A ray leads back to its pixel, and those farther from the axis are farther out."""
    random = np.random.default_rng(seed)
    for _ in range(12):
        model, count = [("plumb_bob", 5), ("rational_polynomial", 8), ("equidistant", 4)][
            random.integers(3)
        ]
        d = tuple(
            float(value) for value in random.uniform(-1, 1, count) * 10 ** random.uniform(-2, 1)
        )
        d = tuple(0.01 * value if 2 <= i < 4 and count > 4 else value for i, value in enumerate(d))
        rays = pixel_rays(model, K, d, 48, 64)
        known = np.isfinite(rays).all(axis=-1)
        pixels = np.stack(np.meshgrid(np.arange(64), np.arange(48)), axis=-1)
        if known.any():
            off = np.linalg.norm(forward(model, d, rays[known]) - pixels[known], axis=-1)
            assert off.max() < 0.11, (model, d)


def test_behind_a_fold_there_is_no_ray():
    """A second ray leads to the same pixel there, and nobody can say which it was."""
    d = (-0.6, 0.0, 0.0, 0.0, 0.0)
    rays = pixel_rays("plumb_bob", K, d, *SIZE)
    slope = np.linalg.norm(rays, axis=-1)
    assert np.nanmax(slope) < (1 / (3 * 0.6)) ** 0.5  # where r (1 - 0.6 r^2) is largest
    disc = np.pi * (400 * 0.6667 * (1 / 1.8) ** 0.5) ** 2 / slope.size
    assert np.isfinite(slope).mean() == pytest.approx(disc, abs=0.02)
