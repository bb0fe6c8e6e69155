"""Frames behind a mosaic of colour filters: brightness and colours."""

import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import (
    MOSAICS,
    colour_from_mosaic,
    grey_from_mosaic,
    mosaic_from_colour,
)
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank
from coded_aperture_ros.optics import Mask, render_psf_stack
from coded_aperture_ros.simulation.layered import random_scene

HALF_GREEN = np.array([0.25, 0.5, 0.25], np.float32)


@pytest.fixture(scope="module")
def picture():
    """Smooth colours and sharp brightness."""
    down, across = np.mgrid[:61, :82].astype(np.float32)
    colours = [np.sin(down / 30 + k) + np.cos(across / 25 + k) for k in range(3)]
    texture = np.random.default_rng(0).random((61, 82)).astype(np.float32)
    return (0.4 + 0.05 * np.dstack(colours) + 0.1 * texture[..., None]).astype(np.float32)


@pytest.mark.parametrize("order", MOSAICS)
def test_every_pixel_keeps_the_value_of_its_filter(picture, order):
    mosaic = mosaic_from_colour(picture, order)
    found = colour_from_mosaic(mosaic, order)
    np.testing.assert_allclose(mosaic_from_colour(found, order), mosaic, atol=1e-6)
    for row, column in np.ndindex(2, 2):
        channel = "rgb".index(order[2 * row + column])
        part = np.s_[row::2, column::2]
        np.testing.assert_array_equal(mosaic[part], picture[part][..., channel])


@pytest.mark.parametrize("order", MOSAICS)
def test_smooth_colours_are_found_exactly(picture, order):
    smooth = np.broadcast_to(np.array([0.6, 0.3, 0.1], np.float32), picture.shape)
    mosaic = mosaic_from_colour(smooth, order)
    np.testing.assert_allclose(colour_from_mosaic(mosaic, order), smooth, atol=1e-6)
    np.testing.assert_allclose(grey_from_mosaic(mosaic, order), smooth @ HALF_GREEN, atol=1e-6)


@pytest.mark.parametrize("order", MOSAICS)
def test_brightness_is_as_sharp_as_on_a_grey_sensor(picture, order):
    found = grey_from_mosaic(mosaic_from_colour(picture, order), order)
    true = picture @ HALF_GREEN
    # Up to 0.3 cycles per pixel in any direction; beyond lies colour.
    window = np.outer(np.hanning(61), np.hanning(82))
    spectra = [np.fft.rfft2((image - true.mean()) * window) for image in (found, true)]
    radius = np.hypot(np.fft.fftfreq(61)[:, None], np.fft.rfftfreq(82))
    passed = (radius > 0.1) & (radius < 0.3)
    difference = np.linalg.norm((spectra[0] - spectra[1])[passed])
    assert difference < 0.1 * np.linalg.norm(spectra[1][passed])


def test_noise_stays_white_but_for_where_colour_is():
    noise = np.random.default_rng(1).standard_normal((240, 320)).astype(np.float32)
    grey = grey_from_mosaic(noise * 0.01 + 0.5, "grbg")
    assert 0.85 < grey.std() / 0.01 < 1


def test_what_is_saturated_in_one_colour_is_saturated():
    mosaic = np.full((20, 20), 0.3, np.float32)
    mosaic[10, 10] = 1.0
    grey = grey_from_mosaic(mosaic, "rggb")
    assert (grey[9:12, 9:12] == 1).all()
    assert grey.max(axis=0)[:8].max() < 0.98


@pytest.mark.parametrize(
    ("mosaic", "order", "what"),
    [
        (np.zeros((8, 8, 3), np.float32), "rggb", "grey frame"),
        (np.zeros((1, 8), np.float32), "rggb", "2x2"),
        (np.zeros((8, 8), np.float32), "rgbg", "rggb, bggr, gbrg, grbg"),
    ],
)
def test_what_is_no_mosaic_is_refused(mosaic, order, what):
    with pytest.raises(InputError, match=what):
        grey_from_mosaic(mosaic, order)


def test_depth_from_a_mosaic_is_nearly_that_of_a_grey_sensor():
    mask = Mask.named("levin")
    scene = random_scene(1_000_021, mask, shape=(240, 320))
    bank = learn_bank(render_psf_stack(mask, np.arange(2.0, 18.0, 0.7)), LearnConfig(window_px=48))
    tint = np.linspace([0.9, 0.7, 0.4], [0.5, 0.7, 0.8], 320, dtype=np.float32)
    picture = np.asarray(scene.coded()[..., None] * tint, np.float32)
    noise = 0.001 * np.random.default_rng(2).standard_normal(picture.shape[:2]).astype(np.float32)
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0, noise=0.001))
    of_grey, of_mosaic, of_raw = (
        estimator.estimate(frame)
        for frame in (
            picture @ HALF_GREEN + noise,
            grey_from_mosaic(mosaic_from_colour(picture, "gbrg") + noise, "gbrg"),
            mosaic_from_colour(picture, "gbrg") + noise,
        )
    )
    assert of_mosaic.health.fits
    apart, apart_raw = (
        np.median(np.abs(each.blur_size_px - of_grey.blur_size_px)) for each in (of_mosaic, of_raw)
    )
    assert apart < 0.15
    assert apart_raw > 3 * apart
