"""Two planes with occlusion: agreement with convolution away from the edge, and truth at it."""

import numpy as np
import pytest
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.datasets.two_plane import (
    composite,
    make_two_planes,
    reach_px,
    two_plane_error,
)
from coded_aperture_benchmarks.thesis.stair import area_psf_stack
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import fftconvolve

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.optics import MASK_NAMES, Mask

RANDOM = load_textures("random")
LEVIN = Mask.named("levin")
# Neither symmetric nor square, with half-open cells.
LOPSIDED = Mask("lopsided", np.array([[1, 0.5, 0, 0], [1, 1, 0, 0.2]], np.float32))
sizes = st.floats(-13, 13)


def pictures(shape=(48, 50)):
    return np.random.default_rng(0).random((2, *shape))


def convolved(mask, picture, size, reach):
    """Return the convolution with the mask's PSF, as far as `composite` would."""
    psf = area_psf_stack(mask, [size]).psfs[0]
    margin = reach - len(psf) // 2
    inner = [slice(margin, length - margin) for length in picture.shape]
    return fftconvolve(picture[tuple(inner)], psf, mode="valid")


@settings(max_examples=30)
@given(st.sampled_from([LEVIN, LOPSIDED]), sizes, sizes)
def test_a_single_plane_is_convolved_with_its_psf(mask, front_blur, back_blur):
    front, back = pictures()
    reach = reach_px(front_blur, back_blur)
    for opaque, picture, size in ((1.0, front, front_blur), (0.0, back, back_blur)):
        opacity = np.full(front.shape, opaque)
        coded = composite(mask, front, opacity, back, front_blur, back_blur)
        np.testing.assert_allclose(coded, convolved(mask, picture, size, reach), atol=1e-5)


def test_far_from_the_edge_each_side_is_convolved_with_its_psf():
    front, back = pictures((60, 140))
    opacity = np.zeros(front.shape)
    opacity[:, :70] = 1
    coded = composite(LOPSIDED, front, opacity, back, 9.3, 14.6)
    reach = reach_px(9.3, 14.6)
    edge = 70 - reach
    left, right = (
        convolved(LOPSIDED, picture, size, reach) for picture, size in ((front, 9.3), (back, 14.6))
    )
    np.testing.assert_allclose(coded[:, : edge - 5], left[:, : edge - 5], atol=1e-5)
    # The edge blurs as the front does: beyond half its blur size, the back is alone.
    np.testing.assert_allclose(coded[:, edge + 5 :], right[:, edge + 5 :], atol=1e-5)
    assert np.abs(coded - np.where(np.arange(coded.shape[1]) < edge, left, right)).max() > 0.05


def test_the_shadow_of_a_black_front_has_the_width_of_its_own_blur():
    """Before a white back, the frame tells which part of the aperture the front leaves open."""
    opacity = np.zeros((40, 80))
    opacity[:, :40] = 1
    coded = composite(LOPSIDED, np.zeros((40, 80)), opacity, np.ones((40, 80)), 10.0, 20.0)
    reach = reach_px(10.0, 20.0)
    middle = 40 - reach
    profile = coded[0]
    # From one column to the next, another column of the PSF comes into view.
    revealed = np.diff(profile)[middle - 6 : middle + 5]
    (psf,) = area_psf_stack(LOPSIDED, [10.0]).psfs
    np.testing.assert_allclose(revealed, psf.sum(axis=0), atol=1e-6)
    assert profile[middle - 8] == 0
    assert profile[middle + 8] == pytest.approx(1)


