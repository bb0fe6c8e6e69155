"""Motion blur: kernels, identification beside defocus, and what a gyroscope knows."""

import dataclasses

import numpy as np
import pytest
from cli_scene import texture
from scipy.signal import fftconvolve

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator, estimate_video
from coded_aperture_ros.frames import Frame
from coded_aperture_ros.likelihood import NumpyEngine, Plan
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank, learn_bank_for_camera
from coded_aperture_ros.likelihood.motion import (
    MotionConfig,
    MotionModel,
    Motions,
    blurred_psf,
    learn_motion_bank,
    motion_kernel,
)
from coded_aperture_ros.likelihood.motion.bank import expected_powers
from coded_aperture_ros.likelihood.motion.engine import MotionEngine
from coded_aperture_ros.likelihood.motion.joint import occurring_motions, refine_motion
from coded_aperture_ros.optics import Intrinsics, Mask, render_psf_stack
from coded_aperture_ros.optics.rotation import expected_motion

MASK = Mask.from_rows(["101", "000", "100"])
SIZES = np.linspace(7, 17, 6)
# Few motions, so that tests are quick.
MOTION = MotionConfig(motion_directions=4, motion_lengths=3, longest_motion_px=9.0)
CONFIG = DepthConfig(confidence_threshold=0.0, noise=0.001, edge_correction=0.0)
WIDTH, HEIGHT = 160, 128
INTRINSICS = Intrinsics.pinhole(200.0, WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def bank():
    still = learn_bank(render_psf_stack(MASK, SIZES), LearnConfig(rank=64), mask=MASK)
    return learn_motion_bank(still, MOTION.motions, 400)


def moving_plane(level, motion_px, seed=0, height=HEIGHT, width=WIDTH):
    """Return a frame of a plane that moves, with noise."""
    random = np.random.default_rng(seed)
    sharp = texture(height + 80, width + 80, seed + 1)
    psf = blurred_psf(render_psf_stack(MASK, SIZES).psfs[level], motion_px)
    frame = fftconvolve(sharp, psf, mode="same")[40:-40, 40:-40]
    return (frame + 0.001 * random.standard_normal(frame.shape)).astype(np.float32)


def moments(kernel):
    rows, columns = np.indices(kernel.shape) - len(kernel) // 2
    return [
        float((kernel * part).sum())
        for part in (columns, rows, columns**2, rows**2, rows * columns)
    ]


@pytest.mark.parametrize("motion_px", [(0.0, 0.0), (4.0, 0.0), (0.3, -0.2), (5.7, 2.9), (-3, 11)])
def test_a_kernel_has_the_moments_of_its_line(motion_px):
    right, down = motion_px
    kernel = motion_kernel(motion_px)
    assert kernel.sum() == pytest.approx(1, abs=1e-6)
    assert kernel.min() >= 0
    x, y, xx, yy, xy = moments(kernel)
    assert (x, y) == pytest.approx((0, 0), abs=1e-5)
    assert xy == pytest.approx(right * down / 12, abs=1e-4)
    # Linear interpolation adds at most a quarter of a pixel's square to the variance.
    assert right**2 / 12 - 1e-4 <= xx <= right**2 / 12 + 0.25 + 1e-4
    assert down**2 / 12 - 1e-4 <= yy <= down**2 / 12 + 0.25 + 1e-4


def test_a_kernel_of_whole_pixels_is_known():
    # Half of the way from one pixel to the next counts for either.
    assert motion_kernel((2.0, 0.0))[1] == pytest.approx([0.25, 0.5, 0.25])
    assert motion_kernel((0.0, 4.0))[:, 2] == pytest.approx([0.125, 0.25, 0.25, 0.25, 0.125])
    assert motion_kernel((0.0, 0.0)).tolist() == [[1.0]]


def test_a_kernel_does_not_tell_the_way_round_but_the_direction():
    kernel = motion_kernel((5.0, 2.0))
    assert motion_kernel((-5.0, -2.0)) == pytest.approx(kernel, abs=1e-7)
    assert motion_kernel((5.0, -2.0)) == pytest.approx(kernel[::-1], abs=1e-7)
    assert kernel[0, 0] == pytest.approx(0)
    assert kernel[2, 0] > 0  # up to the left: the line falls to the right


def test_a_kernel_that_cannot_be():
    with pytest.raises(InputError, match="finite"):
        motion_kernel((float("nan"), 0.0))


def test_motions_that_cannot_be():
    for vectors in (np.zeros((0, 2)), np.zeros((3, 3)), [[np.nan, 0]]):
        with pytest.raises(InputError, match="motions"):
            Motions(vectors)
    with pytest.raises(InputError, match="lengths above 0"):
        Motions.grid(8, [0.0, 1.0])


def test_opposite_motions_are_one():
    motions = Motions.grid(4, [2.0, 4.0])
    assert len(motions) == 9
    assert motions.longest_px == pytest.approx(4)
    assert motions.distances_px([-4.0, 0.0])[2] == pytest.approx(0)
    assert motions.distances_px([0.0, 0.0])[0] == 0


def test_expected_powers_are_those_of_the_basis(bank):
    some = Motions(MOTION.motions.vectors_px[[0, 5]])
    powers = expected_powers(bank.defocus, some, iter)
    for motion, level in ((0, 1), (1, 4)):
        vector = tuple(some.vectors_px[motion])
        psf = blurred_psf(bank.defocus.stack.psfs[level], vector)
        for slope, found in zip(bank.defocus.prior.slopes, powers, strict=True):
            exact = bank.defocus.fourier.expected_power(psf, slope)
            assert found[motion * len(SIZES) + level] == pytest.approx(
                exact, abs=1e-6 * exact.max()
            )


@pytest.mark.parametrize(("level", "motion"), [(1, 0), (4, 3), (2, 6), (3, 11)])
def test_defocus_and_motion_are_identified_together(bank, level, motion):
    vector = bank.motions.vectors_px[motion]
    frame = moving_plane(level, tuple(vector), seed=motion)
    found = DepthEstimator(MotionModel(bank, MOTION), CONFIG).estimate(frame)
    assert np.abs(found.level - level).mean() < 0.3
    apart = np.hypot(*np.moveaxis(found.values("motion") - vector, -1, 0))
    assert (apart < 0.3).mean() > 0.9
    assert found.values("motion").shape == (*frame.shape, 2)
    assert found.values("motion/confidence")[apart < 0.3].mean() > 0.5
    assert (
        0
        <= found.values("motion/confidence").min()
        <= found.values("motion/confidence").max()
        <= 1 + 1e-6
    )
    assert found.layers["motion"].note == "nothing expected"


def test_depth_of_what_moves_in_front_of_a_scene():
    scenes = pytest.importorskip("coded_aperture_benchmarks.datasets.moving_scenes")
    pytest.importorskip("skimage")
    (scene,) = scenes.make_moving_scenes(MASK, 0.001, which=[1])
    camera = scenes.scene_camera(MASK)
    still = learn_bank_for_camera(camera, scenes.NEAR_M, scenes.FAR_M, 14)
    together = learn_motion_bank(still, MotionConfig().motions, MotionConfig().motion_rank)
    config = DepthConfig(confidence_threshold=0.0, saturation=2.0)
    alone = scenes.depth_error(DepthEstimator(still, config, camera).estimate(scene.coded), scene)
    found = DepthEstimator(MotionModel(together), config, camera).estimate(scene.coded)
    error = scenes.depth_error(found, scene)
    assert error["mean_object"] < 0.5 * alone["mean_object"]
    assert error["mean_scene"] < 1.1 * alone["mean_scene"]
    apart = scenes.motion_error_px(found.values("motion"), scene)
    assert apart["motion_object"] < 3  # of 8.5 px
    assert apart["motion_scene"] < 0.5


def test_a_full_basis_is_exact(bank):
    still = dataclasses.replace(bank.defocus)
    few = Motions.grid(2, [4.0])
    exact = learn_motion_bank(still, few, 100_000).product
    assert exact.basis_vectors == np.count_nonzero(still.fourier.multiplicity)
    low = learn_motion_bank(still, few, 300).product
    frame = moving_plane(2, (4.0, 0.0))
    energies = [each.energies(frame, 16, 0.003) for each in (exact, low)]
    assert energies[0] == pytest.approx(energies[1], abs=0.02 * float(np.ptp(energies[0])))


def test_a_motion_that_does_not_fit_the_window_is_refused(bank):
    with pytest.raises(InputError, match="window"):
        learn_motion_bank(bank.defocus, Motions.grid(4, [40.0]))


def test_expected_motion_is_that_of_a_turning_camera():
    # A point ahead, seen by a camera that turns to the right, moves to the left.
    turning = expected_motion((0.0, 0.5, 0.0), 0.02, INTRINSICS)
    middle = turning.motion_px([(HEIGHT - 1) / 2], [(WIDTH - 1) / 2], WIDTH)[0, 0]
    assert middle == pytest.approx((-200 * 0.5 * 0.02, 0), abs=1e-9)
    # One that rolls clockwise turns the picture the other way round.
    rolling = expected_motion((0.0, 0.0, 1.0), 0.02, INTRINSICS)
    right_of_it = rolling.motion_px([(HEIGHT - 1) / 2], [(WIDTH - 1) / 2 + 50], WIDTH)[0, 0]
    assert right_of_it == pytest.approx((0, -50 * 0.02), abs=1e-9)
    # Against rotating points exactly: x' = K R^-1 K^-1 x.
    from scipy.spatial.transform import Rotation

    rate, exposure = np.array([0.3, -0.2, 0.6]), 0.01
    row, column = 20.0, 130.0
    ray = np.array([(column - (WIDTH - 1) / 2) / 200, (row - (HEIGHT - 1) / 2) / 200, 1.0])
    ends = [Rotation.from_rotvec(share * exposure * rate).inv().apply(ray) for share in (-0.5, 0.5)]
    way = np.subtract(*[200 * end[:2] / end[2] for end in ends[::-1]])
    found = expected_motion(rate, exposure, INTRINSICS).motion_px([row], [column], WIDTH)[0, 0]
    assert found == pytest.approx(way, abs=1e-4)
    # In a picture of half the size, half as far.
    half = expected_motion(rate, exposure, INTRINSICS).motion_px(
        [(row - 0.5) / 2], [64.75], WIDTH // 2
    )
    assert half[0, 0] == pytest.approx(way / 2, abs=1e-2)


@pytest.mark.parametrize(
    ("rate", "exposure", "late", "reason"),
    [
        (None, 0.01, 0.0, "no angular velocity"),
        ((0.1, 0.2), 0.01, 0.0, "3 numbers"),
        ((0.1, float("nan"), 0.0), 0.01, 0.0, "not finite"),
        ((float("inf"), 0.0, 0.0), 0.01, 0.0, "not finite"),
        ((0.1, 0.2, 0.0), 0.0, 0.0, "exposure of 0 s"),
        ((0.1, 0.2, 0.0), -1.0, 0.0, "exposure of -1 s"),
        ((0.1, 0.2, 0.0), float("nan"), 0.0, "exposure of nan s"),
        ((0.1, 0.2, 0.0), 0.01, 0.2, "0.2 s late"),
        ((0.1, 0.2, 0.0), 0.01, float("nan"), "late"),
        ((0.0, 50.0, 0.0), 0.01, 0.0, "longer than"),
    ],
)
def test_without_a_usable_gyroscope_all_motions_are_tried(bank, rate, exposure, late, reason):
    expected = expected_motion(rate, exposure, INTRINSICS, late)
    vector = bank.motions.vectors_px[6]
    frame = moving_plane(2, tuple(vector))
    found = DepthEstimator(MotionModel(bank, MOTION), CONFIG).estimate(
        Frame(frame, motion=expected)
    )
    assert reason in found.layers["motion"].note
    assert np.median(found.values("motion"), axis=(0, 1)) == pytest.approx(vector, abs=1e-3)


def test_expected_motions_are_enough_and_tell_the_way_round(bank):
    frame = moving_plane(3, (6.0, 0.0))
    # 200 px of focal length, 6 px to the left.
    turning = expected_motion((0.0, 0.6, 0.0), 0.05, INTRINSICS)
    estimator = DepthEstimator(MotionModel(bank, MOTION), CONFIG)
    found = estimator.estimate(Frame(frame, motion=turning))
    assert found.layers["motion"].note == ""
    assert np.abs(found.level - 3).mean() < 0.3
    assert np.median(found.values("motion"), axis=(0, 1)) == pytest.approx((-6, 0), abs=1e-3)
    # What is wrongly expected leaves no way to the truth.
    wrong = expected_motion((0.6, 0.0, 0.0), 0.05, INTRINSICS)
    amiss = estimator.estimate(Frame(frame, motion=wrong))
    assert np.abs(amiss.level - 3).mean() > 2 * np.abs(found.level - 3).mean()
    # The next frame is one like any other.
    assert estimator.estimate(frame).layers["motion"].note == "nothing expected"


def test_unusable_patches_have_no_motion(bank):
    frame = moving_plane(2, (6.0, 0.0))
    frame[:, :80] = 1.0
    found = DepthEstimator(MotionModel(bank, MOTION), CONFIG).estimate(frame)
    assert np.isnan(found.values("motion")[:, :50]).all()
    assert (found.values("motion/confidence")[:, :50] == 0).all()
    assert np.isfinite(found.values("motion")[:, 120:]).all()


def test_maps_of_another_size(bank):
    frame = moving_plane(2, (6.0, 0.0))
    found = DepthEstimator(MotionModel(bank, MOTION), CONFIG).estimate(frame, (64, 80))
    assert found.level.shape == found.values("motion/confidence").shape == (64, 80)
    # In pixels of the frame all the same; the motions that are tried are 3 px apart.
    assert np.median(found.values("motion")[..., 0]) == pytest.approx(6, abs=0.6)


def test_threads_and_subsets_change_nothing(bank):
    frame = moving_plane(2, (6.0, 0.0))
    engine = MotionEngine(bank, frame.shape, 16)
    engine.project(frame)
    every = engine.all_energies(0.002).copy()
    product = bank.product
    plain = product.energies(frame, 16, 0.002)
    plain = np.moveaxis(plain, -1, 0).reshape(every.shape)
    assert every == pytest.approx(plain, abs=1e-3 * float(np.ptp(plain)))
    assert np.moveaxis(engine.energies(0.002), -1, 0) == pytest.approx(every.min(axis=0))
    rows, columns = every.shape[2:]
    random = np.random.default_rng(0)
    candidates = random.integers(len(bank.motions), size=(rows, columns, 2))
    some = engine.energies_for(0.002, candidates)
    index = np.moveaxis(candidates, -1, 0)[:, None]
    assert some == pytest.approx(np.take_along_axis(every, index, axis=0), abs=1e-2)


@pytest.mark.parametrize("noise", [0.0003, 0.003])
def test_finalists_are_found_as_by_an_exact_search(bank, noise):
    exact = learn_motion_bank(bank.defocus, bank.motions, 100_000)
    coarse = learn_motion_bank(bank.defocus, bank.motions, 48)
    frame = moving_plane(3, tuple(bank.motions.vectors_px[5]), seed=3)
    found = {}
    for name, of, finalists in (("exact", exact, 0), ("coarse", coarse, 0), ("few", coarse, 4)):
        engine = MotionEngine(of, frame.shape, 16, finalists=finalists)
        engine.project(frame)
        found[name] = engine.all_energies(noise).copy()
    best = {name: energies.min(axis=1).argmin(axis=0) for name, energies in found.items()}
    assert (best["few"] == best["exact"]).mean() > 0.95
    if noise < 0.001:  # noise hides what the common basis leaves out
        assert (best["coarse"] == best["exact"]).mean() < 0.9
    # What is tried under fewer textures can only seem less likely.
    excess = found["few"] - found["exact"]
    assert excess.min() > -1e-3 * float(np.ptp(found["exact"]))
    least = [found[name].min(axis=(0, 1)) for name in ("few", "exact")]
    assert (np.abs(least[0] - least[1]) < 1e-3 * np.ptp(found["exact"])).mean() > 0.95


def test_finalists_of_some_motions_are_those_of_all(bank):
    engine = MotionEngine(bank, (HEIGHT, WIDTH), 16, finalists=3)
    engine.project(moving_plane(2, (6.0, 0.0)))
    every = engine.all_energies(0.001).min(axis=(0, 1))
    rows, columns = every.shape
    near = np.broadcast_to([2, 1, 3], (rows, columns, 3))
    some = engine.energies_for(0.001, near)
    assert (some.min(axis=1).argmin(axis=0) == 0).mean() > 0.95
    assert np.median(some.min(axis=(0, 1)) - every) == pytest.approx(
        0, abs=0.01 * float(np.ptp(some))
    )


def test_products_of_another_engine_do_for_defocus_alone(bank):
    frame = moving_plane(1, (0.0, 0.0))
    moving = MotionEngine(bank, frame.shape, 16)
    moving.project(frame)
    alone = NumpyEngine(Plan.for_frames(bank.defocus, frame.shape, 16))
    alone.project(frame)
    energies = np.moveaxis(alone.energies(0.002), -1, 0)
    assert moving.static_energies(0.002) == pytest.approx(
        energies, abs=1e-4 * float(np.ptp(energies))
    )


def test_few_motions_occur():
    motions = MOTION.motions
    # Texture speaks for another motion, by little, at every patch: all of these are of none.
    evidence = np.full((len(motions), 12, 16), 10.0, np.float32)
    evidence[5], evidence[0] = 0.0, 3.0
    assert occurring_motions(evidence, motions, 3).tolist() == [0]
    # Something moves.
    evidence[:, 4:9, 5:12] = 20.0
    evidence[7, 4:9, 5:12] = 0.0
    assert occurring_motions(evidence, motions, 3).tolist() == [0, 7]


def test_a_motion_is_refined_by_parabolas():
    motions = Motions.grid(8, [2.0, 4.0, 6.0, 8.0])
    true = np.array([4.6 * np.cos(1.3), 4.6 * np.sin(1.3)])
    right, down = motions.vectors_px.T
    length, angle = np.hypot(right, down), np.arctan2(down, right)
    turn = (angle - 1.3 + np.pi / 2) % np.pi - np.pi / 2
    total = (length - 4.6) ** 2 + 30 * turn**2
    nearest = int(motions.distances_px(true).argmin())
    assert refine_motion(total, motions, nearest) == pytest.approx(true, abs=1e-6)
    # Nothing lies beyond the longest.
    longest = int(motions.distances_px((8.0, 0.0)).argmin())
    assert np.hypot(*refine_motion(total, motions, longest)) == pytest.approx(8)


def test_a_motion_between_those_that_are_told_apart_is_searched_for(bank):
    config = dataclasses.replace(MOTION, refinement_px=0.1)
    true = np.array([6.9, 1.9])
    assert bank.motions.distances_px(true).min() > 2
    found = DepthEstimator(MotionModel(bank, config), CONFIG).estimate(
        moving_plane(3, tuple(true), 2)
    )
    assert np.median(np.hypot(*np.moveaxis(found.values("motion") - true, -1, 0))) < 0.3


@pytest.mark.parametrize("temporal_frames", [0.0, 2.0])
@pytest.mark.parametrize("regularize", ["none", "semiglobal", "tv"])
def test_where_motion_leaves_depth_unknown_the_nearest_stands(bank, regularize, temporal_frames):
    config = dataclasses.replace(
        CONFIG,
        unknown="nearest",
        confidence_threshold=1.0,
        regularize=regularize,
        temporal_frames=temporal_frames,
    )
    estimator = DepthEstimator(MotionModel(bank, MOTION), config)
    found = estimator.estimate(moving_plane(3, (6.0, 0.0)))
    assert np.isfinite(found.level).all()
    assert found.level.min() >= 0 and found.level.max() <= len(bank.defocus.stack) - 1


def test_every_frame_of_a_video_has_its_own_motion(bank):
    vectors = [(6.0, 0.0), (0.0, 6.0), (6.0, 0.0), (0.0, 6.0), (6.0, 0.0)]
    frames = [moving_plane(3, vector) for vector in vectors]
    config = dataclasses.replace(CONFIG, temporal_frames=0.5)
    estimator = DepthEstimator(MotionModel(bank, MOTION), config)
    results = list(estimate_video(estimator, frames))
    assert len(results) == len(frames)
    for found, vector in zip(results, vectors, strict=True):
        median = np.nanmedian(np.abs(found.values("motion")), axis=(0, 1))
        assert median == pytest.approx(vector, abs=1.5)
