"""What the training scripts write, here and by the workers of a Dask scheduler, and fit."""

import contextlib
import dataclasses
import importlib
import os
import pickle
import sys

import cv2
import numpy as np
import pytest
from joblib.externals.loky import get_reusable_executor

pytest.importorskip("numba", reason="random scenes need numba")

FITTED = "coded_aperture_ros.calibration.fine_tuning"


@pytest.fixture(scope="module")
def training(checkout):
    """The program's modules, as they import each other."""
    folder = str(checkout / "training")
    sys.path.insert(0, folder)
    names = ("shards", "scenes", "boards", "costs", "pictures", "windows", "calibration", "places")
    names += ("train",)
    yield {name: importlib.import_module(name) for name in names}
    sys.path.remove(folder)


@pytest.fixture
def few_frames(training, monkeypatch):
    monkeypatch.setattr(training["scenes"], "FRAMES_PER_SHARD", 2)
    monkeypatch.setattr(training["scenes"], "FRAME_PX", 96)


@pytest.fixture
def run(training):
    """Runs the program."""

    def run_program(task, *options):
        arguments = [task, *map(str, options), "--processes", "1", "--threads", "1"]
        training["train"].main(arguments)

    return run_program


class Bomb:
    """Runs something when it is unpickled."""

    def __init__(self, path):
        self._path = path

    def __reduce__(self):
        return os.mkdir, (str(self._path),)


@pytest.mark.parametrize("kind", ["torch", "legacy", "pickle", "optimizer"])
def test_a_state_runs_nothing(training, tmp_path, kind):
    torch = pytest.importorskip("torch", reason="states are read by torch")
    states = importlib.import_module("states")
    loop = importlib.import_module(f"{FITTED}.loop")
    marker, path = tmp_path / "has_run", tmp_path / "state.pt"
    weights = {"weight": torch.zeros(1, 1), "bias": torch.zeros(1)}
    state = {"network": weights, "average": weights, "optimizer": {}, "spent": 0.0, "step": 1}
    state["optimizer" if kind == "optimizer" else "average"] = Bomb(marker)
    if kind == "pickle":
        path.write_bytes(pickle.dumps(Bomb(marker), 2))
    else:
        torch.save(state, path, _use_new_zipfile_serialization=kind != "legacy")
    schedule = loop.Schedule(minutes=1.0, rate=0.1, warm_steps=1, decay=0.0)
    problem = loop.Problem(torch.nn.Linear(1, 1), schedule, lambda step: iter(()), None, None)
    for read in (lambda: states.averaged_weights(path), lambda: loop.Fit(problem, path)):
        with pytest.raises(pickle.UnpicklingError):
            read()
    assert not marker.exists()
    # It runs without the limit to weights.
    with contextlib.suppress(RuntimeError):
        torch.load(path, weights_only=False)
    assert marker.exists()


def test_some_frames_lose_weak_texture_and_keep_edges(training):
    costs = training["costs"]
    how = [costs.recording_plan(number, "far") for number in range(200)]
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


def test_photographs_with_measured_disparity_are_scenes(training, few_frames, tmp_path):
    scenes = training["scenes"]
    random = np.random.default_rng(3)
    folder = tmp_path / "measured" / "box"
    folder.mkdir(parents=True)
    picture = random.integers(0, 255, (300, 400, 3), np.uint8)
    cv2.imwrite(str(folder / "sharp_srgb.png"), cv2.GaussianBlur(picture, (0, 0), 1))
    disparity = np.full((300, 400), 10, np.float32)
    disparity[:, 150:250] = 40
    disparity[:40] = np.nan
    np.savez(folder / "disparity.npz", disparity=disparity)
    number = scenes.FIRST_MEASURED_SHARD * scenes.FRAMES_PER_SHARD
    frames = [scenes.render(number + step, tmp_path / "measured") for step in range(6)]
    sizes = [scenes.blur_px(frame["blur"]) for frame in frames]
    ends = [scenes.scene_plan(number + step).blur_range_px for step in range(6)]
    for found, (near, far) in zip(sizes, ends, strict=True):
        known = found[np.isfinite(found)]
        # Two surfaces, each at its end of the range: but for the width of a slice.
        of_ends = np.minimum(np.abs(known - abs(near)), np.abs(known - abs(far)))
        assert of_ends.max() < 0.06 * abs(far - near)
    assert any(np.isnan(found).any() for found in sizes)
    assert any(np.ptp(found[np.isfinite(found)]) > 1 for found in sizes)
    assert all(frame["light"].std() > 0 for frame in frames)
    with pytest.raises(SystemExit, match="no folder with disparity"):
        scenes.render(number, tmp_path / "none")


