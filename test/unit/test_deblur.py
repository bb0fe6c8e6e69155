"""Deblurring of frames whose sharp original is known."""

import numpy as np
import pytest
from deblur_scene import NOISE, blurred, deblurrer, edges_and_texture, levin_stack
from scipy import ndimage

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur import Deblurrer
from coded_aperture_ros.deblur.blur_map import filled_blur_map
from coded_aperture_ros.deblur.inverse_basis import InverseBasis, wiener_filters
from coded_aperture_ros.frames import transfer_function
from coded_aperture_ros.likelihood.bank import image_prior
from coded_aperture_ros.metrics import psnr_db
from coded_aperture_ros.optics import Mask, render_psf, render_psf_stack


@pytest.fixture(scope="module")
def stack():
    return levin_stack()


@pytest.fixture(scope="module")
def sharp():
    return edges_and_texture((14, 18), 16)[:208, :272]


@pytest.mark.parametrize("size", [3.0, 6.5, 10.0])
def test_plane_becomes_sharper(stack, sharp, size):
    coded = blurred(sharp, size)
    result = deblurrer().deblur(coded, np.full(sharp.shape, size, np.float32))
    assert result.dtype == np.float32
    assert psnr_db(result, sharp) > psnr_db(coded, sharp) + 3
    wrong = deblurrer().deblur(coded, np.full(sharp.shape, size + 1, np.float32))
    assert psnr_db(result, sharp) > psnr_db(wrong, sharp) + 1


def test_each_half_is_deblurred_by_its_own_depth(stack, sharp):
    left, right = blurred(sharp, 4.0), blurred(sharp, 9.0)
    middle = sharp.shape[1] // 2
    coded = left.copy()
    coded[:, middle:] = right[:, middle:]
    blur = np.full(sharp.shape, 4.0, np.float32)
    blur[:, middle:] = 9.0
    result = deblurrer().deblur(coded, blur)
    for part in (np.s_[:, : middle - 24], np.s_[:, middle + 24 :]):
        assert psnr_db(result[part], sharp[part]) > psnr_db(coded[part], sharp[part]) + 2


@pytest.mark.parametrize("method", ["fast", "cg", "sparse"])
def test_noise_of_colour_is_not_amplified_channel_by_channel(stack, sharp, method):
    grey = np.dstack([sharp] * 3)
    coded = np.dstack([blurred(sharp, 5.0, 0.0)] * 3)
    coded += np.random.default_rng(4).normal(0, 0.01, coded.shape).astype(np.float32)
    blur = np.full(sharp.shape, 5.0, np.float32)
    restore = deblurrer(noise=0.01, method=method, iterations=24).deblur
    together = restore(coded, blur)
    alone = np.dstack([restore(np.ascontiguousarray(c), blur) for c in coded.T.swapaxes(1, 2)])
    assert psnr_db(together, grey) > psnr_db(alone, grey) - 0.7
    assert np.ptp(together, axis=2).mean() < 0.7 * np.ptp(alone, axis=2).mean()


@pytest.mark.parametrize("value", [0.0, 0.3, 0.9])
def test_flat_frame_stays_flat_up_to_its_border(stack, value):
    frame = np.full((120, 150), value, np.float32)
    blur = np.tile(np.linspace(1, 11, 150, dtype=np.float32), (120, 1))
    assert deblurrer().deblur(frame, blur) == pytest.approx(frame, abs=2e-3)


@pytest.mark.parametrize("band", ["full", "half"])
@pytest.mark.parametrize("shape", [(160, 200), (157, 203)])
def test_opposite_borders_that_differ_do_not_ring(stack, band, shape):
    # Blur leaves a slope as it is.
    down, across = np.linspace(0, 0.3, shape[0]), np.linspace(0.1, 0.6, shape[1])
    slope = (down[:, None] + across).astype(np.float32)
    result = deblurrer(band=band, noise=0.001).deblur(slope, np.full(shape, 10.0, np.float32))
    assert np.abs(result - slope).max() < 0.02


def test_smoothness_trades_noise_for_sharpness(stack):
    noise = np.random.default_rng(2).normal(0.5, 0.01, (128, 128)).astype(np.float32)
    blur = np.full(noise.shape, 6.0, np.float32)
    spread = [
        deblurrer(smoothness=smoothness).deblur(noise, blur).std()
        for smoothness in (0.01, 1.0, 100.0)
    ]
    assert spread[0] > 1.3 * spread[1] > 1.3 * spread[2]


