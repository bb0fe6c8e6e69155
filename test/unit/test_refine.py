"""The learned decision: cells, features, probabilities, maps, and when it stands back."""

import dataclasses

import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth import DepthConfig, DepthEstimator, estimate_video, refinement_note
from coded_aperture_ros.depth.decoders.network import NetworkDecoder, small_bank, unsupported_reason
from coded_aperture_ros.depth.decoders.network.bounds import quantile_px
from coded_aperture_ros.depth.decoders.network.cells import (
    CELL_PX,
    HALVINGS,
    Cells,
    upsample_half_cells,
)
from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_SIZES_PX,
    COST_CHANNELS,
    LocalContext,
    PatchScale,
    cost_features,
    frame_features,
    tried_sizes,
)
from coded_aperture_ros.depth.decoders.network.network import Logits, Network
from coded_aperture_ros.depth.decoders.network.probabilities import HalfCells
from coded_aperture_ros.depth.decoders.network.small import SMALL_PX
from coded_aperture_ros.depth.levels import Folding
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank, learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack
from coded_aperture_ros.simulation import render_coded_frame
from coded_aperture_ros.simulation.layered import random_scene

SHAPES = [(96, 128), (97, 131), (240, 333), (121, 200)]


@pytest.fixture(scope="module")
def camera():
    return Camera(600.0, 1.0, 192, 160, Mask.named("levin"), 30.0)


@pytest.fixture(scope="module")
def bank(camera):
    return learn_bank_for_camera(camera, 1.1, 3.0, 24, LearnConfig(window_px=32))


@pytest.fixture(scope="module")
def scene(camera):
    """Return a near card before a far wall, both with the texture of noise."""
    random = np.random.default_rng(4)
    depth = np.full((160, 192), 2.4, np.float32)
    depth[40:120, 70:110] = 1.3
    spectrum = np.fft.rfft2(random.standard_normal(depth.shape))
    fall = np.hypot(np.fft.fftfreq(160)[:, None], np.fft.rfftfreq(192))
    texture = np.fft.irfft2(spectrum / np.maximum(fall, 0.01) ** 0.9, depth.shape)
    sharp = 0.2 * np.exp(0.5 * texture / texture.std())
    frame = render_coded_frame(sharp.astype(np.float32), depth, camera, aperture_blocks=6)
    return frame + 0.001 * random.standard_normal(frame.shape, dtype=np.float32), depth


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("window", [32, 48, 64])
def test_cells_cover_the_frame_and_lie_around_the_patches(shape, window):
    grid = PatchGrid.covering(shape, window, CELL_PX)
    cells = Cells.covering(shape, grid)
    assert cells.top <= 0 and cells.left <= 0
    assert cells.top + cells.rows * CELL_PX >= shape[0]
    assert cells.left + cells.columns * CELL_PX >= shape[1]
    assert cells.rows % 2**HALVINGS == 0 and cells.columns % 2**HALVINGS == 0
    rows, columns = np.meshgrid(grid.row_centres, grid.column_centres, indexing="ij")
    at_cells, known = cells.resample_patches(np.stack([rows, columns]).astype(np.float32), grid)
    assert known.sum() == rows.size
    i, j = np.nonzero(known)
    middle = CELL_PX // 2
    assert np.array_equal(at_cells[0, i, j], cells.top + CELL_PX * i + middle)
    assert np.array_equal(at_cells[1, i, j], cells.left + CELL_PX * j + middle)
    assert cells.pad_frame(np.zeros(shape, np.float32)).shape == (
        cells.rows * CELL_PX,
        cells.columns * CELL_PX,
    )


@pytest.mark.parametrize("stride", [4, 6, 12])
def test_other_strides_are_interpolated(stride):
    shape = (200, 230)
    grid = PatchGrid.covering(shape, 48, stride)
    cells = Cells.covering(shape, grid)
    rows, columns = np.meshgrid(grid.row_centres, grid.column_centres, indexing="ij")
    at_cells, known = cells.resample_patches(np.stack([rows, columns]).astype(np.float32), grid)
    i, j = np.nonzero(known)
    assert at_cells[0, i, j] == pytest.approx(cells.top + CELL_PX * i + 4, abs=1e-3)
    assert at_cells[1, i, j] == pytest.approx(cells.left + CELL_PX * j + 4, abs=1e-3)


