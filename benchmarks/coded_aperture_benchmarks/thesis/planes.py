"""Planes at known blur sizes, one in every frame, as in thesis 5.3.1."""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from coded_aperture_benchmarks.thesis.stair import (
    blur_stack,
    check_frame_options,
    crops_generator,
    with_noise,
)
from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.optics import Mask

LEVELS = 33
SIGMA = 0.0001
# Table 5.1: mean error of the thesis, for random texture and SIGMA. Levels are its unit: methods
# that guess have 11 (evenly) to 17 (at an end of 33).
TABLE_5_1 = {
    "lucy_richardson": {"two_hole": 14.2, "three_hole": 15.4, "four_hole": 13.9},
    "regularized": {"two_hole": 11.9, "three_hole": 14.9, "four_hole": 13.9},
    "wiener": {"two_hole": 17.0, "three_hole": 17.0, "four_hole": 15.1},
    "gaussian": {"two_hole": 12.1, "three_hole": 15.2, "four_hole": 13.7},
    "levin": {"two_hole": 13.9, "three_hole": 15.2, "four_hole": 13.7},
    "two_pixel": {"two_hole": 8.7, "three_hole": 9.3, "four_hole": 8.7},
    "conditional": {"two_hole": 8.7, "three_hole": 9.3, "four_hole": 8.7},
}


@dataclasses.dataclass(frozen=True, eq=False)
class Planes:
    """Coded frames of fronto-parallel planes, one for every level.

    Attributes
    ----------
    coded : ndarray, float32 [levels, side, side]
        With noise. Nothing in them is occluded.
    noise : float
        Standard deviation of the noise that was added.
    """

    coded: NDArray[np.float32]
    noise: float


def make_planes(
    mask: Mask,
    textures: Textures,
    sigma: float = SIGMA,
    seed: int = 0,
    levels: int = LEVELS,
    side_px: int = 160,
) -> Planes:
    """Blur a crop of its own for every level, from 7 to 30 px.

    Parameters
    ----------
    sigma : float, optional
        Noise (standard deviation) behind an open aperture; divided by the mask's open fraction.
    seed : int, optional
        The same seed gives the same crops for every mask.
    levels, side_px : int, optional
        Number of planes, and their side.
    """
    check_frame_options(sigma, side_px, "plane")
    stack = blur_stack(mask, levels)
    whole = side_px + stack.psfs.shape[-1] - 1
    crops = textures.crops(levels, whole, whole, crops_generator(seed))
    coded = np.stack(
        [fftconvolve(crop, psf, mode="valid") for crop, psf in zip(crops, stack.psfs, strict=True)]
    )
    return Planes(*with_noise(coded, mask, sigma, seed))
