"""Depth from simulated frames whose truth is known, and from frames that cannot be used."""

import dataclasses

import numpy as np
import pytest
from scipy import ndimage
from textures import natural_texture

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth import DepthConfig, DepthEstimator, Levels
from coded_aperture_ros.depth.decoders.edges import DEPTH_EDGE_PX, edge_correction, erode_foreground
from coded_aperture_ros.depth.decoders.posterior import refine_level
from coded_aperture_ros.depth.decoders.regularize import regularizer
from coded_aperture_ros.depth.upsample import MapGrid
from coded_aperture_ros.frames import PatchGrid, estimate_noise, grey_image
from coded_aperture_ros.frames.noise import high_power
from coded_aperture_ros.frames.patches import usable_windows
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank, learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack
from coded_aperture_ros.simulation import render_coded_frame

NEAR_M, FAR_M = 1.0, 2.2
NOISE = 0.002


@pytest.fixture(scope="module")
def camera():
    return Camera(800.0, 0.9, 192, 160, Mask.named("levin"), 20.0)


@pytest.fixture(scope="module")
def bank(camera):
    return learn_bank_for_camera(camera, NEAR_M, FAR_M, 20, LearnConfig(window_px=32))


def with_noise(frame, noise=NOISE, seed=1):
    return (frame + np.random.default_rng(seed).normal(0, noise, frame.shape)).astype(np.float32)


@pytest.fixture(scope="module")
def plane(camera):
    """A plane at 1.5 m: frame and depth."""
    depth = np.full((160, 192), 1.5, np.float32)
    return with_noise(render_coded_frame(natural_texture(depth.shape), depth, camera)), depth


@pytest.fixture(scope="module")
def stairs(camera):
    """Left half at 1.2 m, right half at 2 m."""
    depth = np.full((160, 256), 2.0, np.float32)
    depth[:, :128] = 1.2
    return with_noise(render_coded_frame(natural_texture(depth.shape), depth, camera)), depth


def test_plane_is_found_in_metres(bank, camera, plane):
    frame, depth = plane
    estimate = DepthEstimator(bank, DepthConfig(confidence_threshold=0), camera).estimate(frame)
    assert estimate.depth_m.shape == frame.shape
    assert estimate.depth_m.dtype == estimate.confidence.dtype == np.float32
    assert np.median(np.abs(estimate.depth_m / depth - 1)) < 0.015
    assert np.mean(np.abs(estimate.depth_m / depth - 1) < 0.05) > 0.95
    blur = camera.blur_size_px(1.5)
    assert np.median(estimate.blur_size_px) == pytest.approx(blur, abs=0.15)
    # The bank knows its depths itself; the camera only confirms them.
    without = DepthEstimator(bank, DepthConfig(confidence_threshold=0)).estimate(frame)
    assert without.depth_m == pytest.approx(estimate.depth_m, rel=1e-4)


def test_estimate_between_levels_is_finer_than_the_levels(bank, camera):
    refined, rounded = [], []
    for position in (7.25, 9.5, 10.75, 12.5):
        size = np.interp(position, np.arange(bank.levels), bank.blur_sizes_px)
        depth = np.full((160, 192), camera.depth_m(size), np.float32)
        frame = with_noise(render_coded_frame(natural_texture(depth.shape), depth, camera), 5e-4)
        config = DepthConfig(confidence_threshold=0, noise=6e-4, regularize="semiglobal")
        level = DepthEstimator(bank, config).estimate(frame).level
        refined.append(np.abs(level - position).mean())
        rounded.append(np.abs(np.rint(level) - position).mean())
    assert np.mean(refined) < 0.75 * np.mean(rounded)


def test_two_surfaces_keep_their_depths_apart(bank, stairs):
    frame, depth = stairs
    estimate = DepthEstimator(bank, DepthConfig(confidence_threshold=0)).estimate(frame)
    error = np.abs(estimate.depth_m / depth - 1)
    away = np.abs(np.arange(256) - 127.5) > 24
    assert np.mean(error[:, away] < 0.05) > 0.93
    # At most a few columns of in-between depths: no ramp across the edge.
    between = (estimate.depth_m > 1.35) & (estimate.depth_m < 1.75)
    assert between.mean() < 0.08