@pytest.mark.parametrize(("side", "stride"), [(38, 6), (39, 4), (36, 8), (39, 5)])
def test_a_few_patches_fill_all_cells(side, stride):
    cells = Cells.covering((side, 96), PatchGrid.covering((side, 96), 32, stride))
    grid = PatchGrid.covering((side, 96), 32, CELL_PX)
    values = np.ones((2, grid.rows, grid.columns), np.float32)
    at_cells, known = cells.resample_patches(values, grid)
    assert at_cells == pytest.approx(1) and at_cells.shape == (2, cells.rows, cells.columns)
    assert known.any()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("window", [36, 40, 48, 62])
def test_patches_of_another_size_are_put_on_the_same_cells(shape, window):
    cells = Cells.covering(shape, PatchGrid.covering(shape, window, CELL_PX))
    small = PatchGrid.covering(shape, 32, CELL_PX)
    rows, columns = np.meshgrid(small.row_centres, small.column_centres, indexing="ij")
    at_cells, known = cells.resample_patches(np.stack([rows, columns]).astype(np.float32), small)
    i, j = np.nonzero(known)
    assert len(i) >= (small.rows - 1) * (small.columns - 1)
    assert at_cells[0, i, j] == pytest.approx(cells.top + CELL_PX * i + 4, abs=1e-3)
    assert at_cells[1, i, j] == pytest.approx(cells.left + CELL_PX * j + 4, abs=1e-3)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("order", [1, -1])
def test_costs_are_put_on_the_grid_of_blur_sizes(sign, order):
    sizes = (sign * np.linspace(3.0, 9.0, 13))[::order]
    shape = (96, 96)
    grid = PatchGrid.covering(shape, 48, CELL_PX)
    cells = Cells.covering(shape, grid)
    volume = np.broadcast_to(np.abs(sizes) - 3, (grid.rows, grid.columns, 13)).astype(np.float32)
    misfit = np.full((grid.rows, grid.columns), 0.25, np.float32)
    grey = np.full(shape, 0.2, np.float32)
    folding = Folding.from_sizes(sizes)
    looks = [PatchScale(folding.fold_volume(volume), misfit, grid)] * 2
    near = float(sign < 0)
    around = LocalContext.from_frame(grey, 0.001)
    features = cost_features(looks, around, cells, folding.sizes_px, near)
    row, column = cells.rows // 2, cells.columns // 2
    tried = tried_sizes(folding.sizes_px)
    assert BLUR_SIZES_PX[tried] == pytest.approx(np.arange(3, 9.1, 0.5))
    count = len(BLUR_SIZES_PX)
    for first in (0, 3 * count):  # of the model's patches, and of the small ones
        of_cell = features[first : first + count, row, column]
        assert of_cell[tried] == pytest.approx(np.log1p(BLUR_SIZES_PX[tried] - 3), abs=1e-5)
        assert (of_cell[~tried] == 5).all()
        fine = features[first + count : first + 2 * count, row, column]
        expected = np.log1p(30 * (BLUR_SIZES_PX[tried] - 3)) / 3
        assert fine[tried] == pytest.approx(expected, abs=1e-5)
        assert (fine[~tried] == np.float32(2.8)).all()
    assert (features[COST_CHANNELS : COST_CHANNELS + 2, row, column] == 0.25).all()
    assert not features[COST_CHANNELS + 2, 0].any()  # no patches at the edge of the frame
    assert (features[-1] == near).all()


def test_small_patches_have_a_bank_of_the_same_psfs(camera):
    sizes = np.arange(-8, 9) * 0.9
    both = learn_bank(render_psf_stack(camera.mask, sizes), LearnConfig(window_px=48, rank=60))
    small = small_bank(both)
    assert small.window_px == SMALL_PX
    assert small.blur_sizes_px == pytest.approx(np.arange(9) * 0.9)
    config = LearnConfig(window_px=SMALL_PX, rank=60)
    alone = learn_bank(render_psf_stack(camera.mask, sizes[8:]), config)
    frame = np.random.default_rng(0).random((64, 80), dtype=np.float32)
    expected = alone.energies(frame, 8, 0.01)
    assert small.energies(frame, 8, 0.01) == pytest.approx(expected, rel=2e-3)