def test_frames_and_their_costs_are_written_once(training, few_frames, run, tmp_path, capsys):
    scenes, costs = tmp_path / "scenes", tmp_path / "costs"
    training["shards"].make(training["scenes"].SCENES, tmp_path, (3, 4))
    assert sorted(path.name for path in scenes.iterdir()) == ["scenes_0003.npz", "scenes_0004.npz"]
    assert "scenes_0003.npz: 1 of 2" in capsys.readouterr().out
    shard = dict(np.load(scenes / "scenes_0004.npz"))
    expected = training["scenes"].render(9)
    for name, values in expected.items():
        np.testing.assert_array_equal(shard[name][1], values)
    # No blur size is unknown.
    assert np.abs(shard["blur"]).min() > 0 and np.abs(shard["blur"]).max() < 20 * 1500

    data = ("data", "--folder", tmp_path, "--shards", 4, 5, "--held-back")
    before = (scenes / "scenes_0004.npz").stat().st_mtime_ns
    run("refinement", *data)
    assert (scenes / "scenes_0004.npz").stat().st_mtime_ns == before
    assert [path.name for path in costs.glob("*.npz")] == ["costs_0004.npz"]
    seen = np.load(costs / "costs_0004.npz")
    cells = training["costs"].CELLS
    assert seen["costs"].shape[0] == 2 and seen["costs"].shape[2:] == (cells, cells)
    assert np.isfinite(seen["costs"]).all() and np.isfinite(seen["frame"]).all()
    assert seen["tried"].any(axis=1).all() and (seen["corner"] <= 0).all()
    assert ((seen["told"] > 0) & (seen["told"] <= 1)).all()

    capsys.readouterr()
    run("refinement", *data)
    assert capsys.readouterr().out == ""


def test_a_task_refuses_steps_and_shards_that_it_does_not_have(run, capsys):
    for arguments, message in (
        (("blend", "data", "calibrate"), "blend has the steps data, fit, export, quantise, not"),
        (("check", "data", "--shards", 0, 4, 8), "--shards: expected pairs, FIRST END"),
    ):
        with pytest.raises(SystemExit):
            run(*arguments)
        assert message in capsys.readouterr().err


@pytest.mark.slow
def test_what_tells_two_surfaces_is_shown_rooms_behind_nets(training, few_frames, run, tmp_path):
    first = training["scenes"].FIRST_FENCED_SHARD
    run("second", "data", "--folder", tmp_path, "--shards", first, first + 1, "--held-back")
    scene = np.load(tmp_path / "scenes" / f"scenes_{first:04d}.npz")
    assert scene["cover"].shape == scene["near"].shape == scene["behind"].shape == (2, 96, 96)
    found = np.load(tmp_path / "windows" / f"windows_{first:04d}.npz")
    cells = training["costs"].CELLS
    assert found["shown"].shape[0] == 2 and found["shown"].shape[2:] == (cells, cells)
    assert np.isfinite(found["shown"]).all() and set(np.unique(found["two"])) <= {-1, 0, 1}
    two = found["two"] == 1
    assert (found["more"][two] - found["less"][two] >= 2).all()
    assert ((found["share"][two] >= 0.05) & (found["share"][two] <= 0.95)).all()


