"""What the training scripts write, here and by the workers of a Dask scheduler."""

import dataclasses
import importlib
import sys

import numpy as np
import pytest

pytest.importorskip("numba", reason="random scenes need numba")


@pytest.fixture(scope="module")
def training(checkout):
    """The scripts' modules, as they import each other."""
    folder = str(checkout / "training")
    sys.path.insert(0, folder)
    yield {name: importlib.import_module(name) for name in ("shards", "scenes", "costs")}
    sys.path.remove(folder)


@pytest.fixture
def few_frames(training, monkeypatch):
    for name in ("scenes", "costs"):
        monkeypatch.setattr(training[name], "FRAMES_PER_SHARD", 2)
    monkeypatch.setattr(training["scenes"], "FRAME_PX", 96)


def run(monkeypatch, module, *options):
    monkeypatch.setattr(sys, "argv", [module.__name__, *map(str, options)])
    module.main()


def test_some_frames_lose_weak_texture_and_keep_edges(training):
    costs = training["costs"]
    how = [costs.seen(number, "far") for number in range(200)]
    assert 0.15 < np.mean([each.smoothed > 0 for each in how]) < 0.35
    clean = dataclasses.replace(how[0], noise=0.0, gain=0.0, blur_px=0.0, eight_bits=False)
    step = np.repeat(np.float32([0.2, 0.6]), 32) * np.ones((64, 1), np.float32)
    light = step + np.random.default_rng(0).normal(0, 0.002, step.shape).astype(np.float32)
    plain, smooth = (
        costs.recorded(light, dataclasses.replace(clean, smoothed=contrast), 0)
        for contrast in (0.0, 0.02)
    )
    assert np.array_equal(plain, light)
    assert (smooth - step).std() < 0.5 * (light - step).std()
    assert np.abs(smooth - light).max() < 0.02


def test_frames_and_their_costs_are_written_once(
    training, few_frames, monkeypatch, tmp_path, capsys
):
    scenes, costs = tmp_path / "scenes", tmp_path / "costs"
    run(monkeypatch, training["scenes"], "--output", scenes, "--shards", 3, 5)
    assert sorted(path.name for path in scenes.iterdir()) == ["scenes_0003.npz", "scenes_0004.npz"]
    assert "scenes_0003.npz: 1 of 2" in capsys.readouterr().out
    shard = dict(np.load(scenes / "scenes_0004.npz"))
    expected = training["scenes"].render(9)
    for name, values in expected.items():
        np.testing.assert_array_equal(shard[name][1], values)
    # No blur size is unknown.
    assert np.abs(shard["blur"]).min() > 0 and np.abs(shard["blur"]).max() < 20 * 1500

    run(monkeypatch, training["costs"], "--scenes", scenes, "--output", costs, "--shards", 0, 9, 4)
    assert [path.name for path in costs.glob("*.npz")] == ["costs_0004.npz"]
    seen = np.load(costs / "costs_0004.npz")
    cells = training["costs"].CELLS
    assert seen["costs"].shape[0] == 2 and seen["costs"].shape[2:] == (cells, cells)
    assert np.isfinite(seen["costs"]).all() and np.isfinite(seen["frame"]).all()
    assert seen["tried"].any(axis=1).all() and (seen["corner"] <= 0).all()
    assert ((seen["told"] > 0) & (seen["told"] <= 1)).all()

    capsys.readouterr()
    before = (scenes / "scenes_0003.npz").stat().st_mtime_ns
    run(monkeypatch, training["scenes"], "--output", scenes, "--shards", 3, 5)
    assert (scenes / "scenes_0003.npz").stat().st_mtime_ns == before
    assert capsys.readouterr().out == ""


def test_training_never_sees_the_scenes_of_the_benchmarks(training):
    from coded_aperture_benchmarks.frames.random_scenes import FIRST_SEED

    assert FIRST_SEED == 1_000_000
    masks = set()
    for number in (0, 17, 99_999):
        drawn = training["scenes"].drawn(number)
        assert drawn.seed < 100_000 < FIRST_SEED
        assert drawn == training["scenes"].drawn(number)
    for number in range(400):
        masks.add(training["scenes"].drawn(number).mask)
    assert {"levin", "zhou", "four_hole"} < masks <= set(training["scenes"].mask_names())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Dask and what it stands on
def test_workers_of_a_scheduler_make_the_same_frames(training, tmp_path, capsys):
    distributed = pytest.importorskip("distributed")
    render = training["scenes"].render
    tasks = [
        (tmp_path / f"frame_{number}.npz", lambda number=number: (number,)) for number in (1, 2, 3)
    ]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        modules = ("shards.py", "scenes.py")
        training["shards"].compute(render, tasks, modules, cluster.scheduler_address)
    assert "3 of 3" in capsys.readouterr().out
    for path, read in tasks:
        stored = np.load(path)
        for name, values in render(*read()).items():
            np.testing.assert_array_equal(stored[name], values)