def test_levels_of_both_sides_are_folded():
    sizes = np.arange(-3, 5) * 0.7
    folding = Folding.from_sizes(sizes)
    assert folding.sizes_px == pytest.approx(np.arange(5) * 0.7)
    assert folding.far.tolist() == [3, 4, 5, 6, 7]
    assert folding.near.tolist() == [3, 2, 1, 0, 7]  # the largest is on one side only
    volume = np.float32([[[7, 6, 5, 4, 3, 5.5, 6, 1]]])
    assert folding.fold_volume(volume).tolist() == [[[4, 3, 5.5, 6, 1]]]
    one = Folding.from_sizes(-sizes[4:][::-1])
    assert one.sizes_px == pytest.approx(np.arange(1, 5) * 0.7)
    assert one.far.tolist() == one.near.tolist() == [3, 2, 1, 0]


def _logits(probability):
    probability = np.asarray(probability, np.float32)
    size = np.log(np.maximum(probability, 1e-9))[:, None, None]
    return Logits(size, np.full((1, 1), -2.0, np.float32), size)


def test_blur_size_is_the_mean_around_the_likeliest():
    sizes = np.arange(2, 12, 0.5, dtype=np.float32)
    probability = np.zeros(len(sizes))
    probability[[4, 5, 15]] = 0.3, 0.4, 0.3
    found = HalfCells.from_logits(_logits(probability), sizes)
    assert found.size_px == pytest.approx((0.3 * 4.0 + 0.4 * 4.5) / 0.7, abs=1e-4)
    assert found.about == pytest.approx(0.7, abs=1e-4)
    width = float(found.width_px[0, 0])
    right = found.right_within(np.float32([[0.3]]))
    assert right == pytest.approx(0.7 * (1 - np.exp(-0.3 / width)), abs=1e-3)
    assert quantile_px(found, 0.05) == pytest.approx(4.0)
    assert quantile_px(found, 0.95) == pytest.approx(9.5)


def test_features_of_the_confidence_tell_of_what_is_around():
    """Two surfaces of 30x20 half-cells, 4 px of blur apart, and a half-cell that is unsure."""
    size = np.full((30, 40), 6, np.float32)
    size[:, 20:] = 10
    about = np.full(size.shape, 0.9, np.float32)
    about[15, 5] = 0.1
    same = np.full(size.shape, 0.25, np.float32)
    found = HalfCells(size, about, same, same, size[None], np.float32([6]))
    tolerance = np.full(size.shape, 0.5, np.float32)
    odds, sizes, log_tolerance, around, far_around, more, less = found.confidence_features(
        tolerance
    )
    right = about * (1 - np.exp(np.float32(-2)))
    np.testing.assert_allclose(odds, np.log(right / (1 - right)), rtol=1e-4)
    np.testing.assert_array_equal(sizes, size)
    np.testing.assert_allclose(log_tolerance, np.log(0.5), rtol=1e-6)
    fall = odds[0, 0] - odds[15, 5]
    assert around[15, 5] == pytest.approx(odds[0, 0] - fall / 13**2, rel=1e-4)
    assert far_around[15, 25] == odds[0, 0]  # more than 16 half-cells away
    # Two half-cells on either side of the edge see the other surface, 8 tolerances away.
    edge = np.log1p(8) * np.float32([0, 0, 1, 1, 0, 0, 0, 0])
    np.testing.assert_allclose(more[3, 16:24], edge, rtol=1e-6)
    np.testing.assert_allclose(less[3, 16:24], edge[[0, 0, 0, 0, 2, 2, 0, 0]], rtol=1e-6)


@pytest.mark.parametrize("shape", [(8, 8), (8, 40), (34, 8)])
def test_features_of_the_confidence_of_small_frames_are_finite(shape):
    values = np.random.default_rng(0).uniform(0.1, 0.9, (5, *shape)).astype(np.float32)
    size, about, spread, width, tolerance = values
    found = HalfCells(size, about, spread, width, size[None], np.float32([6]))
    assert np.isfinite(found.confidence_features(tolerance)).all()


def test_deviation_holds_two_thirds_of_the_errors():
    sizes = np.arange(2, 12, 0.5, dtype=np.float32)
    sure = HalfCells.from_logits(_logits(np.eye(20)[6]), sizes)
    random = np.random.default_rng(0)
    errors = random.laplace(0, float(sure.width_px[0, 0]), 20_000)
    assert np.mean(np.abs(errors) <= sure.deviation_px()) == pytest.approx(0.68, abs=0.02)
    torn = HalfCells.from_logits(_logits(0.5 * np.eye(20)[2] + 0.5 * np.eye(20)[18]), sizes)
    assert torn.deviation_px() > 5  # the other is 8 px away