def test_boards_of_noise_fill_the_frame_alone_or_behind_a_card(training, monkeypatch, tmp_path):
    scenes, boards = training["scenes"], training["boards"]
    monkeypatch.setattr(scenes, "FRAME_PX", 96)
    first = scenes.FIRST_NOISE_SHARD * scenes.FRAMES_PER_SHARD
    masks, counts, small = set(), [], []
    for number in range(first, first + 24):
        plan = scenes.scene_plan(number)
        scene = boards.board_scene(number, plan, scenes.build_scene(plan)[0], tmp_path)
        sizes = scene.blur_size_px()
        assert np.isfinite(sizes).all() and np.ptp(np.sign(sizes)) == 0
        assert scene.all_in_focus().std() > 0.01
        masks.add(plan.mask)
        counts.append(len(scene.layers))
        small.append(np.abs(sizes).max() < 6)
    assert masks == {"levin", "zhou", "four_hole"}
    assert set(counts) == {1, 2} and 0.5 < np.mean(small) < 1


def test_other_optics_and_processing_are_drawn_anew_for_each_frame(training):
    other, misfits = (importlib.import_module(name) for name in ("other_optics", "misfits"))
    own, random = training["scenes"].mask_named("levin"), np.random.default_rng(0)
    plates = [other.random_optics(own, random).transmission for _ in range(30)]
    assert all(plate.max() > 0.2 and plate.min() >= 0 and plate.max() <= 1 for plate in plates)
    assert len({plate.tobytes() for plate in plates}) == 30
    rows = np.repeat(np.linspace(0, 1, 90, dtype=np.float32)[:, None], 120, axis=1)
    one = misfits.Recorded(rows, None, rows)
    for change in (other.resampled, other.filtered):
        changed = [change(one, np.random.default_rng(seed)) for seed in (1, 1, 2)]
        assert np.array_equal(changed[0].frame, changed[1].frame)
        assert not np.array_equal(changed[0].frame, changed[2].frame)
        assert changed[0].frame.shape == rows.shape and changed[0].frame.dtype == np.float32
    # The truth goes where the frame goes.
    moved = other.resampled(one, np.random.default_rng(1))
    assert np.abs(moved.frame - moved.blur_size_px).max() < 0.03


def test_training_never_sees_the_scenes_of_the_benchmarks(training):
    from coded_aperture_benchmarks.datasets.random_scenes import FIRST_SEED

    assert FIRST_SEED == 1_000_000
    masks = set()
    for number in (0, 17, 99_999):
        plan = training["scenes"].scene_plan(number)
        assert plan.seed < 100_000 < FIRST_SEED
        assert plan == training["scenes"].scene_plan(number)
    for number in range(400):
        masks.add(training["scenes"].scene_plan(number).mask)
    assert {"levin", "zhou", "four_hole"} < masks <= set(training["scenes"].mask_names())


def test_later_shards_have_what_is_rare_in_the_first_ones(training):
    scenes = training["scenes"]
    first = scenes.FIRST_RARE_SHARD * scenes.FRAMES_PER_SHARD
    assert all(
        scenes.scene_plan(number).blur_range_px is None for number in range(first - 400, first)
    )
    later = [scenes.scene_plan(number) for number in range(first, first + 600)]
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


def places_by_a_rule(count=12_000):
    """Places of four kinds, right with odds that bend in one feature, and their probabilities."""
    random = np.random.default_rng(0)
    features = random.normal(0, 1, (7, count)).astype(np.float32) * [[2]] + [[1]]
    odds = 0.8 * features[0] - 1.5 * np.maximum(features[5], 0) + 0.5
    probability = 1 / (1 + np.exp(-odds))
    right = random.random(count) < probability
    kind, group = random.integers(1, 5, count), random.integers(6, size=count)
    errors = np.abs(random.normal(0, np.where(kind == 3, 1.6, 0.8)))  # of one kind larger
    return np.stack([*features, right, right, errors, kind, group]).astype(np.float32), probability