# In whole numbers of 8 bits, a difference in the last digit may change a number by one.
@pytest.mark.parametrize(("network", "exactly"), [("opencv", 1e-3), ("onnxruntime", 0.1)])
def test_brightness_and_colour_do_not_change_the_level(bank, plane, network, exactly):
    if network == "onnxruntime":
        pytest.importorskip("onnxruntime")
    frame, _ = plane
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0, network=network))
    level = estimator.estimate(frame).level
    darker = estimator.estimate(0.5 * frame).level
    assert np.mean(np.abs(darker - level) < 0.5) > 0.95
    coloured = estimator.estimate(np.repeat(frame[..., None], 3, axis=2)).level
    assert coloured == pytest.approx(level, abs=exactly)


@pytest.mark.parametrize("regularize", ["semiglobal", "tv", "graphcut"])
def test_regularisation_helps_against_noise(bank, stairs, regularize):
    frame, depth = stairs
    # How many there are differs from one noise to the next.
    noisy = [with_noise(frame, 0.01, seed) for seed in range(4)]

    def outliers(method):
        config = DepthConfig(confidence_threshold=0, regularize=method)
        estimator = DepthEstimator(bank, config)
        levels = np.array([estimator.estimate(each).depth_m for each in noisy])
        return np.mean(np.abs(levels / depth - 1) > 0.1)

    assert outliers(regularize) < 0.8 * outliers("none")


@pytest.mark.parametrize("regularize", ["semiglobal", "graphcut"])
def test_regularisation_of_no_strength_changes_nothing(bank, plane, regularize):
    frame, _ = plane
    free = DepthEstimator(bank, DepthConfig(regularize="none")).estimate(frame)
    cut = DepthEstimator(bank, DepthConfig(regularize=regularize, smoothness=0)).estimate(frame)
    known = np.isfinite(free.level)
    assert cut.level[known] == pytest.approx(free.level[known], abs=1e-4)


@pytest.mark.parametrize("smoothness", [1.0, 5.0, 20.0])
def test_total_variation_stays_in_the_range_of_levels(smoothness):
    random, levels = np.random.default_rng(0), 12
    for _ in range(10):
        true = random.integers(0, 2, (9, 14, 1)) * (levels - 1)
        energies = (10 * np.abs(np.arange(levels) - true)).astype(np.float32)
        regularize = regularizer("tv", smoothness)
        level = regularize(energies / 2, energies / 2, None, 8)
        assert level.dtype == np.float32
        assert level.min() >= 0
        assert level.max() <= levels - 1


@pytest.mark.parametrize("mask_mm", [0.0, 20.0])
def test_scene_in_front_of_the_focal_plane(mask_mm):
    """Negative blur sizes, the mask turned by 180 degrees; also with the mask off the lens."""
    others = {"lens_mask_distance_mm": mask_mm, "side": "near"}
    camera = Camera(800.0, 3.0, 192, 160, Mask.named("zhou"), 20.0, **others)
    near_side = learn_bank_for_camera(camera, NEAR_M, FAR_M, 20, LearnConfig(window_px=32))
    assert (near_side.blur_sizes_px < 0).all()
    depth = np.full((160, 256), 2.0, np.float32)
    depth[:, :128] = 1.2
    frame = with_noise(render_coded_frame(natural_texture(depth.shape), depth, camera))
    for given in (camera, None):
        config = DepthConfig(confidence_threshold=0)
        estimate = DepthEstimator(near_side, config, given).estimate(frame)
        error = np.abs(estimate.depth_m / depth - 1)
        away = np.abs(np.arange(256) - 127.5) > 24
        assert np.mean(error[:, away] < 0.05) > 0.9
        assert (estimate.blur_size_px < 0).all()


def test_missing_maxflow_is_one_clear_line(bank, plane, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "maxflow.fastmin", None)
    with pytest.raises(InputError, match="needs PyMaxflow"):
        DepthEstimator(bank, DepthConfig(regularize="graphcut")).estimate(plane[0])


