"""PSFs measured from dots, and from a sharp and a coded picture."""

import numpy as np
import pytest
from dot_grid import dot_picture, point_image
from scipy import ndimage, signal

from coded_aperture_ros.calibration import (
    centred_stack,
    equally_spaced_stack,
    psf_from_dots,
    psf_from_pair,
    psf_picture,
)
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.optics import Mask, camera_from_mapping, render_psf

CAMERA = {
    "focal_length_px": 1194.0,
    "focus_distance_m": 1.9,
    "image_width": 640,
    "image_height": 480,
    "mask": {"name": "levin"},
    "mask_extent_mm": 52.0,
}
SMALL = {"size": (260, 320), "spacing_px": 29.3}


def transmission(mask):
    return Mask.named(mask).transmission


def error_of(psf, mask, blur_size_px):
    true = point_image(transmission(mask), blur_size_px, 0, 0, max(len(psf), 31))
    margin = (len(true) - len(psf)) // 2
    return np.linalg.norm(np.pad(psf, margin) - true) / np.linalg.norm(true)


@pytest.mark.parametrize("blur_size_px", [5.0, 7.3, -11.0, 15.6, 20.0])
@pytest.mark.parametrize("mask", ["levin", "four_hole"])
def test_dots_give_the_psf_within_3_percent(mask, blur_size_px):
    """Noise, dots up to a pixel off the grid, vignetting, uneven background light."""
    measured = psf_from_dots(dot_picture(transmission(mask), blur_size_px), abs(blur_size_px))
    found = centred_stack([measured.at], ["a.png"], mask=Mask.named(mask)).centred[0]
    # Neither mask tells its orientation well enough to be asked for it here.
    assert abs(found.blur_size_px) == pytest.approx(abs(blur_size_px), abs=0.05)
    assert error_of(found.psf, mask, np.copysign(blur_size_px, found.blur_size_px)) < 0.03
    assert found.psf.sum() == pytest.approx(1)
    assert found.psf.min() >= 0
    assert found.misfit < 0.03
    assert found.snr > 30
    assert 0.2 < measured.scatter_px < 0.45
    assert measured.field_variation < 0.04
    assert measured.missing == 0


def test_dark_dots_of_unknown_size_on_a_bright_page():
    picture = dot_picture(transmission("levin"), 12.0, dark_on_bright=True, peak=0.6)
    measured = psf_from_dots(picture)
    assert measured.dark
    found = centred_stack([measured.at], ["a.png"], mask=Mask.named("levin")).centred[0]
    assert error_of(found.psf, "levin", 12.0) < 0.03


def test_colour_is_averaged():
    picture = dot_picture(transmission("levin"), 9.0, **SMALL)
    one = psf_from_dots(picture, 9.0)
    three = psf_from_dots(np.stack([0.8 * picture, picture, 1.2 * picture], axis=-1), 9.0)
    np.testing.assert_allclose(one.at(np.zeros(2))[0], three.at(np.zeros(2))[0], atol=1e-4)


def test_a_mask_without_symmetry_tells_its_side_and_centre():
    """The middle of the mask's extent, not its centre of light, is the PSF's centre."""
    mask = Mask.named("three_hole")
    for size in (9.0, -9.0):
        measured = psf_from_dots(dot_picture(mask.transmission, size, **SMALL), 9.0)
        found = centred_stack([measured.at], ["a.png"], mask=mask).centred[0]
        assert found.blur_size_px == pytest.approx(size, abs=0.05)
        assert error_of(found.psf, "three_hole", size) < 0.03


@pytest.mark.parametrize("mask", ["levin", "four_hole", "three_hole"])
def test_without_knowing_the_mask(mask):
    sizes = (6.0, 10.0, 15.0)
    grid = {"size": (360, 480), "spacing_px": 33.7}
    measured = [psf_from_dots(dot_picture(transmission(mask), size, **grid)) for size in sizes]
    found = centred_stack([one.at for one in measured], ["a", "b", "c"])
    for size, one in zip(sizes, found.centred, strict=True):
        assert one.blur_size_px == pytest.approx(size, rel=0.05)
        assert np.isnan(one.misfit)
        # The outline tells the centre of three holes less well than the middle of all light does
        # that of a mask with its light in the middle.
        assert error_of(one.psf, mask, size) < (0.12 if mask == "three_hole" else 0.03)


