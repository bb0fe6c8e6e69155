"""The bound on free space: nearer than what is seen, and no promise where nothing can be said."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from textures import natural_texture

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator, refinement_note
from coded_aperture_ros.depth.decoders.network.bounds import nearest_level_around, nearest_px
from coded_aperture_ros.depth.decoders.network.probabilities import HalfCells
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.optics import Camera, FieldCurvature, Mask
from coded_aperture_ros.simulation import render_coded_frame

SHAPE, NEAR_M, FAR_M, NOISE = (160, 224), 2.0, 3.0, 0.002
RANGE_M = 1.5, 5.0


def camera_of(side):
    """Return a camera that is focused before the range, beyond it, or in it."""
    focus_m = {"far": 0.9, "near": 30.0, "both": 2.4}[side]
    mask = Mask.named("three_wide" if side == "both" else "levin")
    extent_mm = {"far": 30.0, "near": 40.0, "both": 100.0}[side]
    return Camera(400.0, focus_m, SHAPE[1], SHAPE[0], mask, extent_mm, side=side)


def coded_by(camera, depth_m, noise=NOISE):
    """Return the frame that a camera takes of a textured scene."""
    sharp = np.clip(natural_texture(SHAPE, seed=2, contrast=0.02), 0.05, 1)
    coded = render_coded_frame(sharp, depth_m, camera)
    return (coded + np.random.default_rng(1).normal(0, noise, SHAPE)).astype(np.float32)


@pytest.fixture(scope="module")
def truth_m():
    """Return the depth of a box before a wall."""
    depth = np.full(SHAPE, FAR_M, np.float32)
    depth[50:130, 60:140] = NEAR_M
    return depth


@pytest.fixture(scope="module", params=["far", "near", "both"])
def seen(request, truth_m):
    """Return a camera, its bank and a frame."""
    camera = camera_of(request.param)
    return camera, learn_bank_for_camera(camera, *RANGE_M, 30), coded_by(camera, truth_m)


def estimated(seen, frame=None, size=None, **settings):
    """Return what is found, with a bound at 1 % risk unless said otherwise."""
    camera, bank, coded = seen
    estimator = DepthEstimator(bank, DepthConfig(**{"free_space_risk": 0.01, **settings}), camera)
    estimate = estimator.estimate(coded if frame is None else frame, size)
    estimator.close()
    return estimate


def test_next_to_nothing_is_nearer_than_the_bound(seen, truth_m):
    bound = estimated(seen).values("free_space")
    assert bound.shape == SHAPE and np.isfinite(bound).all()
    assert (truth_m < bound).mean() <= 0.01
    assert bound.min() >= RANGE_M[0] * (1 - 1e-5)
    # It tells the wall from the box, and some of the space before both is free.
    wall, box = np.median(bound[10:40, 20:200]), np.median(bound[70:110, 80:120])
    if seen[0].side != "both":  # which takes more texture than there is
        assert RANGE_M[0] < box < NEAR_M and box + 0.1 < wall < FAR_M


def test_less_risk_promises_less(seen):
    bounds = [
        estimated(seen, free_space_risk=risk).values("free_space") for risk in (0.03, 0.01, 0.001)
    ]
    for more, less in pairwise(bounds):
        # Where the edge of a surface is drawn depends on both sides.
        assert (less <= 1.01 * more).mean() > 0.99 and (less < more).mean() > 0.2


@pytest.mark.parametrize("unknown", ["nothing", "nearest"])
def test_the_bound_is_never_beyond_the_depth(seen, unknown):
    estimate = estimated(seen, unknown=unknown, temporal_frames=3.0)
    known = np.isfinite(estimate.depth_m)
    assert known.mean() > 0.5 or seen[0].side == "both"
    assert (estimate.values("free_space")[known] <= estimate.depth_m[known] + 1e-5).all()


def test_no_bound_unless_asked_for_and_nothing_else_changes(seen):
    without, with_it = estimated(seen, free_space_risk=0.0), estimated(seen)
    assert without.values("free_space") is None
    for name in ("depth_m", "confidence", "std_dev_m"):
        np.testing.assert_array_equal(getattr(without, name), getattr(with_it, name))


def test_smaller_maps_say_the_same(seen):
    full, half = (
        estimated(seen).values("free_space"),
        estimated(seen, size=(80, 112)).values("free_space"),
    )
    assert half.shape == (80, 112)
    assert np.median(np.abs(half / full[::2, ::2] - 1)) < 0.03


@pytest.mark.parametrize(("pixel_px", "reach"), [(1, 1), (2, 2), (8, 2), (9, 2), (10, 3), (0.5, 1)])
def test_the_near_end_of_the_nearest_level_around_counts(seen, pixel_px, reach):
    """Of cells of 4 px: 4 px around each pixel of the map, and all of the pixel."""
    levels = Levels.from_model(seen[1], seen[0])
    far, near = levels.nearest_first[[20, 5]].astype(np.float32)
    level = np.full((30, 40), far)
    level[12, 15] = near
    found = nearest_level_around(level, levels, 0.7, 4, pixel_px)
    nearer = -0.7 if levels.nearest_first[0] == 0 else 0.7
    expected = np.full((30, 40), far + nearer)
    expected[12 - reach : 13 + reach, 15 - reach : 16 + reach] = near + nearer
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize("divisor", [2, 4, 8, 9])
def test_a_pixel_of_a_small_map_keeps_to_all_that_it_covers(seen, truth_m, divisor):
    rows, columns = SHAPE[0] // divisor, SHAPE[1] // divisor
    bound = estimated(seen, size=(rows, columns)).values("free_space")
    covered = truth_m[: rows * divisor, : columns * divisor]
    nearest = covered.reshape(rows, divisor, columns, divisor).min(axis=(1, 3))
    assert (nearest < bound).mean() <= 0.01


def test_nothing_is_promised_of_frames_that_do_not_fit(seen):
    disc = dataclasses.replace(seen[0], mask=Mask.named("disc"))
    estimate = estimated(seen, coded_by(disc, np.full(SHAPE, NEAR_M, np.float32)))
    assert not estimate.health.fits
    np.testing.assert_allclose(estimate.values("free_space"), RANGE_M[0], rtol=1e-4)


def test_nothing_is_promised_where_nothing_is_seen(seen):
    dark = seen[2].copy()
    dark[:, :80] = 1.0  # saturated
    bound = estimated(seen, dark, check_fit=False).values("free_space")
    np.testing.assert_allclose(bound[:, :40], RANGE_M[0], rtol=1e-4)
    assert np.median(bound[:, 180:]) > RANGE_M[0] * 1.05
    blank = np.full(SHAPE, 0.4, np.float32)
    np.testing.assert_allclose(estimated(seen, blank).values("free_space"), RANGE_M[0], rtol=1e-4)


def test_field_curvature_moves_the_bound_with_the_depth(truth_m):
    camera = camera_of("far")
    bank = learn_bank_for_camera(camera, *RANGE_M, 30)
    coded = coded_by(camera, truth_m, noise=0)
    bent = dataclasses.replace(camera, field_curvature=FieldCurvature(0.5, 0.0))
    flat, moved = (estimated((lens, bank, coded)) for lens in (camera, bent))
    known = np.isfinite(flat.depth_m) & np.isfinite(moved.depth_m)
    assert np.abs(moved.values("free_space") / flat.values("free_space") - 1).max() > 0.02
    assert (moved.values("free_space")[known] <= moved.depth_m[known] + 1e-4).all()


def test_what_gives_no_bound_is_refused():
    with pytest.raises(InputError, match="free_space_risk: needs regularize: learned"):
        DepthConfig(regularize="semiglobal", free_space_risk=0.01)
    with pytest.raises(InputError, match="free_space_risk"):
        DepthConfig(free_space_risk=0.2)


def test_where_the_network_was_not_trained_nothing_is_promised():
    camera = camera_of("far")
    bank = learn_bank_for_camera(camera, *RANGE_M, 5)
    config = DepthConfig(free_space_risk=0.01)
    assert refinement_note(bank, config).endswith("no free-space bound")
    assert "free space" not in refinement_note(bank, DepthConfig())
    frame = natural_texture(SHAPE, seed=2)
    bound = DepthEstimator(bank, config, camera).estimate(frame).values("free_space")
    np.testing.assert_allclose(bound, RANGE_M[0], rtol=1e-4)


def test_nothing_is_promised_where_light_is_lost_in_a_video(seen):
    camera, bank, coded = seen
    settings = DepthConfig(free_space_risk=0.01, temporal_frames=4.0, check_fit=False)
    estimator = DepthEstimator(bank, settings, camera)
    for _ in range(4):
        before = estimator.estimate(coded).values("free_space")
    lit = coded.copy()
    lit[60:100, 150:200] = 1.0
    after = estimator.estimate(lit).values("free_space")
    estimator.close()
    inside = np.s_[70:90, 160:190]
    np.testing.assert_allclose(after[inside], RANGE_M[0], rtol=1e-4)
    assert np.median(before[inside]) > RANGE_M[0] * 1.02


@pytest.mark.parametrize("far", [1.0, 0.99, 0.96, 0.94, 0.5, 0.02, 0.0])
def test_before_the_bound_lies_no_more_than_its_share(far):
    """Levels on both sides of the focus share the probability."""
    sizes_px = np.arange(1.0, 12.0, 0.5, dtype=np.float32)
    given = np.exp(-np.abs(sizes_px - 5))  # of either side
    given /= given.sum()
    signed = np.concatenate([-sizes_px[::-1], sizes_px])
    shares = np.concatenate([(1 - far) * given[::-1], far * given])
    nothing = np.zeros((1, 1), np.float32)
    for share in (0.01, 0.05, 0.2):
        cells = HalfCells(*(nothing,) * 4, np.log(given)[:, None, None], sizes_px)
        bound = float(nearest_px(cells, share, np.full((1, 1), far, np.float32))[0, 0])
        assert shares[signed < bound - 0.25].sum() <= share + 1e-5
        assert shares[signed < bound + 0.25].sum() >= share - 1e-5
