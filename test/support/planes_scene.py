"""Synthetic planes in front of a small camera, for the tests of calibration."""

import numpy as np
from scipy.signal import fftconvolve

from coded_aperture_ros.likelihood.bank import power_spectrum
from coded_aperture_ros.optics import Mask, render_psf

WINDOW, NOISE, SIZE = 24, 0.001, 144
FOCUS_M, SLOPE_PX_M = 1.0, 11.0 / 0.75
DEPTHS_M = 1 / np.linspace(0.85, 0.25, 8)


def texture(random, size):
    """Texture that is nowhere quite a power law of one slope."""
    shape = (2 * size, 2 * size)
    texture = np.zeros(shape)
    for slope in (1.8, 2.6):
        spectrum = np.fft.rfft2(random.normal(size=shape)) * np.sqrt(power_spectrum(slope, shape))
        texture += np.fft.irfft2(spectrum, shape)
    return texture


def blur_size_px(depth_m, focus_m=FOCUS_M):
    return SLOPE_PX_M * (1 / focus_m - 1 / np.asarray(depth_m))


def plane(depth_m, seed, mask="levin", size=SIZE, focus_m=FOCUS_M, noise=NOISE, tilt_px=0.0):
    """Photograph of a plane; with a tilt, the blur grows from left to right by so many px."""
    random = np.random.default_rng(1000 + seed)
    sharp = texture(np.random.default_rng(seed), size)
    middle = float(blur_size_px(depth_m, focus_m))
    strips = 9 if tilt_px else 1
    image = np.zeros((size, size))
    columns = np.array_split(np.arange(size), strips)
    for offset, chosen in zip(np.linspace(-0.5, 0.5, strips), columns, strict=True):
        extent = middle + (offset * tilt_px if strips > 1 else 0)
        blurred = fftconvolve(sharp, render_psf(Mask.named(mask), extent), "same")
        image[:, chosen] = blurred[:size, :size][:, chosen]
    image = 0.45 + 0.07 * image
    return (image + random.normal(0, noise, image.shape)).astype(np.float32)
