"""Thin lens that fits the measured blur of planes, and the planes that contradict it."""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.planes.measure import MIN_ERROR_PX, MeasuredPlane
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.arrays import DoubleArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank import ThinLens

# What lies farther from the line than this has another depth than it was said to have. Narrow blur
# is often measured wrong by more, and has little information.
_NARROW_PX = 4.5
_NARROW_OUTLIER_PX = 1.8
_OUTLIER_PX = 1.0
_OUTLIER_SHARE = 0.08
# Blur that falls by more from one plane to the next, where it has to grow, is that of exchanged
# planes: it fell in none of 18 right lists, and by 0.5 px or more in eight of nine lists with the
# first two exchanged.
_FALL_PX = 0.4
_ITERATIONS = 20
_NO_LENS = ThinLens(1e-9, 0.0)


def fitted_lens(depths_m: DoubleArray, sizes_px: DoubleArray, errors_px: DoubleArray) -> ThinLens:
    """Thin lens of the line through signed blur sizes; outliers have little weight.

    Least squares, reweighted by Huber's function.
    """
    terms = np.stack([np.ones_like(depths_m), -1 / depths_m], axis=1)
    trust = np.ones_like(sizes_px)
    for _ in range(_ITERATIONS):
        roots = np.sqrt(trust) / errors_px
        (offset, slope), *_ = np.linalg.lstsq(roots[:, None] * terms, roots * sizes_px, rcond=None)
        deviation = np.abs(sizes_px - terms @ [offset, slope])
        usual = max(1.48 * float(np.median(deviation)), MIN_ERROR_PX)
        trust = np.minimum(1, 1.5 * usual / np.maximum(deviation, 1e-9))
    return ThinLens(float(slope), float(offset / slope)) if slope else _NO_LENS


def fit_signed_lens(planes: Planes, measured: Sequence[MeasuredPlane]) -> ThinLens:
    """Thin lens for planes that are all beyond the focus, or all in front of it.

    Raises `InputError` with the files: planes on both sides of the focus, or depths that do not
    belong to their pictures.
    """
    depths = planes.depths_m
    sizes = np.array([plane.size_px for plane in measured])
    errors = np.array([plane.error_px for plane in measured])
    fit, outliers = min(
        (_line(depths, sign * sizes, errors) for sign in (1, -1)), key=lambda found: found[1]
    )
    if outliers:
        _refuse_both_sides(planes, sizes, errors, outliers)
        _refuse_swapped(planes, sizes, errors)
        _refuse_depths(planes, fit, sizes)
    _refuse_falling(planes, fit, sizes)
    return fit


def _line(depths: NDArray, sizes: NDArray, errors: NDArray) -> tuple[ThinLens, int]:
    """Line through a pair of sizes with the fewest outliers, and their number."""
    inverse = 1 / depths
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
        return _NO_LENS, len(inverse)
    agree = best[2]
    fit = fitted_lens(depths[agree], sizes[agree], errors[agree])
    return fit, len(_outliers(fit, depths, sizes))


def _tolerance(sizes: NDArray) -> NDArray:
    usual = np.maximum(_OUTLIER_PX, _OUTLIER_SHARE * np.abs(sizes))
    return np.where(np.abs(sizes) < _NARROW_PX, _NARROW_OUTLIER_PX, usual)


def _outliers(fit: ThinLens, depths: NDArray, sizes: NDArray) -> IndexArray:
    return np.flatnonzero(np.abs(sizes - fit.blur_size_px(depths)) > _tolerance(sizes))


def _refuse_both_sides(planes: Planes, sizes: NDArray, errors: NDArray, outliers: int) -> None:
    """Raise `InputError` with the planes in front of a focus between them, if it explains more."""
    depths = planes.depths_m
    found = None
    for front in range(1, len(depths)):
        signs = np.where(np.arange(len(depths)) < front, -1, 1)
        fit, off = _line(depths, signs * sizes, errors)
        if off < outliers and depths[0] < fit.focus_distance_m < depths[-1]:
            outliers = off
            crossing_m = fit.focus_distance_m
            nearer = [planes.names[i] for i in np.flatnonzero(depths < crossing_m)]
            found = InputError(
                f"{_list(nearer)}: in front of the focus at about {crossing_m:.3g} m, while "
                f"{len(depths) - len(nearer)} planes lie beyond it, and blur does not tell the "
                "sides apart: take the planes of one side only, or focus before or beyond all of "
                "them"
            )
    if found is not None:
        raise found


