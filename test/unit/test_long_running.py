"""What runs for days must not grow, and what cannot run is refused at the start."""

import dataclasses
import gc
import tracemalloc

import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import processors, thread_count
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood.bank import (
    LearnConfig,
    learn_bank_for_camera,
    load_bank,
    save_bank,
)
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation import render_coded_frame

SHAPE = (160, 192)
LEVELS = 10
EVERYTHING = DepthConfig(confidence_threshold=0)


@pytest.fixture(scope="module")
def camera():
    return Camera(800.0, 0.9, 192, 160, Mask.named("levin"), 20.0)


def learned(camera, **config):
    return learn_bank_for_camera(camera, 1.0, 2.2, LEVELS, LearnConfig(window_px=32, **config))


@pytest.fixture(scope="module")
def bank(camera):
    return learned(camera, highest_frequency=1.0)


def plane_at(camera, depth_m, noise=0.002, seed=1):
    random = np.random.default_rng(seed)
    spectrum = np.fft.rfft2(random.normal(size=SHAPE))
    frequency = np.hypot(np.fft.fftfreq(SHAPE[0])[:, None], np.fft.rfftfreq(SHAPE[1]))
    frequency[0, 0] = np.inf
    texture = np.fft.irfft2(spectrum * frequency**-1.2, SHAPE)
    texture = (0.4 + 0.1 * texture / texture.std()).astype(np.float32)
    frame = render_coded_frame(texture, np.full(SHAPE, depth_m, np.float32), camera)
    return (frame + random.normal(0, noise, SHAPE)).astype(np.float32)


def growth(call, warm_up):
    """Return how many bytes more are held after `call` of numbers up to three times the warm-up."""

    def size_after(count):
        for number in range(count):
            call(number)
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = size_after(warm_up)
        return size_after(3 * warm_up) - before
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def frames(camera):
    return [plane_at(camera, 1.5, seed=seed) for seed in range(4)]