def test_field_variation_is_seen():
    """Blur that grows over the picture, as of a tilted grid."""
    sharp = dot_picture(transmission("levin"), 9.0, jitter_px=0.1)
    soft = dot_picture(transmission("levin"), 11.0, jitter_px=0.1)
    share = np.linspace(0, 1, sharp.shape[1])
    tilted = psf_from_dots((1 - share) * sharp + share * soft, 11.0)
    assert tilted.field_variation > 0.08
    assert psf_from_dots(sharp, 9.0).field_variation < 0.03


def test_missing_dots_specks_and_saturated_dots_are_left_out():
    picture = dot_picture(transmission("levin"), 9.0, missing=(60, 61, 90))
    picture[200:203, 330:333] += 0.5
    for row, column in ((100, 100), (300, 400)):
        picture[row : row + 10, column : column + 10] = 1.0
    measured = psf_from_dots(picture, 9.0)
    assert 2 <= measured.missing <= 9
    assert measured.rejected >= 2
    found = centred_stack([measured.at], ["a.png"], mask=Mask.named("levin")).centred[0]
    assert error_of(found.psf, "levin", 9.0) < 0.03


def noise_only():
    return (0.1 + 0.01 * np.random.default_rng(0).standard_normal((200, 200))).astype(np.float32)


def line_of_dots():
    picture = dot_picture(transmission("levin"), 7.0, angle_deg=0, spacing_px=40.0)
    picture[:215] = picture[270:] = 0.04
    return picture


@pytest.mark.parametrize(
    ("picture", "phrase"),
    [
        (noise_only(), "no dots that repeat|no grid of dots"),
        (np.full((200, 200), 0.1, np.float32), "no dots that repeat"),
        (line_of_dots(), "one direction only|no grid of dots|no dots that repeat|whole dots"),
        (dot_picture(transmission("levin"), 9.0, size=(120, 120)), "whole dots in the picture"),
        (dot_picture(transmission("levin"), 26.0, spacing_px=29.0), "the dots overlap"),
        (
            np.minimum(dot_picture(transmission("levin"), 9.0, peak=1.3), 1.0),
            "dots are saturated: expose for a shorter time",
        ),
        (
            np.minimum(2 * dot_picture(transmission("levin"), 9.0, dark_on_bright=True), 1.0),
            "the background is saturated",
        ),
        (
            dot_picture(transmission("levin"), 9.0, **SMALL, peak=0.004, noise=0.004),
            "light",
        ),
        (
            dot_picture(transmission("levin"), 9.0, missing=tuple(range(20, 150, 3))),
            "dots of the grid are missing",
        ),
        (np.full((200, 200), np.nan, np.float32), "NaN"),
    ],
)
def test_pictures_that_cannot_be_used(picture, phrase):
    with pytest.raises(InputError, match=phrase):
        psf_from_dots(picture)


def test_known_blur_wider_than_the_gaps_is_an_overlap():
    with pytest.raises(InputError, match=r"the dots overlap: they are 29\.\d px apart"):
        psf_from_dots(dot_picture(transmission("levin"), 9.0, **SMALL), 24.0)


def test_another_mask_is_refused():
    measured = psf_from_dots(dot_picture(transmission("four_hole"), 11.0, **SMALL), 11.0)
    with pytest.raises(InputError, match=r"a\.png: the PSF differs from that of mask levin by"):
        centred_stack([measured.at], ["a.png"], mask=Mask.named("levin"))


# ---- the stack ----


def rendered(mask, sizes):
    return [render_psf(Mask.named(mask), size).astype(np.float64) for size in sizes]


@pytest.mark.parametrize("mask", ["levin", "four_hole"])
def test_between_two_depths(mask):
    sizes = np.arange(8.0, 20.0, 0.5)
    stack = equally_spaced_stack(rendered(mask, sizes), sizes, 2 * len(sizes) - 1)
    np.testing.assert_allclose(np.diff(stack.blur_sizes_px), 0.25)
    errors = [
        error_of(psf, mask, size) for psf, size in zip(stack.psfs, stack.blur_sizes_px, strict=True)
    ]
    assert max(errors[::2]) < 1e-6
    assert max(errors) < 0.04