@pytest.mark.parametrize("regularize", ["semiglobal", "learned"])
def test_confidence_tells_right_from_wrong(bank, camera, regularize):
    """Texture on the left, almost nothing but noise on the right."""
    depth = np.full((160, 256), 1.5, np.float32)
    texture = natural_texture(depth.shape)
    texture[:, 128:] = 0.4 + 0.002 * (texture[:, 128:] - 0.4)
    frame = with_noise(render_coded_frame(texture, depth, camera))
    config = DepthConfig(confidence_threshold=0, regularize=regularize)
    estimate = DepthEstimator(bank, config).estimate(frame)
    confidence = estimate.confidence
    assert (confidence.min() >= 0) and (confidence.max() <= 1)
    assert np.median(confidence[:, :96]) > 0.7
    # The network goes on with what is around, and is a little surer that it is so.
    assert np.median(confidence[:, 176:]) < (0.35 if regularize == "learned" else 0.3)
    thresholded = estimate.where_confident(0.5)
    assert np.isfinite(thresholded.depth_m[:, :96]).mean() > 0.9
    assert np.isfinite(thresholded.depth_m[:, 176:]).mean() < 0.1
    assert np.array_equal(np.isnan(thresholded.depth_m), np.isnan(thresholded.level))


@pytest.mark.parametrize("regularize", ["semiglobal", "learned"])
def test_deviation_is_about_that_of_the_levels(bank, camera, stairs, regularize):
    frame, depth = stairs
    config = DepthConfig(confidence_threshold=0, regularize=regularize)
    estimate = DepthEstimator(bank, config).estimate(frame)
    deviation = estimate.std_dev_m
    assert deviation.shape == depth.shape and deviation.dtype == np.float32
    assert (deviation > 0).all()
    away = np.abs(np.arange(256) - 127.5) > 24
    error = np.abs(estimate.depth_m - depth)
    assert np.mean((error < deviation)[:, away]) > 0.6
    assert np.mean((error < 3 * deviation)[:, away]) > 0.9
    # Inverse depth is linear in the blur size: what is 5/3 as far is known (3/5)^2 as well. The
    # network may know one of the blur sizes better than the other.
    ratio = np.median(deviation[:, 160:]) / np.median(deviation[:, :96])
    assert ratio > (2 / 1.2) ** (2 if regularize == "semiglobal" else 1)
    noisy = DepthEstimator(bank, config).estimate(with_noise(frame, 0.01))
    assert np.median(noisy.std_dev_m[:, :96]) > 1.2 * np.median(deviation[:, :96])


def test_deviation_is_known_where_depth_is(bank, stairs):
    estimate = DepthEstimator(bank, DepthConfig(confidence_threshold=0)).estimate(stairs[0])
    some = estimate.where_confident(float(np.median(estimate.confidence)))
    unknown = np.isnan(some.depth_m)
    assert 0.2 < unknown.mean() < 0.8
    assert np.array_equal(np.isnan(some.std_dev_m), unknown)
    assert estimate.enlarged((320, 512)).std_dev_m.shape == (320, 512)
    careful = DepthEstimator(bank, DepthConfig(confidence_threshold=0.7, unknown="nearest"))
    assert np.isfinite(careful.estimate(stairs[0]).std_dev_m).all()


def test_deviation_in_metres_follows_the_camera(bank, camera):
    """`z^2 |d(1 / z) / d level|` times the deviation, and +inf at and beyond infinity."""
    level = np.linspace(1, bank.levels - 2, 50).astype(np.float32)
    sizes = np.interp(level, np.arange(bank.levels), bank.blur_sizes_px)
    step = 0.1 * (bank.blur_sizes_px[1] - bank.blur_sizes_px[0])
    changed = np.abs(camera.depth_m(sizes + step) - camera.depth_m(sizes - step)) / 2
    for levels in (Levels.from_model(bank, camera), Levels.from_model(bank)):
        *_, found = levels.metric_maps(level, np.full_like(level, 0.1), np.zeros(50, bool))
        assert found.dtype == np.float32
        assert found == pytest.approx(changed, rel=0.02)
    infinity = camera.blur_at_infinity_px
    sizes = np.linspace(0.5, 1.2, 8) * infinity
    beyond = dataclasses.replace(bank, stack=render_psf_stack(camera.mask, sizes))
    level = np.arange(8, dtype=np.float32)
    *_, found = Levels.from_model(beyond, camera).metric_maps(
        level, np.ones(8, "f4"), np.zeros(8, bool)
    )
    assert np.array_equal(np.isinf(found), sizes >= infinity)
    assert np.all(np.diff(found[:5]) > 0)