def test_occlusion_is_that_of_rays_through_the_aperture():
    """Against a sum over many points of the aperture, one ray each."""
    front, back = pictures((40, 44))
    opacity = (np.random.default_rng(1).random(front.shape) < 0.3).astype(float)
    front_blur, back_blur, fine = 7.0, 12.0, 120
    reach = reach_px(front_blur, back_blur)
    rows, columns = (length - 2 * reach for length in front.shape)
    cells = LOPSIDED.transmission

    def seen(picture, down, right):
        top, left = reach - round(down), reach - round(right)
        return picture[top : top + rows, left : left + columns]

    expected, light = np.zeros((rows, columns)), 0.0
    for v, u in np.ndindex(fine, 2 * fine):
        passes = float(cells[2 * v // fine, 4 * u // (2 * fine)])
        if passes:
            point = (v + 0.5) / (2 * fine) - 0.25, (u + 0.5) / (2 * fine) - 0.5
            near, far = ([size * x for x in point] for size in (front_blur, back_blur))
            a = seen(opacity, *near)
            expected += passes * (a * seen(front, *near) + (1 - a) * seen(back, *far))
            light += passes
    coded = composite(LOPSIDED, front, opacity, back, front_blur, back_blur)
    np.testing.assert_allclose(coded, expected / light, atol=5e-3)


@pytest.mark.parametrize("name", MASK_NAMES)
def test_no_light_is_lost_at_the_edge(name):
    opacity = np.random.default_rng(0).random((50, 50))
    grey = np.full((50, 50), 0.4)
    coded = composite(Mask.named(name), grey, opacity, grey, 10.0, 15.0)
    np.testing.assert_allclose(coded, 0.4, atol=1e-6)


def test_truth_is_what_a_pinhole_sees():
    planes = make_two_planes(LEVIN, RANDOM, 10.0, 22.0, shape=(64, 80))
    assert planes.coded.shape == planes.level.shape == (64, 80)
    step = 23 / 38
    np.testing.assert_allclose(planes.level[:, :40], (10 - 7) / step, rtol=1e-6)
    np.testing.assert_allclose(planes.level[:, 40:], (22 - 7) / step, rtol=1e-6)
    assert planes.edge_distance_px[0, [0, 39, 40, 79]].tolist() == [39.5, 0.5, 0.5, 39.5]


def test_the_edge_of_the_frame_is_where_the_truth_says():
    """Black before white: half the light at the edge, for a symmetric mask."""

    class Planes(Textures):
        def crops(self, count, rows, columns, random):
            return np.stack([np.zeros((rows, columns)), np.ones((rows, columns))]).astype(
                np.float32
            )

    planes = make_two_planes(LEVIN, Planes("planes", ()), 11.0, 20.0, sigma=0.0, shape=(16, 80))
    assert planes.coded[0, 39:41].mean() == pytest.approx(0.5, abs=1e-5)
    assert planes.coded[0, 30] == pytest.approx(0, abs=1e-6)
    assert planes.coded[0, 49] == pytest.approx(1, abs=1e-6)


def test_the_crops_are_the_same_for_every_mask_and_blur():
    def back(mask, front_blur, sigma=0.0):
        return make_two_planes(mask, RANDOM, front_blur, 16.0, sigma, shape=(64, 96)).coded[:, 70:]

    np.testing.assert_allclose(back(LEVIN, 8.0), back(LEVIN, 28.0), atol=1e-5)
    # The mean over a PSF's reach hardly depends on the mask.
    assert np.corrcoef(back(LEVIN, 8.0).ravel(), back(Mask.named("disc"), 8.0).ravel())[0, 1] > 0.4
    noise = back(LEVIN, 8.0, 0.01) - back(LEVIN, 8.0)
    assert noise.std() == pytest.approx(0.01 / LEVIN.open_fraction, rel=0.1)


def test_errors_are_told_apart_by_their_distance_from_the_edge():
    planes = make_two_planes(LEVIN, RANDOM, 10.0, 14.0, shape=(64, 96))
    # All of the back within 10 px of the edge is taken for the front.
    level = planes.level.copy()
    level[:, 48:58] = planes.level[0, 0]
    step = float(planes.level[0, -1] - planes.level[0, 0])
    error = two_plane_error(level, planes)
    assert error.near_edge == pytest.approx(step * 10 / 32, rel=1e-5)
    assert error.everywhere == pytest.approx(step * 10 / 96, rel=1e-5)
    assert error.beyond == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((5.0, 14.0), "blur size"), ((10.0, 31.0), "blur size"), ((10.0, 14.0, -0.1), "noise")],
)
def test_impossible_planes_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        make_two_planes(LEVIN, RANDOM, *arguments, shape=(64, 64))


def test_pictures_that_do_not_fit_are_refused():
    front, back = pictures()
    with pytest.raises(InputError, match="shape"):
        composite(LEVIN, front, np.ones((3, 3)), back, 9.0, 9.0)
    with pytest.raises(InputError, match="larger"):
        composite(LEVIN, front, np.ones_like(front), back, 9.0, 60.0)
