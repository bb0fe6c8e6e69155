"""Both sides of the focal plane: the phase of a frame tells them apart, its power does not."""

import dataclasses
import json

import numpy as np
import pytest
import yaml
from cli_scene import call, call_benchmarks
from coded_aperture_benchmarks.datasets.sides import SideEstimates, SideFrame, SideScore
from coded_aperture_benchmarks.datasets.textures import load_textures
from scipy.signal import fftconvolve

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator, Layer, side_warning
from coded_aperture_ros.depth.decoders.sides import (
    SideFinder,
    condition_on_side,
    far_log_odds,
    side_confidence,
)
from coded_aperture_ros.depth.stages.decode import SIDE
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.io import write_image
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank_for_camera
from coded_aperture_ros.likelihood.motion import MotionConfig, learn_motion_bank
from coded_aperture_ros.optics import Mask, render_psf
from coded_aperture_ros.optics.camera_file import camera_from_mapping
from coded_aperture_ros.simulation import render_coded_frame

ROWS, COLUMNS = 160, 192
NEAR_M, FAR_M = 1.5, 3.0
NOISE = 0.002
MAPPING = {
    "focal_length_px": 1000.0,
    "focus_distance_m": 2.0,
    "image_width": COLUMNS,
    "image_height": ROWS,
    "mask": {"name": "three_wide"},
    "mask_extent_mm": 60.0,
    "side": "both",
}


def camera_with(mask, **changes):
    return camera_from_mapping({**MAPPING, "mask": {"name": mask}, **changes})


def learned(camera, levels=21):
    return learn_bank_for_camera(camera, NEAR_M, FAR_M, levels, LearnConfig(rank=64))


@pytest.fixture(scope="module")
def camera():
    return camera_with("three_wide")


@pytest.fixture(scope="module")
def bank(camera):
    return learned(camera)


@pytest.fixture(scope="module")
def picture():
    """Crops of photographs, with a margin."""
    margin = 40
    return load_textures("natural").crops(
        4, ROWS + margin, COLUMNS + margin, np.random.default_rng(3)
    )


def coded(texture, mask, size_px, seed=0):
    psf = render_psf(mask, size_px, 41)
    frame = fftconvolve(texture, psf, mode="valid")
    return (frame + np.random.default_rng(seed).normal(0, NOISE, frame.shape)).astype(np.float32)


def grid_of(estimator, frame):
    return estimator.run_front(frame).observation.grid


def test_the_range_may_hold_the_focus_with_side_both_only(camera):
    smallest, largest = camera.blur_range_px(NEAR_M, FAR_M)
    assert (smallest, largest) == pytest.approx((-10.0, 10.0))
    assert camera.blur_range_px(2.2, FAR_M)[0] > 0  # one side of it is a range too
    for side in ("far", "near"):
        with pytest.raises(InputError, match=r"with an asymmetric mask, set side: both$"):
            dataclasses.replace(camera, side=side).blur_range_px(NEAR_M, FAR_M)
    with pytest.raises(InputError, match=r"side.*far, near, both"):
        camera_with("zhou", side="all")


@pytest.mark.parametrize(("near_m", "far_m"), [(1.5, 3.0), (1.2, 2.1), (1.95, 8.0), (1.9, 300.0)])
def test_levels_mirror_each_other(camera, near_m, far_m):
    bank = learn_bank_for_camera(camera, near_m, far_m, 12, LearnConfig(rank=8, window_px=64))
    sizes, asked = bank.blur_sizes_px, camera.blur_range_px(near_m, far_m)
    assert len(sizes) == 12 and np.ptp(np.diff(sizes)) < 1e-9
    assert np.abs(sizes).min() < 1e-9
    step = sizes[1] - sizes[0]
    assert asked[0] - 1.001 * step < sizes[0] <= asked[0] + 1e-9
    assert asked[1] - 1e-9 <= sizes[-1] < asked[1] + 1.001 * step
    assert np.isfinite(bank.stack.depths_m).all()
    with pytest.raises(InputError, match="at least 3 are needed, got 2"):
        learn_bank_for_camera(camera, near_m, far_m, 2)


