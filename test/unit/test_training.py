"""What the training scripts write, here and by the workers of a Dask scheduler, and fit."""

import dataclasses
import importlib
import sys

import cv2
import numpy as np
import pytest

pytest.importorskip("numba", reason="random scenes need numba")


@pytest.fixture(scope="module")
def training(checkout):
    """The scripts' modules, as they import each other."""
    folder = str(checkout / "training")
    sys.path.insert(0, folder)
    yield {
        name: importlib.import_module(name)
        for name in ("shards", "scenes", "costs", "pictures", "second_shown")
    }
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


def test_what_tells_two_surfaces_is_shown_rooms_behind_nets(
    training, few_frames, monkeypatch, tmp_path
):
    monkeypatch.setattr(training["second_shown"], "FRAMES_PER_SHARD", 2)
    scenes, costs, shown = (tmp_path / name for name in ("scenes", "costs", "shown"))
    first = training["scenes"].FIRST_FENCED_SHARD
    shards = ("--shards", 25 * first, 25 * first + 1)  # of two frames each
    run(monkeypatch, training["scenes"], "--output", scenes, *shards)
    given = ("--scenes", scenes)
    run(monkeypatch, training["costs"], *given, "--output", costs, *shards)
    run(monkeypatch, training["second_shown"], *given, "--costs", costs, "--output", shown, *shards)
    scene = np.load(scenes / f"scenes_{25 * first:04d}.npz")
    assert scene["cover"].shape == scene["near"].shape == scene["behind"].shape == (2, 96, 96)
    found = np.load(shown / f"second_{25 * first:04d}.npz")
    cells = training["costs"].CELLS
    assert found["shown"].shape[0] == 2 and found["shown"].shape[2:] == (cells, cells)
    assert np.isfinite(found["shown"]).all() and set(np.unique(found["two"])) <= {-1, 0, 1}
    two = found["two"] == 1
    assert (found["more"][two] - found["less"][two] >= 2).all()
    assert ((found["share"][two] >= 0.05) & (found["share"][two] <= 0.95)).all()


def test_training_never_sees_the_scenes_of_the_benchmarks(training):
    from coded_aperture_benchmarks.datasets.random_scenes import FIRST_SEED

    assert FIRST_SEED == 1_000_000
    masks = set()
    for number in (0, 17, 99_999):
        drawn = training["scenes"].drawn(number)
        assert drawn.seed < 100_000 < FIRST_SEED
        assert drawn == training["scenes"].drawn(number)
    for number in range(400):
        masks.add(training["scenes"].drawn(number).mask)
    assert {"levin", "zhou", "four_hole"} < masks <= set(training["scenes"].mask_names())


def test_later_shards_have_what_is_rare_in_the_first_ones(training):
    scenes = training["scenes"]
    first = scenes.FIRST_RARE_SHARD * scenes.FRAMES_PER_SHARD
    assert all(scenes.drawn(number).blur_range_px is None for number in range(first - 400, first))
    later = [scenes.drawn(number) for number in range(first, first + 600)]
    assert all((each.blur_range_px is None) == (each.side == "both") for each in later)
    ranges = [np.abs(each.blur_range_px) for each in later if each.blur_range_px]
    far = np.array([sizes.max() for sizes in ranges])
    near = np.array([sizes.min() for sizes in ranges])
    assert 0.5 < np.mean(far > 16) < 0.75 and far.max() * 1500 < 2**15
    assert 0.15 < np.mean(far < 8) < 0.35 and near.min() > 0.5
    empty = [each for each in later if each.empty]
    assert 0.1 < len(empty) / len(later) < 0.25
    # One wall or corridor, as long as it is wide or narrow: nothing stands in it.
    light = scenes.render(empty[0].seed)["light"]
    assert light.shape == (scenes.FRAME_PX, scenes.FRAME_PX)