def test_calibration_finds_the_probabilities_that_places_were_made_with(
    training, monkeypatch, capsys
):
    calibration = training["calibration"]
    monkeypatch.setattr(calibration, "_STEPS", 60)
    places, probability = places_by_a_rule()
    found = calibration.confidence_calibration(places)
    assert [layer.shape for layer in found.layers] == [(16, 8), (16, 17), (1, 17)]
    said = found.confidence(places[:7])
    assert np.abs(said - probability).mean() < 0.05
    assert abs(said - probability)[probability < 0.05].max() < 0.2
    printed = capsys.readouterr().out
    assert printed.count("by the others: cross-entropy") == 4
    assert printed.count("fold") == 12

    calibrated = calibration.deviation_calibration(places, found, np.float32(1.5))
    assert calibrated.deviation == pytest.approx(1.6 * 1.5, rel=0.1)  # holds for each kind
    assert set(calibration.calibration_arrays(calibrated)) == {
        "confidence0",
        "confidence1",
        "confidence2",
        "deviation",
    }


def test_slopes_of_the_fit_are_those_of_the_loss(training):
    random = np.random.default_rng(0)
    shapes = (5, 4), (1, 6)
    layers = [random.normal(0, 1, shape) for shape in shapes]
    features, right = random.normal(0, 1, (3, 50)), random.random(50)
    weight = np.full(50, 1 / 50)

    def loss(layers):
        return training["calibration"]._unlikelihood(layers, features, right, weight)

    _, slopes = loss(layers)
    for layer, slope in zip(layers, slopes, strict=True):
        for place in np.ndindex(layer.shape):
            before = layer[place]
            values = []
            for step in (-1e-4, 1e-4):
                layer[place] = before + step
                values.append(loss(layers)[0])
            layer[place] = before
            assert slope[place] == pytest.approx(np.diff(values)[0] / 2e-4, abs=1e-4)


def write_photograph(folder, shape=(120, 150)):
    """Photograph of a wall behind a square, with its disparity."""
    random = np.random.default_rng(0)
    folder.mkdir(parents=True)
    picture = cv2.GaussianBlur(random.integers(0, 255, (*shape, 3)).astype(np.uint8), (0, 0), 1)
    cv2.imwrite(str(folder / "sharp_srgb.png"), picture)
    disparity = np.full(shape, 20, np.float32)
    disparity[40:90, 50:110] = 40
    disparity[:, :3] = np.nan
    np.savez(folder / "disparity.npz", disparity=disparity)


def test_places_of_frames_are_measured_by_the_weights_of_a_file(
    training, monkeypatch, checkout, tmp_path
):
    places = training["places"]
    shipped = checkout / "coded_aperture_ros/depth/decoders/network/refinement.npz"
    monkeypatch.setattr(places, "FRAMES_PER_SHARD", 1)
    monkeypatch.setattr(places, "_SIZE", (96, 128))
    write_photograph(tmp_path / "measured" / "square")
    found = places.frame_places(shipped, tmp_path, 1, 1)
    features, labels = found[: -places.LABELS], found[-places.LABELS :]
    right, nearly, deviations, kind, group = labels
    assert 0.2 < np.median(deviations) < 3
    assert len(features) == 7 and found.shape[1] > 300 and np.isfinite(found).all()
    assert (right <= nearly).all() and np.mean(right) > 0.1 and nearly.max() == 1
    assert places.PHOTOGRAPH in kind and set(kind) <= {0, 1, 2, places.PHOTOGRAPH}
    assert set(group) == {0}
    # Kept by the weights that they are of.
    names = {path.name.partition("_")[0] for path in tmp_path.iterdir() if path.is_dir()}
    assert names - {"banks"} == {"measured", "places", "photographs"}


@pytest.fixture
def torch(training):
    """PyTorch, and the modules that need it."""
    torch = pytest.importorskip("torch", reason="fitting needs torch")
    pytest.importorskip("onnx", reason="torch writes networks by it")
    threads = torch.get_num_threads()
    yield torch
    torch.set_num_threads(threads)