@pytest.mark.parametrize(("true", "at_most"), [(0.0, 0.0024), (0.003, 0.0048), (0.01, 0.013)])
def test_noise_is_estimated_and_errs_upward(bank, camera, true, at_most):
    """The more noise, the less of it can be texture; without any, some texture counts as noise."""
    depth = np.full((160, 192), 1.8, np.float32)
    frame = render_coded_frame(natural_texture(depth.shape), depth, camera)
    grid = PatchGrid.covering(frame.shape, bank.window_px, 8)
    noise = estimate_noise(high_power(with_noise(frame, true), grid))
    assert true < noise <= at_most


def test_noise_is_that_of_one_channel(bank, plane):
    """Three channels with noise of their own are seen as their mean, with less noise."""
    frame, _ = plane
    random = np.random.default_rng(5)
    colour = frame[..., None] + random.normal(0, 0.01, (*frame.shape, 3)).astype(np.float32)
    estimated = DepthEstimator(bank).estimate(colour)
    given = DepthEstimator(bank, DepthConfig(noise=estimated.noise)).estimate(colour)
    assert 0.01 < estimated.noise < 0.015
    assert given.confidence == pytest.approx(estimated.confidence, abs=0.01)


def test_bank_of_another_mask_is_refused(bank, camera):
    other = dataclasses.replace(camera, mask=Mask.named("zhou"))
    with pytest.raises(InputError, match=r"mask zhou is not the one .*mask levin"):
        DepthEstimator(bank, camera=other)


def test_bank_of_the_other_side_is_refused(bank, camera):
    other = dataclasses.replace(camera, focus_distance_m=3.0, side="near")
    with pytest.raises(InputError, match="side is near, but the bank"):
        DepthEstimator(bank, camera=other)


def test_measured_psfs_say_their_depths_themselves(bank, camera, plane):
    """A camera file knows nothing of PSFs without sizes, and less than measured depths."""
    indices = dataclasses.replace(
        bank.stack, blur_sizes_px=np.arange(20.0), depths_m=None, in_pixels=False
    )
    unknown = dataclasses.replace(bank, stack=indices, mask_digest="")
    with pytest.raises(InputError, match=r"without their sizes.*--depths"):
        DepthEstimator(unknown, camera=camera)
    everything = DepthConfig(confidence_threshold=0)
    estimate = DepthEstimator(unknown, everything).estimate(plane[0])
    assert estimate.depth_m is None and estimate.std_dev_m is None
    depths = 2 * bank.stack.depths_m
    measured = dataclasses.replace(unknown, stack=dataclasses.replace(indices, depths_m=depths))
    estimate = DepthEstimator(measured, everything, camera).estimate(plane[0])
    assert np.median(estimate.depth_m) == pytest.approx(3.0, rel=0.02)


def test_given_noise_is_used(bank, plane):
    assert DepthEstimator(bank, DepthConfig(noise=0.02)).estimate(plane[0]).noise == 0.02
    of_bank = dataclasses.replace(bank, noise=0.03)
    assert DepthEstimator(of_bank).estimate(plane[0]).noise == 0.03


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0, np.nan, np.inf])
def test_frame_of_one_value_has_no_depth(bank, value):
    estimate = DepthEstimator(bank).estimate(np.full((96, 96, 3), value, np.float32))
    assert np.isnan(estimate.depth_m).all()
    assert np.isnan(estimate.level).all()
    assert not estimate.confidence.any()


@pytest.mark.parametrize("bad", [np.nan, 1.0, -np.inf, -1e30])
def test_unusable_pixels_spoil_only_their_surroundings(bank, plane, bad):
    frame, depth = plane[0].copy(), plane[1]
    frame[60:100, 80:120] = bad
    frame[20, 20] = bad
    estimate = DepthEstimator(bank).estimate(frame)
    assert np.isnan(estimate.depth_m[70:90, 90:110]).all()
    assert not estimate.confidence[70:90, 90:110].any()
    known = np.isfinite(estimate.depth_m)
    assert known[:, :48].mean() > 0.9
    assert np.median(np.abs(estimate.depth_m[known] / depth[known] - 1)) < 0.02


def test_filled_pixels_do_not_count_as_a_frame_without_noise(bank, camera):
    depth = np.full((160, 192), 1.5, np.float32)
    frame = with_noise(render_coded_frame(natural_texture(depth.shape), depth, camera), 0.01)
    frame[:, :64] = 1
    assert DepthEstimator(bank).estimate(frame).noise > 0.01


