"""Depth through masks of a few equal holes: holes, neighbours, levels, and what is refused."""

import json

import numpy as np
import pytest
from cli_scene import call, camera_file, texture
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.thesis.planes import TABLE_5_1, make_planes
from coded_aperture_benchmarks.thesis.reference.conditional import conditional_levels
from coded_aperture_benchmarks.thesis.stair import blur_stack
from scipy.signal import fftconvolve

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood.two_pixel import (
    TwoPixelConfig,
    find_holes,
    neighbour_lines,
    two_pixel_model,
    two_pixel_model_for_camera,
)
from coded_aperture_ros.likelihood.two_pixel.likelihood import TwoPixelEngine
from coded_aperture_ros.likelihood.two_pixel.model import channel_kernel
from coded_aperture_ros.optics import Mask, load_camera, render_psf, render_psf_stack

BARE = DepthConfig(regularize="none", edge_correction=0.0, confidence_threshold=0.0, saturation=2.0)
THREE_UNEQUAL = ["1100", "0000", "1001"]


def test_holes_of_the_named_masks_lie_where_they_were_cut():
    holes = find_holes(Mask.named("two_hole"))
    assert holes.count == 2
    assert holes.side == pytest.approx(8 / 34)
    np.testing.assert_allclose(sorted(holes.centres[:, 1]), [-13 / 34, 13 / 34], atol=1e-9)
    np.testing.assert_allclose(holes.centres[:, 0], 0, atol=1e-9)


@pytest.mark.parametrize(("name", "count"), [("two_hole", 2), ("three_hole", 3), ("four_hole", 4)])
def test_there_are_n_times_n_minus_1_offsets_in_pairs(name, count):
    offsets = find_holes(Mask.named(name)).offsets
    assert offsets.shape == (count * (count - 1), 2)  # eq. 5.19
    np.testing.assert_allclose(offsets.sum(axis=0), 0, atol=1e-12)


def test_round_holes_of_a_drawn_mask_are_equal():
    rows, columns = np.mgrid[:60, :60]
    picture = np.zeros((60, 60), np.float32)
    for row, column in ((12.2, 14.0), (44.0, 40.7)):
        picture += np.clip(8 - np.hypot(rows - row, columns - column), 0, 1)
    assert find_holes(Mask("drawn", picture)).count == 2


@pytest.mark.parametrize(
    ("mask", "said"),
    [
        (Mask.named("disc"), "mask disc: it has one opening"),
        (Mask.named("annulus"), "mask annulus: it has one opening"),
        (Mask.named("levin"), "mask levin: "),
        (Mask.from_rows(THREE_UNEQUAL, "cut"), "mask cut: its 3 openings are not equal, opening"),
        (Mask.from_rows(["10101", "00000", "10101", "00000", "10101"]), "9 openings"),
    ],
    ids=["disc", "annulus", "levin", "unequal", "nine"],
)
def test_other_masks_are_refused_with_the_reason(mask, said):
    with pytest.raises(InputError, match="--method bank") as error:
        find_holes(mask)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("count", "lines"), [(2, 1), (3, 3), (4, 6), (5, 10)])
def test_work_grows_with_the_pairs_of_holes_and_not_with_the_window(count, lines):
    cells = np.zeros((24, 24), np.float32)
    # In general position, so that no two pairs of them are parallel.
    for row, column in ((0, 3), (5, 19), (19, 7), (14, 0), (2, 12))[:count]:
        cells[row : row + 4, column : column + 4] = 1
    mask = Mask("scattered", cells)
    stack = blur_stack(mask, 4)
    models = [two_pixel_model(stack, mask, TwoPixelConfig(window_px=px)) for px in (48, 96)]
    assert [len(model.lines) for model in models] == [lines, lines]
    assert len({model.derivatives * len(model.lags) for model in models}) == 1


