"""The engines: on every backend the energies are those of the definition, in `FilterBank`."""

import sys
import tracemalloc
from functools import cache
from importlib.machinery import ModuleSpec
from types import SimpleNamespace

import numpy as np
import pytest
from definition import energies_by_definition
from scipy.ndimage import gaussian_filter, uniform_filter

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import BACKENDS, Plan, new_engine
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank
from coded_aperture_ros.optics import Mask, render_psf_stack

NOISE = 0.002
# Of the spread of the energies in a frame. Single precision gives up to 1e-5, on every backend.
TOLERANCE = 3e-5


@pytest.fixture(params=[name for name in BACKENDS if name != "auto"])
def backend(request):
    if request.param != "numpy":
        torch = pytest.importorskip("torch", reason="needs PyTorch")
        if request.param == "cuda" and not torch.cuda.is_available():
            pytest.skip("needs a CUDA device")
    return request.param


@cache
def some_bank(window_px=32, levels=5, mask="levin"):
    stack = render_psf_stack(Mask.named(mask), np.linspace(3, 9, levels))
    return learn_bank(stack, LearnConfig(window_px=window_px, rank=32))


def some_frame(shape, seed=0):
    """Texture that is blurred more on the right; read-only, as a camera's may be."""
    random = np.random.default_rng(seed)
    sharp = gaussian_filter(random.normal(0.4, 1.0, shape), 1)
    right = np.arange(shape[1]) >= shape[1] // 2
    blurred = np.where(right, uniform_filter(sharp, 7), uniform_filter(sharp, 4))
    frame = (blurred + random.normal(0, NOISE, shape)).astype(np.float32)
    frame.setflags(write=False)
    return frame


def plan_engine(bank, shape, stride_px, backend="numpy", threads=1):
    return new_engine(Plan.for_frames(bank, shape, stride_px), backend, threads)


def assert_close(energies, expected):
    assert energies.shape == expected.shape
    assert energies.dtype == np.float32
    assert np.ptp(expected, axis=-1).any()  # the levels differ somewhere
    assert np.abs(energies - expected).max() < TOLERANCE * np.ptp(expected)


@pytest.mark.parametrize(
    ("window_px", "levels", "shape", "stride_px"),
    [
        (32, 5, (96, 128), 8),
        (16, 5, (101, 77), 5),
        (30, 2, (101, 77), 7),
        (48, 5, (77, 101), 12),
        (48, 5, (48, 48), 12),  # one window
        (16, 2, (16, 90), 3),  # one row
        (16, 5, (101, 17), 40),  # one column, with gaps
        (32, 5, (40, 41), 1),
    ],
)
def test_energies_are_those_of_the_definition(backend, window_px, levels, shape, stride_px):
    bank, frame = some_bank(window_px, levels), some_frame(shape)
    engine = plan_engine(bank, shape, stride_px, backend)
    engine.project(frame)
    assert engine.name == backend
    random = np.random.default_rng(1)
    grid = PatchGrid.covering(shape, window_px, stride_px)
    noises = random.uniform(0.5, 2.5, (grid.rows, grid.columns)).astype(np.float32) * NOISE
    for noise in (NOISE, noises, 0.05, NOISE / 20, NOISE):
        assert_close(engine.energies(noise), energies_by_definition(bank, frame, stride_px, noise))
    engine.close()


@pytest.mark.parametrize(("mask", "mirrored"), [("levin", True), ("zhou", False)])
def test_only_what_a_mask_tells_is_looked_at(backend, mask, mirrored):
    """Behind a mask that is its own mirror image, +v and -v are alike."""
    bank, frame = some_bank(mask=mask), some_frame((64, 72))
    plan = Plan.for_frames(bank, frame.shape, 8)
    assert mirrored == (not plan.horizontal_counts[plan.paired : 2 * plan.paired].any())
    engine = plan_engine(bank, frame.shape, 8, backend)
    engine.project(frame)
    assert_close(engine.energies(NOISE), energies_by_definition(bank, frame, 8, NOISE))


@pytest.mark.parametrize(("stride_px", "step"), [(8, 2), (4, 4), (12, 1)])
def test_levels_that_are_not_dense_are_those_of_some_patches(backend, stride_px, step):
    bank, frame = some_bank(), some_frame((70, 85))
    plan = Plan.for_frames(bank, frame.shape, stride_px, dense_levels=3)
    engine = new_engine(plan, backend)
    engine.project(frame)
    energies = engine.energies(NOISE)
    expected = energies_by_definition(bank, frame, stride_px, NOISE)
    assert plan.sparse_step == step
    assert_close(energies[..., :3], expected[..., :3])
    assert_close(energies[::step, ::step], expected[::step, ::step])