@pytest.mark.filterwarnings("ignore")  # of torch, about its own way to write a network
def test_the_network_that_ships_can_be_fitted_further(torch, checkout, run, tmp_path):
    from coded_aperture_ros.core.archive import read_archive
    from coded_aperture_ros.depth.decoders.network.network import SCHEMA, SCHEMA_VERSION

    names = ("weights", "onnx_form")
    weights, networks = (importlib.import_module(f"{FITTED}.{name}") for name in names)
    path = checkout / "coded_aperture_ros/depth/decoders/network/refinement.npz"
    network = weights.network_of_arrays(read_archive(path, SCHEMA, SCHEMA_VERSION)).eval()
    random = torch.Generator().manual_seed(0)
    inputs = network.stem[0].in_channels - len(network.every_level.sizes), network.frame[0][0]
    costs = torch.rand(2, inputs[0], 8, 8, generator=random)
    frame = torch.rand(2, inputs[1].in_channels, 16, 16, generator=random)
    with torch.no_grad():
        before = network(costs, frame)
        networks.renormalise(network, [(costs, frame)])
        after = network(costs, frame)
    for one, other in zip(before, after, strict=True):
        torch.testing.assert_close(one, other, atol=1e-3, rtol=1e-3)
    assert network.stem[1].running_mean.abs().max() > 0

    (tmp_path / "state").mkdir()
    torch.save({"average": network.state_dict()}, tmp_path / "state" / "refinement.pt")
    run("refinement", "export", "--folder", tmp_path)
    exported = tmp_path / "refinement.npz"
    old, new = (read_archive(each, SCHEMA, SCHEMA_VERSION) for each in (path, exported))
    confidence = {f"confidence{layer}" for layer in range(3)}
    added_later = {"levels_int8", "cells_int8", "deviation", "checked"} | confidence
    assert set(old) == set(new) | added_later and not added_later & set(new)
    for name in ("first_weights", "size_bias", "choice_weights", "trust"):
        np.testing.assert_allclose(new[name], old[name], rtol=1e-3, atol=1e-6)
    again = weights.network_of_arrays(new).eval()
    with torch.no_grad():
        for one, other in zip(again(costs, frame), before, strict=True):
            torch.testing.assert_close(one, other, atol=0.02, rtol=0.02)


@pytest.fixture
def refinement(training, torch, monkeypatch):
    """The module that fits the refinement, with one frame at a time."""
    module = importlib.import_module("refinement")
    monkeypatch.setattr(training["scenes"], "FRAMES_PER_SHARD", 1)
    monkeypatch.setattr(training["scenes"], "FRAME_PX", 96)
    for place in (module, importlib.import_module(f"{FITTED}.frames")):
        monkeypatch.setattr(place, "BATCH", 1)
    monkeypatch.setattr(module, "_RENORMALISED_BATCHES", 1)
    return module


@pytest.mark.filterwarnings("ignore")  # of torch, about its own way to write a network
def test_the_refinement_is_fitted_further_on_a_device(
    torch, refinement, checkout, run, tmp_path, capsys
):
    device = "cuda" if torch.cuda.is_available() else "cpu"
    shipped = checkout / "coded_aperture_ros/depth/decoders/network/refinement.npz"
    folder = ("--folder", tmp_path, "--shards", 0, 1, "--held-back", 1, 2)
    further = ("--least-told", 0, "--further", shipped, "--minutes", 0.01, "--device", device)
    run("refinement", "data", "fit", "export", *folder, *further)
    assert "1 items to learn from, 1 held back\nheld back: {" in capsys.readouterr().out
    # It says no device: it loads wherever it is used.
    state = torch.load(tmp_path / "state" / "refinement_further.pt", weights_only=True)
    assert state["step"] > 0
    assert all(weights.device.type == "cpu" for weights in state["average"].values())
    moments = state["optimizer"]["state"]
    assert all(each.device.type == "cpu" for some in moments.values() for each in some.values())
    first = state["network"]["every_level.layers.first.weight"]
    exported = dict(np.load(tmp_path / "refinement.npz"))["first_weights"]
    np.testing.assert_allclose(exported, first[:, :, 0, 0], atol=0.02)