def test_parallel_pairs_share_a_line_and_others_do_not():
    lines = {
        name: neighbour_lines(find_holes(Mask.named(name)), 30.0)
        for name in ("two_hole", "three_hole", "four_hole")
    }
    assert [len(of_mask) for of_mask in lines.values()] == [1, 3, 2]
    # Two pairs are parallel, but the fifth hole is part of neither.
    fifth = Mask.from_rows(["1010001", "0000000", "0101000"])
    assert len(neighbour_lines(find_holes(fifth), 30.0)) > 4
    scattered = Mask.from_rows(["1000000", "0000010", "0000000", "0000000", "0100001"])
    assert len(neighbour_lines(find_holes(scattered), 30.0)) == 6
    (line,) = lines["two_hole"]
    np.testing.assert_array_equal(line.lags[:, 0], 0)
    # The disparity of the largest blur, and half a hole.
    assert line.lags[-1, 1] == np.ceil(30 * 26 / 34 + 30 * 4 / 34)


def test_every_pair_of_a_slanted_line_has_its_own_lag():
    line = neighbour_lines(find_holes(Mask.named("three_hole")), 30.0)[1]
    lags = line.lags[line.pair_lags]
    between = line.positions[:, None] - line.positions[None, :]
    np.testing.assert_array_equal(np.abs(lags), np.abs(between))
    assert len(line.lags) < 2 * len(line.positions)


@pytest.mark.parametrize("channel", range(4))
def test_a_channel_passes_the_power_that_it_says(channel):
    kernel = channel_kernel(channel, np.array([1.0, 0.5]), 2)
    white = np.random.default_rng(0).standard_normal((128, 128))
    kept = fftconvolve(white, kernel[::-1, ::-1], mode="valid")
    assert kernel.sum() == pytest.approx(0, abs=1e-6)
    # The slope of a ramp is what a difference says, however much it is averaged.
    rows, columns = np.mgrid[: len(kernel), : len(kernel)]
    slope = {0: columns, 1: rows, 2: (rows + columns) / 2, 3: (rows - columns) / 2}[channel]
    assert (kernel * slope).sum() == pytest.approx(1, abs=1e-6)
    full = np.abs(np.fft.rfft2(kernel, (64, 64))) ** 2
    mirrored = np.concatenate([full, full[:, 1:-1]], axis=1)
    assert kept.var() == pytest.approx(mirrored.mean(), rel=0.1)