@pytest.mark.filterwarnings("ignore")  # of torch, about its own way to write a network
def test_the_network_that_ships_can_be_fitted_further(training, checkout, monkeypatch, tmp_path):
    torch = pytest.importorskip("torch", reason="fitting needs torch")
    pytest.importorskip("onnx", reason="the file holds networks in its form")
    from coded_aperture_ros.core.archive import read_archive
    from coded_aperture_ros.depth.decoders.network.network import SCHEMA, SCHEMA_VERSION

    names = ("batches", "shipped", "export")
    batches, shipped, export = (importlib.import_module(name) for name in names)
    path = checkout / "coded_aperture_ros" / "depth" / "refine" / "refinement.npz"
    network = shipped.shipped(path).eval()
    random = torch.Generator().manual_seed(0)
    inputs = network.stem[0].in_channels - len(network.every_level.sizes), network.frame[0][0]
    costs = torch.rand(2, inputs[0], 8, 8, generator=random)
    frame = torch.rand(2, inputs[1].in_channels, 16, 16, generator=random)
    batch = batches.Batch(costs, frame, *[torch.zeros(2)] * 3)
    with torch.no_grad():
        before = network(costs, frame)
        shipped.normalised(network, [batch])
        after = network(costs, frame)
    for one, other in zip(before, after, strict=True):
        torch.testing.assert_close(one, other, atol=1e-3, rtol=1e-3)
    assert network.stem[1].running_mean.abs().max() > 0

    state, exported = tmp_path / "state.pt", tmp_path / "refinement.npz"
    torch.save({"average": network.state_dict()}, state)
    run(monkeypatch, export, "--state", state, "-o", exported)
    old, new = (read_archive(each, SCHEMA, SCHEMA_VERSION) for each in (path, exported))
    assert set(old) == set(new)
    for name in ("first_weights", "size_bias", "choice_weights", "trust"):
        np.testing.assert_allclose(new[name], old[name], rtol=1e-3, atol=1e-6)
    again = shipped.shipped(exported).eval()
    with torch.no_grad():
        for one, other in zip(again(costs, frame), before, strict=True):
            torch.testing.assert_close(one, other, atol=0.02, rtol=0.02)


@pytest.fixture
def blend(training, monkeypatch):
    """The scripts that fit the blend, with few and small frames."""
    torch = pytest.importorskip("torch", reason="fitting needs torch")
    names = ("blend_network", "blend_fit", "blend_export")
    modules = {name: importlib.import_module(name) for name in names}
    monkeypatch.setattr(training["pictures"], "FRAMES_PER_SHARD", 1)
    monkeypatch.setattr(training["pictures"], "FRAME_PX", 128)
    monkeypatch.setattr(modules["blend_fit"], "_BATCH", 2)
    threads = torch.get_num_threads()
    yield modules
    torch.set_num_threads(threads)


def test_errors_of_depth_are_drawn_for_each_frame(training):
    measured = training["pictures"]._measured
    true = np.linspace(2, 12, 128 * 128, dtype=np.float32).reshape(128, 128)
    before = true.copy()
    found = [measured(true, np.random.default_rng(seed)) for seed in range(60)]
    assert np.array_equal(true, before)
    assert np.array_equal(found[7], measured(true, np.random.default_rng(7)), equal_nan=True)
    assert all(each.dtype == np.float32 and each.shape == true.shape for each in found)
    assert 0.15 < np.mean([np.isnan(each).any() for each in found]) < 0.45
    same = [np.array_equal(each, true) for each in found]
    assert 0.15 < np.mean(same) < 0.5


def test_pictures_are_turned_with_the_pixels_of_their_cells(blend):
    from coded_aperture_ros.deblur.blend.features import pack_cells

    random = np.random.default_rng(0)
    pixels = random.random((2, 32, 24)).astype(np.float32)

    def picture(pixels):
        cells = pack_cells(pixels)
        whole = cells.mean(axis=0)
        return blend["blend_fit"].Picture(cells, whole[None], cells[:16], whole)

    for flip in (False, True):
        for turns in range(4):
            expected = pixels[..., ::-1] if flip else pixels
            expected = picture(np.rot90(expected, turns, axes=(1, 2)))
            found = picture(pixels).turned(flip, turns)
            for name in ("cells", "maps", "sharp", "scale"):
                # Means of a cell's pixels in another order.
                np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-6)


