"""Learning a filter bank from pictures of textured planes, without knowing the mask.

The energies of a bank need nothing of a PSF but its autocorrelation, and the PSFs of all depths
are one mask, scaled. So one mask and one focus distance are sought under which the pictures are
likeliest, by the same likelihood with which the bank will judge patches later (thesis 6.2.1
learns from planes too, but a subspace for each of them on its own).

The likelihood of a single mask has many local maxima, because power spectra have no phases. A
mixture of a few masks, whose autocorrelations add up, has the same power spectra to offer and is
easy to climb. The bank is computed from the mixture. Only for deblurring, a single mask of that
autocorrelation is sought afterwards; its orientation (as found or rotated by 180 degrees) is
beyond what power spectra tell.
"""

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from coded_aperture_ros.bank.learning import (
    DEFAULT_LEVEL_COUNT,
    LearnConfig,
    check_levels,
    learn_bank,
)
from coded_aperture_ros.bank.model import FilterBank
from coded_aperture_ros.bank.pattern import LearnedPattern
from coded_aperture_ros.bank.prior import NaturalImagePrior
from coded_aperture_ros.calibration.mask.search import MaskSearch
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.optics import render_psf_stack


def learn_bank_from_planes(
    planes: Planes,
    levels: int = DEFAULT_LEVEL_COUNT,
    config: LearnConfig | None = None,
    prior: NaturalImagePrior | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> FilterBank:
    """Learn the bank of a camera whose mask is not known from pictures of planes.

    Parameters
    ----------
    planes : Planes
        All on one side of the focal plane, with texture everywhere; ten or more that are equally
        spaced in inverse depth are better than a few.
    levels : int, optional
        Number of levels, equally spaced in blur size between the nearest and the farthest plane;
        at least 2.
    config : LearnConfig, optional
        The window has to be twice as wide as the largest blur; a warning is logged if it seems
        not to be.
    prior : NaturalImagePrior, optional
        For the bank; the fit has a more flexible one.
    progress : callable, optional
        Wraps the iteration over the steps of the fit, as ``tqdm.tqdm`` does.

    Returns
    -------
    FilterBank
        With depths. Its PSFs are those of one mask that has about the autocorrelation found;
        their orientation is a guess. Blur sizes are the extent of that mask in px. Beside a
        camera file, the bank's own depths hold.

    Raises
    ------
    InputError
        If a plane has no texture above its noise, or is smaller than the window.
    """
    check_levels(levels)
    config = config or LearnConfig()
    search = MaskSearch(planes, config.window_px, progress)
    mixture = search.mixture()
    mask, extent_px = search.single(mixture)
    pattern = LearnedPattern.of_fit(mixture, mask, extent_px, planes.images[0].shape[1])
    near_m, far_m = planes.depths_m[[0, -1]]
    return learn_bank_for_pattern(
        pattern, near_m, far_m, levels, config, prior, learned_from_planes(planes, pattern)
    )


def learned_from_planes(planes: Planes, pattern: LearnedPattern) -> str:
    """Say in a few words which planes a bank comes from."""
    return (
        f"{len(planes.names)} planes at {planes.depths_m[0]:g} to {planes.depths_m[-1]:g} m, "
        f"focus found at {pattern.focus_distance_m:.3g} m"
    )


def learn_bank_for_pattern(
    pattern: LearnedPattern,
    near_m: float,
    far_m: float,
    levels: int = DEFAULT_LEVEL_COUNT,
    config: LearnConfig | None = None,
    prior: NaturalImagePrior | None = None,
    learned_from: str = "planes",
) -> FilterBank:
    """Learn the bank of a mask that is known from planes, for a depth range.

    Parameters
    ----------
    pattern : LearnedPattern
    near_m, far_m : float
        Depths of the first and of the last level, metres.
    levels : int, optional
        Number of levels, equally spaced in blur size; at least 2.
    config, prior, learned_from
        See `learn_bank`.

    Returns
    -------
    FilterBank
        With depths, which hold whatever a camera file says.

    Raises
    ------
    InputError
        If the focus lies within the range, there are fewer than two levels, or a blur size does
        not fit the window.
    """
    check_levels(levels)
    sizes_px = np.linspace(*pattern.blur_range_px(near_m, far_m), levels)
    stack = render_psf_stack(pattern.mask, sizes_px)
    bank = learn_bank(
        dataclasses.replace(stack, depths_m=pattern.depth_m(sizes_px)),
        config,
        prior,
        learned_from=learned_from,
        components=pattern.components(sizes_px),
    )
    return dataclasses.replace(bank, pattern=pattern)
