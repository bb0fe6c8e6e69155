"""Videos: frames averaged where nothing moves, and evidence carried from frame to frame."""

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from textures import natural_texture

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator, estimate_video
from coded_aperture_ros.depth.stages.temporal import TemporalFilter
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.frames.static_average import StaticAverage, frames_per_patch, join_averages
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation import render_coded_frame

SHAPE = (160, 192)
LEVELS = 10
NOISE = 0.01
GRID = PatchGrid.covering(SHAPE, 32, 8)
EVERYTHING = DepthConfig(confidence_threshold=0)


@pytest.fixture(scope="module")
def camera():
    return Camera(800.0, 0.9, 192, 160, Mask.named("levin"), 20.0)


@pytest.fixture(scope="module")
def bank(camera):
    return learn_bank_for_camera(camera, 1.0, 2.2, LEVELS, LearnConfig(window_px=32))


@pytest.fixture(scope="module")
def fine_bank(camera):
    """A bank with levels as near to each other as the refinement wants them."""
    return learn_bank_for_camera(camera, 1.0, 2.2, 22, LearnConfig(window_px=32))


def fine_texture(shape=SHAPE, seed=0):
    """Texture that has nothing in common with itself shifted by 4 px."""
    texture = gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.0)
    return (0.4 + 0.1 * texture / texture.std()).astype(np.float32)


def noisy(frame, count, noise=NOISE, seed=1):
    """Return so many frames of a still scene."""
    random = np.random.default_rng(seed)
    return [(frame + random.normal(0, noise, frame.shape)).astype(np.float32) for _ in range(count)]


def blurred(camera, depth_m, seed=0, contrast=0.01):
    depth = np.full(SHAPE, depth_m, np.float32)
    return render_coded_frame(natural_texture(SHAPE, seed, contrast), depth, camera)


# The mean of what is still.


def frames_of_pixels(frames):
    return np.repeat(np.repeat(frames, 8, axis=0), 8, axis=1)


@pytest.mark.parametrize("told", [1.0, 1.5])
@pytest.mark.parametrize("most", [4, 12])
def test_noise_of_a_still_scene_falls_with_the_root_of_the_frames(most, told):
    """Also where its noise was estimated too high; by chance some places start anew."""
    scene, average = fine_texture(), StaticAverage(most)
    for n, frame in enumerate(noisy(scene, 2 * most), 1):
        mean, frames = average.add(frame, told * NOISE)
        n = min(n, most)
        assert 1 <= frames.min() <= frames.max() <= n + 1e-4
        assert np.median(frames) > 0.5 * n
        error = (mean - scene) / NOISE
        assert error.std() < 1.25 / np.sqrt(n)
        assert error.std() > 0.95 / np.sqrt(2 * n - 1)  # that of a mean which fades
        # What it says it is the mean of, it is.
        promised = 1 / np.sqrt(frames_of_pixels(frames))
        assert 0.65 < (error / promised).std() < 1.05
    patches = frames_per_patch(frames, GRID)
    assert (patches.shape, patches.dtype) == ((GRID.rows, GRID.columns), np.float32)
    assert np.median(patches) == pytest.approx(np.median(frames), rel=0.25)


