"""The blur size of every plane, measured by itself, and the thin lens that fits them.

The search for the mask takes for granted that the blur sizes lie on the line of a thin lens
(thesis eq. 3.28). Here each plane is measured without that, so that a wrong depth, planes on both
sides of the focus or a tilted plane show.
"""

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank import LearnConfig, LearnedPattern, learn_bank
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.levels import refine_level
from coded_aperture_ros.imaging.noise import estimate_noise, high_power
from coded_aperture_ros.optics import render_psf_stack

# Blur sizes to choose from: beyond those of all planes on either side.
_SIZES, _BEYOND, _SMALLEST_PX = 48, 1.2, 0.5
# Whole sizes are this uncertain even on the best of planes; sharp planes are worse.
_LEAST_ERROR_PX = 0.1
# What lies farther from the line than this has another depth than it was said to have.
_OUTLIER_PX, _OUTLIER_SHARE = 1.0, 0.08
_ITERATIONS = 20
# A tilt is told if it is this sure, and so large.
_SURE, _TILT_PX = 4.0, 0.6


@dataclasses.dataclass(frozen=True, eq=False)
class MeasuredPlane:
    """The blur of one plane, without regard to its depth.

    Attributes
    ----------
    size_px : float
        Unsigned blur size of the mask, from all windows together.
    sizes_px : ndarray, float32 [rows, columns]
        That of every window.
    error_px : float
        Standard error of `size_px`, from the scatter of the windows.
    tilt_px : (float, float)
        How much more the blur is at the right end than at the left, and at the bottom than at the
        top.
    tilt_error_px : float
        Standard error of these.
    """

    size_px: float
    sizes_px: NDArray[np.float32]
    error_px: float
    tilt_px: tuple[float, float]
    tilt_error_px: float

    @property
    def is_tilted(self) -> bool:
        """Whether the blur surely varies over the field."""
        tilt = float(np.hypot(*self.tilt_px))
        return tilt > max(_SURE * self.tilt_error_px, _TILT_PX)