def test_basis_gives_back_every_inverse_filter(stack):
    """Also for model errors and noises between those that it was made from."""
    errors, noise, shape = np.array([0.06, 0.15]), 0.002, (96, 108)
    prior = image_prior(shape)
    transfers = [transfer_function(psf, shape) for psf in stack.psfs]
    # What is seen of a filter on blurred photographs.
    weight = np.sqrt(prior * np.mean(np.abs(transfers) ** 2, axis=0) + noise**2)
    for rank, tolerance in ((24, 0.05), (12, 0.15)):
        basis = InverseBasis.learn(stack, 0.003, rank)
        coefficients, kernels = basis.coefficients(errors, noise), basis.transforms(shape)
        for level in (0, 5, 10):
            wanted = wiener_filters(transfers[level], prior, errors, noise)
            difference = np.tensordot(coefficients[level], kernels, 1) - wanted
            assert np.linalg.norm(weight * difference) < tolerance * np.linalg.norm(weight * wanted)


def test_inverse_filter_is_the_least_squares_solution_of_one_plane():
    """Eq. 6.27 for one plane: the gradient of its cost vanishes at the filtered image."""
    shape = (32, 32)
    psf = render_psf(Mask.named("levin"), 5.0)
    transfer = transfer_function(psf, shape).astype(np.complex128)
    prior = image_prior(shape).astype(np.float64)
    observed = np.fft.rfft2(np.random.default_rng(3).random(shape))
    error = np.array([0.0])
    estimate = wiener_filters(transfer, prior, error, NOISE)[0] * observed
    gradient = np.conj(transfer) * (transfer * estimate - observed) + NOISE**2 / prior * estimate
    assert np.abs(gradient).max() < 1e-4 * np.abs(np.conj(transfer) * observed).max()


def test_gaps_of_the_depth_map_are_filled_from_the_nearest():
    blur = np.array([[1, np.nan, np.nan, 5], [1, np.nan, np.inf, 5]], np.float32)
    assert filled_blur_map(blur, np.zeros((2, 4), np.float32)).tolist() == [
        [1, 1, 5, 5],
        [1, 1, 5, 5],
    ]
    larger = filled_blur_map(blur, np.zeros((4, 8), np.float32))
    assert larger.shape == (4, 8)
    assert (larger.min(), larger.max()) == (1, 5)


def test_unknown_depth_and_pixels_that_are_not_numbers_are_survived(stack, sharp):
    coded = blurred(sharp, 6.0)
    coded[50:52, 60:64] = np.nan
    blur = np.full((104, 136), 6.0, np.float32)
    blur[20:60, 40:70] = np.nan
    result = deblurrer().deblur(coded, blur)
    assert np.isfinite(result).all()
    far = np.s_[120:, 150:]
    assert psnr_db(result[far], sharp[far]) > psnr_db(coded[far], sharp[far]) + 3


@pytest.mark.parametrize("bad", [1e30, -1e30, np.inf, -np.inf])
def test_a_pixel_out_of_all_bounds_spoils_only_its_surroundings(stack, sharp, bad):
    coded = blurred(sharp, 6.0)
    blur = np.full(sharp.shape, 6.0, np.float32)
    clean = deblurrer().deblur(coded, blur, NOISE)
    coded[50, 60] = bad
    spoilt = deblurrer().deblur(coded, blur, NOISE)
    assert spoilt[120:, 150:] == pytest.approx(clean[120:, 150:], abs=0.01)


@pytest.mark.parametrize("sizes", [[0.1, 0.9], [3.0, 3.0], [5.0, 9.0], [4.0]])
def test_few_or_equal_levels_are_deblurred_like_many(sharp, sizes):
    """The inverse filters of such stacks span less than the rank that is asked for."""
    coded = blurred(sharp, sizes[-1])
    blur = np.full(sharp.shape, sizes[-1], np.float32)
    few = Deblurrer(render_psf_stack(Mask.named("levin"), sizes)).deblur(coded, blur, NOISE)
    around = np.linspace(sizes[-1] - 0.05, sizes[-1] + 0.05, 9)
    many = Deblurrer(render_psf_stack(Mask.named("levin"), around)).deblur(coded, blur, NOISE)
    assert psnr_db(few, many) > 40


