"""A second surface in the window, and what the generator and the training know of it."""

import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator, refinement_note
from coded_aperture_ros.depth.decoders.network.features import BLUR_SIZES_PX
from coded_aperture_ros.depth.decoders.network.second import (
    LEAST_ODDS,
    SurfacePair,
    cell_probabilities,
)
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation import SensorModel


def test_the_one_beside_is_the_one_that_is_not_there():
    odds = np.float32([[LEAST_ODDS + 1, LEAST_ODDS - 0.01]])
    less, more, share = (np.full((1, 2), value, np.float32) for value in (3.0, 9.0, 0.2))
    at_net, at_wall = np.float32([[3.4] * 4] * 2), np.float32([[8.0] * 4] * 2)
    pair = SurfacePair(odds, less, more, share)
    pair = pair.map_values(lambda part: np.repeat(np.repeat(part, 2, 0), 2, 1))
    for size_px, other, taken in ((at_net, 9.0, 0.8), (at_wall, 3.0, 0.2)):
        found, of_window = pair.other_surface(size_px)
        assert found[:, :2] == pytest.approx(other) and of_window[:, :2] == pytest.approx(taken)
        assert np.isnan(found[:, 2:]).all() and np.isnan(of_window[:, 2:]).all()


def test_probabilities_of_cells():
    tried = np.zeros(len(BLUR_SIZES_PX), bool)
    tried[4:7] = True
    logits = np.zeros((3, 2, 4), np.float32)
    logits[1, 0, 0] = 50  # one of the four half-cells of the first cell is sure
    mean, most = cell_probabilities(logits, tried)
    assert mean.shape == most.shape == (len(tried), 1, 2)
    assert mean[:, 0, 0].sum() == pytest.approx(1)
    assert mean[4:7, 0, 0] == pytest.approx([0.25, 0.5, 0.25], abs=1e-6)
    assert most[4:7, 0, 0] == pytest.approx([1 / 3, 1, 1 / 3], abs=1e-6)
    assert not mean[~tried].any() and not most[~tried].any()


@pytest.fixture(scope="module")
def fence():
    """Return a camera, its bank, a frame of a room behind leaves, and the scene."""
    pytest.importorskip("numba", reason="random scenes need numba")
    from coded_aperture_ros.simulation.layered import fenced_scene

    fenced = fenced_scene(4_000_000, Mask.named("levin"), "leaves", shape=(288, 384))
    camera = fenced.scene.camera
    ends_m = camera.depth_m([fenced.near_px.min(), fenced.behind_px.max()])
    bank = learn_bank_for_camera(camera, *ends_m, 30)
    frame = SensorModel(0.002).expose(fenced.scene.coded(), np.random.default_rng(0))
    return camera, bank, frame, fenced


def estimated(camera, bank, frame, size=None, **settings):
    config = DepthConfig(**{"second_surface": True, **settings})
    estimator = DepthEstimator(bank, config, camera)
    estimate = estimator.estimate(frame, size)
    estimator.close()
    return estimate


def test_what_is_behind_leaves_is_told_beside_them(fence):
    camera, bank, frame, fenced = fence
    estimate = estimated(camera, bank, frame, confidence_threshold=0.0)
    second_m, share = estimate.values("second"), estimate.values("second_share")
    assert second_m.dtype == share.dtype == np.float32
    assert second_m.shape == share.shape == frame.shape
    two = np.isfinite(second_m)
    assert np.array_equal(two, np.isfinite(share)) and two.mean() > 0.4
    assert share[two].min() >= 0 and share[two].max() <= 1
    near_m, behind_m = camera.depth_m(fenced.near_px), camera.depth_m(fenced.behind_px)
    # They are two, everywhere.
    assert np.abs(estimate.depth_m[two] / second_m[two] - 1).min() > 0.02
    pair = np.sort([estimate.depth_m[two], second_m[two]], axis=0)
    right = np.abs(pair / np.stack([near_m[two], behind_m[two]]) - 1) <= 0.1
    assert right.mean() > 0.7
    # It takes nothing from the depth, and is not told where nobody asks.
    without = estimated(camera, bank, frame, second_surface=False)
    assert without.values("second") is None and without.values("second_share") is None
    np.testing.assert_array_equal(without.depth_m, estimated(camera, bank, frame).depth_m)


@pytest.mark.parametrize("settings", [{"unknown": "nearest"}, {"free_space_risk": 0.01}])
def test_with_other_settings_and_smaller_maps(fence, settings):
    camera, bank, frame, _ = fence
    plain, whole = estimated(camera, bank, frame), estimated(camera, bank, frame, **settings)
    np.testing.assert_array_equal(plain.values("second"), whole.values("second"))
    small = estimated(camera, bank, frame, (144, 192), **settings)
    assert small.values("second").shape == small.values("second_share").shape == (144, 192)
    same = np.isclose(
        whole.values("second")[::2, ::2], small.values("second"), rtol=1e-3, equal_nan=True
    )
    assert same.mean() > 0.9