@pytest.mark.parametrize("regularize", ["none", "semiglobal", "tv", "graphcut"])
def test_smallest_frame_has_maps_of_single_precision(bank, plane, regularize):
    frame = plane[0][:32, :32]
    config = DepthConfig(confidence_threshold=0, regularize=regularize)
    estimate = DepthEstimator(bank, config).estimate(frame)
    for values in (estimate.level, estimate.blur_size_px, estimate.depth_m, estimate.confidence):
        assert (values.shape, values.dtype) == ((32, 32), np.float32)


def test_filled_pixels_have_the_mean_of_their_surroundings():
    frame = np.full((40, 40), 0.25, np.float32)
    frame[10:13, 10:13] = np.nan
    grey, unusable = grey_image(frame, 0.995)
    assert grey == pytest.approx(np.full((40, 40), 0.25))
    assert unusable.sum() == 9
    assert grey_image(np.full((4, 4), 0.3, np.float32), 0.995)[1] is None
    windows = usable_windows(unusable, PatchGrid.covering((40, 40), 16, 8))
    assert windows.tolist() == [
        [False, False, True, True],
        [False, True, True, True],  # the lower right one has a single bad pixel of 64
        [True] * 4,
        [True] * 4,
    ]


def test_smaller_maps_cover_the_whole_frame(bank, stairs):
    frame, _ = stairs
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0))
    full, half = estimator.estimate(frame), estimator.estimate(frame, (80, 128))
    assert half.depth_m.shape == (80, 128)
    assert np.mean(np.abs(full.level[::2, ::2] - half.level) < 0.3) > 0.9


def test_upsampling_interpolates_on_a_surface_and_not_across_an_edge():
    grid = PatchGrid(top=0, left=0, stride_px=8, rows=1, columns=4, window_px=8)
    level = np.array([[0.0, 1.0, 9.0, 9.5]], np.float32)
    at = MapGrid.for_map(grid, (8, 40), (8, 40))
    row = at.interpolate(level)[4]
    centres = grid.column_centres
    assert row[centres] == pytest.approx([0, 1, 9, 9.5])
    assert row[centres[0] : centres[1] + 1] == pytest.approx(np.linspace(0, 1, 9), abs=1e-5)
    assert set(np.unique(row[centres[1] : centres[2] + 1])) == {1.0, 9.0}
    assert row[centres[3] :] == pytest.approx(9.5)
    rows, columns = at.patches
    assert set(rows) == {0}
    assert columns[centres].tolist() == [0, 1, 2, 3]


def fattened(level, reach):
    """Return what windows make of a level map: the sharper surface wins within their reach."""
    return ndimage.minimum_filter(level, 2 * reach + 1, mode="nearest")


def test_trimming_undoes_what_windows_do_at_an_edge():
    true = np.full((60, 80), 20, np.float32)
    true[:, :30] = 5
    true[40:, :] = 5
    seen = fattened(true, 6)
    assert np.count_nonzero(seen != true) > 200
    assert np.array_equal(erode_foreground(seen, 6, 9, 3.0), true)
    assert np.array_equal(erode_foreground(seen, 0, 9, 3.0), seen)


def test_trimming_leaves_thin_obstacles_specks_and_slants():
    thin = np.full((60, 80), 20, np.float32)
    thin[:, 40:44] = 5
    seen = fattened(thin, 3)
    assert np.array_equal(erode_foreground(seen, 6, 9, 3.0), seen)
    speck = np.full((60, 80), 5, np.float32)
    speck[30:33, 40:43] = 20
    assert np.array_equal(erode_foreground(speck, 6, 9, 3.0), speck)
    slant = np.broadcast_to(np.linspace(0, 20, 80, dtype=np.float32), (60, 80)).copy()
    assert np.array_equal(erode_foreground(slant, 6, 9, 3.0), slant)


def test_two_threads_trim_as_one_does(bank):
    """Each has half of the map, and what is around it."""
    random = np.random.default_rng(2)
    level = ndimage.zoom(random.uniform(0, 19, (12, 9)), 10, order=0).astype(np.float32)
    whole = edge_correction(bank, 0.8, Workers(1))(level, 1.0)
    assert np.count_nonzero(whole != level) > 1000
    for cut in (level, level[:37], level[:1]):
        steps = np.abs(np.diff(bank.blur_sizes_px)).mean()
        reach_px = round(min(bank.fattening * 0.8, 1.0) * bank.window_px)
        expected = erode_foreground(cut, reach_px, 15, DEPTH_EDGE_PX / steps)
        assert np.array_equal(edge_correction(bank, 0.8, Workers(2))(cut, 1.0), expected)


