"""Expected spectra of blurred texture, of thousands of masks by one matrix product.

The power spectrum of a PSF is linear in the autocorrelation of the mask's grid, and so is what a
window sees of blurred texture. For grids of one size the spectra of all levels are therefore the
product of the autocorrelations with a matrix that is computed once.
"""

import dataclasses
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.optics import Mask, render_psf

WINDOW_PX = 64
_TORUS_PX = 2 * WINDOW_PX
# A Hann window spreads each frequency over little more than two cycles per window to each side.
_REACH = 4
_HIGHEST = 0.45
# Of the Gaussian that resembles an Airy disc, as a share of the radius of its first dark ring.
_AIRY_TO_SIGMA = 0.345
_DIRECTIONS = 16


@dataclasses.dataclass(frozen=True)
class SceneConfig:
    """Blur sizes that a mask has to distinguish, texture, diffraction and motion."""

    levels: int = option(
        30, "Blur levels, equally spaced between the smallest and the largest.", minimum=2
    )
    smallest_px: float = option(7.0, "Smallest blur size.", unit="px", within=(0.5, 60))
    largest_px: float = option(30.0, "Largest blur size.", unit="px", within=(1.0, 60))
    slope: float = option(2.4, "Fall-off of the texture's power with frequency.", within=(0.5, 4.0))
    diffraction_px: float = option(
        0.0,
        "Radius of the Airy disc of an opening as wide as the mask, in the picture; narrower "
        "openings have a larger one. 0: no diffraction.",
        unit="px",
        within=(0.0, 5.0),
    )
    motion_px: float = option(
        0.0,
        "Length of motion blur in an unknown direction. 0: nothing moves.",
        unit="px",
        within=(0.0, 60.0),
    )

    def __post_init__(self) -> None:
        check_options(self)
        if not self.smallest_px < self.largest_px:
            raise InputError(
                f"smallest_px: expected less than largest_px, got {self.smallest_px:g} and "
                f"{self.largest_px:g}"
            )

    @cached_property
    def blur_sizes_px(self) -> DoubleArray:
        """Blur size of every level, px [levels]."""
        return np.linspace(self.smallest_px, self.largest_px, self.levels)


@dataclasses.dataclass(frozen=True)
class Frequencies:
    """K frequencies: every second one of a window, half of the plane.

    `vertical` and `horizontal` are whole cycles per window.
    """

    vertical: IndexArray
    horizontal: IndexArray

    @staticmethod
    def from_window() -> "Frequencies":
        """Frequencies of a Hann window of `WINDOW_PX`; neighbours share their information."""
        half = WINDOW_PX // 2
        vertical, horizontal = np.meshgrid(
            np.arange(-half + 2, half + 1, 2), np.arange(0, half + 1, 2), indexing="ij"
        )
        keep = (np.maximum(np.abs(vertical), horizontal) > 1) & ((horizontal > 0) | (vertical >= 0))
        # Blur has removed most of the texture above.
        keep &= np.hypot(vertical, horizontal) <= _HIGHEST * WINDOW_PX
        return Frequencies(vertical[keep], horizontal[keep])

    @property
    def radius(self) -> DoubleArray:
        """Cycles per pixel [K]."""
        return np.hypot(self.vertical, self.horizontal) / WINDOW_PX


def autocorrelations(grids: NDArray[np.floating]) -> FloatArray:
    """Autocorrelations [B, (2 n - 1) n] of masks [B, n, n], for light of one in all.

    Lags go down (-n+1 to n-1) and right (0 to n-1); those to the left count with their mirror
    images. Each mask has to let some light through.
    """
    n = grids.shape[-1]
    transfer = scipy.fft.rfft2(grids.astype(np.float32), (2 * n, 2 * n))
    lags = scipy.fft.irfft2(transfer.real**2 + transfer.imag**2, (2 * n, 2 * n))
    lags = np.roll(lags, n - 1, axis=1)[:, : 2 * n - 1, :n]
    lags[:, :, 1:] *= 2
    light = grids.sum(axis=(1, 2), dtype=np.float64)
    return (lags.reshape(len(grids), -1) / light[:, None] ** 2).astype(np.float32)