def test_the_refinement_s_losses_are_where_its_batches_are(training, torch, refinement):
    loop, losses = (importlib.import_module(f"{FITTED}.{name}") for name in ("loop", "loss"))
    cells, bins = 4, losses.BINS
    costs = torch.rand(2, 6 * bins + 4, cells, cells)
    frame = torch.rand(2, 16, 2 * cells, 2 * cells)
    blur_px = 20 * torch.rand(2, 4 * cells, 4 * cells)
    batch = losses.Batch(costs, frame, torch.ones(2, bins, dtype=bool), blur_px, torch.zeros(2))
    outputs = tuple(torch.rand(2, count, 2 * cells, 2 * cells) for count in (bins + 1, 36))
    # A device that has no numbers, on every machine: what is elsewhere does not mix with it.
    outputs, batch = loop.on_device((outputs, batch), "meta")
    parts = losses.true_losses(outputs, batch, *batch.true_quarters())
    _, counted = batch.true_quarters()
    parts["taught"] = losses.divergence(outputs, outputs, batch, counted)
    assert {part.device.type for part in parts.values()} == {"meta"}


@pytest.mark.parametrize(
    ("values", "tensors"),
    [
        (lambda tensor: tensor, lambda moved: [moved]),
        (lambda tensor: (tensor, "name"), lambda moved: moved[:1]),
        (lambda tensor: [tensor, None, 3], lambda moved: moved[:1]),
        (lambda tensor: {"a": {0: tensor}, "b": 1.0}, lambda moved: [moved["a"][0]]),
        (lambda tensor: [{"a": (tensor, tensor)}], lambda moved: [*moved[0]["a"]]),
    ],
    ids=["tensor", "tuple", "list", "dict", "nested"],
)
def test_tensors_move_with_what_holds_them(training, torch, values, tensors):
    loop = importlib.import_module(f"{FITTED}.loop")
    given = values(torch.zeros(2))
    moved = loop.on_device(given, "meta")
    assert type(moved) is type(given)
    assert [tensor.device.type for tensor in tensors(moved)] == ["meta"] * len(tensors(given))
    # What is there already is the same.
    assert all(
        one is other
        for one, other in zip(tensors(loop.on_device(given, "cpu")), tensors(given), strict=True)
    )


@pytest.mark.parametrize("device", ["nonsense", "cuda:99", ""])
def test_a_device_that_is_not_there_ends_the_program(training, torch, run, tmp_path, device):
    with pytest.raises(SystemExit, match=f"--device {device}: PyTorch finds none here: ."):
        run("refinement", "fit", "--folder", tmp_path, "--device", device)


@pytest.fixture
def blend(training, torch, monkeypatch):
    """The module that fits the blend, with few and small frames."""
    module = importlib.import_module("blend")
    monkeypatch.setattr(training["pictures"], "FRAMES_PER_SHARD", 1)
    monkeypatch.setattr(training["pictures"], "FRAME_PX", 128)
    monkeypatch.setattr(module, "BATCH", 2)
    return module


def test_errors_of_depth_are_drawn_for_each_frame(training):
    measured = training["pictures"].measured_blur
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
        return blend.Picture(cells, whole[None], cells[:16], whole)

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
    training, torch, blend, monkeypatch, run, tmp_path, capsys
):
    folder = ("--folder", tmp_path)
    run("blend", "data", *folder, "--shards", 2, 4, "--held-back")
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir()) == [
        "pictures_0002.npz",
        "pictures_0003.npz",
    ]
    stored = dict(np.load(tmp_path / "pictures" / "pictures_0003.npz"))
    for name, values in training["pictures"].picture_arrays(3, tmp_path / "banks").items():
        np.testing.assert_array_equal(stored[name][0], values)
        assert np.isfinite(values).all()

    fit = ("fit", *folder, "--shards", 2, 4, "--held-back")
    with pytest.raises(SystemExit, match="0 items to hold back, at least 2 are needed"):
        run("blend", *fit)
    capsys.readouterr()
    steps = []
    for minutes in (0.03, 0.03, 0.06):
        run("blend", *fit, 3, 4, "--minutes", minutes)
        steps.append(torch.load(tmp_path / "state" / "blend.pt", weights_only=True)["step"])
    assert 0 < steps[0] == steps[1] < steps[2]
    assert capsys.readouterr().out.count("2 items to learn from, 2 held back\nheld back: {") == 3

    assert_the_package_runs_what_was_fitted(torch, blend, monkeypatch, run, tmp_path)


