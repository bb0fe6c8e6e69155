"""Small planes of an unknown mask, for the tests of finding it."""

import numpy as np
from planes_scene import texture
from scipy.signal import fftconvolve

from coded_aperture_ros.calibration.blind.config import BlindConfig
from coded_aperture_ros.optics import Mask, render_psf

MASK = Mask.from_rows(["#..##", "##...", ".#.##", "....#", "###.#"])
SIZES_PX = np.array([9.0, 5.0, 12.0, 7.5, 6.0, 10.5])
NOISE = 0.001
CONFIG = BlindConfig(largest_blur_px=14, least_cells=4, most_cells=6)


def plane(size_px, seed, mask=MASK, side=208, noise=NOISE):
    """Photograph of a plane of its own texture, in 256 steps."""
    random = np.random.default_rng(500 + seed)
    sharp = texture(np.random.default_rng(seed), side)
    if size_px:
        sharp = fftconvolve(sharp, render_psf(mask, size_px), "same")
    image = 0.45 + 0.07 * sharp[:side, :side] + random.normal(0, noise, (side, side))
    return (np.rint(255 * np.clip(image, 0, 1)) / 255).astype(np.float32)


def planes(sizes_px=SIZES_PX, mask=MASK):
    return [plane(size, seed, mask) for seed, size in enumerate(sizes_px)]


def names(count=6):
    return [f"{number}.png" for number in range(count)]
