"""A textured square before a textured background."""

import numpy as np
from scipy import ndimage


def fine_texture(seed, shape):
    """Fine texture that has no period, in [0.2, 0.8]."""
    smooth = ndimage.gaussian_filter(np.random.default_rng(seed).random(shape), 1.2)
    return np.interp(smooth, (smooth.min(), smooth.max()), (0.2, 0.8)).astype(np.float32)


def red_square(shape, inside, near_px, far_px):
    """A red square before a blue background, and their blur sizes; `inside` says where it is."""
    sharp = np.zeros((*shape, 3), np.float32)
    sharp[..., 2] = fine_texture(1, shape)
    blur = np.full(shape, far_px, np.float32)
    sharp[inside], blur[inside] = 0, near_px
    sharp[(*inside, 0)] = fine_texture(2, shape)[inside]
    return sharp, blur