@pytest.mark.parametrize("step_px", [1, 2, 3])
def test_what_moves_is_not_smeared(step_px):
    scene, patch = fine_texture(), fine_texture((64, 64), seed=5)
    average = StaticAverage(16)
    for i, frame in enumerate(noisy(scene, 10)):
        left = 60 + step_px * i
        random = np.random.default_rng(i)
        frame[48:112, left : left + 64] = patch + random.normal(0, NOISE, patch.shape)
        mean, frames = average.add(frame, NOISE)
    inside = np.s_[56:104, left + 8 : left + 56]
    assert frames[7:13, left // 8 + 2 : left // 8 + 6].max() < 1.1
    assert np.abs(mean - frame)[inside].max() < 0.5 * NOISE
    assert (mean[inside] - patch[8:56, 8:56]).std() == pytest.approx(NOISE, rel=0.1)
    # Far away from it all frames count.
    assert np.median(frames[:, 21:]) > 5
    assert (mean - scene)[:, :32].std() < 0.45 * NOISE


def test_average_forgets_when_told():
    average, first, second = StaticAverage(8), fine_texture(), fine_texture((96, 128), seed=1)
    for frame in noisy(first, 3):
        average.add(frame, NOISE)
    average.reset()
    mean, frames = average.add(second, NOISE)
    assert np.array_equal(mean, second)
    assert mean is not second
    assert (frames == 1).all()


def test_means_of_past_and_future_join_without_counting_a_frame_twice():
    video = noisy(fine_texture(), 8)
    squares = np.ones((SHAPE[0] // 8, SHAPE[1] // 8), np.float32)
    forward = np.mean(video[:4], axis=0), 4 * squares
    backward = np.mean(video[3:], axis=0), 5 * squares
    mean, frames = join_averages(forward, backward, video[3])
    assert mean == pytest.approx(np.mean(video, axis=0), abs=1e-5)
    assert (frames == 8).all()


def test_joined_means_of_a_still_scene_have_less_noise_than_each():
    scene = fine_texture()
    video = noisy(scene, 8)
    forward, backward = StaticAverage(100), StaticAverage(100)
    for frame in video[:4]:
        until = forward.add(frame, NOISE)
    for frame in video[:2:-1]:
        after = backward.add(frame, NOISE)
    mean, frames = join_averages(until, after, video[3])
    assert 0.7 * 8 < np.median(frames) <= 8
    assert (mean - scene).std() == pytest.approx(NOISE / np.sqrt(8), rel=0.15)


# Evidence that is carried.


def evidence_for(level, strength, levels=9):
    """Return evidence of that strength against all levels but one, at every patch."""
    evidence = np.full((GRID.rows, GRID.columns, levels), strength, np.float32)
    np.put_along_axis(evidence, np.broadcast_to(level, (GRID.rows, GRID.columns, 1)), 0, axis=-1)
    return evidence


def weak_evidence(seed=0):
    """Return random evidence, so alike for all levels that drift does not matter."""
    random = np.random.default_rng(seed)
    return random.uniform(0, 2, (GRID.rows, GRID.columns, 9)).astype(np.float32)


NOTHING = np.zeros((GRID.rows, GRID.columns, 9), np.float32)


def without_least(evidence):
    return evidence - evidence.min(axis=-1, keepdims=True)


def test_first_frame_has_its_own_evidence():
    evidence = weak_evidence() + 1
    result = TemporalFilter(4.0).add(evidence, fine_texture(), GRID, NOISE)
    assert result == pytest.approx(without_least(evidence), abs=1e-6)
    assert result.dtype == np.float32


@pytest.mark.parametrize("frames", [0.5, 1.0, 4.0])
def test_evidence_of_a_still_scene_adds_up_and_fades(frames):
    keep, grey = np.exp(-1 / frames), fine_texture()
    temporal, expected = TemporalFilter(frames), NOTHING
    for seed in range(5):
        evidence = weak_evidence(seed)
        result = temporal.add(evidence, grey, GRID, NOISE)
        expected = without_least(evidence + keep * expected)
        if seed == 1:  # later on, levels may differ by more than the drift
            assert result == pytest.approx(expected, abs=2e-3)
        assert (result.min(axis=-1) == 0).all()
    assert np.mean(result.argmin(-1) == expected.argmin(-1)) > 0.9


def test_weak_evidence_is_decided_by_earlier_frames():
    temporal, video = TemporalFilter(4.0), noisy(fine_texture(), 3)
    temporal.add(evidence_for(3, 5.0), video[0], GRID, NOISE)
    temporal.add(NOTHING, video[1], GRID, NOISE)
    result = temporal.add(evidence_for(7, 0.5), video[2], GRID, NOISE)
    assert (result.argmin(-1) == 3).all()
    # Stronger evidence wins against the past at once.
    result = temporal.add(evidence_for(7, 6.0), video[2], GRID, NOISE)
    assert (result.argmin(-1) == 7).all()


def test_past_is_forgotten_where_the_scene_has_changed():
    temporal, grey = TemporalFilter(10.0), fine_texture()
    temporal.add(evidence_for(3, 10.0), grey, GRID, NOISE)
    changed = grey.copy()
    changed[:, 96:] = fine_texture(seed=1)[:, 96:]
    weak = weak_evidence() / 2
    result = temporal.add(weak, changed, GRID, NOISE)
    away = GRID.column_centres > 96 + 32
    assert result[:, away] == pytest.approx(without_least(weak)[:, away], abs=0.05)
    assert (result[:, GRID.column_centres < 96 - 32].argmin(-1) == 3).all()
    # What is still there, in windows that saw what is not, is judged anew.
    beside = np.abs(GRID.column_centres - (96 - GRID.window_px // 4)) < 8
    assert result[:, beside] == pytest.approx(without_least(weak)[:, beside], abs=0.05)


@pytest.mark.parametrize(("down_px", "right_px"), [(0, 8), (8, 0), (-8, 8), (0, -8)])
def test_evidence_moves_along_with_a_scene(down_px, right_px):
    scene, past = fine_texture((192, 224)), weak_evidence()
    temporal = TemporalFilter(4.0)
    temporal.add(past, scene[16:176, 16:208], GRID, NOISE)
    moved = scene[16 - down_px : 176 - down_px, 16 - right_px : 208 - right_px]
    result = temporal.add(NOTHING, moved, GRID, NOISE)
    from_there = np.roll(without_least(past), (down_px // 8, right_px // 8), axis=(0, 1))
    inner = np.s_[8:-8, 8:-8]  # no window that shows what has just come into view
    expected = without_least(np.exp(-1 / 4) * from_there)
    assert result[inner] == pytest.approx(expected[inner], abs=0.02)


def test_half_a_patch_is_the_mean_of_two():
    scene, past = fine_texture((160, 224)), weak_evidence()
    temporal = TemporalFilter(4.0)
    temporal.add(past, scene[:, 16:208], GRID, NOISE)
    result = temporal.add(NOTHING, scene[:, 12:204], GRID, NOISE)
    past = without_least(past)
    expected = without_least(np.exp(-1 / 4) * (past + np.roll(past, 1, axis=1)) / 2)
    inner = np.s_[8:-8, 8:-8]  # no window that shows what has just come into view
    assert result[inner] == pytest.approx(expected[inner], abs=0.02)


def test_neighbours_of_a_level_stay_possible():
    temporal, grey, keep = TemporalFilter(4.0), fine_texture(), np.exp(-1 / 4)
    temporal.add(evidence_for(4, 10.0), grey, GRID, NOISE)
    result = temporal.add(NOTHING, grey, GRID, NOISE)
    expected = keep * np.array([10, 10, 10, 4, 0, 4, 10, 10, 10])
    assert result == pytest.approx(np.broadcast_to(expected, result.shape), abs=1e-3)


@pytest.mark.parametrize("direction", [1, -1])
def test_surface_that_comes_nearer_is_followed(direction):
    temporal, grey = TemporalFilter(10.0), fine_texture()
    for level in range(9)[::direction]:
        result = temporal.add(evidence_for(level, 3.0), grey, GRID, NOISE)
        assert (result.argmin(-1) == level).all()


def test_evidence_is_bounded():
    """One frame, or many, may be wrong: neither must hold for long."""
    temporal, grey = TemporalFilter(1000.0), fine_texture()
    for _ in range(20):
        temporal.add(evidence_for(1, 1e6), grey, GRID, NOISE)
    for _ in range(4):
        result = temporal.add(evidence_for(7, 1e6), grey, GRID, NOISE)
    assert (result.argmin(-1) == 7).all()


def test_black_frames_have_finite_evidence():
    temporal, black = TemporalFilter(4.0), np.zeros(SHAPE, np.float32)
    for grey in (black, black, fine_texture(), black):
        result = temporal.add(NOTHING, grey, GRID, 2e-4)
        assert np.isfinite(result).all()
    assert not result.any()


def test_temporal_filter_forgets_when_told():
    temporal, grey = TemporalFilter(4.0), fine_texture()
    temporal.add(evidence_for(3, 10.0), grey, GRID, NOISE)
    temporal.reset()
    assert not temporal.add(NOTHING, grey, GRID, NOISE).any()


# Frames of a camera that runs.


def with_memory(frames, regularize="semiglobal"):
    return dataclasses.replace(EVERYTHING, temporal_frames=frames, regularize=regularize)


def levels_of(estimator, frames):
    return np.array([estimator.estimate(frame).level for frame in frames])


def error_and_flicker(levels, true):
    return np.abs(levels - true).mean(), levels.std(axis=0).mean()


@pytest.fixture(scope="module")
def weak_scene(bank, camera):
    """A plane under much noise: 12 frames, and its level."""
    video = noisy(blurred(camera, 1.8, contrast=0.005), 12)
    true = np.interp(camera.blur_size_px(1.8), bank.blur_sizes_px, np.arange(LEVELS))
    return video, true


def test_still_scene_is_more_accurate_and_calmer_with_memory(bank, weak_scene):
    video, true = weak_scene
    alone, filtered = (
        levels_of(DepthEstimator(bank, with_memory(frames)), video)[5:] for frames in (0.0, 3.0)
    )
    error, flicker = error_and_flicker(alone, true)
    less_error, less_flicker = error_and_flicker(filtered, true)
    assert less_error < 0.7 * error
    assert less_flicker < 0.4 * flicker


def test_no_memory_is_every_frame_for_itself(bank, weak_scene):
    video = weak_scene[0][:4]
    estimator = DepthEstimator(bank, with_memory(0.0))
    for frame in video:
        estimate, own = estimator.estimate(frame), DepthEstimator(bank, EVERYTHING).estimate(frame)
        assert np.array_equal(estimate.level, own.level)
        assert np.array_equal(estimate.confidence, own.confidence)


def assert_same(estimate, expected):
    assert np.array_equal(estimate.level, expected.level)
    assert np.array_equal(estimate.confidence, expected.confidence)
    assert estimate.noise == expected.noise


@pytest.mark.parametrize("start_anew", ["size", "reset"])
def test_another_video_begins_without_memory(bank, weak_scene, start_anew):
    estimator, fresh = (DepthEstimator(bank, with_memory(3.0)) for _ in range(2))
    first = weak_scene[0]
    second = [frame[:128, 16:176] for frame in first[6:9]] if start_anew == "size" else first[6:9]
    levels_of(estimator, [frame[::-1, ::-1].copy() for frame in first[:4]])
    if start_anew == "reset":
        estimator.reset()
    for frame in second:
        assert_same(estimator.estimate(frame), fresh.estimate(frame))
    # And back: the first video is not remembered either.
    if start_anew == "size":
        alone = DepthEstimator(bank, with_memory(3.0))
        assert_same(estimator.estimate(first[4]), alone.estimate(first[4]))


@pytest.mark.parametrize(
    ("frame", "size"),
    [
        (np.full((20, 192), 0.4, np.float32), None),
        (np.full((*SHAPE, 4), 0.4, np.float32), None),
        (np.full(SHAPE, 100, np.uint8), None),
        (np.full(SHAPE, 0.4, np.float32), (0, 8)),
    ],
    ids=["small", "channels", "type", "map"],
)
def test_refused_frame_leaves_the_memory_as_it_is(bank, weak_scene, frame, size):
    video = weak_scene[0]
    disturbed, undisturbed = (DepthEstimator(bank, with_memory(3.0)) for _ in range(2))
    for good in video[:4]:
        disturbed.estimate(good)
        undisturbed.estimate(good)
    with pytest.raises(InputError):
        disturbed.estimate(frame, size)
    expected = undisturbed.estimate(video[4])
    assert_same(disturbed.estimate(video[4]), expected)
    own = DepthEstimator(bank, EVERYTHING).estimate(video[4])
    assert np.abs(own.level - expected.level).max() > 0.5  # there was something to remember


@pytest.mark.parametrize("regularize", ["semiglobal", "learned"])
@pytest.mark.parametrize("frames", [0.0, 2.0])
def test_stages_are_timed_in_order(fine_bank, weak_scene, frames, regularize):
    estimator = DepthEstimator(fine_bank, with_memory(frames, regularize))
    for frame in weak_scene[0][:2]:
        estimate = estimator.estimate(frame)
        stages = ["observe", "static average", "spectra", "energies", "likelihood"]
        stages += ["small patches", "temporal", "decode", "quality of fit", "periodic texture"]
        stages += ["unknown", "metric"]
        left_out = set() if frames else {"static average", "temporal"}
        if regularize == "semiglobal":
            left_out.add("small patches")
        assert list(estimate.seconds) == [stage for stage in stages if stage not in left_out]
        assert all(0 <= seconds < 60 for seconds in estimate.seconds.values())


@pytest.fixture(scope="module")
def moving_object(bank, camera):
    """A near square that moves by 3 px a frame: frames, and where it is."""
    behind, on_it = natural_texture(SHAPE, seed=3), natural_texture((80, 80), seed=4)
    frames, objects = [], []
    for i in range(10):
        left = 40 + 3 * i
        texture, depth = behind.copy(), np.full(SHAPE, 2.0, np.float32)
        texture[40:120, left : left + 80] = on_it
        depth[40:120, left : left + 80] = 1.2
        inside = np.zeros(SHAPE, bool)
        inside[48:112, left + 8 : left + 72] = True
        coded = render_coded_frame(texture, depth, camera)
        frames += noisy(coded, 1, 0.006, seed=i)
        objects.append(inside)
    near, far = (
        np.interp(camera.blur_size_px(depth), bank.blur_sizes_px, np.arange(LEVELS))
        for depth in (1.2, 2.0)
    )
    return frames, np.array(objects), near, far


def test_memory_does_not_harm_what_moves(bank, moving_object):
    frames, objects, near, far = moving_object
    alone, filtered = (
        levels_of(DepthEstimator(bank, with_memory(memory)), frames) for memory in (0.0, 4.0)
    )
    assert np.abs(filtered - near)[objects].mean() < 1.05 * np.abs(alone - near)[objects].mean()
    behind = np.s_[2:, :, 160:]
    assert np.abs(filtered - far)[behind].mean() < 1.05 * np.abs(alone - far)[behind].mean()


def sizes_of(estimator, frames):
    return np.array([estimator.estimate(frame).blur_size_px for frame in frames])


def test_refinement_is_more_accurate_and_calmer_with_memory(fine_bank, camera, weak_scene):
    video, true = weak_scene[0], camera.blur_size_px(1.8)
    alone, filtered = (
        sizes_of(DepthEstimator(fine_bank, with_memory(frames, "learned")), video)[5:]
        for frames in (0.0, 3.0)
    )
    error, flicker = error_and_flicker(alone, true)
    less_error, less_flicker = error_and_flicker(filtered, true)
    assert less_error < 0.9 * error
    assert less_flicker < 0.6 * flicker


def test_memory_does_not_harm_the_refinement_of_what_moves(fine_bank, camera, moving_object):
    frames, objects, *_ = moving_object
    alone, filtered = (
        sizes_of(DepthEstimator(fine_bank, with_memory(memory, "learned")), frames)
        for memory in (0.0, 4.0)
    )
    for depth_m, where in ((1.2, objects), (2.0, np.s_[2:, :, 160:])):
        true = camera.blur_size_px(depth_m)
        error, less = (np.abs(sizes - true)[where].mean() for sizes in (alone, filtered))
        assert less < error + 0.05  # px; what is left behind would be off by 5 px


# Recorded videos.


# 0.5 looks 1 frame ahead and 1 looks 2: blocks of 4 and of 8 frames, of which 3 and 6 are done.
@pytest.mark.parametrize(
    ("memory", "length"),
    [(0.5, n) for n in (1, 2, 3, 4, 5, 7, 8, 10)] + [(1.0, n) for n in (1, 2, 7, 8, 9, 14, 15)],
)
def test_every_frame_of_a_video_has_its_result(bank, camera, memory, length):
    """Each frame has another brightness and depth, by which its result is known."""
    depths = np.where(np.arange(length) % 2, 1.2, 1.9)
    coded = {depth: blurred(camera, depth, seed=int(depth * 10)) for depth in (1.2, 1.9)}
    frames = (noisy(coded[depth], 1, 0.002, seed)[0] for seed, depth in enumerate(depths))
    results = list(estimate_video(DepthEstimator(bank, with_memory(memory)), frames))
    found = [np.median(result.depth_m) for result in results]
    assert found == pytest.approx(depths, rel=0.06)


def test_video_without_frames_has_no_results(bank):
    assert list(estimate_video(DepthEstimator(bank, with_memory(1.0)), [])) == []


def test_results_come_before_the_video_ends(bank, weak_scene):
    taken = []

    def frames():
        for frame in weak_scene[0] * 4:
            taken.append(frame)
            yield frame

    results = estimate_video(DepthEstimator(bank, with_memory(1.0)), frames())
    next(results)
    assert len(taken) == 8


def test_video_is_no_worse_than_a_camera_that_runs(bank, weak_scene):
    video, true = weak_scene
    causal = levels_of(DepthEstimator(bank, with_memory(2.0)), video)
    results = estimate_video(DepthEstimator(bank, with_memory(2.0)), video)
    both_ways = np.array([result.level for result in results])
    error, flicker = error_and_flicker(causal, true)
    assert error_and_flicker(both_ways, true)[0] < error
    assert error_and_flicker(both_ways, true)[1] < 0.7 * flicker
    # The first frames gain the most: to them the past says nothing.
    first, first_causal = (np.abs(levels[0] - true).mean() for levels in (both_ways, causal))
    assert first < 0.7 * first_causal


@pytest.mark.parametrize("window_px", [32, 48])
def test_video_of_one_frame_is_that_frame(camera, window_px):
    """Also where evidence against a level is stronger than a frame's may count."""
    bank = learn_bank_for_camera(camera, 1.0, 2.2, LEVELS, LearnConfig(window_px=window_px))
    frame = blurred(camera, 1.5)
    own = DepthEstimator(bank, EVERYTHING).estimate(frame)
    (result,) = estimate_video(DepthEstimator(bank, with_memory(2.0)), [frame])
    causal = DepthEstimator(bank, with_memory(2.0)).estimate(frame)
    assert result.level == pytest.approx(causal.level, abs=1e-4)
    assert np.mean(np.abs(result.level - own.level) < 0.6) > 0.98


def test_still_scene_without_noise_is_alike_at_all_times(bank, camera):
    frame = blurred(camera, 1.5)
    own = DepthEstimator(bank, EVERYTHING).estimate(frame).level
    results = estimate_video(DepthEstimator(bank, with_memory(1.0)), [frame] * 7)
    levels = np.array([result.level for result in results])
    assert levels == pytest.approx(levels[::-1], abs=1e-2)
    assert np.mean(np.abs(levels - own) < 0.6) > 0.98
    assert np.ptp(levels, axis=0).mean() < 0.1


def test_video_backwards_has_the_results_backwards(bank, moving_object):
    video = moving_object[0][:8]

    def levels(frames):
        results = estimate_video(DepthEstimator(bank, with_memory(1.5)), frames)
        return np.array([result.level for result in results])

    difference = np.abs(levels(video) - levels(video[::-1])[::-1])
    assert np.mean(difference < 0.01) > 0.995


@pytest.mark.parametrize("at", [3, 5, 6])
def test_every_result_knows_the_next_frames(bank, weak_scene, at):
    """Also the last ones of a block of frames that are finished together, here the sixth."""
    video = weak_scene[0]
    changed = [*video[: at + 2], video[at + 2][::-1].copy(), *video[at + 3 :]]
    results = [
        list(estimate_video(DepthEstimator(bank, with_memory(1.0)), frames))[at].level
        for frames in (video[:11], changed[:11], video[: at + 1])
    ]
    assert not np.array_equal(results[0], results[1])
    assert not np.array_equal(results[0], results[2])


def test_video_maps_have_the_size_that_was_asked_for(bank, weak_scene):
    estimator = DepthEstimator(bank, with_memory(0.5))
    results = list(estimate_video(estimator, weak_scene[0][:2], (80, 96)))
    assert [result.level.shape for result in results] == [(80, 96)] * 2


@pytest.mark.parametrize("at", [1, 6])
def test_frames_of_two_sizes_are_refused(bank, weak_scene, at):
    """Within a block, and in a later one."""
    frames = [*weak_scene[0][:at], weak_scene[0][at][:128, :160]]
    results = estimate_video(DepthEstimator(bank, with_memory(0.5)), frames)
    with pytest.raises(InputError, match="a frame of 160x128 px after frames of 192x160 px"):
        list(results)


def test_video_needs_memory(bank, weak_scene):
    with pytest.raises(InputError, match=r"temporal_frames: .* more than 0"):
        list(estimate_video(DepthEstimator(bank, EVERYTHING), weak_scene[0][:2]))


def test_video_of_an_impossible_map_is_refused(bank, weak_scene):
    estimator = DepthEstimator(bank, dataclasses.replace(EVERYTHING, temporal_frames=1.0))
    with pytest.raises(InputError, match="at least 1x1"):
        list(estimate_video(estimator, weak_scene[0][:2], (0, 8)))