def test_maps_are_linear_within_surfaces_and_cut_at_edges():
    slope = np.add.outer(np.arange(6) * 0.1, np.arange(8) * 0.05).astype(np.float32)
    bordered = np.arange(8 * 10).reshape(8, 10)
    nowhere = bordered[1:-1, 1:-1].repeat(2, 0).repeat(2, 1)
    level = upsample_half_cells(slope, nowhere, 0.8)
    rows = (np.arange(24) + 0.5) / 4 - 0.5
    assert level[4:-4, 14] == pytest.approx((rows * 0.1 + (14.5 / 4 - 0.5) * 0.05)[4:-4], abs=1e-5)
    step = np.zeros((6, 8), np.float32)
    step[:, 4:] = 9
    owners = nowhere.copy()
    owners[:, 7] += 1  # the right quarters of the last column before the step: the right one's
    edge = upsample_half_cells(step, owners, 0.8)
    assert set(np.unique(edge)) == {0, 9}
    assert (edge[:, :14] == 0).all() and (edge[:, 14:] == 9).all()


def test_what_stands_in_for_it_is_told(camera):
    def note(largest_px):
        stack = render_psf_stack(camera.mask, np.linspace(4, largest_px, 30))
        return refinement_note(learn_bank(stack), DepthConfig())

    assert note(20.0) is None
    assert "semiglobal in place of learned" in note(24.0)


def test_where_it_was_not_trained_it_stands_back(bank, camera, scene):
    frame, _ = scene
    assert unsupported_reason(bank, 8) == ""
    assert "stride of 24 px" in unsupported_reason(bank, 24)
    small = dataclasses.replace(bank, window_px=24)
    assert "window of 24 px" in unsupported_reason(small, 8)

    def with_sizes(sizes_px):
        return dataclasses.replace(bank, stack=render_psf_stack(camera.mask, sizes_px))

    for levels in (21, 11, 6):  # steps of 0.8 px, to rounding
        even = with_sizes(np.linspace(2, 2 + 0.8 * (levels - 1), levels))
        assert "px apart" not in unsupported_reason(even, 8)
    coarse = with_sizes(np.append(np.linspace(2, 9, bank.levels - 1), 10))
    assert "up to 1 px apart" in unsupported_reason(coarse, 8)
    wide = with_sizes(np.linspace(4, 30, bank.levels))
    assert "blur of 30 px" in unsupported_reason(wide, 8)
    narrow = with_sizes(np.linspace(3.05, 3.2, bank.levels))
    assert "span 0.15 px" in unsupported_reason(narrow, 8)
    margin = np.pad(bank.stack.psfs, [(0, 0), (10, 10), (10, 10)])
    padded = dataclasses.replace(bank, stack=dataclasses.replace(bank.stack, psfs=margin))
    assert "do not fit patches of 32 px" in unsupported_reason(padded, 8)
    indices = dataclasses.replace(bank, stack=dataclasses.replace(bank.stack, in_pixels=False))
    assert "not known in pixels" in unsupported_reason(indices, 8)
    learned, classical = (
        DepthEstimator(bank, DepthConfig(regularize=how, stride_px=24), camera).estimate(frame)
        for how in ("learned", "semiglobal")
    )
    assert np.array_equal(learned.level, classical.level, equal_nan=True)


def uncertain_levels(model, *_):
    return np.zeros(model.shape[:2], np.float32)


# Settings, a window of the bank, a regulariser that is handed over: which decoder decides.
CHOICES = {
    "defaults": (DepthConfig(), 32, None, True),
    "not asked for": (DepthConfig(regularize="semiglobal"), 32, None, False),
    "none asked for": (DepthConfig(regularize="none"), 32, None, False),
    "wide stride": (DepthConfig(stride_px=24), 32, None, False),
    "small window": (DepthConfig(), 24, None, False),
    "handed over": (DepthConfig(), 32, uncertain_levels, False),
}


