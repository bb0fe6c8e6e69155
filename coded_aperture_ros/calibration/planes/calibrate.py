"""Calibration from pictures of textured planes at known depths: mask, focus, bank, and its error.

Everything that can be told about the pictures is told: what is wrong with one is an error that
names it, what could be better is advice.
"""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from coded_aperture_ros.bank import FilterBank, LearnConfig, LearnedPattern
from coded_aperture_ros.calibration.mask.recognition import fitted_extent, recognised_mask
from coded_aperture_ros.calibration.mask.search import MaskSearch
from coded_aperture_ros.calibration.planes.checks import (
    Advice,
    PlaneCheck,
    advice_on_depths,
    advice_on_pictures,
    check_planes,
)
from coded_aperture_ros.calibration.planes.fit import (
    LeftOut,
    MeasuredPlane,
    ThinLensFit,
    leave_one_out,
    measured_planes,
    signed_fit,
)
from coded_aperture_ros.calibration.planes.learning import (
    learn_bank_for_pattern,
    learned_from_planes,
)
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import MASK_NAMES, Mask

# A bank may go this far beyond the planes, as a share of their range of blur sizes.
_EXTRAPOLATION = 0.15
_NEAR_FOCUS_PX = 1.5


@dataclasses.dataclass(frozen=True, eq=False)
class PlanesCalibration:
    """What a set of planes tells about a camera.

    Attributes
    ----------
    bank : FilterBank
    pattern : LearnedPattern
        Mask and thin lens.
    mask_is_known : bool
        Whether the mask is one with a name, or the camera file's; else it was found from the
        pictures, and its extent is uncertain by a cell.
    planes : Planes
    checks : list of PlaneCheck
    measured : list of MeasuredPlane
    left_out : LeftOut
        Depths that the other planes give each plane.
    advice : list of Advice
    """

    bank: FilterBank
    pattern: LearnedPattern
    mask_is_known: bool
    planes: Planes
    checks: list[PlaneCheck]
    measured: list[MeasuredPlane]
    left_out: LeftOut
    advice: list[Advice]

    @property
    def residual_px(self) -> float:
        """Root mean square difference of measured blur sizes from the line."""
        fitted = np.abs(self.pattern.blur_size_px(self.planes.depths_m))
        sizes = np.array([plane.size_px for plane in self.measured])
        return float(np.sqrt(np.mean((sizes - fitted) ** 2)))


def calibrate_planes(
    planes: Planes,
    levels: int = 40,
    config: LearnConfig | None = None,
    depth_range_m: tuple[float, float] | None = None,
    mask: Mask | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> PlanesCalibration:
    """Learn a bank from planes, with focus and blur slope, and say how good it will be.

    Parameters
    ----------
    planes : Planes
    levels : int, optional
        Of the bank.
    config : LearnConfig, optional
        Its window has to be twice as wide as the largest blur.
    depth_range_m : (float, float), optional
        Depths of the first and last level; by default those of the planes.
    mask : Mask, optional
        What is in the lens, if it is known. Otherwise the masks with names are tried, and if none
        is clearly it, the mask is found from the pictures.
    progress : callable, optional
        Wraps the iteration over the steps of the search, as ``tqdm.tqdm`` does.

    Raises
    ------
    InputError
        Naming the picture and what to do: no texture, wrong depths, planes on both sides of the
        focus, a depth range far beyond the planes.
    """
    config = config or LearnConfig()
    checks = check_planes(planes, config.window_px)
    search = MaskSearch(planes, config.window_px, progress)
    mixture = search.mixture()
    width = planes.images[0].shape[1]
    # The mixture's own grid serves to measure; what the mask is comes after the depths are right.
    part = Mask("mixture", mixture.parts[0] / mixture.parts[0].max())
    grid = LearnedPattern.of_fit(mixture, part, mixture.extent_px, width)
    measured = measured_planes(planes, grid, config)
    fit = signed_fit(planes, measured)
    found_mask, extent_px, known = _mask(search, mixture, mask)
    scale = extent_px / mixture.extent_px
    measured = [_scaled(plane, scale) for plane in measured]
    pattern = dataclasses.replace(
        LearnedPattern.of_fit(mixture, found_mask, extent_px, width),
        slope_px_m=fit.slope_px_m * scale,
        inverse_focus=fit.inverse_focus,
    )
    wanted = depth_range_m or (float(planes.depths_m[0]), float(planes.depths_m[-1]))
    _check_range(planes, pattern, wanted)
    bank = learn_bank_for_pattern(
        pattern, *wanted, levels, config, learned_from=learned_from_planes(planes, pattern)
    )
    return PlanesCalibration(
        bank=bank,
        pattern=pattern,
        mask_is_known=known,
        planes=planes,
        checks=checks,
        measured=measured,
        left_out=leave_one_out(
            planes, measured, ThinLensFit(pattern.slope_px_m, pattern.inverse_focus)
        ),
        advice=[
            *advice_on_pictures(checks),
            *advice_on_depths(planes.depths_m, depth_range_m),
            *_advice_on_blur(planes, pattern, measured),
        ],
    )


def _mask(search: MaskSearch, mixture: Any, mask: Mask | None) -> tuple[Mask, float, bool]:
    """Return the mask, its extent at the most blurred plane, and whether it is a known one."""
    if mask is not None:
        return mask, fitted_extent(search.likelihood, mixture, mask)[0], True
    known = recognised_mask(search.likelihood, mixture, [Mask.named(name) for name in MASK_NAMES])
    if known is not None:
        return *known, True
    return *search.single(mixture), False


def _scaled(plane: MeasuredPlane, scale: float) -> MeasuredPlane:
    return MeasuredPlane(
        size_px=plane.size_px * scale,
        sizes_px=plane.sizes_px * np.float32(scale),
        error_px=plane.error_px * scale,
        tilt_px=(plane.tilt_px[0] * scale, plane.tilt_px[1] * scale),
        tilt_error_px=plane.tilt_error_px * scale,
    )


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
