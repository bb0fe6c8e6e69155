"""Edges, thin structures and sparsification, against answers known beforehand."""

import numpy as np
import pytest
from coded_aperture_benchmarks.metrics.deltas import delta_shares
from coded_aperture_benchmarks.metrics.dense import score
from coded_aperture_benchmarks.metrics.edges import BoundaryMatch, flying_pixels, occluding_contour
from coded_aperture_benchmarks.metrics.sparsification import Sparsification
from coded_aperture_benchmarks.metrics.thin import pieces_found, thin_pieces

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.metrics.edges import edge_distance_px
from coded_aperture_ros.optics import Camera, Mask


def step(column, near=2.0, far=10.0, shape=(40, 60)):
    return np.where(np.arange(shape[1]) < column, near, far) * np.ones(shape)


def test_depths_between_two_surfaces_fly():
    """A wall at 4 m beside one at 2 m, and a step of 3 %."""
    truth = np.full((9, 80), 4.0)
    truth[:, :40] = 2
    truth[:, 70:] = 4.12
    depth = truth.copy()
    depth[0, 38:44] = 3  # between both
    depth[1, 38:44] = 2.05, 2.05, 3.9, 3.9, 3.9, 3.9  # on one of them
    depth[2, 38:44] = 1  # before both
    depth[3, 60] = 3  # too far from the edge
    depth[4, 72] = 3
    depth[5, 40] = 2  # the other surface
    truth[6, 40], depth[6, 40] = np.nan, 3
    depth[7, 38:44] = 5  # behind both
    expected = np.zeros(truth.shape, bool)
    expected[0, 38:44] = True
    np.testing.assert_array_equal(flying_pixels(depth, truth), expected)


def test_deltas_are_ratios_and_unknown_is_wrong():
    truth = np.array([1.0, 1.0, 1.0, 1.0, np.nan])
    depth = np.array([1.04, 1 / 1.1, 1.2, np.nan, 1.0])
    assert list(delta_shares(depth, truth).values()) == [0.25, 0.5, 0.75]
    assert np.isnan(delta_shares(truth[4:], truth[4:])[1.05])


def test_the_contour_is_on_the_nearer_side():
    contour = occluding_contour(step(20))
    assert np.flatnonzero(contour[5]).tolist() == [19]
    distance = edge_distance_px(step(20))
    assert distance[5, 17:23].tolist() == [2, 1, 0, 0, 1, 2]


def test_borders_of_the_unknown_are_no_edges():
    size = step(20)
    size[:, 17:23] = np.nan
    assert not occluding_contour(size).any()
    assert np.isinf(edge_distance_px(size)).all()


@pytest.mark.parametrize(("shift", "scores"), [(0, [1, 1, 1]), (2, [0, 1, 1]), (5, [0, 0, 0])])
def test_a_shifted_edge_is_found_within_its_shift(shift, scores):
    match = BoundaryMatch.of(step(20 + shift), step(20))
    assert [each.f_score for each in match.values()] == scores


def test_precision_and_recall_add_up():
    both = step(20)
    both[:, 40:] = 30.0
    (match, *_) = BoundaryMatch.of(both, step(20)).values()
    assert (match.precision, match.recall) == (0.5, 1.0)
    assert match.f_score == pytest.approx(2 / 3)
    (none, *_) = BoundaryMatch.of(step(60), step(20)).values()
    assert (none.recall, none.f_score) == (0, 0)
    assert np.isnan(BoundaryMatch.of(both, step(60))[1].f_score)
    assert (match + none).true == 80
    unknown = step(20)
    unknown[:, 38:42] = np.nan  # what lies there is not judged
    assert BoundaryMatch.of(both, unknown)[1].precision == 1
    with pytest.raises(InputError, match="one shape"):
        BoundaryMatch.of(both, step(20, shape=(3, 4)))


def rods(*columns, slope=0.0):
    """A slanted wall with upright rods of (left, width)."""
    size = 10 + slope * np.arange(160) * np.ones((100, 160))
    for left, width in columns:
        size[:, left : left + width] = 3.0
    return size