def _refuse_swapped(planes: Planes, sizes: NDArray, errors: NDArray) -> None:
    """Raise `InputError` with the two pictures that explain all others once exchanged."""
    depths = planes.depths_m
    names = planes.names
    for i, j in itertools.combinations(range(len(depths)), 2):
        order = np.arange(len(depths))
        order[[i, j]] = j, i
        if any(_line(depths, sign * sizes[order], errors[order])[1] == 0 for sign in (1, -1)):
            raise InputError(
                f"{names[i]} and {names[j]}: their depths, {depths[i]:g} and {depths[j]:g} m, seem "
                "to be swapped: the blur grows evenly if they are exchanged"
            )


def _refuse_falling(planes: Planes, fit: ThinLens, sizes: NDArray) -> None:
    """Raise `InputError` with the first two neighbours whose blur is in the other order."""
    depths = planes.depths_m
    names = planes.names
    falls = np.diff(_side(fit, depths) * sizes) < -_FALL_PX
    if falls.any():
        i = int(np.argmax(falls))
        raise InputError(
            f"{names[i]} and {names[i + 1]}: their depths, {depths[i]:g} and {depths[i + 1]:g} m, "
            f"seem to be swapped: their blur, {sizes[i]:.1f} and {sizes[i + 1]:.1f} px, is in the "
            "other order"
        )


def _refuse_depths(planes: Planes, fit: ThinLens, sizes: NDArray) -> None:
    """Raise `InputError` with the pictures whose blur does not suit their depths."""
    depths = planes.depths_m
    names = planes.names
    signed = _side(fit, depths) * sizes
    off = _outliers(fit, depths, signed)
    if len(off) > len(depths) // 3:
        pairs = [names[i + 1] for i in np.flatnonzero(np.diff(signed) <= 0)]
        where = f"{_list(pairs)}: less" if pairs else f"{_list(names)}: not"
        raise InputError(
            f"{where} in line with the depths: the blur of {len(off)} of {len(depths)} planes "
            "does not grow with depth as a lens makes it; check that every depth belongs to its "
            "picture, that focus and aperture stayed as they were, and that all planes are on one "
            "side of the focus"
        )
    faults = []
    for i in off:
        like_m = float(fit.depth_m(signed[i]))
        like = f"{like_m:.3g} m" if np.isfinite(like_m) else "infinity"
        faults.append(f"{names[i]}: blurred as at {like}, not as at {depths[i]:g} m")
    raise InputError(
        "; ".join(faults) + ": correct the depth, or take the picture again; if the depths are "
        "right, the lens is focused elsewhere in the corners: see calibrate field"
    )


def _side(fit: ThinLens, depths: NDArray) -> float:
    return float(np.sign(np.median(fit.blur_size_px(depths))))


def _list(names: Sequence[str], most: int = 4) -> str:
    if len(names) > most:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return ", ".join(names)


@dataclasses.dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """Depths of planes by the line through the others.

    Depth of each plane from its blur as a whole [I], infinite where it is blurred more than that,
    its relative error [I], and the median relative error of its windows one by one [I]: what a
    depth map has without regularisation.
    """

    depths_m: DoubleArray
    errors: DoubleArray
    window_errors: DoubleArray


def leave_one_out(planes: Planes, measured: Sequence[MeasuredPlane], fit: ThinLens) -> LeaveOneOut:
    """Depth of each plane from its blur and the line through the other planes.

    The mask is that of all planes; focus and slope are the others' alone.
    """
    depths_m = planes.depths_m
    side = _side(fit, depths_m)
    sizes = side * np.array([plane.size_px for plane in measured])
    errors_px = np.array([plane.error_px for plane in measured])
    depths = []
    errors = []
    window_errors = []
    for i, plane in enumerate(measured):
        others = np.arange(len(depths_m)) != i
        line = fitted_lens(depths_m[others], sizes[others], errors_px[others])
        depths.append(float(line.depth_m(sizes[i])))
        sizes_px = np.append(side * plane.sizes_px, sizes[i])
        found = np.maximum(line.inverse_depth(sizes_px), 1e-9)
        relative = np.abs(1 / (depths_m[i] * found) - 1)
        errors.append(float(relative[-1]))
        window_errors.append(float(np.median(relative[:-1])))
    return LeaveOneOut(np.array(depths), np.array(errors), np.array(window_errors))
