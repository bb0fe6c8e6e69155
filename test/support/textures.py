"""Textures with a known spectrum."""

import numpy as np

from coded_aperture_ros.likelihood.bank import power_spectrum


def natural_texture(shape, seed=0, contrast=0.01):
    """Natural texture of some variance around 0.4."""
    random = np.random.default_rng(seed)
    rows, columns = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    frequency = np.hypot(rows, columns)
    frequency[0, 0] = np.inf
    texture = np.fft.irfft2(np.fft.rfft2(random.normal(size=shape)) * frequency**-1.2, shape)
    return (0.4 + texture * np.sqrt(contrast) / texture.std()).astype(np.float32)


def blurred_texture(psf, contrast=0.02, slope=2.4, size=128, noise=0.002, seed=0):
    """A texture from the prior, blurred by circular convolution, with noise."""
    random = np.random.default_rng(seed)
    shape = (size, size)
    spectrum = np.fft.rfft2(random.normal(size=shape))
    spectrum *= np.sqrt(contrast * power_spectrum(slope, shape))
    padded = np.zeros(shape)
    padded[: len(psf), : len(psf)] = psf
    blurred = np.fft.irfft2(spectrum * np.fft.rfft2(padded), shape)
    return (0.4 + blurred + random.normal(0, noise, shape)).astype(np.float32)