@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_rods_are_sorted_by_width(slope):
    size = rods(
        (10, 1), (20, 2), (30, 3), (40, 4), (50, 7), (70, 8), (90, 20), (120, 30), slope=slope
    )
    pieces = thin_pieces(size)
    columns = {
        widths: [
            np.flatnonzero((labels == each).any(axis=0)) for each in range(1, labels.max() + 1)
        ]
        for widths, labels in pieces.items()
    }
    assert {widths: [each.size for each in found] for widths, found in columns.items()} == {
        (2, 4): [2, 3], (4, 8): [4, 7], (8, 20): [8, 20],
    }  # fmt: skip


def test_corners_and_slanted_walls_are_not_thin():
    size = np.full((100, 160), 10.0)
    size[20:70, 40:120] = 3.0
    assert not any(labels.any() for labels in thin_pieces(size).values())
    wall = np.abs(np.arange(160) - 80) * 0.4 * np.ones((100, 160))
    assert not any(labels.any() for labels in thin_pieces(wall).values())


def test_beside_the_unknown_nothing_is_thin():
    size = rods((50, 6))
    size[:, 56:80] = np.nan
    assert not any(labels.any() for labels in thin_pieces(size).values())
    assert not any(labels.any() for labels in thin_pieces(size * np.nan).values())


def test_gaps_are_rods_turned_round():
    size = 13 - rods((50, 6))
    assert thin_pieces(-size)[4, 8].max() == 1


def test_half_of_a_piece_finds_it():
    labels = thin_pieces(rods((20, 4), (50, 6)))[4, 8]
    assert pieces_found(labels, np.arange(160) * np.ones((100, 160)) < 22).tolist() == [True, False]
    assert pieces_found(labels * 0, labels > 0).size == 0


def test_sparsification_against_the_oracle():
    errors = np.array([0.4, 0.1, 0.2, 0.3])
    perfect = Sparsification.of(errors, -errors)
    assert perfect.area_over_oracle == 0
    assert perfect.area == pytest.approx((0.1 + 0.15 + 0.2 + 0.25) / 4)
    blind = Sparsification.of(errors, np.ones(4))
    assert blind.error == pytest.approx(np.full(4, 0.25))
    assert blind.area_over_oracle == pytest.approx(0.25 - perfect.area)
    assert [curve.tolist() for curve in perfect.at(np.array([0.25]))] == [[0.1], [0.1]]
    assert np.isnan(Sparsification.of(errors[:0], errors[:0]).area)
    with pytest.raises(InputError, match="one shape"):
        Sparsification.of(errors, errors[:2])


CAMERA = Camera(800.0, 0.9, 160, 100, Mask.named("levin"), 20.0)


def test_the_score_of_the_truth_is_perfect():
    truth = CAMERA.depth_m(rods((20, 6), (100, 12)))
    result = score(truth, truth * 0.01, np.full(truth.shape, 0.99), truth, CAMERA)
    assert (result["pixels"], result["abs_rel"]) == (truth.size, 0)
    assert result["delta_1.05"] == result["within_10_percent"] == 1
    assert result["published"]["within_10_percent"] == result["confident"]["coverage"] == 1
    assert result["sparsification"]["ause"] == 0
    assert result["boundary"]["1"]["f_score"] == 1
    assert result["boundary"]["edge_pixels"] == 400
    assert (result["thin"]["4-8"]["found"], result["thin"]["8-20"]["pieces"]) == (1, 1)
    assert result["std_dev"]["within_one"] == 1


def test_the_score_counts_what_is_unknown_as_wrong():
    truth = CAMERA.depth_m(rods((20, 6)))
    truth[:, 150:] = np.nan
    depth, confidence = truth.copy(), np.full(truth.shape, 0.9)
    depth[:, :15] = np.nan
    confidence[:50] = 0.3
    result = score(
        np.stack([depth] * 2), None, np.stack([confidence] * 2), np.stack([truth] * 2), CAMERA
    )
    assert result["pixels"] == 2 * 150 * 100
    assert result["within_10_percent"] == result["delta_1.25"] == 0.9
    assert result["published"]["within_10_percent"] == result["published"]["coverage"] == 0.45
    assert result["published"]["flying_near_edges"] == 0
    assert result["confident"] == {"threshold": 0.55, "coverage": 0.45, "within_10_percent": 1}
    assert result["median_error"] == 0
    assert result["std_dev"] is None
    nothing = score(truth * np.nan, None, confidence, truth, CAMERA)
    assert (nothing["within_10_percent"], nothing["boundary"]["4"]["f_score"]) == (0, 0)
    assert np.isnan(nothing["abs_rel"])
