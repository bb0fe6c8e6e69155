"""What the field reports of dense depth maps, in one dictionary: errors, edges, confidence."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.datasets.ray_traced import Rods
from coded_aperture_benchmarks.metrics.deltas import DELTA_BOUNDS, delta_shares
from coded_aperture_benchmarks.metrics.edges import TOLERANCES_PX, BoundaryMatch, flying_pixels
from coded_aperture_benchmarks.metrics.sparsification import Sparsification
from coded_aperture_benchmarks.metrics.thin import WIDTHS_PX, pieces_found, thin_pieces
from coded_aperture_benchmarks.run import Row
from coded_aperture_ros.metrics import Reliability
from coded_aperture_ros.metrics.edges import edge_distance_px
from coded_aperture_ros.optics import Camera

NEAR_EDGE_PX = 16
RIGHT_WITHIN, SHARE_WITHIN = 0.05, 0.10
CONFIDENT = 0.55
DELTAS = tuple(f"delta_{bound:.2f}" for bound in DELTA_BOUNDS)
TOLERANCES = tuple(map(str, TOLERANCES_PX))
WIDTHS = tuple(f"{low}-{high}" for low, high in WIDTHS_PX)
_COVERAGES = np.arange(1, 21) / 20
# A mesh of a net is as long as it is wide.
_GAP_ELONGATION = 0.75
_DIGITS = 4


def score(
    depth_m: NDArray[np.floating],
    std_dev_m: NDArray[np.floating] | None,
    confidence: NDArray[np.floating],
    truth_m: NDArray[np.floating],
    camera: Camera | Sequence[Camera],
    threshold: float = CONFIDENT,
) -> dict[str, Any]:
    """Compare depth maps with the truth; frames are pooled.

    Unless it says otherwise, a share is one of all pixels with a true depth, and a pixel without
    an estimate, or with one that is not finite, counts as wrong. Means and medians of errors are
    over the pixels that have both. A number that nothing is known of is NaN.

    Parameters
    ----------
    depth_m : ndarray, shape [h, w] or [frames, h, w]
        Metres, as estimated with the confidence threshold 0; NaN where unknown.
    std_dev_m : ndarray, of the same shape, or None
        Stated standard deviation, metres.
    confidence : ndarray, of the same shape
        In [0, 1].
    truth_m : ndarray, of the same shape
        Metres, NaN where unknown.
    camera : Camera, or sequence of Camera
        What turns depths into blur sizes: a depth edge is a jump of more than one pixel. The same
        for all frames, or one for each.
    threshold : float
        Depth is published from this confidence on.

    Returns
    -------
    dict
        pixels, near_edge_pixels : with a true depth, and those of them within 16 px of an edge.
        abs_rel : mean of |depth - truth| / truth.
        delta_1.05, ... : share of pixels off by less than this factor.
        within_10_percent, within_10_percent_near_edges, within_10_percent_away : shares.
        median_error, median_error_away : of |depth - truth| / truth.
        published : threshold, coverage, abs_rel, delta_1.05, ..., within_10_percent; what is below
        the threshold is unknown; and flying_near_edges, the share of the published pixels within
        16 px of an edge that are `flying_pixels`.
        confident : threshold (.55), coverage, and within_10_percent of the confident pixels.
        expected_calibration_error : of the confidence that the depth is right to 5 %.
        sparsification : coverage, abs_rel, oracle : the mean relative error of the most confident
        pixels, and of those with the least errors; area : below the first; ause : between both.
        boundary : by tolerance in px, precision, recall and f_score of the depth edges;
        edge_pixels : of the truth.
        thin : by width in px, pieces, found (right to 10 % on half of their pixels), recall,
        pixels and the share of them that are right; gaps : likewise, where a farther surface is
        seen between nearer ones.
        std_dev : None, or of the published pixels the shares with errors below one and two
        standard deviations; and ause, where pixels are sorted by the relative standard deviation.
    """
    maps = _frames(depth_m), _frames(truth_m), np.nan_to_num(_frames(confidence))
    cameras = [camera] * len(maps[1]) if isinstance(camera, Camera) else camera
    std_dev = None if std_dev_m is None else _frames(std_dev_m)
    result: Row = _rounded(_scores(*maps, std_dev, cameras, threshold))
    return result


def _scores(
    depth: NDArray[np.floating],
    truth: NDArray[np.floating],
    confidence: NDArray[np.floating],
    std_dev: NDArray[np.floating] | None,
    cameras: Sequence[Camera],
    threshold: float,
) -> Row:
    sizes = [each.blur_size_px(frame) for each, frame in zip(cameras, truth, strict=True)]
    near_edge = np.stack([edge_distance_px(size) for size in sizes]) <= NEAR_EDGE_PX
    with_truth = np.isfinite(truth)
    with np.errstate(invalid="ignore"):
        relative = np.where(np.isfinite(depth), np.abs(depth - truth) / truth, np.nan)
        right = relative <= SHARE_WITHIN
    known = np.isfinite(relative)
    sure = confidence >= CONFIDENT
    published = confidence >= threshold
    flying = np.stack([flying_pixels(*each) for each in zip(depth, truth, strict=True)])
    reliability = Reliability.from_estimates(confidence[known], relative[known] <= RIGHT_WITHIN)
    return {
        "pixels": int(np.count_nonzero(with_truth)),
        "near_edge_pixels": int(np.count_nonzero(with_truth & near_edge)),
        **_errors(depth, truth, relative),
        "within_10_percent_near_edges": _mean(right[with_truth & near_edge]),
        "within_10_percent_away": _mean(right[with_truth & ~near_edge]),
        "median_error": _median(relative[known]),
        "median_error_away": _median(relative[known & ~near_edge]),
        "published": {
            "threshold": threshold,
            "coverage": _mean((known & published)[with_truth]),
            **_errors(
                np.where(published, depth, np.nan), truth, np.where(published, relative, np.nan)
            ),
            "flying_near_edges": _mean(flying[known & published & near_edge]),
        },
        "confident": {
            "threshold": CONFIDENT,
            "coverage": _mean((known & sure)[with_truth]),
            "within_10_percent": _mean(right[known & sure]),
        },
        "expected_calibration_error": reliability.expected_calibration_error,
        "sparsification": _sparsified(relative[known], confidence[known]),
        "boundary": _boundary(
            [each.blur_size_px(frame) for each, frame in zip(cameras, depth, strict=True)], sizes
        ),
        "thin": _thin(sizes, right),
        "gaps": _thin([-size for size in sizes], right, elongation=_GAP_ELONGATION),
        "std_dev": None
        if std_dev is None
        else _std_dev(relative, std_dev / truth, std_dev / depth, published),
    }


def score_rods(relative: Sequence[NDArray[np.floating]], rods: Sequence[Rods]) -> dict[str, Any]:
    """Count the rods of known widths that were found: right to 10 % on half of their pixels.

    Parameters
    ----------
    relative : sequence of ndarray of float
        Every frame's relative error; NaN where there is no depth.
    rods : sequence of Rods
        Of every frame.

    Returns
    -------
    dict
        By width in px (the upper bound excluded but for the last), rods that are seen, found,
        recall, and the share of their pixels that is right.
    """
    widths: list[float] = []
    pixels: list[NDArray[Any]] = []
    good: list[NDArray[Any]] = []
    for errors, frame in zip(relative, rods, strict=True):
        count = len(frame.widths_px)
        labels, right = frame.labels.ravel(), (errors <= SHARE_WITHIN).ravel()
        widths.extend(frame.widths_px)
        pixels.append(np.bincount(labels, minlength=count + 1)[1:])
        good.append(np.bincount(labels, right, minlength=count + 1)[1:])
    width, total, rightly = np.array(widths), np.concatenate(pixels), np.concatenate(good)
    row: Row = {}
    for (low, high), name in zip(WIDTHS_PX, WIDTHS, strict=True):
        last = (low, high) == WIDTHS_PX[-1]
        chosen = (width >= low) & ((width < high) | last) & (total > 0)
        found = rightly[chosen] >= total[chosen] / 2
        row[name] = {
            "pieces": int(np.count_nonzero(chosen)),
            "found": int(np.count_nonzero(found)),
            "recall": _mean(found),
            "pixels_right": float(rightly[chosen].sum() / max(total[chosen].sum(), 1)),
        }
    result: Row = _rounded(row)
    return result


def _errors(
    depth: NDArray[np.floating], truth: NDArray[np.floating], relative: NDArray[np.floating]
) -> Row:
    deltas = zip(DELTAS, delta_shares(depth, truth).values(), strict=True)
    with np.errstate(invalid="ignore"):
        right = (relative <= SHARE_WITHIN)[np.isfinite(truth)]
    return {
        "abs_rel": _mean(relative[np.isfinite(relative)]),
        **dict(deltas),
        "within_10_percent": _mean(right),
    }


def _sparsified(errors: NDArray[np.floating], confidence: NDArray[np.floating]) -> Row:
    curve = Sparsification.of(errors, confidence)
    coverage = _COVERAGES if errors.size else _COVERAGES[:0]
    abs_rel, oracle = curve.at(coverage)
    return {
        "coverage": coverage.tolist(),
        "abs_rel": abs_rel.tolist(),
        "oracle": oracle.tolist(),
        "area": curve.area,
        "ause": curve.area_over_oracle,
    }


def _boundary(
    estimated: Sequence[NDArray[np.floating]], true: Sequence[NDArray[np.floating]]
) -> Row:
    matches = [BoundaryMatch.of(*sizes) for sizes in zip(estimated, true, strict=True)]
    row: Row = {}
    for tolerance, name in zip(TOLERANCES_PX, TOLERANCES, strict=True):
        total = sum((each[tolerance] for each in matches), BoundaryMatch(0, 0, 0, 0))
        row[name] = {"precision": total.precision, "recall": total.recall, "f_score": total.f_score}
        row["edge_pixels"] = total.true
    return row


def _thin(
    sizes: Sequence[NDArray[np.floating]], right: NDArray[np.bool_], elongation: float = 2.0
) -> Row:
    frames = [thin_pieces(size, elongation=elongation) for size in sizes]
    row: Row = {}
    for widths, name in zip(WIDTHS_PX, WIDTHS, strict=True):
        labels = [pieces[widths] for pieces in frames]
        found = np.concatenate([pieces_found(*each) for each in zip(labels, right, strict=True)])
        inside = np.stack(labels) > 0
        row[name] = {
            "pieces": found.size,
            "found": int(np.count_nonzero(found)),
            "recall": _mean(found),
            "pixels": int(np.count_nonzero(inside)),
            "pixels_right": _mean(right[inside]),
        }
    return row


def _std_dev(
    relative: NDArray[np.floating],
    of_truth: NDArray[np.floating],
    of_depth: NDArray[np.floating],
    published: NDArray[np.bool_],
) -> Row:
    """Summarise standard deviations, relative to the true depth and to the estimated one."""
    stated = np.isfinite(relative) & np.isfinite(of_depth)
    errors, bounds = relative[stated & published], of_truth[stated & published]
    return {
        "within_one": _mean(errors <= bounds),
        "within_two": _mean(errors <= 2 * bounds),
        "median": _median(bounds),
        "ause": Sparsification.of(relative[stated], -of_depth[stated]).area_over_oracle,
    }


def _frames(values: NDArray[np.floating]) -> NDArray[np.floating]:
    return values.reshape(-1, *values.shape[-2:])


def _mean(values: NDArray) -> float:
    return float(np.mean(values, dtype=np.float64)) if values.size else float("nan")


def _median(values: NDArray[np.floating]) -> float:
    return float(np.median(values)) if values.size else float("nan")


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return round(value, _DIGITS) if isinstance(value, float) else value
