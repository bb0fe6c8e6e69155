"""The windowed Fourier basis against direct transforms and against random textures."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood.bank import WindowedFourierBasis, power_spectrum
from coded_aperture_ros.optics import Mask, render_psf


def spectra(basis, image, stride):
    """All spectra: the projection onto the identity."""
    return basis.power(image, stride)


def textures(slope, size, count, seed=0):
    """Periodic random textures of unit variance with a power-law spectrum."""
    random = np.random.default_rng(seed)
    shape = (size, size)
    white = np.fft.rfft2(random.normal(size=(count, *shape)))
    return np.fft.irfft2(white * np.sqrt(power_spectrum(slope, shape)), shape)


@pytest.mark.parametrize(("window", "stride"), [(16, 5), (24, 8)])
def test_spectrum_is_that_of_each_windowed_patch(window, stride):
    image = np.random.default_rng(1).random((50, 67)).astype(np.float32)
    basis = WindowedFourierBasis(window)
    power, grid = spectra(basis, image, stride)
    hann = np.outer(basis.window, basis.window)
    assert np.sum(hann**2) == pytest.approx(1, abs=1e-5)
    for i, row in enumerate(grid.row_centres):
        for j, column in enumerate(grid.column_centres):
            top, left = row - window // 2, column - window // 2
            patch = image[top : top + window, left : left + window] * hann
            direct = np.abs(np.fft.rfft2(patch)) ** 2
            assert power[i, j] == pytest.approx(direct.ravel(), rel=1e-3, abs=1e-5)


@given(
    height=st.integers(16, 200),
    width=st.integers(16, 200),
    window=st.integers(4, 8).map(lambda half: 2 * half),
    stride=st.integers(1, 40),
)
def test_windows_lie_inside_the_frame_and_leave_little_out(height, width, window, stride):
    grid = PatchGrid.covering((height, width), window, stride)
    for centres, length in ((grid.row_centres, height), (grid.column_centres, width)):
        first, last = centres[0] - window // 2, centres[-1] + window // 2
        assert first >= 0
        assert last <= length
        assert abs(first - (length - last)) <= 1
        assert first + (length - last) < stride


def test_white_noise_has_its_variance_at_every_frequency():
    noise = np.random.default_rng(2).normal(0, 0.1, (400, 400)).astype(np.float32)
    basis = WindowedFourierBasis(16)
    power, _ = spectra(basis, noise, 8)
    # White noise and the mean over 2401 windows, half of them independent.
    assert power.mean(axis=(0, 1)) == pytest.approx(np.full(basis.size, 0.01), rel=0.2)
    assert power.mean() == pytest.approx(0.01, rel=0.02)
    noise_power = power @ basis.noise_weights
    assert noise_power.mean() == pytest.approx(0.01, rel=0.03)


def test_the_mean_of_a_patch_does_not_count():
    basis = WindowedFourierBasis(16)
    power, _ = spectra(basis, np.full((40, 40), 0.7, np.float32), 8)
    assert power.max() > 1
    assert np.abs(power @ basis.multiplicity).max() < 1e-8
    assert basis.multiplicity.sum() == 16 * 16 - 9


@pytest.mark.parametrize("slope", [1.6, 2.4])
@pytest.mark.parametrize("blur", [None, 9.3])
def test_expected_power_is_the_mean_over_textures(slope, blur):
    window = 24
    basis = WindowedFourierBasis(window)
    psf = np.ones((1, 1), np.float32) if blur is None else render_psf(Mask.named("levin"), blur)
    size = 4 * window
    padded = np.zeros((size, size))
    padded[: len(psf), : len(psf)] = psf
    sharp = textures(slope, size, 150)
    blurred = np.fft.irfft2(np.fft.rfft2(sharp) * np.fft.rfft2(padded), (size, size))
    mean = np.mean([spectra(basis, g.astype(np.float32), window)[0] for g in blurred], (0, 1, 2))
    expected = basis.expected_power(psf, slope)
    counts = basis.multiplicity > 0
    ratio = mean[counts] / expected[counts]
    assert np.median(ratio) == pytest.approx(1, abs=0.03)
    assert np.quantile(np.abs(ratio - 1), 0.9) < 0.15


def test_prior_has_unit_variance():
    for shape in ((64, 64), (48, 90)):
        power = power_spectrum(2.4, shape)
        assert np.fft.irfft2(power, shape)[0, 0] == pytest.approx(1)


def test_small_image_and_odd_window_are_refused():
    with pytest.raises(InputError, match=r"40x20 px is smaller than the bank's 24 px window"):
        spectra(WindowedFourierBasis(24), np.zeros((20, 40), np.float32), 8)
    with pytest.raises(InputError, match="even number"):
        WindowedFourierBasis(25)