@pytest.mark.slow
@pytest.mark.parametrize(("temporal_frames", "warm_up"), [(0.0, 30), (3.0, 100)])
def test_memory_does_not_grow(bank, frames, temporal_frames, warm_up):
    config = dataclasses.replace(EVERYTHING, temporal_frames=temporal_frames)
    estimator = DepthEstimator(bank, config)
    # Each twice: static, then another scene.
    grown = growth(lambda number: estimator.estimate(frames[number // 2 % 4]), warm_up)
    estimator.close()
    assert grown < 50_000  # less than half a frame


@pytest.mark.slow
def test_memory_does_not_grow_with_changes_of_size(bank, frames):
    """Each size is planned anew; the plans before are let go."""
    estimator = DepthEstimator(bank, dataclasses.replace(EVERYTHING, temporal_frames=3.0))
    grown = growth(lambda number: estimator.estimate(frames[0][: 96 + 8 * (number % 2)]), 4)
    estimator.close()
    assert grown < 50_000


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"method": "cg", "iterations": 2}])
def test_memory_of_deblurring_does_not_grow(bank, frames, options):
    """Nor with other sizes of frames, or other settings."""
    configs = [DeblurConfig(temporal_frames=count, **options) for count in (0.0, 3.0)]
    deblurrer = Deblurrer(bank.stack, configs[0])

    def deblur(number):
        deblurrer.reconfigure(configs[number // 3 % 2])
        frame = frames[number % 4][: 96 + 8 * (number // 6 % 2)]
        deblurrer.deblur(frame, np.full(frame.shape, 6.0, np.float32), 0.002)

    grown = growth(deblur, 24)
    deblurrer.close()
    assert grown < 50_000


def test_threads_that_are_not_there_are_refused():
    with pytest.raises(InputError, match="threads: -1 is out of range"):
        DepthConfig(threads=-1)
    assert thread_count(DepthConfig().threads) == min(processors(), 4)
    too_many = processors() + 1
    if too_many <= 1024:
        message = f"threads: {too_many} is out of range: .* {processors()} processor.*at most "
        with pytest.raises(InputError, match=message):
            DepthConfig(threads=too_many)
    with pytest.raises(InputError, match="threads: 10000 is out of range"):
        DepthConfig(threads=10_000)


@pytest.mark.parametrize("backend", ["nonsense", "", "NumPy"])
def test_backend_that_is_not_there_is_refused(backend):
    with pytest.raises(InputError, match=r"backend: .*numpy, torch, cuda, auto"):
        DepthConfig(backend=backend)


@pytest.mark.parametrize("backend", ["torch", "cuda"])
def test_missing_pytorch_is_found_before_the_first_frame(backend, monkeypatch):
    monkeypatch.setattr("coded_aperture_ros.likelihood.backends.find_spec", lambda _: None)
    with pytest.raises(InputError, match=f"{backend} needs PyTorch"):
        DepthConfig(backend=backend)


def test_stride_is_the_banks_unless_configured(bank, camera):
    frame, coarse = plane_at(camera, 1.5), dataclasses.replace(bank, stride_px=16)
    configured = DepthEstimator(bank, dataclasses.replace(EVERYTHING, stride_px=16)).estimate(frame)
    of_bank = DepthEstimator(coarse, EVERYTHING).estimate(frame)
    assert np.array_equal(of_bank.level, configured.level)
    assert np.array_equal(of_bank.confidence, configured.confidence)
    estimator = DepthEstimator(coarse, dataclasses.replace(EVERYTHING, stride_px=8))
    overruled = estimator.estimate(frame)
    assert np.array_equal(overruled.level, DepthEstimator(bank, EVERYTHING).estimate(frame).level)
    assert not np.array_equal(overruled.level, of_bank.level)


def test_bank_file_keeps_frequency_stride_and_error(camera, tmp_path):
    bank = learned(camera, highest_frequency=0.3)
    tuned = dataclasses.replace(bank, stride_px=12, level_error=0.25)
    save_bank(tuned, tmp_path / "bank.npz")
    loaded = load_bank(tmp_path / "bank.npz")
    assert (loaded.highest_frequency, loaded.stride_px, loaded.level_error) == (0.3, 12, 0.25)
    assert loaded.basis_vectors == tuned.basis_vectors
    frame = plane_at(camera, 1.5)
    before, after = (DepthEstimator(each, EVERYTHING).estimate(frame) for each in (tuned, loaded))
    assert np.array_equal(before.level, after.level)
    save_bank(bank, tmp_path / "bank.npz")
    assert np.isnan(load_bank(tmp_path / "bank.npz").level_error)


def test_strong_blur_leaves_nothing_in_high_frequencies(bank, camera):
    """Levels without frequencies above 0.3 are nearly as good, and not the same."""
    low = learned(camera, highest_frequency=0.3)
    assert low.fourier.multiplicity.sum() < 0.5 * bank.fourier.multiplicity.sum()
    errors = []
    for each in (bank, low):
        estimator = DepthEstimator(each, EVERYTHING)
        assert each.blur_sizes_px[-2] > 7
        depth = camera.depth_m(each.blur_sizes_px[-2])
        levels = [estimator.estimate(plane_at(camera, depth, seed=i)).level for i in range(3)]
        errors.append(np.abs(np.array(levels) - (LEVELS - 2)).mean())
    assert errors[0] != errors[1]
    assert errors[1] < 0.3
    assert errors[1] < errors[0] + 0.1


def test_bank_file_of_version_1_is_read(bank, camera, tmp_path):
    save_bank(bank, tmp_path / "bank.npz")
    with np.load(tmp_path / "bank.npz") as archive:
        arrays = dict(archive)
    assert int(arrays["schema_version"]) == 2
    for name in ("highest_frequency", "stride_px", "level_error"):
        del arrays[name]
    arrays["schema_version"] = 1
    np.savez(tmp_path / "old.npz", **arrays)
    old = load_bank(tmp_path / "old.npz")
    assert (old.highest_frequency, old.stride_px) == (1.0, 8)
    assert np.isnan(old.level_error)
    frame = plane_at(camera, 1.5)
    levels = [DepthEstimator(each, EVERYTHING).estimate(frame).level for each in (old, bank)]
    assert np.array_equal(levels[0], levels[1])