@pytest.mark.parametrize("case", CHOICES)
def test_stages_and_message_go_by_one_choice(bank, camera, case):
    config, window_px, regularize, learned = CHOICES[case]
    model = bank
    if window_px != bank.window_px:
        model = learn_bank(bank.stack, LearnConfig(window_px=window_px))
    estimator = DepthEstimator(model, config, camera, regularize=regularize)
    names = [stage.name for stage in estimator.front((96, 128))]
    (decode,) = [stage for stage in estimator.back((96, 128)) if stage.name == "decode"]
    estimator.close()
    assert isinstance(decode.decoder, NetworkDecoder) == ("small patches" in names) == learned
    note = refinement_note(model, config)
    # What a program hands over is no setting: there is nothing to say to users.
    told = note is not None and "in place of learned" in note
    assert told == (config.regularize == "learned" and not learned and regularize is None)
    if told:
        stride_px = config.stride_px or model.stride_px
        assert unsupported_reason(model, stride_px) in note


def test_most_of_a_simple_scene_is_right(bank, camera, scene):
    frame, depth = scene
    config = DepthConfig(regularize="learned", confidence_threshold=0.0)
    found = DepthEstimator(bank, config, camera).estimate(frame)
    assert found.level.dtype == found.confidence.dtype == np.float32
    assert np.isfinite(found.depth_m).all() and (found.std_dev_m > 0).all()
    assert (found.confidence >= 0).all() and (found.confidence <= 1).all()
    right = np.abs(found.depth_m - depth) <= 0.1 * depth
    assert right.mean() > 0.85
    away = np.ones(depth.shape, bool)
    away[24:136, 54:126] = False
    assert right[away].mean() > 0.95  # the wall, up to the edges of the frame
    # Surer where it is right.
    assert found.confidence[right].mean() > found.confidence[~right].mean() + 0.03


def test_saturated_and_missing_pixels_give_no_depth(bank, camera, scene):
    frame = scene[0].copy()
    frame[60:110, 20:70] = np.nan
    config = DepthConfig(regularize="learned", confidence_threshold=0.2)
    found = DepthEstimator(bank, config, camera).estimate(frame)
    assert np.isnan(found.depth_m[75:95, 35:55]).all()
    assert np.isfinite(found.depth_m[:, 120:]).mean() > 0.5


def test_unseen_is_as_near_as_can_be(bank, camera, scene):
    """What nothing is known of must not be taken for what is around it."""
    frame = scene[0].copy()
    frame[20:150, 112:] = np.nan
    config = DepthConfig(unknown="nearest", confidence_threshold=0.5)
    found = DepthEstimator(bank, config, camera).estimate(frame)
    assert found.depth_m[60:110, 150:] == pytest.approx(1.1, rel=0.02)


def test_levels_beyond_infinity_have_a_confidence(camera, scene):
    reach_px = camera.blur_at_infinity_px
    sizes = np.linspace(reach_px - 9, reach_px + 3, 25)
    wide = learn_bank(render_psf_stack(camera.mask, sizes), LearnConfig(window_px=48))
    estimator = DepthEstimator(wide, DepthConfig(confidence_threshold=0.0), camera)
    assert np.isfinite(estimator.estimate(scene[0]).confidence).all()


def test_small_bank_is_learned_once(bank, camera, scene):
    first = small_bank(bank)
    for frame in (scene[0], scene[0][:, :150]):
        DepthEstimator(bank, DepthConfig(confidence_threshold=0.2), camera).estimate(frame)
        assert small_bank(bank) is first


def test_maps_of_other_sizes_show_the_same(bank, camera, scene):
    estimator = DepthEstimator(
        bank, DepthConfig(regularize="learned", confidence_threshold=0.0), camera
    )
    whole = estimator.estimate(scene[0])
    half = estimator.estimate(scene[0], (80, 96))
    assert half.level.shape == half.std_dev_m.shape == (80, 96)
    assert np.median(np.abs(half.level - whole.level[::2, ::2])) < 0.2


def test_nearest_plausible_is_never_farther(bank, camera, scene):
    levels = {}
    for unknown in ("nothing", "nearest"):
        config = DepthConfig(regularize="learned", unknown=unknown, confidence_threshold=0.8)
        levels[unknown] = DepthEstimator(bank, config, camera).estimate(scene[0]).depth_m
    known = np.isfinite(levels["nothing"])
    assert np.isfinite(levels["nearest"]).all() and not known.all()
    assert np.array_equal(levels["nearest"][known], levels["nothing"][known])