def test_frame_without_light_has_no_preference(backend):
    bank, black = some_bank(), np.zeros((64, 80), np.float32)
    engine = plan_engine(bank, black.shape, 8, backend)
    engine.project(black)
    energies = engine.energies(NOISE)
    assert energies == pytest.approx(energies_by_definition(bank, black, 8, NOISE), rel=1e-5)
    assert np.ptp(energies, axis=-1).max() == 0
    engine.close()


def test_frames_do_not_depend_on_earlier_ones(backend):
    bank, shape = some_bank(), (90, 100)
    engine = plan_engine(bank, shape, 8, backend)
    for seed in (1, 2):
        frame = some_frame(shape, seed)
        engine.project(frame)
        engine.energies(0.05)
        assert_close(engine.energies(NOISE), energies_by_definition(bank, frame, 8, NOISE))
    engine.close()


def test_any_number_of_threads_gives_the_same(backend):
    if processors() < 2:
        pytest.skip("needs two processors")
    shape = (150, 170)
    results = []
    for threads in (1, 2):
        engine = plan_engine(some_bank(), shape, 6, backend, threads)
        engine.project(some_frame(shape))
        results.append(engine.energies(NOISE).copy())
        engine.close()
        engine.close()  # does no harm
    assert_close(results[1], results[0])


@pytest.mark.parametrize("group_bytes", [0, 2**19])
def test_working_in_groups_of_rows_changes_nothing(backend, group_bytes, monkeypatch):
    if backend == "numpy":
        pytest.skip("always works in groups")
    from coded_aperture_ros.likelihood import torch_engine

    monkeypatch.setattr(torch_engine, "_GROUP_BYTES", group_bytes)
    bank, frame = some_bank(), some_frame((120, 101))
    engine = plan_engine(bank, frame.shape, 5, backend)
    assert 1 < len(engine._groups) <= engine._plan.grid.rows
    engine.project(frame)
    assert_close(engine.energies(NOISE), energies_by_definition(bank, frame, 5, NOISE))
    engine.close()


def test_nothing_large_is_allocated_per_frame():
    frame = some_frame((240, 320))
    engine = plan_engine(some_bank(), frame.shape, 8)
    noise = np.full((engine.plan.grid.rows, engine.plan.grid.columns), NOISE, np.float32)

    def work():
        engine.project(frame)
        engine.energies(noise)

    work()
    tracemalloc.start()
    try:
        work()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
        engine.close()
    assert peak < 200_000  # the frame alone has 307 200 bytes


def test_frame_smaller_than_a_window_is_refused(backend):
    with pytest.raises(InputError, match="80x31 px is smaller than the bank's 32 px window"):
        plan_engine(some_bank(), (31, 80), 8, backend)


@pytest.mark.parametrize("threads", [-1, 0, 10_000])
def test_threads_that_are_not_there_are_refused(backend, threads):
    message = f"threads: {threads} is out of range: this machine has {processors()} processor"
    with pytest.raises(InputError, match=message):
        plan_engine(some_bank(), (64, 64), 8, backend, threads)


def test_unknown_backend_is_refused():
    with pytest.raises(InputError, match="'opencl' is not one of numpy, torch, cuda, auto"):
        plan_engine(some_bank(), (64, 64), 8, "opencl")


def planned(backend):
    return plan_engine(some_bank(), (64, 64), 8, backend).name


def test_missing_torch_is_refused_by_name(monkeypatch):
    monkeypatch.setattr("coded_aperture_ros.likelihood.backends.find_spec", lambda name: None)
    for name in ("torch", "cuda"):
        with pytest.raises(InputError, match=rf"{name} needs PyTorch: .*pip install .*use numpy"):
            planned(name)
    assert planned("auto") == "numpy"


def test_missing_gpu_is_refused_by_name(monkeypatch):
    # A stand-in, so that this is tested without PyTorch, too.
    without = SimpleNamespace(
        __spec__=ModuleSpec("torch", None), cuda=SimpleNamespace(is_available=lambda: False)
    )
    monkeypatch.setitem(sys.modules, "torch", without)
    with pytest.raises(InputError, match=r"no CUDA device here .*use torch or numpy"):
        planned("cuda")
    assert planned("auto") == "numpy"