def test_nothing_is_told_of_what_was_not_seen(fence):
    camera, bank, frame, _ = fence
    dark = frame.copy()
    dark[:, :160] = 2.0  # saturated
    second_m = estimated(camera, bank, dark).values("second")
    assert np.isnan(second_m[:, :96]).all() and np.isfinite(second_m[:, 240:]).any()
    other = learn_bank_for_camera(camera, *camera.depth_m([2.0, 18.0]), 30)
    # Half as fine as the bank takes it to be.
    misfit = estimated(
        camera, other, np.ascontiguousarray(frame[::2, ::2].repeat(2, 0).repeat(2, 1))
    )
    assert not misfit.health.fits and np.isnan(misfit.values("second")).all()


def test_of_both_sides_and_of_coarse_banks_nothing_is_told(fence):
    camera, _, frame, _ = fence
    coarse = learn_bank_for_camera(camera, *camera.depth_m([3.0, 15.0]), 8)
    estimate = estimated(camera, coarse, frame)
    assert (
        np.isnan(estimate.values("second")).all()
        and np.isnan(estimate.values("second_share")).all()
    )
    assert "no second surface" in refinement_note(coarse, DepthConfig(second_surface=True))
    both = Camera(400.0, 2.4, 224, 160, Mask.named("three_wide"), 100.0, side="both")
    of_both = learn_bank_for_camera(both, 1.5, 5.0, 30)
    assert np.isnan(estimated(both, of_both, frame[:160, :224]).values("second")).all()
    assert "both sides" in refinement_note(of_both, DepthConfig(second_surface=True))
    assert refinement_note(of_both, DepthConfig()) is None
    with pytest.raises(InputError, match="second_surface: needs regularize: learned"):
        DepthConfig(second_surface=True, regularize="semiglobal")


# ---- which windows show two surfaces ----


def test_windows_with_two_surfaces():
    pytest.importorskip("numba")
    from coded_aperture_benchmarks.metrics.surfaces import at_middles, shares, surfaces

    blur_px = np.full((96, 160), 9.0, np.float32)
    blur_px[:, 80:] = 4.0
    windows = surfaces(shares(blur_px, np.ones_like(blur_px)))
    assert windows.two.shape == (12, 20)
    middle = windows.two[6]
    assert (middle[:6] == 0).all() and (middle[-6:] == 0).all() and (middle[8:12] == 1).all()
    two = windows.two == 1
    assert windows.less_px[two] == pytest.approx(4.0) and windows.more_px[two] == pytest.approx(9.0)
    # Its middle is 4 px left of the edge: 20 of 48 px are of the right side.
    assert windows.share[6, 9] == pytest.approx(20 / 48)
    assert at_middles(blur_px)[6, 8:12].tolist() == [9, 9, 4, 4]
    # A slanted wall is one surface, and what differs by less than 2 px is neither.
    slanted = np.tile(np.linspace(3, 12, 160, dtype=np.float32), (96, 1))
    assert (surfaces(shares(slanted, np.ones_like(slanted))).two[2:-2, 2:-2] == 0).all()
    blur_px[:, 80:] = 7.5
    assert not (surfaces(shares(blur_px, np.ones_like(blur_px))).two == 1).any()


@pytest.mark.parametrize("kind", ["net", "leaves", "pane"])
@pytest.mark.parametrize("side", ["far", "near"])
def test_fences_are_before_rooms(kind, side):
    pytest.importorskip("numba")
    from coded_aperture_ros.simulation.layered import fenced_scene

    mask = Mask.named("levin")
    fenced = fenced_scene(7, mask, kind, side, (96, 128))
    again = fenced_scene(7, mask, kind, side, (96, 128))
    np.testing.assert_array_equal(fenced.cover, again.cover)
    assert ((fenced.cover >= 0) & (fenced.cover <= 1)).all() and fenced.cover.max() > 0.2
    near_m, behind_m = (
        fenced.scene.camera.depth_m(sizes) for sizes in (fenced.near_px, fenced.behind_px)
    )
    assert (near_m < behind_m).all()
    assert (fenced.behind_px - fenced.near_px >= 1.99).all()
    # What is all covered, or not at all, is what the scene itself says.
    sizes = fenced.scene.blur_size_px()
    bare = fenced.cover == 0
    np.testing.assert_allclose(sizes[bare], fenced.behind_px[bare], atol=1e-4)
    if kind != "pane":
        covered = fenced.cover == 1
        # Leaves are turned this way and that.
        off = 1.6 if kind == "leaves" else 1e-3
        np.testing.assert_allclose(sizes[covered], fenced.near_px[covered], atol=off)


def test_a_refocused_scene_has_the_same_depths():
    pytest.importorskip("numba")
    from coded_aperture_ros.simulation.layered import random_scene

    scene = random_scene(3, Mask.named("levin"), "far", (96, 128))
    other = scene.refocused(2.5)
    np.testing.assert_allclose(other.depth_m(), scene.depth_m(), rtol=1e-4)
    assert other.camera.focus_distance_m == 2.5
    expected = other.camera.blur_size_px(scene.depth_m())
    np.testing.assert_allclose(other.blur_size_px(), expected, atol=1e-3)
    np.testing.assert_array_equal(other.all_in_focus(), scene.all_in_focus())
