"""Periodic texture that looks like usual texture at another depth is not trusted."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from textures import natural_texture

from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.stages.periodic_texture import may_be_periodic
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import Cost
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.likelihood.bank.prior import periodic_levels
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation import render_coded_frame

SHAPE, WALL_M, NOISE = (224, 320), 3.0, 0.002


@pytest.fixture(scope="module")
def camera():
    return Camera(600.0, 0.71, SHAPE[1], SHAPE[0], Mask.named("levin"), 21.5)


@pytest.fixture(scope="module")
def bank(camera):
    return learn_bank_for_camera(camera, 0.8, 7.0, 30)


def grain(period_px):
    """Return rings of wood, mean 0 and deviation 1."""
    rows, columns = np.indices(SHAPE)
    bent = 6 * natural_texture(SHAPE, seed=5) + np.hypot(rows + 90.0, columns - 130.0)
    rings = np.sin(2 * np.pi * bent / period_px)
    return (rings - rings.mean()) / rings.std()


def wall(camera, texture, contrast):
    """Return a frame of a wall whose texture, blurred, has about this standard deviation."""
    depth = np.full(SHAPE, WALL_M, np.float32)
    plain = np.full(SHAPE, 0.3, np.float32)
    blurred = render_coded_frame(plain + np.float32(0.05) * texture, depth, camera)
    blurred = 0.3 + contrast * (blurred - blurred.mean()) / blurred.std()
    noise = np.random.default_rng(1).normal(0, NOISE, SHAPE)
    return (blurred + noise).astype(np.float32)


def published(bank, camera, frame, how, periodic):
    """Return the share of pixels with a depth, and of these what is right within 10 %."""
    estimator = DepthEstimator(bank, DepthConfig(regularize=how, check_fit=False), camera)
    work = estimator.run_front(frame)
    if not periodic:
        work.frame_cost = dataclasses.replace(work.frame_cost, periodic=None)
    estimator.run_back(work)
    depth = np.asarray(work.estimate().depth_m)
    estimator.close()
    known = np.isfinite(depth)
    right = np.abs(depth / WALL_M - 1) < 0.1
    return known.mean(), right.sum() / max(known.sum(), 1)


@pytest.mark.parametrize("how", ["learned", "semiglobal"])
@pytest.mark.parametrize(("period_px", "contrast"), [(6, 0.0027), (13, 0.004), (16, 0.0027)])
def test_a_wall_of_wood_is_not_told_to_be_near(bank, camera, how, period_px, contrast):
    frame = wall(camera, grain(period_px), contrast)
    before, right = published(bank, camera, frame, how, periodic=False)
    assert before > 0.15 and right < 0.01  # all of it wrong
    after, _ = published(bank, camera, frame, how, periodic=True)
    assert after < 0.02


@pytest.mark.parametrize("how", ["learned", "semiglobal"])
def test_usual_texture_is_published_as_before(bank, camera, how):
    frame = wall(camera, natural_texture(SHAPE, seed=3), 0.03)
    before, right = published(bank, camera, frame, how, periodic=False)
    after, _ = published(bank, camera, frame, how, periodic=True)
    assert right > 0.9
    assert after > before - 0.02 and before > 0.5


def test_single_patches_are_not_enough():
    grid = PatchGrid.covering((240, 320), 48, 8)
    sizes_px = np.linspace(2, 16, 30)
    count = len(periodic_levels(30))
    volume = np.full((grid.rows, grid.columns, 30), 5, np.float32)
    volume[..., 2] = 0
    periodic = np.full((grid.rows, grid.columns, 2 * count), 5, np.float32)
    periodic[..., -1] = -1  # the last level, with some of the bands
    level = np.full((grid.rows, grid.columns), 2, np.float32)

    usable = np.ones((grid.rows, grid.columns), bool)

    def doubted(periodic, level):
        return may_be_periodic(
            Cost(volume, periodic=periodic),
            usable,
            level,
            SimpleNamespace(blur_sizes_px=sizes_px),
            grid,
        )

    assert doubted(periodic, level).all()
    few = periodic.copy()
    few[:, ::2] = 5
    assert not doubted(few, level).any()
    assert not doubted(periodic, np.full_like(level, 29)).any()  # the same depth
    # Those that say nothing do not count.
    usable[:, ::2] = False
    assert doubted(few, level).all()


@pytest.mark.parametrize("side", [1, -1])
def test_coarse_levels_are_no_other_depth(side):
    grid = PatchGrid.covering((240, 320), 48, 8)
    sizes_px = np.linspace(2, 20, 4) * side
    shape = grid.rows, grid.columns
    volume = np.tile(np.float32([5, 0, 0, 5]), (*shape, 1))
    cost = Cost(volume, periodic=np.full((*shape, 6), 100, np.float32))
    for level in (1.0, 1.5, 2.0):
        found = np.full(shape, level, np.float32)
        assert not may_be_periodic(
            cost, np.ones(shape, bool), found, SimpleNamespace(blur_sizes_px=sizes_px), grid
        ).any()


def test_saturated_lamps_do_not_hide_a_wall_of_wood(bank, camera):
    frame = wall(camera, grain(13), 0.004)
    frame[:, 50::110] = frame[:, 51::110] = frame[:, 52::110] = 1
    before, _ = published(bank, camera, frame, "semiglobal", periodic=False)
    after, _ = published(bank, camera, frame, "semiglobal", periodic=True)
    assert before > 0.2
    assert after < before / 10


def test_only_the_own_levels_are_in_the_volume(bank, camera):
    frame = wall(camera, natural_texture(SHAPE, seed=3), 0.03)
    noise = np.float32(NOISE)
    costs = [bank.plan(SHAPE, 8, periodic=tried).cost(frame, noise) for tried in (True, False)]
    np.testing.assert_allclose(costs[0].volume, costs[1].volume, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(costs[0].misfit, costs[1].misfit, rtol=1e-4, atol=1e-4)
    assert costs[1].periodic is None
    assert costs[0].periodic.shape[-1] == 2 * len(periodic_levels(bank.levels))