def test_background_is_found_nearer_to_an_edge_with_trimming(bank, stairs):
    """The near plane ends at column 128; where does the map end it?"""
    frame, _ = stairs

    def edge(edge_correction):
        config = DepthConfig(
            confidence_threshold=0, regularize="semiglobal", edge_correction=edge_correction
        )
        depth = DepthEstimator(bank, config).estimate(frame).depth_m
        return np.median((depth < 1.55).sum(axis=1))

    assert edge(0.0) > 132
    assert abs(edge(0.2) - 128) < abs(edge(0.0) - 128) - 2


def test_shot_noise_may_be_told(bank, camera):
    """Bright rows are noisier than dark ones; told so, the dark ones are not drowned."""
    depth = np.full((160, 256), 1.5, np.float32)
    texture = natural_texture(depth.shape, contrast=4e-4)
    texture = np.clip(texture - 0.4, -0.04, 0.04)
    texture += np.where(np.arange(256) < 128, 0.05, 0.8).astype(np.float32)
    frame = render_coded_frame(texture, depth, camera)
    gain, read = 1e-4, 0.001
    variance = read**2 + gain * np.clip(frame, 0, None)
    noise = np.random.default_rng(4).normal(0, 1, frame.shape)
    frame = (frame + np.sqrt(variance) * noise).astype(np.float32)

    def found(**noise):
        config = DepthConfig(confidence_threshold=0, regularize="none", **noise)
        estimate = DepthEstimator(bank, config).estimate(frame)
        return np.mean(np.abs(estimate.depth_m / depth - 1)[:, :104] < 0.05), estimate.noise

    told, read_found = found(noise_gain=gain)
    assert read < read_found < 3 * read
    # The noise of the bright half, taken for that of the whole frame, hides the dark texture.
    assert told > found(noise=float(np.sqrt(gain * 0.8)))[0] + 0.05


def test_parabola_finds_the_vertex_and_keeps_to_the_range():
    levels = np.arange(7.0)
    for vertex in (2.0, 2.3, 3.49):
        energies = (3 * (levels - vertex) ** 2)[None, None].astype(np.float32)
        assert refine_level(energies, energies.argmin(-1)) == pytest.approx(vertex, abs=1e-5)
    for vertex, end in ((-2.0, 0.0), (9.0, 6.0)):
        energies = ((levels - vertex) ** 2)[None, None].astype(np.float32)
        assert refine_level(energies, energies.argmin(-1)) == pytest.approx(end)


def test_wrong_input_is_refused(bank, camera):
    estimator = DepthEstimator(bank)
    with pytest.raises(InputError, match="smaller than the bank's 32 px window"):
        estimator.estimate(np.zeros((31, 64), np.float32))
    with pytest.raises(InputError, match=r"\[rows, columns, 3\], got \[64, 64, 4\]"):
        estimator.estimate(np.zeros((64, 64, 4), np.float32))
    with pytest.raises(InputError, match="expected at least 1x1"):
        estimator.estimate(np.zeros((64, 64), np.float32), (0, 8))
    with pytest.raises(InputError, match="floating values"):
        estimator.estimate(np.zeros((64, 64), np.uint8))
    with pytest.raises(InputError, match="stride_px"):
        DepthConfig(stride_px=-1)
    with pytest.raises(InputError, match="one of none, semiglobal, tv, graphcut, learned"):
        DepthConfig(regularize="magic")
    weak = Camera(800.0, 0.9, 192, 160, camera.mask, 1.0)
    with pytest.raises(InputError, match="learn the bank for this camera"):
        DepthEstimator(bank, camera=weak)


@pytest.mark.parametrize("name", ["noise", "least_noise", "noise_gain", "smoothness"])
@pytest.mark.parametrize("regularize", ["learned", "semiglobal"])
def test_options_may_be_numbers_of_numpy(name, regularize):
    bank = learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(1, 10, 24)))
    frame = np.random.default_rng(0).random((96, 128), np.float32)

    def estimated(value):
        config = DepthConfig(regularize=regularize, confidence_threshold=0.0, **{name: value})
        return DepthEstimator(bank, config).estimate(frame)

    of_python, of_numpy = estimated(0.01), estimated(np.float64(0.01))
    np.testing.assert_array_equal(of_numpy.level, of_python.level)
    assert of_numpy.confidence.dtype == np.float32