def test_the_power_alone_does_not_tell_the_side(bank, camera, picture):
    frame = coded(picture[0], camera.mask, -7.0)
    energies = bank.energies(frame, 16, NOISE)
    assert energies == pytest.approx(energies[..., ::-1], rel=1e-3)


def test_the_phase_tells_the_side(bank, camera, picture):
    grid = grid_of(DepthEstimator(bank, None, camera), coded(picture[0], camera.mask, 5.0))
    finder = SideFinder(bank.stack, (ROWS, COLUMNS))
    shape = len(grid.row_centres), len(grid.column_centres)
    for size in (3.0, 8.0):
        level = np.full(shape, np.abs(bank.blur_sizes_px - size).argmin())
        for sign in (-1, 1):
            for texture in picture:
                frame = coded(texture, camera.mask, sign * size)
                found = finder.log_odds(frame, grid, level, NOISE)
                assert np.mean(np.sign(found) == sign) > 0.6
                # The level of the other side with the same blur size asks the same question.
                mirrored = finder.log_odds(frame, grid, bank.levels - 1 - level, NOISE)
                assert mirrored == pytest.approx(found, abs=0.02)


def test_a_frame_turned_around_is_on_the_other_side(bank, camera, picture):
    """Half a turn of scene and PSF is what the focal plane does to the PSF alone."""
    grid = PatchGrid.covering((ROWS, ROWS), bank.window_px, 16)
    level = np.full((grid.rows, grid.columns), bank.levels - 4)
    frame = coded(picture[1], camera.mask, 7.0)[:, :ROWS]
    finder = SideFinder(bank.stack, frame.shape)
    upright = finder.log_odds(frame, grid, level, NOISE)
    turned = finder.log_odds(frame[::-1, ::-1].copy(), grid, level, NOISE)
    assert np.abs(upright).max() > 2
    assert np.median(np.abs(turned[::-1, ::-1] + upright)) < 0.1
    sure = np.abs(upright) > 2
    assert (np.sign(turned[::-1, ::-1]) == -np.sign(upright))[sure].all()


def test_texture_without_phases_tells_nothing(bank, camera):
    """Gaussian noise with the spectrum of photographs: all that there is to know is its power."""
    random = np.random.default_rng(5)
    size = 512
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)) + 1 / size
    white = np.fft.fft2(random.standard_normal((size, size)))
    texture = np.fft.ifft2(white / frequency**1.2).real
    texture = 0.5 + 0.1 * texture[: ROWS + 40, : COLUMNS + 40] / texture.std()
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0), camera)
    said = [
        estimator.estimate(coded(texture, camera.mask, size, seed)).values("side").mean()
        for seed, size in enumerate((-7.0, 7.0))
    ]
    assert max(said) < 0.8


def test_depth_on_both_sides(bank, camera, picture):
    estimator = DepthEstimator(bank, DepthConfig(), camera)
    assert bank.stack.has_both_sides and side_warning(bank) is None
    for size in (-8.5, -4.5, 4.5, 8.5):
        for texture in picture[:2]:
            estimate = estimator.estimate(coded(texture, camera.mask, size))
            known = np.isfinite(estimate.depth_m)
            assert known.mean() > 0.5
            right = np.sign(estimate.blur_size_px[known]) == np.sign(size)
            assert right.mean() > 0.95
            depth_m = float(camera.depth_m(size))
            assert np.median(estimate.depth_m[known]) == pytest.approx(depth_m, rel=0.04)
            side = estimate.values("side")
            assert side.shape == estimate.confidence.shape
            assert (estimate.confidence <= side + 1e-6)[known].all()
    assert "focal side" in estimate.seconds