def test_with_a_mask_any_step_will_do():
    sizes = np.array([6.0, 19.0, 13.0])
    stack = equally_spaced_stack(rendered("levin", sizes), sizes, 14, mask=Mask.named("levin"))
    np.testing.assert_allclose(stack.blur_sizes_px, np.arange(6, 20))
    for psf, size in zip(stack.psfs, stack.blur_sizes_px, strict=True):
        assert error_of(psf, "levin", size) < 1e-5


def test_depths_of_the_stack_are_those_of_the_lens():
    camera = camera_from_mapping(CAMERA)
    depths = np.array([4.0, 2.3, 2.9])
    sizes = camera.blur_size_px(depths)
    stack = equally_spaced_stack(rendered("levin", sizes), sizes, 9, depths)
    np.testing.assert_allclose(stack.depths_m, camera.depth_m(stack.blur_sizes_px))
    np.testing.assert_allclose(stack.depths_m[[0, -1]], [2.3, 4.0])


@pytest.mark.parametrize(
    ("sizes", "depths", "phrase"),
    [
        ((6.0, 6.0, 8.0), None, "same blur size of 6.00 px"),
        ((6.0, 7.0, 8.0), (1.0, 3.0, 2.0), "does not grow with the distance"),
    ],
)
def test_blur_sizes_that_make_no_stack(sizes, depths, phrase):
    with pytest.raises(InputError, match=phrase):
        equally_spaced_stack(rendered("levin", sizes), sizes, depths_m=depths)


def test_picture_of_psfs():
    psfs = rendered("levin", [3.0, 9.0]) * 5
    drawn = psf_picture(psfs)
    assert drawn.min() == 0
    assert drawn.max() == pytest.approx(1)
    tiles_down, tiles_right = (round(length / (drawn.shape[0] / 2)) for length in drawn.shape)
    assert (tiles_down, tiles_right) == (2, 8)


# ---- a sharp and a coded picture ----


def pair(mask, size, *, noise=0.002, moved=(2.3, -1.6), vignetting=0.2, seed=1):
    """A page of random specks, and the same through the mask, moved, darker towards the corners."""
    random = np.random.default_rng(seed)
    specks = (random.random((380, 440)) < 0.5).astype(float)
    page = 0.1 + 0.7 * ndimage.gaussian_filter(specks, 0.5)
    inside = slice(50, -50), slice(50, -50)
    coded = signal.fftconvolve(page, point_image(transmission(mask), size, 0, 0, 33), "same")
    coded = coded[inside]
    rows, columns = np.meshgrid(*(np.linspace(-1, 1, n) for n in coded.shape), indexing="ij")
    coded = 0.6 * coded * (1 - vignetting * (rows**2 + columns**2))
    back = ndimage.fourier_shift(np.fft.fft2(page), [-move for move in moved])
    sharp = np.fft.ifft2(back).real[inside]
    return tuple(one + noise * random.standard_normal(one.shape) for one in (sharp, coded))


@pytest.mark.parametrize(
    ("mask", "size"), [("levin", 5.0), ("levin", 12.0), ("four_hole", 8.0), ("four_hole", 16.0)]
)
def test_a_pair_gives_the_psf_within_3_percent(mask, size):
    measured = psf_from_pair(*pair(mask, size), size + 2)
    found = centred_stack([measured.at], ["coded.png"], mask=Mask.named(mask)).centred[0]
    assert found.blur_size_px == pytest.approx(size, abs=0.03)
    assert error_of(found.psf, mask, size) < 0.03
    assert found.psf.min() >= 0
    assert measured.agreement > 0.85


@pytest.mark.parametrize(
    ("sharp", "coded", "phrase"),
    [
        (pair("levin", 6.0)[0], pair("levin", 6.0)[1][:-1], "px, the sharp one"),
        (pair("levin", 6.0)[0], pair("levin", 6.0, seed=2)[1], "explains|do not show the same"),
        (np.full((280, 340), 0.5), pair("levin", 6.0)[1], "no texture"),
        (1.5 + pair("levin", 6.0)[0], pair("levin", 6.0)[1], "sharp picture is saturated"),
        (np.full((280, 340), np.nan), pair("levin", 6.0)[1], "NaN"),
        (pair("levin", 6.0)[0][:40, :40], pair("levin", 6.0)[1][:40, :40], "too small"),
    ],
)
def test_pairs_that_cannot_be_used(sharp, coded, phrase):
    with pytest.raises(InputError, match=phrase):
        psf_from_pair(sharp, coded, 8)