def assert_the_package_runs_what_was_fitted(torch, blend, monkeypatch, run, folder):
    from coded_aperture_ros.core.archive import read_archive
    from coded_aperture_ros.core.workers import Workers
    from coded_aperture_ros.deblur.blend import Blend
    from coded_aperture_ros.deblur.blend import blend as package
    from coded_aperture_ros.deblur.blend.features import pack_cells, unpack_cells
    from coded_aperture_ros.optics import Mask, render_psf_stack

    # As after a longer fit: the last layer begins with zeros.
    path = folder / "state" / "blend.pt"
    state = torch.load(path, weights_only=True)
    last = state["average"]["last.weight"]
    last += 0.02 * torch.randn(last.shape, generator=torch.Generator().manual_seed(0))
    torch.save(state, path)
    run("blend", "export", "--folder", folder)
    arrays = read_archive(folder / "blend.npz", package.SCHEMA, package.SCHEMA_VERSION)
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
    network = blend.Blend().eval()

    def of_torch():
        with torch.no_grad():
            blended = blend.blended(network(torch.cat([cells, maps], 1)), cells)
        return unpack_cells(blended[0].numpy() * scale + mean, frame.shape)

    of_start = of_torch()
    network.load_state_dict(state["average"])
    expected = of_torch()
    assert np.abs(expected - of_start).max() > 0.1
    np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.mark.filterwarnings("ignore")  # of torch, about its own way to write a network
def test_the_second_surface_is_fitted_and_is_what_the_package_runs(
    training, torch, monkeypatch, run, tmp_path
):
    from coded_aperture_ros.depth.decoders.network import second as package
    from coded_aperture_ros.depth.decoders.network.features import BLUR_SIZES_PX

    second = importlib.import_module("second")
    random = np.random.default_rng(0)
    cells, data = training["costs"].CELLS, training["windows"].WINDOWS
    for shard in (0, 1):
        two = random.integers(-1, 2, (16, cells, cells))
        shown = random.random((16, 144, cells, cells)) + (two[:, None] == 1)
        arrays = {"shown": shown, "two": two, "share": 0.3 * (two == 1)}
        arrays |= {"less": 4.0 * (two == 1), "more": 9.0 * (two == 1)}
        data.path(tmp_path, shard).parent.mkdir(exist_ok=True)
        halves = {name: values.astype(np.float16) for name, values in arrays.items()}
        np.savez(data.path(tmp_path, shard), **halves)
    of_task = ("--folder", tmp_path, "--shards", 0, 1, "--held-back", 1, 2)
    run("second", "fit", "export", "calibrate", *of_task, "--minutes", 0.05)

    weights = dict(np.load(tmp_path / "second.npz"))
    monkeypatch.setattr(package, "read_shipped", lambda *_: weights)
    surface = package.SecondSurface(np.ones(len(BLUR_SIZES_PX), bool))
    assert surface._least_odds == weights["least_odds"]
    given = random.random((1, 144, 12, 16)).astype(np.float32)
    network = second.Second(144).eval()
    network.load_state_dict(
        torch.load(tmp_path / "state" / "second.pt", weights_only=True)["average"]
    )
    larger = torch.from_numpy(given.copy())
    larger[:, : 2 * len(BLUR_SIZES_PX)] *= 4
    with torch.no_grad():
        expected = network(larger).numpy()
    np.testing.assert_allclose(surface._network({"shown": given}), expected, atol=0.02)

    # 2 % of the windows with one surface pass for two.
    stored = dict(np.load(data.path(tmp_path, 1)))
    found = surface._network({"shown": stored["shown"][:1].astype(np.float32)})
    with torch.no_grad():
        odds = torch.nn.functional.pixel_shuffle(torch.from_numpy(found), 2)[0, -2].numpy()
    assert np.mean(odds[stored["two"][0] == 0] > weights["least_odds"]) == pytest.approx(
        0.02, abs=0.02
    )

    further = tmp_path / "further.npz"
    of_fit = ("--minutes", 0.05, "--further", tmp_path / "second.npz", "--weights", further)
    run("second", "fit", "export", *of_task, *of_fit)
    assert further.exists() and (tmp_path / "state" / "second_further.pt").exists()