def test_psf_that_is_wider_than_the_frame(sharp):
    wide = render_psf_stack(Mask.named("levin"), [90.0, 150.0])
    frame = sharp[:64, :72]
    result = Deblurrer(wide).deblur(frame, np.full(frame.shape, 120.0, np.float32))
    assert result.shape == frame.shape
    assert np.isfinite(result).all()


def test_wrong_input_is_refused(stack):
    wrong = deblurrer()
    frame = np.zeros((64, 64), np.float32)
    with pytest.raises(InputError, match="no pixel has a known depth"):
        wrong.deblur(frame, np.full((64, 64), np.nan, np.float32))
    with pytest.raises(InputError, match="blur map: expected"):
        wrong.deblur(frame, np.zeros(64, np.float32))
    with pytest.raises(InputError, match="floating values"):
        wrong.deblur(np.zeros((64, 64), np.uint8), frame)
    with pytest.raises(InputError, match="5x7 px is too small to estimate its noise"):
        wrong.deblur(np.zeros((7, 5), np.float32), np.zeros((7, 5), np.float32))
    with pytest.raises(InputError, match=r"map of 30x64 px .* frame of 64x64 px"):
        wrong.deblur(frame, np.zeros((64, 30), np.float32))
    with pytest.raises(InputError, match=r"got \[64, 64, 2\]"):
        wrong.deblur(np.zeros((64, 64, 2), np.float32), frame)


def test_missing_pixels_are_filled_from_their_surroundings(stack):
    frame = np.full((96, 96, 3), 0.6, np.float32)
    frame[40:43, 40:43, 1] = np.nan
    result = deblurrer().deblur(frame, np.full((96, 96), 6.0, np.float32))
    assert result == pytest.approx(np.full((96, 96, 3), 0.6), abs=5e-3)


@pytest.mark.parametrize("shape", [(208, 272), (187, 255)])
def test_the_lower_half_of_the_frequencies_is_deblurred_as_by_all(stack, sharp, shape):
    """A wide PSF leaves nothing in the upper half, which does not count here."""
    smooth = ndimage.gaussian_filter(sharp, 1.5)[: shape[0], : shape[1]]
    coded = blurred(smooth, 9.0, 0.0005)
    blur = np.full(shape, 9.0, np.float32)
    half = deblurrer(band="half").deblur(coded, blur)
    full = deblurrer().deblur(coded, blur)
    assert half.shape == full.shape
    assert psnr_db(half, smooth) > psnr_db(coded, smooth) + 2
    assert psnr_db(half, smooth) > psnr_db(full, smooth) - 1
    # In its right place: a shift by half a pixel would be worse.
    shifted = ndimage.shift(half, (0.5, 0.5), order=3, mode="nearest")
    assert psnr_db(half, full) > psnr_db(shifted, full) + 2


def test_the_upper_half_of_the_frequencies_stays(stack):
    columns = np.tile(np.arange(128), (96, 1))
    stripes = (0.5 + 0.2 * np.cos(2 * np.pi * 0.4 * columns)).astype(np.float32)
    result = deblurrer(band="half").deblur(stripes, np.full((96, 128), 6.0, np.float32), 0.002)
    inside = (slice(24, -24), slice(24, -24))
    # All of it, but for the smoothing at the end, and no brightness is lost.
    assert result[inside].std() > 0.8 * stripes[inside].std()
    assert result[inside].mean() == pytest.approx(0.5, abs=0.01)
    full = deblurrer().deblur(stripes, np.full((96, 128), 6.0, np.float32), 0.002)
    assert abs(full[inside].std() / stripes[inside].std() - 1) > 0.2


def test_half_of_the_frequencies_in_colour_and_by_two_depths(stack, sharp):
    colour = np.dstack([0.9 * sharp, sharp, 0.7 * sharp]).astype(np.float32)
    near, far = (np.dstack([blurred(c, size) for c in colour.transpose(2, 0, 1)])
                 for size in (5.0, 10.0))  # fmt: skip
    middle = sharp.shape[1] // 2
    coded = np.where(np.arange(sharp.shape[1])[None, :, None] < middle, near, far)
    blur = np.where(np.arange(sharp.shape[1]) < middle, 5.0, 10.0).astype(np.float32)
    blur = np.tile(blur, (sharp.shape[0], 1))
    result = deblurrer(band="half").deblur(coded.astype(np.float32), blur)
    for part in (slice(0, middle - 20), slice(middle + 20, None)):
        gain = psnr_db(result[:, part], colour[:, part]) - psnr_db(coded[:, part], colour[:, part])
        assert gain > 1.5