def measured_planes(
    planes: Planes, pattern: LearnedPattern, config: LearnConfig
) -> list[MeasuredPlane]:
    """Measure the blur of every plane with filters for many sizes of the same mask.

    Parameters
    ----------
    planes : Planes
    pattern : LearnedPattern
        Only its mask is used, and how large it gets at most.
    config : LearnConfig
        Of the filters.
    """
    largest = _BEYOND * float(np.abs(pattern.blur_size_px(planes.depths_m)).max())
    largest = min(largest, config.window_px - 1)
    sizes_px = np.linspace(_SMALLEST_PX, largest, _SIZES)
    bank = learn_bank(
        render_psf_stack(pattern.mask, sizes_px),
        config,
        components=pattern.components(sizes_px),
    )
    measured = []
    for image in planes.images:
        grey = image if image.ndim == 2 else image.mean(axis=2, dtype=np.float32)
        grey = np.ascontiguousarray(grey, np.float32)
        frame = bank.project(grey, config.window_px // 4)
        energies = bank.energies(frame, estimate_noise(high_power(grey, frame.grid)))
        whole = energies.mean(axis=(0, 1), keepdims=True)

        def sizes_of(energies: NDArray[np.float32]) -> NDArray[np.float64]:
            levels = refine_level(energies, energies.argmin(axis=-1))
            return np.interp(levels, np.arange(_SIZES), sizes_px)

        measured.append(_measured(float(sizes_of(whole)[0, 0]), sizes_of(energies)))
    return measured


def _measured(size_px: float, sizes_px: NDArray[np.float64]) -> MeasuredPlane:
    rows, columns = sizes_px.shape
    down, right = np.meshgrid(
        np.linspace(-0.5, 0.5, rows), np.linspace(-0.5, 0.5, columns), indexing="ij"
    )
    terms = np.stack([np.ones(sizes_px.size), right.ravel(), down.ravel()], axis=1)
    values, weights = sizes_px.ravel(), np.ones(sizes_px.size)
    for _ in range(_ITERATIONS):  # least absolute deviations: a few windows may be far off
        roots = np.sqrt(weights)[:, None]
        found, *_ = np.linalg.lstsq(roots * terms, roots[:, 0] * values, rcond=None)
        deviation = np.abs(values - terms @ found)
        weights = 1 / np.maximum(deviation, 0.02)
    # Windows a quarter apart share most of their pixels: 16 of them tell about as much as four.
    scatter = 1.48 * float(np.median(deviation)) * np.sqrt(4 / sizes_px.size)
    spread = [float(np.sqrt(np.mean(direction**2))) for direction in (right, down)]
    return MeasuredPlane(
        size_px=size_px,
        sizes_px=sizes_px.astype(np.float32),
        error_px=max(scatter, _LEAST_ERROR_PX),
        tilt_px=(float(found[1]), float(found[2])),
        tilt_error_px=max(scatter, _LEAST_ERROR_PX / 2) / max(min(spread), 0.1),
    )


@dataclasses.dataclass(frozen=True)
class ThinLensFit:
    """The line ``S = slope (1 / z_focus - 1 / z)`` through measured blur sizes.

    Attributes
    ----------
    slope_px_m : float
        ``M f_px``, pixels times metres.
    inverse_focus : float
        ``1 / z_focus``, 1/m.
    """

    slope_px_m: float
    inverse_focus: float

    def blur_size_px(self, inverse_depths: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signed blur size."""
        return self.slope_px_m * (self.inverse_focus - inverse_depths)

    def inverse_depth(self, size_px: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the inverse depth of signed blur sizes."""
        return np.asarray(self.inverse_focus - size_px / self.slope_px_m, np.float64)


def fitted_lens(
    inverse_depths: NDArray[np.float64],
    sizes_px: NDArray[np.float64],
    errors_px: NDArray[np.float64],
) -> ThinLensFit:
    """Fit the line through signed blur sizes; single ones that are far off count little.

    Weighted least squares, weighted anew by Huber's function.
    """
    terms = np.stack([np.ones_like(inverse_depths), -inverse_depths], axis=1)
    trust = np.ones_like(sizes_px)
    for _ in range(_ITERATIONS):
        roots = np.sqrt(trust) / errors_px
        (offset, slope), *_ = np.linalg.lstsq(roots[:, None] * terms, roots * sizes_px, rcond=None)
        deviation = np.abs(sizes_px - terms @ [offset, slope])
        usual = max(1.48 * float(np.median(deviation)), _LEAST_ERROR_PX)
        trust = np.minimum(1, 1.5 * usual / np.maximum(deviation, 1e-9))
    if slope == 0:
        return ThinLensFit(1e-9, 0.0)
    return ThinLensFit(float(slope), float(offset / slope))


def signed_fit(planes: Planes, measured: list[MeasuredPlane]) -> ThinLensFit:
    """Fit the thin lens, and say which planes contradict it.

    Returns
    -------
    ThinLensFit
        With positive slope: all planes beyond the focus, or all in front of it.

    Raises
    ------
    InputError
        Naming the files: planes on both sides of the focus, or depths that do not belong to their
        pictures.
    """
    inverse = 1 / planes.depths_m
    sizes = np.array([plane.size_px for plane in measured])
    errors = np.array([plane.error_px for plane in measured])
    one_side = min(
        (_line(inverse, sign * sizes, errors) for sign in (1, -1)), key=lambda found: found[1]
    )
    both = _both_sides(inverse, sizes, errors)
    fit, outliers = one_side
    if outliers and both is not None and both[1] < outliers:
        crossing_m = 1 / both[0].inverse_focus
        nearer = [name for name, depth in _named(planes) if depth < crossing_m]
        raise InputError(
            f"{_list(nearer)}: in front of the focus at about {crossing_m:.3g} m, while "
            f"{len(inverse) - len(nearer)} planes lie beyond it, and blur does not tell the sides "
            "apart: take the planes of one side only, or focus before or beyond all of them"
        )
    if outliers:
        _refuse_swapped(planes, sizes, errors)
        _refuse_depths(planes, fit, sizes)
    return fit


def _line(inverse: NDArray, sizes: NDArray, errors: NDArray) -> tuple[ThinLensFit, int]:
    """Return the line with the fewest sizes off it, and how many there are.

    Tried are the lines through all pairs of planes, then the best is fitted to what agrees.
    """
    best: tuple[int, float, NDArray] | None = None
    for i, j in itertools.combinations(range(len(inverse)), 2):
        slope = (sizes[j] - sizes[i]) / (inverse[i] - inverse[j])
        if slope <= 0:
            continue
        deviation = np.abs(sizes - sizes[i] - slope * (inverse[i] - inverse))
        off = deviation > _tolerance(sizes)
        rank = (int(off.sum()), float(np.minimum(deviation, _OUTLIER_PX).sum()))
        if best is None or rank < best[:2]:
            best = (*rank, ~off)
    if best is None:  # the blur never grows
        return ThinLensFit(1e-9, 0.0), len(inverse)
    agree = best[2]
    fit = fitted_lens(inverse[agree], sizes[agree], errors[agree])
    off = np.abs(sizes - fit.blur_size_px(inverse)) > _tolerance(sizes)
    return fit, int(off.sum())


def _tolerance(sizes: NDArray) -> NDArray:
    return np.maximum(_OUTLIER_PX, _OUTLIER_SHARE * np.abs(sizes))


def _both_sides(
    inverse: NDArray, sizes: NDArray, errors: NDArray
) -> tuple[ThinLensFit, int] | None:
    """Return the best line with the focus between planes, two or more on each side."""
    found = []
    for front in range(1, len(inverse)):
        signs = np.where(np.arange(len(inverse)) < front, -1, 1)
        fit, off = _line(inverse, signs * sizes, errors)
        if inverse.min() < fit.inverse_focus < inverse.max():
            found.append((fit, off))
    return min(found, key=lambda one: one[1], default=None)


def _refuse_depths(planes: Planes, fit: ThinLensFit, sizes: NDArray) -> None:
    """Name the pictures whose blur does not suit their depths."""
    inverse = 1 / planes.depths_m
    signed = np.sign(np.median(fit.blur_size_px(inverse))) * sizes
    off = np.flatnonzero(np.abs(signed - fit.blur_size_px(inverse)) > _tolerance(sizes))
    if len(off) > len(inverse) // 3:
        pairs = [planes.names[i + 1] for i in np.flatnonzero(np.diff(signed) <= 0)]
        where = f"{_list(pairs)}: less" if pairs else f"{_list(planes.names)}: not"
        raise InputError(
            f"{where} in line with the depths: the blur of {len(off)} of {len(inverse)} planes "
            "does not grow with depth as a lens makes it; check that every depth belongs to its "
            "picture, that focus and aperture stayed as they were, and that all planes are on one "
            "side of the focus"
        )
    says = [
        f"{planes.names[i]}: blurred as at {_depth_text(fit.inverse_depth(signed[i]))}, "
        f"not as at {planes.depths_m[i]:g} m"
        for i in off
    ]
    raise InputError("; ".join(says) + ": correct the depth, or take the picture again")


def _refuse_swapped(planes: Planes, sizes: NDArray, errors: NDArray) -> None:
    """Name the two pictures with which everything suits, were they only exchanged."""
    inverse = 1 / planes.depths_m
    for i, j in itertools.combinations(range(len(inverse)), 2):
        order = np.arange(len(inverse))
        order[[i, j]] = j, i
        for sign in (1, -1):
            if _line(inverse, sign * sizes[order], errors[order])[1] == 0:
                raise InputError(
                    f"{planes.names[i]} and {planes.names[j]}: their depths, "
                    f"{planes.depths_m[i]:g} and {planes.depths_m[j]:g} m, seem to be swapped: the "
                    "blur grows evenly if they are exchanged"
                )


def _depth_text(inverse: NDArray[np.float64]) -> str:
    return f"{1 / float(inverse):.3g} m" if inverse > 0 else "infinity"


def _named(planes: Planes) -> list[tuple[str, float]]:
    return [(name, float(z)) for name, z in zip(planes.names, planes.depths_m, strict=True)]


def _list(names: "list[str] | tuple[str, ...]", most: int = 4) -> str:
    if len(names) > most:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return ", ".join(names)


@dataclasses.dataclass(frozen=True, eq=False)
class LeftOut:
    """Depths of planes by the line through the others.

    Attributes
    ----------
    depths_m : ndarray, float64 [I]
        Of each plane, from its blur as a whole; infinite where it is blurred more than that.
    errors : ndarray, float64 [I]
        Their relative errors.
    window_errors : ndarray, float64 [I]
        Median relative error of each plane's windows one by one: what a depth map has without
        regularisation.
    """

    depths_m: NDArray[np.float64]
    errors: NDArray[np.float64]
    window_errors: NDArray[np.float64]


def leave_one_out(planes: Planes, measured: list[MeasuredPlane], fit: ThinLensFit) -> LeftOut:
    """Estimate each plane's depth from its blur and the line through the other planes.

    The mask is that of all planes; focus and slope are the others' alone.
    """
    inverse = 1 / planes.depths_m
    sign = np.sign(np.median(fit.blur_size_px(inverse)))
    sizes = sign * np.array([plane.size_px for plane in measured])
    errors_px = np.array([plane.error_px for plane in measured])
    depths, errors, window_errors = [], [], []
    for i, plane in enumerate(measured):
        others = np.arange(len(inverse)) != i
        line = fitted_lens(inverse[others], sizes[others], errors_px[others])

        def relative(size_px: NDArray, line: ThinLensFit = line, z: float = inverse[i]) -> NDArray:
            found = np.maximum(line.inverse_depth(size_px), 1e-9)
            return np.abs(z / found - 1)

        own = line.inverse_depth(sizes[i])
        depths.append(1 / float(own) if own > 0 else np.inf)
        errors.append(float(relative(sizes[i])))
        window_errors.append(float(np.median(relative(sign * plane.sizes_px))))
    return LeftOut(np.array(depths), np.array(errors), np.array(window_errors))
