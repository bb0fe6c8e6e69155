"""The pipeline that nodes, commands, bags and Python programs share."""

import dataclasses
import pickle
import threading

import numpy as np
import pytest
from small_camera import CAMERA, DEPTH_M, FAR_M, NEAR_M, coded_wall

from coded_aperture_ros import FramePipeline
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer, blur_levels
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import Frame, KnownNoise, View, channel_noise
from coded_aperture_ros.frames.frame import LateFrameError
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank_for_camera
from coded_aperture_ros.optics import camera_from_mapping

SECOND_NS = 1_000_000_000


@pytest.fixture(scope="module")
def camera():
    return camera_from_mapping(CAMERA)


@pytest.fixture(scope="module")
def frame(camera):
    return coded_wall(camera)


@pytest.fixture(scope="module")
def bank(camera):
    return learn_bank_for_camera(camera, NEAR_M, FAR_M, 12, LearnConfig(window_px=32, rank=32))


def noisier(frame, seed):
    noise = 0.01 * np.random.default_rng(seed).standard_normal(frame.shape)
    return (frame + noise).astype(np.float32)


def test_depth_and_picture_are_those_of_the_parts(bank, camera, frame):
    pipeline = FramePipeline(bank, camera)
    result = pipeline(frame)
    alone = DepthEstimator(bank, None, camera).estimate(frame)
    assert np.array_equal(result.depth_m, alone.depth_m, equal_nan=True)
    assert np.nanmedian(result.depth_m) == pytest.approx(DEPTH_M, rel=0.05)
    sharp = Deblurrer(bank.stack).deblur(frame, alone.blur_size_px)
    assert np.array_equal(pipeline.deblur(frame, result), sharp)
    assert np.array_equal(pipeline.deblur(frame), sharp)
    assert next(iter(result.seconds)) == "observe"
    pipeline.close()


def test_pictures_are_made_only_when_asked_for(bank, camera, frame, monkeypatch):
    def deblur(*_):
        raise AssertionError("nobody has asked for the picture")

    monkeypatch.setattr(Deblurrer, "deblur", deblur)
    pipeline = FramePipeline(bank, camera)
    result = pipeline(frame)
    with pytest.raises(AssertionError, match="nobody"):
        pipeline.deblur(frame, result)
    with pytest.raises(InputError, match="made without it"):
        FramePipeline(bank, camera, deblur=None).deblur(frame)


def test_depth_from_elsewhere_is_deblurred_by(bank, camera, frame):
    """With a bank, or by the PSFs alone; they are those of the same camera."""
    depth_m = np.full((12, 16), DEPTH_M, np.float32)
    blur_size_px = camera.blur_map_px(depth_m).astype(np.float32)
    expected = Deblurrer(bank.stack).deblur(frame, blur_size_px)
    pipeline = FramePipeline(bank, camera)
    assert np.array_equal(pipeline.deblur(frame, depth_m), expected)
    levels = blur_levels(camera=camera, depth_range_m=(NEAR_M, FAR_M), level_count=12)
    alone = FramePipeline(levels, camera)
    assert np.allclose(alone.deblur(frame, depth_m), expected, atol=1e-3)
    with pytest.raises(InputError, match="no depth"):
        alone(frame)
    with pytest.raises(InputError, match="no depth is known"):
        pipeline.deblur(frame, np.full((12, 16), np.nan, np.float32))
    with pytest.raises(InputError, match="give the camera"):
        stack = dataclasses.replace(bank.stack, depths_m=None)
        FramePipeline(dataclasses.replace(bank, stack=stack)).deblur(frame, depth_m)


def test_region_of_the_view_has_the_depth_of_the_whole(bank, camera, frame):
    """Also when regions and whole frames take turns."""
    pipeline = FramePipeline(bank, camera)
    rows, columns = frame.shape
    region = np.s_[8 : rows - 16, 16 : columns - 8]
    cut = np.ascontiguousarray(frame[region])
    view = View(cut.shape[1], cut.shape[0], columns, rows, left=16, top=8)
    whole = pipeline(frame)
    found = pipeline(Frame(cut, view=view))
    assert np.nanmedian(found.depth_m) == pytest.approx(np.nanmedian(whole.depth_m), rel=0.02)
    again = pipeline(frame)
    assert np.array_equal(again.depth_m, whole.depth_m, equal_nan=True)
    sharp = pipeline.deblur(Frame(cut, view=view), np.full(cut.shape, DEPTH_M, np.float32))
    assert sharp.shape == cut.shape


def test_time_that_goes_back_begins_another_video(bank, camera, frame):
    memory = DepthConfig(temporal_frames=4.0)
    pipeline, fresh = (FramePipeline(bank, camera, memory, None) for _ in range(2))
    for number in range(3):
        pipeline(Frame(noisier(frame, number), stamp_ns=(10 + number) * SECOND_NS))
    expected = fresh(noisier(frame, 9))
    found = pipeline(Frame(noisier(frame, 9), stamp_ns=2 * SECOND_NS))
    assert np.array_equal(found.level, expected.level, equal_nan=True)
    pipeline.reset()
    fresh.reset()
    again = pipeline(Frame(noisier(frame, 8), stamp_ns=SECOND_NS)), fresh(noisier(frame, 8))
    assert np.array_equal(again[0].level, again[1].level, equal_nan=True)