@pytest.mark.parametrize("unknown", ["nothing", "nearest"])
@pytest.mark.parametrize("memory", [0.0, 4.0])
@pytest.mark.parametrize("size", [None, (80, 96), (53, 200)])
def test_options_meet_each_other(bank, camera, scene, unknown, memory, size):
    config = DepthConfig(
        regularize="learned",
        unknown=unknown,
        temporal_frames=memory,
        noise=0.001,
        confidence_threshold=0.1,
    )
    estimator = DepthEstimator(bank, config, camera)
    frame = scene[0].copy()
    frame[:8, :8] = 1.0  # saturated
    for _ in range(2):
        found = estimator.estimate(frame, size)
    assert found.depth_m.shape == (size or frame.shape)
    assert np.isfinite(found.confidence).all()
    assert np.isfinite(found.depth_m).any()
    if memory:
        frames = list(estimate_video(estimator, [frame] * 3, size))
        assert [each.depth_m.shape for each in frames] == [size or frame.shape] * 3


def test_both_sides_of_the_focal_plane():
    camera = Camera(600.0, 1.0, 192, 160, Mask.named("three_wide"), 30.0, side="both")
    bank = learn_bank_for_camera(camera, 0.7, 1.8, 31)
    assert unsupported_reason(bank, 8) == ""
    scene = random_scene(1_000_007, camera.mask, "both", (160, 192))
    camera = scene.camera
    bank = learn_bank_for_camera(camera, *_range_of(scene.depth_m()), 31)
    frame = scene.coded() + 0.001 * np.random.default_rng(0).standard_normal((160, 192))
    config = DepthConfig(regularize="learned", confidence_threshold=0.0, unknown="nearest")
    found = DepthEstimator(bank, config, camera).estimate(frame.astype(np.float32))
    right = np.abs(np.abs(found.blur_size_px) - np.abs(scene.blur_size_px())) < 1
    assert right[np.isfinite(scene.blur_size_px())].mean() > 0.6
    assert (found.values("side") >= 0.5).all() and (found.values("side") <= 1).all()
    assert (found.confidence <= 1).all() and np.isfinite(found.depth_m).all()


@pytest.mark.parametrize("sign", [1, -1])
def test_side_that_reaches_farther_than_the_other(sign):
    """A size that one side alone has is on that side, or nothing is said of it."""
    camera = Camera(600.0, 1.0, 192, 160, Mask.named("three_wide"), 30.0, side="both")
    sizes = np.arange(-5, 3, 0.5) * -sign
    stack = render_psf_stack(camera.mask, np.sort(sizes))
    bank = learn_bank(stack, LearnConfig(window_px=48))
    depth = np.full((160, 192), camera.depth_m(-4.0 * -sign), np.float32)
    random = np.random.default_rng(3)
    texture = random.standard_normal(depth.shape)
    sharp = (0.3 * np.exp(0.4 * texture)).astype(np.float32)
    frame = render_coded_frame(sharp, depth, camera, aperture_blocks=6)
    frame += 0.001 * random.standard_normal(frame.shape, dtype=np.float32)
    config = DepthConfig(confidence_threshold=0.0)
    found = DepthEstimator(bank, config, camera).estimate(frame)
    inside = np.s_[30:-30, 30:-30]
    right = np.abs(found.blur_size_px - 4.0 * sign)[inside] < 1
    sure = found.confidence[inside] > 0.3
    assert (right | ~sure).mean() > 0.95
    assert right.mean() > 0.8


def _range_of(depth_m):
    return float(np.nanmin(depth_m)), float(np.nanmax(depth_m))


def test_network_runs_frames_of_any_size():
    tried = tried_sizes(np.linspace(2, 8, 9))
    network = Network(tried, Workers())
    random = np.random.default_rng(0)
    for shape in SHAPES:
        grid = PatchGrid.covering(shape, 48, CELL_PX)
        cells = Cells.covering(shape, grid)
        volume = random.random((grid.rows, grid.columns, 9), dtype=np.float32)
        grey = random.random(shape, dtype=np.float32)
        flat = volume[..., 0]
        looks = [PatchScale(volume, flat, grid)] * 2
        around = LocalContext.from_frame(grey, 0.01)
        costs = cost_features(looks, around, cells, np.linspace(2, 8, 9), 0.0)
        logits = network(costs, frame_features(around, cells))
        assert logits.size.shape == (tried.sum(), 2 * cells.rows, 2 * cells.columns)
        assert np.isfinite(logits.size).all()


def test_unknown_regularisation_is_refused():
    with pytest.raises(InputError, match="learned"):
        DepthConfig(regularize="magic")