def test_a_scene_across_the_focal_plane(bank, camera, picture):
    depth = np.full((ROWS, COLUMNS), 2.6, np.float32)
    depth[:, : COLUMNS // 2] = 1.6
    frame = render_coded_frame(picture[0][:ROWS, :COLUMNS], depth, camera)
    frame += np.random.default_rng(0).normal(0, NOISE, frame.shape)
    estimate = DepthEstimator(bank, DepthConfig(confidence_threshold=0), camera).estimate(
        frame.astype(np.float32)
    )
    inside = np.abs(np.arange(COLUMNS) - COLUMNS // 2) > 32
    near = np.sign(estimate.blur_size_px) == np.sign(camera.blur_size_px(depth))
    assert near[:, inside].mean() > 0.9
    # The levels of the other side, which may be as likely, do not count.
    error = np.abs(estimate.depth_m - depth)[:, inside]
    deviation = estimate.std_dev_m[:, inside]
    assert np.median(deviation) < 0.2
    assert np.mean(error < 3 * deviation) > 0.8


def test_video_keeps_the_side(bank, camera, picture):
    estimator = DepthEstimator(bank, DepthConfig(temporal_frames=3.0), camera)
    for seed in range(3):
        estimate = estimator.estimate(coded(picture[0], camera.mask, -6.5, seed))
    known = np.isfinite(estimate.depth_m)
    assert known.mean() > 0.5
    assert (estimate.blur_size_px[known] < 0).mean() > 0.95


def test_one_side_is_as_before(camera, picture):
    one = dataclasses.replace(camera, side="far")
    bank = learn_bank_for_camera(one, 2.1, FAR_M, 12, LearnConfig(rank=64))
    estimator = DepthEstimator(bank, DepthConfig(), one)
    estimate = estimator.estimate(coded(picture[0], camera.mask, 6.0))
    assert not bank.stack.has_both_sides
    assert estimate.values("side") is None
    assert "focal side" not in estimate.seconds


@pytest.mark.parametrize("mask", ["levin", "disc", "annulus", "four_hole", "two_hole"])
def test_a_symmetric_mask_cannot_tell_and_says_so(mask, picture):
    camera = camera_with(mask)
    bank = learned(camera, 11)
    assert Mask.named(mask).asymmetry == 0
    assert "same after half a turn" in side_warning(bank) and "\n" not in side_warning(bank)
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0), camera)
    estimate = estimator.estimate(coded(picture[0], camera.mask, 7.0))
    assert estimate.values("side") == pytest.approx(0.5, abs=0.01)
    depth = estimate.where_confident(DepthConfig().confidence_threshold).depth_m
    # What is left is near the focal plane, where both sides are about as far.
    assert np.isfinite(depth).mean() < 0.1


def test_a_frame_without_information_has_no_depth(bank, camera):
    estimator = DepthEstimator(bank, DepthConfig(), camera)
    for frame in (np.full((ROWS, COLUMNS), 0.3), np.full((ROWS, COLUMNS), np.nan)):
        estimate = estimator.estimate(frame.astype(np.float32))
        assert not np.isfinite(estimate.depth_m).any()


def test_asymmetry_of_masks():
    assert Mask.from_rows(["#.", ".."]).asymmetry == 1
    assert Mask.from_rows(["##", ".#"]).asymmetry == pytest.approx(1 / 3)
    assert Mask.from_rows(["#.", ".#"]).asymmetry == 0


def test_probabilities_of_a_side():
    sizes = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    probability = np.array([[[0.1, 0.3, 0.0, 0.2, 0.4], [0.2] * 5]], np.float32)
    given = condition_on_side(probability, sizes)
    assert given[0, 0] == pytest.approx([0.25, 0.75, 0, 1 / 3, 2 / 3])
    assert given[0, 1] == pytest.approx([0.2] * 5)  # uninformative


def test_neighbours_on_one_surface_tell_the_side_together():
    grid = PatchGrid(0, 0, 24, 8, 8, 48)
    sizes = np.arange(-10.0, 11.0)
    level = np.full((8, 8), 16, np.float32)  # +6 px
    chances = np.full((8, 8), 0.4, np.float32)
    together = side_confidence(level, chances, grid, sizes)
    alone = side_confidence(level, np.where(np.eye(8), chances, 0).astype(np.float32), grid, sizes)
    assert (together > 0.5).all() and (together > alone).all()
    # A patch that is of the other opinion is outvoted, unless it is another surface.
    chances[4, 4] = -0.4
    assert side_confidence(level, chances, grid, sizes)[4, 4] > 0.5
    level[4, 4] = 11
    assert side_confidence(level, chances, grid, sizes)[4, 4] < 0.5