@pytest.mark.parametrize(
    ("depth", "deblur"),
    [
        (DepthConfig(temporal_frames=2.0), DeblurConfig()),
        (DepthConfig(), DeblurConfig(temporal_frames=2.0)),
    ],
)
def test_a_late_frame_is_refused_where_frames_depend_on_others(bank, camera, frame, depth, deblur):
    pipeline = FramePipeline(bank, camera, depth, deblur)
    pipeline(Frame(frame, stamp_ns=5 * SECOND_NS))
    with pytest.raises(LateFrameError, match="older than the one before"):
        pipeline(Frame(frame, stamp_ns=5 * SECOND_NS - SECOND_NS // 2))
    forgetful = FramePipeline(bank, camera)
    forgetful(Frame(frame, stamp_ns=5 * SECOND_NS))
    forgetful(Frame(frame, stamp_ns=5 * SECOND_NS - SECOND_NS // 2))


def test_settings_change_between_frames(bank, camera, frame):
    pipeline = FramePipeline(bank, camera, DepthConfig(confidence_threshold=1.0))
    before = pipeline(frame)
    estimator = pipeline.estimator
    pipeline.reconfigure(depth=estimator.config, camera=camera)
    assert pipeline.estimator is estimator  # nothing has changed
    pipeline.reconfigure(depth=DepthConfig(unknown="nearest", confidence_threshold=1.0))
    after = pipeline(frame)
    assert np.isfinite(after.depth_m).all()
    assert not np.isfinite(before.depth_m).any()
    sharp = pipeline.deblur(frame, after)
    pipeline.reconfigure(deblur=DeblurConfig(smoothness=50.0))
    smooth = pipeline.deblur(frame)
    assert np.abs(np.diff(smooth)).mean() < 0.9 * np.abs(np.diff(sharp)).mean()
    near = dataclasses.replace(camera, side="near")
    with pytest.raises(InputError, match="side"):
        pipeline.reconfigure(camera=near)
    assert pipeline.estimator.camera is camera  # as it was
    pipeline(frame)


def test_the_noise_of_options_comes_before_that_of_camera_and_bank(bank, camera, frame):
    known = dataclasses.replace(camera, noise=0.02, noise_gain=1e-4)
    of_bank = dataclasses.replace(bank, noise=0.03)
    estimate = FramePipeline(of_bank, known, DepthConfig(noise=0.01))(frame)
    assert estimate.noise == pytest.approx(0.01)
    assert FramePipeline(of_bank, known)(frame).noise == pytest.approx(0.02)
    assert FramePipeline(of_bank, camera)(frame).noise == pytest.approx(0.03)
    assert FramePipeline(bank, camera)(frame).noise < 0.008  # estimated

    # And the picture is deblurred with that noise.
    for pipeline, noise in (
        (FramePipeline(of_bank, known, deblur=DeblurConfig(noise=0.05)), KnownNoise(0.05, 1e-4)),
        (FramePipeline(of_bank, known), KnownNoise(0.02, 1e-4)),
        (FramePipeline(of_bank, camera), KnownNoise(0.03)),
        (FramePipeline(bank, camera), KnownNoise()),
    ):
        result = pipeline(frame)
        blur = result.blur_size_px
        expected = Deblurrer(bank.stack).deblur(frame, blur, channel_noise(frame, noise))
        assert np.array_equal(pipeline.deblur(frame, result), expected)


def test_a_video_is_seen_from_both_ends(bank, camera, frame):
    frames = [noisier(frame, seed) for seed in range(5)]
    pipeline = FramePipeline(bank, camera, DepthConfig(temporal_frames=1.0))
    results = list(pipeline.video(frames, (48, 64)))
    assert [estimate.level.shape for _, estimate in results] == [(48, 64)] * 5
    assert all(found.light is own for (found, _), own in zip(results, frames, strict=True))
    with pytest.raises(InputError, match="temporal_frames"):
        list(FramePipeline(bank, camera).video(frames))


def test_a_pipeline_travels_to_another_process(bank, camera, frame):
    pipeline = FramePipeline(bank, camera, DepthConfig(threads=1))
    pipeline(frame)
    sent = pickle.loads(pickle.dumps(pipeline))
    assert sent.estimator.config == pipeline.estimator.config
    assert np.array_equal(sent.deblur(frame), pipeline.deblur(frame))


def test_closing_ends_the_threads(bank, camera, frame):
    from coded_aperture_ros.core.workers import processors

    if processors() < 2:
        pytest.skip("needs two processors")
    before = threading.active_count()
    pipeline = FramePipeline(bank, camera, DepthConfig(threads=2), DeblurConfig(threads=2))
    pipeline.deblur(frame)
    assert threading.active_count() > before
    pipeline.close()
    assert threading.active_count() == before