def test_measured_covariances_are_the_mean_products_of_the_window():
    mask = Mask.named("three_hole")
    model = two_pixel_model(render_psf_stack(mask, [8.0, 12.0]), mask, TwoPixelConfig(window_px=32))
    grey = np.random.default_rng(0).random((80, 96), dtype=np.float32)
    engine = TwoPixelEngine(model, grey.shape, 16)
    engine.project(grey)
    half = 16
    # What the widest kernel sees only in part does not count.
    reach = max(len(kernel) // 2 for kernel in model.kernels[0])
    inside = np.s_[reach:-reach, reach:-reach]
    for patch in ((1, 2), (0, 0)):
        row, column = engine.grid.row_centres[patch[0]], engine.grid.column_centres[patch[1]]
        start = 0
        for line, kernel in zip(model.lines, model.kernels[0], strict=True):
            padded = np.pad(grey.astype(float), len(kernel) // 2)
            windows = np.lib.stride_tricks.sliding_window_view(padded, kernel.shape)
            passed = np.full(np.array(grey.shape) + 64, np.nan)
            passed[32:-32, 32:-32][inside] = (windows * kernel).sum(axis=(2, 3))[inside]
            for place, (down, right) in enumerate(line.lags, start):
                top, left = row - half - int(down / 2) + 32, column - half - int(right / 2) + 32
                ends = top + down, left + right
                first = passed[top : top + 32, left : left + 32]
                second = passed[ends[0] : ends[0] + 32, ends[1] : ends[1] + 32]
                measured = engine._covariances[place].reshape(engine.grid.rows, -1)[patch]
                assert measured == pytest.approx(np.nanmean(first * second), abs=1e-5)
            start += len(line.lags)
        assert start == len(model.lags) > 20


def test_two_threads_and_another_window_grid_give_the_same_energies():
    mask = Mask.named("four_hole")
    model = two_pixel_model(blur_stack(mask, 6), mask, TwoPixelConfig(window_px=48))
    grey = texture(128, 176)
    one, fine = TwoPixelEngine(model, grey.shape, 16), TwoPixelEngine(model, grey.shape, 4)
    for engine in (one, fine):
        engine.project(grey)
    # The windows of both lie at the same pixels, 16 and 4 apart.
    assert (one.grid.top, one.grid.left) == (fine.grid.top, fine.grid.left) == (0, 0)
    coarse, dense = one.energies(0.002), fine.energies(0.002)
    np.testing.assert_allclose(dense[::4, ::4], coarse, rtol=1e-3)


def planes_error(mask, planes, levels, window_px):
    model = two_pixel_model(blur_stack(mask, levels), mask, TwoPixelConfig(window_px=window_px))
    estimator = DepthEstimator(model, BARE)
    inner = (slice(30, -30), slice(30, -30))
    estimates = [estimator.estimate(coded).level[inner] for coded in planes.coded]
    return float(np.mean([np.abs(level - i).mean() for i, level in enumerate(estimates)]))


@pytest.mark.parametrize("name", ["two_hole", "three_hole", "four_hole"])
def test_a_quarter_of_the_error_of_table_5_1(name):
    mask = Mask.named(name)
    planes = make_planes(mask, load_textures("random"), seed=3, side_px=112)
    error = planes_error(mask, planes, 33, 64)
    assert error < TABLE_5_1["two_pixel"][name] / 4
    assert error < 0.3


def test_natural_texture_under_noise():
    mask = Mask.named("two_hole")
    planes = make_planes(mask, load_textures("natural"), 0.001, 1, 16, 144)
    assert planes_error(mask, planes, 16, 96) < 0.8


def test_fractional_disparities_are_told_apart():
    mask = Mask.named("two_hole")
    # A level is a fifth of a pixel of disparity.
    sizes = np.linspace(14, 16.6, 11)
    model = two_pixel_model(render_psf_stack(mask, sizes), mask, TwoPixelConfig(window_px=64))
    estimator = DepthEstimator(model, BARE)
    sharp = load_textures("random").crops(1, 140, 140, np.random.default_rng(0))[0]
    for level in (2, 5, 8):
        coded = fftconvolve(sharp, render_psf(mask, sizes[level], 19), mode="valid")
        found = estimator.estimate(coded.astype(np.float32)).level
        assert np.median(np.abs(found - level)) < 1


def test_the_data_term_of_the_thesis_finds_white_texture_behind_two_holes():
    mask = Mask.named("two_hole")
    stack = blur_stack(mask, 9)
    planes = make_planes(mask, load_textures("random"), levels=9, side_px=112)
    holes = find_holes(mask)
    found = [
        conditional_levels(coded, holes, stack.blur_sizes_px, 64)[30:-30, 30:-30]
        for coded in planes.coded
    ]
    assert np.mean([np.abs(level - i).mean() for i, level in enumerate(found)]) < 0.6
    with pytest.raises(InputError, match="at least 64 px"):
        conditional_levels(planes.coded[0][:50], holes, stack.blur_sizes_px, 64)


def test_metric_depth_of_a_wall_and_the_same_confidence(tmp_path):
    camera = load_camera(camera_file(tmp_path, mask={"name": "two_hole"}))
    model = two_pixel_model_for_camera(camera, 1.6, 3.0, 12)
    estimator = DepthEstimator(model, DepthConfig(), camera)
    psf = render_psf(camera.mask, float(camera.blur_size_px(2.0)))
    coded = fftconvolve(texture(160, 200), psf, mode="valid").astype(np.float32)
    coded += 0.001 * np.random.default_rng(0).standard_normal(coded.shape, dtype=np.float32)
    estimate = estimator.estimate(coded)
    known = np.isfinite(estimate.depth_m)
    assert known.mean() > 0.7
    assert np.median(estimate.depth_m[known]) == pytest.approx(2.0, rel=0.03)
    assert 0.4 < np.median(estimate.confidence) <= 0.87
    colour = estimator.estimate(np.stack([coded] * 3, axis=-1))
    assert colour.level.shape == coded.shape
    flat = estimator.estimate(np.full((120, 160), 0.5, np.float32))
    assert np.isnan(flat.depth_m).all()


@pytest.mark.parametrize(
    ("sizes", "config", "said"),
    [
        ([-8.0, 8.0], {}, "focus lies inside the range"),
        ([8.0, 60.0], {}, "more than the window of 48 px"),
        ([8.0, 12.0, 10.0], {}, "in order"),
        ([8.0], {}, "at least 2 levels"),
        ([8.0, 12.0], {"window_px": 44}, "use 40 or 48"),
    ],
)
def test_levels_that_cannot_be_are_refused(sizes, config, said):
    mask = Mask.named("two_hole")
    with pytest.raises(InputError, match=said):
        two_pixel_model(render_psf_stack(mask, sizes), mask, TwoPixelConfig(**config))


def coded_file(folder):
    path = folder / "coded.npy"
    psf = render_psf(Mask.named("three_hole"), 8.0)
    np.save(path, fftconvolve(texture(), psf, mode="same").astype(np.float32))
    return path


def test_command_line(tmp_path, capsys):
    camera = camera_file(tmp_path, mask={"name": "three_hole"})
    options = (
        "--method",
        "two_pixel",
        "--camera",
        camera,
        "--depth-range",
        1.6,
        3,
        "--level-count",
    )
    output = tmp_path / "depth.npy"
    result = call(capsys, "depth", *options, 12, coded_file(tmp_path), "-o", output, "--json")
    assert result.status == 0, result.err
    (summary,) = json.loads(result.out)
    assert summary["unit"] == "m"
    # Blur of 8 px: z = 16 / (16 - 8) m.
    assert summary["median"] == pytest.approx(2.0, rel=0.05)
    assert np.load(output.with_suffix(".confidence.npy")).shape == np.load(output).shape


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (("--method", "two_pixel"), 2, "--camera"),
        (("--method", "two_pixel", "--camera", "CAMERA"), 2, "--depth-range"),
        (("--method", "two_pixel", "--bank", "b.npz"), 2, "--bank: not with --method two_pixel"),
        ((), 2, "--bank"),
        (("--bank", "b.npz", "--depth-range", 1, 2), 2, "only with --method two_pixel"),
        (("--method", "two_pixel", "--camera", "LEVIN", "--depth-range", 1.6, 3), 1, "mask levin"),
        (
            ("--method", "two_pixel", "--camera", "CAMERA", "--depth-range", 0.8, 3),
            1,
            "focus at 1 m",
        ),
    ],
)
def test_command_line_refuses_in_one_line(tmp_path, capsys, arguments, status, said):
    files = {
        "CAMERA": camera_file(tmp_path, "two.yaml", mask={"name": "two_hole"}),
        "LEVIN": camera_file(tmp_path, "levin.yaml"),
    }
    words = [files.get(word, word) for word in arguments]
    result = call(capsys, "depth", *words, coded_file(tmp_path), "-o", tmp_path / "depth.npy")
    assert result.status == status
    assert said in result.err.strip().splitlines()[-1]
    assert "Traceback" not in result.err


@pytest.mark.slow
def test_benchmark_of_accuracy(capsys):
    options = ("--cases", "random,0.0001", "--masks", "two_hole", "--levels", 8, "--side", 96)
    arguments = ("bench", "accuracy", "two_pixel", *options, "--window", 48, "--jobs", 1)
    result = call(capsys, *arguments, "--methods", "two_pixel", "bank", "--json")
    assert result.status == 0, result.err
    two_pixel, bank = json.loads(result.out)["cells"]
    assert (two_pixel["method"], bank["method"]) == ("two_pixel", "bank")
    assert two_pixel["mean_error"] < 0.5
    assert two_pixel["thesis_mean_error"] is None  # there are 33 levels in the thesis
    assert "two_hole" in call(capsys, *arguments, "--methods", "two_pixel").out
    assert call(capsys, *arguments, "--methods", "simples").status == 2
    assert "one opening" in call(capsys, *arguments, "--masks", "disc").err