@pytest.mark.filterwarnings("ignore")  # of torch, about its own way to write a network
def test_the_blend_is_fitted_goes_on_and_is_what_the_package_runs(
    training, blend, monkeypatch, tmp_path, capsys
):
    import torch

    pytest.importorskip("onnx", reason="torch writes networks by it")
    shards, folder = tmp_path / "pictures", tmp_path / "fit"
    run(monkeypatch, training["pictures"], "--output", shards, "--shards", 2, 4)
    assert sorted(path.name for path in shards.glob("*.npz")) == [
        "pictures_0002.npz",
        "pictures_0003.npz",
    ]
    stored = dict(np.load(shards / "pictures_0003.npz"))
    for name, values in training["pictures"].list_pictures(3, shards / "banks").items():
        np.testing.assert_array_equal(stored[name][0], values)
        assert np.isfinite(values).all()

    options = ("--pictures", shards, "--output", folder, "--shards", 2, 3, "--threads", 1)
    with pytest.raises(SystemExit, match="0 pictures to look at: --validate needs at least 2"):
        run(monkeypatch, blend["blend_fit"], *options, "--validate", 0, 2)
    capsys.readouterr()
    options += ("--validate", 3, 4, "--minutes")
    steps = []
    for minutes in (0.03, 0.03, 0.06):
        run(monkeypatch, blend["blend_fit"], *options, minutes)
        steps.append(torch.load(folder / "state.pt")["step"])
    assert 0 < steps[0] == steps[1] < steps[2]
    assert capsys.readouterr().out.count("2 pictures to learn from, 2 to look at\nheld out: {") == 3

    assert_the_package_runs_what_was_fitted(blend, monkeypatch, folder / "state.pt")


def assert_the_package_runs_what_was_fitted(blend, monkeypatch, path):
    import torch

    from coded_aperture_ros.core.archive import read_archive
    from coded_aperture_ros.core.workers import Workers
    from coded_aperture_ros.deblur.blend import Blend
    from coded_aperture_ros.deblur.blend import blend as package
    from coded_aperture_ros.deblur.blend.features import pack_cells, unpack_cells
    from coded_aperture_ros.optics import Mask, render_psf_stack

    # As after a longer fit: the last layer begins with zeros.
    state = torch.load(path)
    last = state["average"]["last.weight"]
    last += 0.02 * torch.randn(last.shape, generator=torch.Generator().manual_seed(0))
    torch.save(state, path)
    exported = path.with_name("blend.npz")
    run(monkeypatch, blend["blend_export"], "--state", path, "-o", exported)
    arrays = read_archive(exported, package.SCHEMA, package.SCHEMA_VERSION)
    monkeypatch.setattr(package, "read_shipped", lambda *_: arrays)

    random = np.random.default_rng(0)
    frame = cv2.GaussianBlur(random.random((93, 122)).astype(np.float32), (0, 0), 2)
    blur = np.linspace(2, 8, 122, dtype=np.float32) * np.ones((93, 1), np.float32)
    known, noise = random.random(blur.shape) < 0.9, 0.003
    of_package = Blend(
        render_psf_stack(Mask.named("levin"), np.arange(1, 10, 0.5)), 10, Workers(), "opencv"
    )
    (found,) = of_package.restore([frame], blur, known, noise)

    hypotheses = of_package._brightness
    sizes = package.hypothesis_blur_sizes(blur)
    cells = pack_cells(
        hypotheses.compute(frame, np.stack([*map(hypotheses.table_steps, sizes)]), noise)
    )
    mean, scale = package.mean_and_contrast(cells[-16:], noise)
    maps = package.cell_maps(sizes, known, scale, noise)
    cells, maps = (torch.from_numpy(each)[None] for each in ((cells - mean) / scale, maps))
    network = blend["blend_network"].Blend().eval()

    def of_torch():
        with torch.no_grad():
            blended = blend["blend_network"].blended(network(torch.cat([cells, maps], 1)), cells)
        return unpack_cells(blended[0].numpy() * scale + mean, frame.shape)

    of_start = of_torch()
    network.load_state_dict(state["average"])
    expected = of_torch()
    assert np.abs(expected - of_start).max() > 0.1
    np.testing.assert_allclose(found, expected, atol=1e-3)


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