def test_a_size_that_one_side_only_has_tells_it():
    costs = np.full((1, 1, 6), 20, np.float32)
    sizes = np.arange(-1.0, 5.0)
    costs[..., 5] = 0
    assert far_log_odds(costs, sizes)[0, 0] > 0.5


def test_what_does_not_go_with_both_sides(bank, camera, tmp_path, capsys):
    with pytest.raises(InputError, match="both sides of the focal plane"):
        learn_motion_bank(bank, MotionConfig().motions)
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(MAPPING))
    one = dataclasses.replace(camera, side="near")
    with pytest.raises(InputError, match="its side is near, but the bank has blur sizes of"):
        DepthEstimator(bank, None, one)


def test_the_program_works_by_the_camera_file_alone(tmp_path, capsys, caplog, picture):
    for mask in ("three_wide", "levin"):
        (tmp_path / f"{mask}.yaml").write_text(yaml.safe_dump({**MAPPING, "mask": {"name": mask}}))
    frame = tmp_path / "coded.npy"
    write_image(frame, coded(picture[0], Mask.named("three_wide"), -7.0))
    for mask in ("three_wide", "levin"):
        result = call(
            capsys, "learn", "--camera", tmp_path / f"{mask}.yaml", "--depth-range", NEAR_M, FAR_M,
            "--level-count", 21, "-o", tmp_path / f"{mask}.npz",
        )  # fmt: skip
        assert result.status == 0
    (warning,) = caplog.messages  # of the other one
    assert "same after half a turn" in warning and "\n" not in warning
    output = tmp_path / "depth.npy"
    result = call(capsys, "depth", "--bank", tmp_path / "three_wide.npz", frame, "-o", output)
    assert (result.status, result.err) == (0, "")
    depth, side = np.load(output), np.load(tmp_path / "depth.side.npy")
    truth = float(camera_with("three_wide").depth_m(-7.0))
    assert np.nanmedian(depth) == pytest.approx(truth, rel=0.03)
    assert side.shape == depth.shape and side[np.isfinite(depth)].min() > 0.5


@pytest.mark.slow
def test_the_benchmark_tells_masks_apart(capsys):
    arguments = ("sign", "--masks", "zhou", "disc", "--planes", 4, "--levels", 15)
    result = call_benchmarks(capsys, *arguments, "--jobs", 1, "--json")
    assert result.status == 0
    zhou, disc = json.loads(result.out)["cells"]
    # Confident is what has depth: from a confidence of 0.45 on, by default.
    assert zhou["right"] > 0.9 and zhou["confident_right"] > 0.93
    assert zhou["level_error"] < 1.5 * zhou["told_level_error"] + 0.5
    assert disc["confident"] == 0 and disc["confident_right"] is None
    assert "oracle" in call_benchmarks(capsys, *arguments[:-3], 2, "--levels", 9, "--jobs", 1).out


def test_a_wrong_side_is_scored_as_one(camera):
    truth = np.full((4, 5), 6.0, np.float32)
    frame = SideFrame(truth, truth, np.full_like(truth, 2.5))
    sizes = np.where(np.arange(5) < 4, 6.0, -6.0) * np.ones((4, 1))
    estimate = DepthEstimate(
        level=np.zeros((4, 5), np.float32),
        blur_size_px=sizes,
        depth_m=np.full((4, 5), 2.5),
        confidence=np.full((4, 5), 0.7),
        noise=NOISE,
        layers={"side": Layer(SIDE, np.full((4, 5), 0.9))},
    )
    score = SideScore.of([SideEstimates(frame, estimate, truth, frame.depth_m)], 1.0, 0.55)
    assert score.right == score.confident_right == pytest.approx(0.8)
    assert score.level_error == pytest.approx(0.2 * 12)
    assert (score.oracle_level_error, score.confident, score.within) == (0, 1, 1)