def test_the_check_is_fitted_and_is_what_the_package_runs(torch, monkeypatch, run, tmp_path):
    from coded_aperture_ros.depth import CAUSES
    from coded_aperture_ros.depth.quality import health

    check, misfits = (importlib.import_module(name) for name in ("check", "misfits"))
    random = np.random.default_rng(0)
    for shard in (0, 1):
        cause = random.integers(-1, len(CAUSES), 400)
        rows = {
            "features": random.normal(0, 1, (400, 12)).astype(np.float32),
            "error": np.where(cause < 0, 0.01, 0.4),
            "coverage": np.full(400, 0.8),
            "cause": cause,
            "kind": np.where(cause < 0, "fits", "other mask"),
            "strength": np.zeros(400),
            "number": np.arange(400) // 4,
        }
        rows["features"][:, 0] += 3 * (cause < 0)
        rows["few_windows"] = rows["features"] + random.normal(0, 0.1, (400, 12)).astype(np.float32)
        path = misfits.MISFITS_DATA.path(tmp_path, shard)
        path.parent.mkdir(exist_ok=True)
        np.savez(path, **rows)
    of_task = ("--folder", tmp_path, "--shards", 0, 1, "--held-back", 1, 2)
    run("check", "fit", "export", *of_task)

    def found_by(path):
        weights = dict(np.load(path))
        monkeypatch.setattr(health, "read_shipped", lambda *_: weights)
        health._weights.cache_clear()
        found = np.stack([health.outputs_of(features) for features in rows["features"]])
        health._weights.cache_clear()
        return weights, found

    def state_of(name):
        state = torch.load(tmp_path / "state" / f"{name}.pt", weights_only=True)
        return state["step"], check.merged(state["average"])

    def expected_of(arrays):
        return check.Members(arrays).eval().means(torch.tensor(rows["features"])).numpy()

    weights, found = found_by(tmp_path / "fit.npz")
    steps, arrays = state_of("check")
    np.testing.assert_allclose(found, expected_of(arrays), atol=0.05)
    # It tells what fits, by the feature that shows it.
    assert np.mean((found[:, 0] > 0) == (rows["cause"] < 0)) > 0.85
    assert steps == 60

    # Half of the networks stay as they are, but for rounding.
    further = tmp_path / "further.npz"
    run("check", "fit", "export", *of_task, "--further", tmp_path / "fit.npz", "--weights", further)
    other, found = found_by(further)
    before = check.unpacked({name: values for name, values in weights.items() if values.ndim})
    _, fitted = state_of("check_further")
    share = check._FURTHER.share
    used = {name: before[name] + share * (fitted[name] - before[name]) for name in fitted}
    np.testing.assert_allclose(found, expected_of(used), atol=0.05)
    changed = np.abs(other["weight0"].astype(int) - weights["weight0"]).max(axis=(1, 2))
    assert changed[:4].max() <= 1 < changed[4:].min()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Dask and what it stands on
@pytest.mark.parametrize("where", ["processes", "scheduler"])
def test_processes_and_workers_of_a_scheduler_make_the_same_frames(
    training, tmp_path, capsys, where
):
    render, shards = training["scenes"].render, training["shards"]
    data = shards.Data(
        "frame", lambda number, _, __: render(number), modules=("measured", "scenes")
    )
    numbers = (1, 2, 3)
    if where == "processes":
        # Those that other tests have left do not look for modules in the folder of training.
        get_reusable_executor().shutdown()
        shards.make(data, tmp_path, numbers, processes=2)
    else:
        distributed = pytest.importorskip("distributed")
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster:
            shards.make(data, tmp_path, numbers, scheduler=cluster.scheduler_address)
    assert "3 of 3" in capsys.readouterr().out
    for number in numbers:
        stored = data.read(tmp_path, number)
        for name, values in render(number).items():
            np.testing.assert_array_equal(stored[name], values)
