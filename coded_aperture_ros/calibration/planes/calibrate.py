"""Calibration from pictures of textured planes at known depths: mask, focus, bank, and its error.

The costs of a bank need nothing of a PSF but its autocorrelation, and the PSFs of all depths are
one mask, scaled. So one mask and one focus distance are sought under which the pictures are
likeliest, by the same likelihood with which the bank will judge patches later (thesis 6.2.1
learns from planes too, but a subspace for each of them on its own).

The likelihood of a single mask has many local maxima, because power spectra have no phases. A
mixture of a few masks, whose autocorrelations add up, has the same power spectra to offer and is
easy to optimise. The bank is computed from the mixture. Only for deblurring, a single mask of that
autocorrelation is sought afterwards; power spectra do not tell its orientation (as found or turned
by 180 degrees).

A picture that cannot be used is an error with its name; possible improvements are advice.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from coded_aperture_ros.calibration.mask.recognition import fit_extent, recognise_mask
from coded_aperture_ros.calibration.planes.checks import (
    Advice,
    PlaneCheck,
    advice_on_depths,
    advice_on_pictures,
    check_pictures,
)
from coded_aperture_ros.calibration.planes.fit import LeaveOneOut, fit_signed_lens, leave_one_out
from coded_aperture_ros.calibration.planes.measure import MeasuredPlane, measure_planes
from coded_aperture_ros.calibration.planes.order import exchange_gains, refuse_exchanged
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.calibration.planes.search import LensFit, MaskSearch, learned_pattern
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.bank import (
    DEFAULT_LEVEL_COUNT,
    FilterBank,
    LearnConfig,
    LearnedPattern,
    NaturalImagePrior,
    learn_bank_for_pattern,
)
from coded_aperture_ros.likelihood.bank.model import check_level_count
from coded_aperture_ros.optics import MASK_NAMES, Mask

# A bank may go this far beyond the planes, as a share of their range of blur sizes.
_EXTRAPOLATION = 0.15
_NEAR_FOCUS_PX = 1.5


@dataclasses.dataclass(frozen=True, eq=False)
class PlanesCalibration:
    """Calibration of a camera from planes.

    `pattern` is mask and thin lens. The mask is known if it is one with a name, or the camera
    file's; else it was found from the pictures, and its extent is uncertain by a cell. `left_out`
    has the depth of each plane by the others.
    """

    bank: FilterBank
    pattern: LearnedPattern
    mask_is_known: bool
    planes: Planes
    checks: list[PlaneCheck]
    measured: list[MeasuredPlane]
    left_out: LeaveOneOut
    advice: list[Advice]

    @property
    def residual_px(self) -> float:
        """Root mean square difference of measured blur sizes from the line, px."""
        fitted = np.abs(self.pattern.blur_size_px(self.planes.depths_m))
        sizes = np.array([plane.size_px for plane in self.measured])
        return float(np.sqrt(np.mean((sizes - fitted) ** 2)))


def calibrate_planes(
    planes: Planes,
    level_count: int = 40,
    config: LearnConfig | None = None,
    depth_range_m: tuple[float, float] | None = None,
    mask: Mask | None = None,
    progress: Progress = iter,
) -> PlanesCalibration:
    """Bank, focus and blur slope from planes, with their expected error.

    Parameters
    ----------
    planes : Planes
    level_count : int, optional
        Levels of the bank.
    config : LearnConfig, optional
        Its window has to be twice as wide as the largest blur; 0 is 48 px here, as the blur is not
        known before.
    depth_range_m : (float, float), optional
        Depths of the first and last level, m; by default those of the planes.
    mask : Mask, optional
        The mask in the lens, if it is known. Otherwise the masks with names are tried, and if none
        is clearly it, the mask is found from the pictures.
    progress : callable, optional
        Wraps the iteration over the steps of the search, as ``tqdm.tqdm`` does.

    Returns
    -------
    PlanesCalibration

    Raises
    ------
    InputError
        With the picture and what to do: no texture, wrong or exchanged depths, planes on both sides
        of the focus, a depth range far beyond the planes.

    References
    ----------
    Martinello 2012, section 6.2.1.

    Examples
    --------
    >>> from coded_aperture_ros.calibration.planes.folder import load_planes
    >>> found = calibrate_planes(load_planes(["planes/"]))  # doctest: +SKIP
    >>> found.pattern.focus_distance_m  # doctest: +SKIP
    """
    config = (config or LearnConfig()).for_blur()
    checks = check_pictures(planes.images, planes.names, config.window_px, planes.depths_m)
    search = MaskSearch(planes, config.window_px, progress)
    mixture = search.mixture()
    width = planes.images[0].shape[1]
    # The mixture's own grid serves to measure; what the mask is comes after the depths are right.
    part = Mask("mixture", mixture.parts[0] / mixture.parts[0].max())
    grid = learned_pattern(mixture, part, mixture.sizes.extent_px, width)
    measured = measure_planes(planes, grid, config)
    fit = fit_signed_lens(planes, measured)
    refuse_exchanged(planes, exchange_gains(search, mixture))
    found_mask, extent_px, known = _mask(search, mixture, mask)
    scale = extent_px / mixture.sizes.extent_px
    measured = [plane.scaled(scale) for plane in measured]
    pattern = dataclasses.replace(
        learned_pattern(mixture, found_mask, extent_px, width),
        slope_px_m=fit.slope_px_m * scale,
        inverse_focus=fit.inverse_focus,
    )
    wanted = depth_range_m or _depth_range(planes)
    _check_range(planes, pattern, wanted)
    learned_from = _learned_from(planes, pattern)
    bank = learn_bank_for_pattern(pattern, *wanted, level_count, config, learned_from=learned_from)
    return PlanesCalibration(
        bank=_of_size(bank, planes),
        pattern=pattern,
        mask_is_known=known,
        planes=planes,
        checks=checks,
        measured=measured,
        left_out=leave_one_out(planes, measured, pattern),
        advice=[
            *advice_on_pictures(checks),
            *advice_on_depths(planes.depths_m, depth_range_m),
            *_advice_on_blur(planes, pattern, measured),
        ],
    )


def learn_bank_from_planes(
    planes: Planes,
    level_count: int = DEFAULT_LEVEL_COUNT,
    config: LearnConfig | None = None,
    prior: NaturalImagePrior | None = None,
    progress: Progress = iter,
) -> FilterBank:
    """Bank from planes, for a mask that is none of those with names.

    Parameters
    ----------
    planes : Planes
    level_count, config, progress
        See `calibrate_planes`.
    prior : NaturalImagePrior, optional
        Prior of the bank; the fit has a more flexible one.

    Returns
    -------
    FilterBank
        With the depths of the planes, which hold beside a camera file. Its PSFs are those of one
        mask that has about the autocorrelation found; their orientation is a guess. Blur sizes are
        the extent of that mask in px. A warning is logged if the window seems to be too small.

    Raises
    ------
    InputError
        If a plane has no texture above its noise, or is smaller than the window, or if neighbours
        seem to be swapped.

    Examples
    --------
    >>> from coded_aperture_ros.calibration.planes.folder import load_planes
    >>> bank = learn_bank_from_planes(load_planes(["planes/"]))  # doctest: +SKIP
    """
    check_level_count(level_count)
    config = (config or LearnConfig()).for_blur()
    check_pictures(planes.images, planes.names, config.window_px)
    search = MaskSearch(planes, config.window_px, progress)
    mixture = search.mixture()
    refuse_exchanged(planes, exchange_gains(search, mixture))
    pattern = learned_pattern(mixture, *search.single(mixture), planes.images[0].shape[1])
    wanted = _depth_range(planes)
    learned_from = _learned_from(planes, pattern)
    bank = learn_bank_for_pattern(pattern, *wanted, level_count, config, prior, learned_from)
    return _of_size(bank, planes)


def _of_size(bank: FilterBank, planes: Planes) -> FilterBank:
    height, width = planes.images[0].shape[:2]
    return dataclasses.replace(bank, image_width=width, image_height=height)


def _depth_range(planes: Planes) -> tuple[float, float]:
    return float(planes.depths_m[0]), float(planes.depths_m[-1])


def _learned_from(planes: Planes, pattern: LearnedPattern) -> str:
    near_m, far_m = _depth_range(planes)
    return (
        f"{len(planes.names)} planes at {near_m:g} to {far_m:g} m, "
        f"focus found at {pattern.focus_distance_m:.3g} m"
    )


def _mask(search: MaskSearch, mixture: LensFit, mask: Mask | None) -> tuple[Mask, float, bool]:
    """Mask, its extent at the most blurred plane, and whether it is a known one."""
    if mask is not None:
        return mask, fit_extent(search.likelihood, mixture, mask)[0], True
    known = recognise_mask(search.likelihood, mixture, [Mask.named(name) for name in MASK_NAMES])
    if known is not None:
        return *known, True
    return *search.single(mixture), False


def _check_range(planes: Planes, pattern: LearnedPattern, wanted: tuple[float, float]) -> None:
    ends = pattern.blur_range_px(*wanted)
    have = pattern.blur_size_px(planes.depths_m[[0, -1]])
    beyond = _EXTRAPOLATION * float(np.ptp(have))
    if ends[0] < have[0] - beyond or ends[1] > have[1] + beyond:
        raise InputError(
            f"depth range {wanted[0]:g} to {wanted[1]:g} m goes far beyond the planes, "
            f"{planes.depths_m[0]:g} to {planes.depths_m[-1]:g} m: add planes there, or narrow it"
        )


def _advice_on_blur(
    planes: Planes, pattern: LearnedPattern, measured: Sequence[MeasuredPlane]
) -> list[Advice]:
    advice = []
    for name, depth_m, plane in zip(planes.names, planes.depths_m, measured, strict=True):
        if plane.size_px < _NEAR_FOCUS_PX:
            text = f"blur of {plane.size_px:.1f} px is too little: move it from the focus"
            advice.append(Advice(name, text))
        if plane.is_tilted:
            advice.append(Advice(name, _tilt_text(pattern, float(depth_m), plane)))
    return advice


def _tilt_text(pattern: LearnedPattern, depth_m: float, plane: MeasuredPlane) -> str:
    across, down = plane.tilt_px
    px, more, less = max(
        (abs(across), *(("right", "left") if across > 0 else ("left", "right"))),
        (abs(down), *(("bottom", "top") if down > 0 else ("top", "bottom"))),
    )
    # Beyond the focus what is blurred more is farther, in front of it nearer.
    beyond = pattern.blur_size_px(depth_m) > 0
    farther, nearer = (more, less) if beyond else (less, more)
    metres = px / pattern.slope_px_m * depth_m**2
    return (
        f"tilted: blur differs by {px:.1f} px from {less} to {more}, as if its {farther} were "
        f"{metres:.2g} m farther than its {nearer}: set it parallel to the sensor"
    )