def lag_matrix(cells: int, scene: SceneConfig, frequencies: Frequencies) -> FloatArray:
    """Matrix [(2 n - 1) n, levels * K] from autocorrelations to expected spectra.

    For texture of unit variance, as `expected_spectra`; aliasing of the sensor is left out.
    """
    offsets = np.arange(-_REACH, _REACH + 1)
    leakage = _window_power()[offsets]
    vertical = (2 * frequencies.vertical[:, None] + offsets) / _TORUS_PX  # [K, Q]
    horizontal = (2 * frequencies.horizontal[:, None] + offsets) / _TORUS_PX
    radius = np.hypot(vertical[:, :, None], horizontal[:, None, :])
    texture = _texture(np.maximum(radius, 1 / _TORUS_PX), scene)
    texture *= (leakage * np.sinc(vertical) ** 2)[:, :, None]
    texture *= (leakage * np.sinc(horizontal) ** 2)[:, None, :]
    down = np.arange(-cells + 1, cells)
    right = np.arange(cells)
    rows = []
    for size in scene.blur_sizes_px:
        cell = size / cells
        cell_transform = (
            np.sinc(vertical * cell)[:, :, None] * np.sinc(horizontal * cell)[:, None, :]
        )
        rightward = np.exp(2j * np.pi * cell * horizontal[:, :, None] * right)
        downward = np.exp(2j * np.pi * cell * vertical[:, None, :] * down[:, None])
        rows.append((downward @ ((texture * cell_transform**2) @ rightward)).real)
    return np.array(rows).reshape(-1, len(down) * cells).T.astype(np.float32)


def expected_spectra(mask: Mask, scene: SceneConfig, frequencies: Frequencies) -> FloatArray:
    """Spectra that a window is expected to see, of any mask [levels, K].

    For texture of unit variance before the blur.
    """
    torus = (_TORUS_PX, _TORUS_PX)
    vertical = np.fft.fftfreq(_TORUS_PX)[:, None]
    radius = np.hypot(vertical, np.fft.rfftfreq(_TORUS_PX))
    texture = _texture(np.maximum(radius, 1 / _TORUS_PX), scene).astype(np.float32)
    overlap = scipy.fft.irfft(_window_power()[: WINDOW_PX + 1] * _TORUS_PX, _TORUS_PX)
    window = (overlap[:, None] * overlap).astype(np.float32)
    psfs = [render_psf(mask, size) for size in scene.blur_sizes_px]
    transfer = np.stack([scipy.fft.rfft2(psf, torus) for psf in psfs])
    spectra = seen_spectra(texture, transfer.real**2 + transfer.imag**2, window)
    taken = spectra[:, 2 * frequencies.vertical, 2 * frequencies.horizontal]
    return np.maximum(taken, 0).astype(np.float32)


def seen_spectra(texture: FloatArray, gain: FloatArray, overlap: FloatArray) -> FloatArray:
    """Spectra of texture behind PSFs, as windows with this autocorrelation see them.

    `texture` and `gain` are powers as by ``rfft2``, [rows, columns] and [L, rows, columns], of a
    torus that is as large as `overlap`.
    """
    covariance = scipy.fft.irfft2(texture * gain, overlap.shape)
    return np.asarray(scipy.fft.rfft2(covariance * overlap).real)


def diffraction_loss(
    smallest_opening: NDArray[np.floating], scene: SceneConfig, frequencies: Frequencies
) -> FloatArray:
    """Share of the power that is left after diffraction [B, K].

    `smallest_opening` is the width of each mask's narrowest opening as a share of the mask's. Its
    diffraction counts for all of the mask, which errs on the dark side.
    """
    sigma = _AIRY_TO_SIGMA * scene.diffraction_px / smallest_opening[:, None]
    loss: FloatArray = np.exp(-((2 * np.pi * sigma * frequencies.radius) ** 2))
    return loss.astype(np.float32)


def _window_power() -> DoubleArray:
    """Power of the window at every frequency of the torus, of unit sum [torus]."""
    window = WindowedFourierBasis(WINDOW_PX).window.astype(np.float64)
    power = np.abs(np.fft.fft(window, _TORUS_PX)) ** 2
    return power / power.sum()


def _texture(radius: DoubleArray, scene: SceneConfig) -> DoubleArray:
    """Power of texture of unit variance, blurred by motion."""
    frequency = np.fft.fftfreq(_TORUS_PX)
    everywhere = np.hypot(frequency[:, None], frequency)
    everywhere[0, 0] = 1 / _TORUS_PX
    power = radius**-scene.slope / np.mean(everywhere**-scene.slope)
    if scene.motion_px > 0:
        along = np.cos(np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS)
        power *= np.mean(np.sinc(radius[..., None] * scene.motion_px * along) ** 2, axis=-1)
    return power
