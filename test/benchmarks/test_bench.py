"""`coded_aperture bench accuracy`: what it prints, writes and refuses."""

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from cli_scene import (
    CAMERA,
    HEIGHT,
    WIDTH,
    call,
    call_benchmarks,
    json_of,
    json_of_benchmarks,
    texture,
)
from coded_aperture_benchmarks.datasets.fitting_frames import Fitting, recorded
from coded_aperture_benchmarks.datasets.misfits import LIGHT, MISFITS
from coded_aperture_benchmarks.suites import fitting, lens, pictures, trust
from coded_aperture_benchmarks.thesis.reference import REFERENCE_METHODS
from coded_aperture_benchmarks.thesis.suites.stair import lost_cells
from waiting import output_of, run_program, run_python, wait_until

from coded_aperture_ros.cli import extension
from coded_aperture_ros.cli import main as program
from coded_aperture_ros.io import read_image, write_image
from coded_aperture_ros.optics import Camera, FieldCurvature, Mask, render_psf_stack
from coded_aperture_ros.simulation.render import render_coded_frame

SMALL = ("--levels", 3, "--repeats", 1, "--window", 32, "--masks", "levin", "--jobs", 1)
STAIR = ("bench", "accuracy", "stair", "--textures", "random", "--side", 48, *SMALL)
TWO_PLANE = (
    *("bench", "accuracy", "two-plane", "--texture", "random", "--size", 64, 96),
    *("--blurs", "8,28", *SMALL),
)


def test_a_stair_of_three_steps_is_recognised(capsys):
    results = json_of(capsys, *STAIR, "--sigmas", 0.001, 0.3, "--methods", "bank", "bank-graphcut")
    cells = {(cell["sigma"], cell["method"]): cell for cell in results["cells"]}
    assert len(cells) == 4
    easy, hard = cells[0.001, "bank"], cells[0.3, "bank"]
    # Half a step from 7 to 18.5 px would be another level.
    assert easy["mean_error"] < 0.4 < hard["mean_error"]
    assert easy["mean_error_confident_half"] < 0.4
    assert easy["noise"] == pytest.approx(0.001 / Mask.named("levin").open_fraction, abs=1e-6)
    assert np.diff(easy["mean_of_step"]).min() > 0.5
    assert easy["thesis_mean_error"] is None  # that is for 39 levels
    kinds = {(entry["texture"], entry["method"]) for entry in results["reliability"]}
    assert kinds == {("random", "bank"), ("random", "bank-graphcut")}


def test_without_the_program_errors_are_one_line_too(checkout, tmp_path):
    done = run_python(
        "-m",
        "coded_aperture_benchmarks",
        "accuracy",
        "scenes",
        str(tmp_path),
        env={**os.environ, "PYTHONPATH": f"{checkout}{os.pathsep}{checkout / 'benchmarks'}"},
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert str(tmp_path) in done.stderr


def test_the_bank_can_know_the_noise(capsys):
    (known,) = json_of(capsys, *STAIR, "--sigmas", 0.01, "--methods", "bank", "--known-noise")[
        "cells"
    ]
    (own,) = json_of(capsys, *STAIR, "--sigmas", 0.01, "--methods", "bank")["cells"]
    assert known["noise_estimated"] == pytest.approx(known["noise"], rel=1e-4)
    assert own["noise_estimated"] != pytest.approx(own["noise"], rel=1e-4)


@pytest.mark.slow
def test_other_processes_measure_the_same(capsys):
    arguments = (*STAIR, "--sigmas", 0, 0.01, "--methods", "bank")
    alone = json_of(capsys, *arguments)["cells"]
    together = json_of(capsys, *arguments, "--jobs", 2)["cells"]
    for cell in (*alone, *together):
        assert cell.pop("seconds") > 0
    assert together == alone


def test_the_table_names_the_cells_of_the_thesis(capsys, monkeypatch):
    """Masks down, noise across, our number beside that of the same cell; nothing is computed."""
    from coded_aperture_benchmarks.methods import identification

    monkeypatch.setattr(identification, "identify", guess_zero)
    result = call(
        capsys,
        *("bench", "accuracy", "stair", "--jobs", 1, "--repeats", 1, "--textures", "random"),
        *("--sigmas", 0, 0.001, "--methods", "bank", "--masks", "four_hole", "mura", "disc"),
    )
    assert (result.status, result.err) == (0, "")
    lines = {line.split()[0]: line for line in result.out.splitlines() if line}
    assert lines["mask"].split()[1:] == ["sigma", "0", "sigma", "0.001", "time"]
    assert "(b)" in lines["four_hole"]
    assert lines["four_hole"].count("19.00") == 2  # the mean of 0 to 38
    assert lines["four_hole"].index("[0.9]") < lines["four_hole"].index("[8.7]")
    assert "(~h)" in lines["mura"]
    assert lines["disc"].count("[-]") == 2


def guess_zero(method, coded, noise, setting):
    from coded_aperture_benchmarks.methods.identification import Identified

    return Identified(np.zeros(coded.shape), None, None, 0.5)


def test_a_method_that_beats_the_bank_is_named():
    def row(method, error, sigma=0.0):
        return {
            "mask": "levin", "texture": "natural", "sigma": sigma,
            "method": method, "mean_error": error,
        }  # fmt: skip

    rows = [row("bank", 1.0), row("wiener", 0.9), row("levin", 1.1), row("bank-tv", 0.5)]
    rows += [row("bank", 2.0, 0.1), row("wiener", 2.0, 0.1)]
    (worse,) = lost_cells(rows)
    assert (worse["method"], worse["sigma"], worse["bank_mean_error"]) == ("wiener", 0.0, 1.0)
    assert lost_cells([row("wiener", 0.9)]) == []


def test_reference_methods_take_part(capsys):
    pytest.importorskip("skimage")
    name = REFERENCE_METHODS[-1]
    result = call(capsys, *STAIR, "--sigmas", 0, "--methods", "bank", name)
    assert (result.status, result.err) == (0, "")
    assert f"random texture, {name}" in result.out
    assert "beats" in result.out.splitlines()[-1]


def test_two_planes_are_compared_with_the_plain_window(capsys):
    results = json_of(capsys, *TWO_PLANE, "--methods", "bank", "bank-tv")
    cells = {cell["method"]: cell for cell in results["cells"]}
    assert list(cells) == ["plain-48", "bank", "bank-tv"]
    plain, bank = cells["plain-48"], cells["bank"]
    assert plain["near_edge_over_plain"] == 1
    assert bank["near_edge_over_plain"] == pytest.approx(
        bank["mean_error_near_edge"] / plain["mean_error_near_edge"], abs=0.002
    )
    assert bank["mean_error_near_edge"] > bank["mean_error_beyond"]
    assert bank["mean_error_beyond"] < 0.3


def test_figures_are_written(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    stair = tmp_path / "new" / "stair"
    result = call(capsys, *STAIR, "--sigmas", 0, "--methods", "bank", "--output", stair)
    assert (result.status, result.err) == (0, "")
    planes = tmp_path / "planes"
    result = call(capsys, *TWO_PLANE, "--methods", "bank", "--output", planes)
    assert (result.status, result.err) == (0, "")
    pictures = {path.name for path in stair.iterdir()}
    assert pictures == {"maps_random_0.png", "reliability.png", "results.json", "spread_random.png"}
    assert {path.name for path in planes.iterdir()} == {"edges.png", "results.json"}
    for path in (*stair.glob("*.png"), *planes.glob("*.png")):
        assert read_image(path).std() > 0.05, f"{path} is blank"
    assert json.loads((stair / "results.json").read_text())["benchmark"] == "stair"


@pytest.fixture
def folder(scene, tmp_path):
    """Return the small scene as a ray tracer would have left it."""
    scene_folder = tmp_path / "table"
    scene_folder.mkdir()
    rows = ["".join(".#"[int(cell)] for cell in row) for row in Mask.named("levin").transmission]
    meta = {
        "fx": CAMERA["focal_length_px"],
        "focus_distance_m": CAMERA["focus_distance_m"],
        "width": WIDTH,
        "height": HEIGHT,
        "aperture_width_m": CAMERA["mask_extent_mm"] / 1e3,
        "masks": {"levin": rows},
    }
    (scene_folder / "meta.json").write_text(json.dumps(meta))
    coded = np.load(scene.coded_npy)
    write_image(scene_folder / "coded_levin_linear.png", coded)
    write_image(scene_folder / "aif_linear.png", scene.sharp)
    tenths = np.rint(scene.depth_m * 1e4).astype(np.uint16)
    import cv2

    cv2.imwrite(str(scene_folder / "depth_0.1mm.png"), tenths)
    return scene_folder


@pytest.mark.parametrize("kind", ["fits", *MISFITS, *LIGHT])
def test_every_kind_of_misfit_changes_what_is_recorded(kind):
    random = np.random.default_rng(0)
    light = random.random((96, 96, 3)).astype(np.float32)
    stack = render_psf_stack(Mask.named("three_wide"), np.arange(2.0, 14.0, 0.5))
    blur = np.full((96, 96), 3.0, np.float32)
    fitting = Fitting(light, lambda: light, lambda extent: extent * light, stack, blur, 0.002)
    plain = recorded(fitting, light, np.random.default_rng(1))
    if kind == "fits":
        assert np.abs(plain.frame - light).mean() == pytest.approx(0.8 * 0.002, rel=0.1)
        return
    change = LIGHT[kind] if kind in LIGHT else MISFITS[kind].change
    found = 0
    for strength in (0.0, 0.37, 1.0):
        other = change(fitting, strength, np.random.default_rng(1))
        if other is None:  # the mask looks the same
            continue
        found += 1
        assert np.isfinite(other.frame).all()
        assert other.frame.dtype == np.float32
        same = other.frame.shape == plain.frame.shape and np.array_equal(other.frame, plain.frame)
        changed = [
            not same,
            other.known_noise > 0,
            not np.array_equal(other.stack.psfs, stack.psfs),
            not np.array_equal(other.blur_size_px, blur),
        ]
        assert any(changed)
        np.testing.assert_allclose(other.stack.psfs.sum(axis=(1, 2)), 1, atol=1e-4)
    assert found


@pytest.mark.slow
def test_trust_is_measured(capsys, folder):
    arguments = ("trust", folder, "--jobs", 1, "--kinds", "enlarged", "shrunk", "less light")
    result = call_benchmarks(capsys, *arguments, "--json")
    assert (result.status, result.err) == (0, "")
    results = json.loads(result.out)
    rows = {(row["kind"], row["strength"]): row for row in results["rows"]}
    assert len(rows) == 4 * 5
    assert results["cells"] == 5  # what was shrunk leaves no trace
    assert rows["fits", 0.0]["health"] > 0.5
    assert rows["fits", 0.0]["error"] < 0.05
    assert rows["enlarged", 1.0]["health"] < 0.5
    wrong = [row["wrong"] for row in results["rows"] if row["kind"] == "enlarged"]
    assert results["wrong"] == pytest.approx(np.mean(wrong))
    assert "of 5 cells that leave a trace" in trust.SUITE.text(results)
    assert call_benchmarks(capsys, "trust", folder, "--kinds", "magic").status == 2


def test_what_fits_is_said_to_fit(capsys, folder):
    arguments = ("fitting", folder)
    results = json_of_benchmarks(capsys, *arguments)
    assert (results["fitting"], results["changing"]) == (5, 0)
    alarms = [row for row in results["rows"] if row["health"] < 0.5]
    assert results["said_to_fit"] == pytest.approx(1 - len(alarms) / 5)
    assert results["rows"][0]["health"] > 0.5
    assert results["rows"][0]["error"] < 0.05
    assert all(row["coverage"] <= row["coverage_unchecked"] for row in results["rows"])
    assert "of 5 frames that fit" in fitting.SUITE.text(results)
    assert "use levin" in call_benchmarks(capsys, "fitting", folder, "--masks", "zhou").err


def test_pictures_are_seen_by_many_cameras(capsys, tmp_path):
    result = call(capsys, "bench", "accuracy", "pictures", tmp_path)
    assert result.status == 1 and "expected a folder with video_livingroom1/" in result.err
    rows = pictures.measure(pictures.Cell(tmp_path, 0, "levin", "near", (3.0, 14.0)))
    assert [row["recorded"] for row in rows] == ["noise 0.002", "noise 0.005", "8 bits"]
    for row in rows:
        assert row["fits"] and row["picture"] == "motorcycle"
        assert row["right_confident"] > 0.85 and row["coverage"] > 0.7
    assert "motorcycle" in pictures.SUITE.text({"cells": rows})
    assert "35 mm f/1.4, full frame" in pictures.SUITE.text({"cells": rows})


def test_a_lens_is_measured_with_planes(capsys, folder, tmp_path):
    straight = Camera(400.0, 1.0, WIDTH, HEIGHT, Mask.named("levin"), 40.0)
    bent = dataclasses.replace(straight, field_curvature=FieldCurvature(1.0, 0.0))
    listed = []
    for seed, depth_m in enumerate((1.5, 1.8, 2.2, 3.0)):
        flat = np.full((HEIGHT, WIDTH), depth_m, np.float32)
        write_image(tmp_path / f"{seed}.png", render_coded_frame(texture(seed=seed), flat, bent))
        listed.append({"file": f"{seed}.png", "depth_m": depth_m})
    (tmp_path / "planes.json").write_text(json.dumps(listed))
    arguments = ("lens", folder, "--planes", tmp_path, "--levels", 12)
    results = json_of_benchmarks(capsys, *arguments)
    without, with_ = results["cells"]
    assert (without["field_curvature"], with_["field_curvature"]) == (False, True)
    assert without["all"] < 0.05  # this scene has none
    assert with_["outer"] > without["outer"]
    assert "by thirds of the radius" in lens.SUITE.text(results)
    assert call_benchmarks(capsys, "lens", folder).status == 2


def test_depth_of_a_scene_is_scored(capsys, folder):
    (cell,) = json_of(
        capsys, *("bench", "accuracy", "scenes", folder, "--levels", 12, "--regularize", "tv")
    )["cells"]
    assert (cell["scene"], cell["mask"], cell["regularize"]) == ("table", "levin", "tv")
    everywhere, confident = cell["everywhere"], cell["confident"]
    assert everywhere["away"]["median_error"] < 0.05
    assert everywhere["near_edges"]["median_error"] > everywhere["away"]["median_error"]
    assert everywhere["all"]["coverage"] > 0.99
    assert 0.3 < confident["all"]["coverage"] < everywhere["all"]["coverage"]
    assert confident["all"]["within_10_percent"] > everywhere["all"]["within_10_percent"]
    dense = cell["dense"]
    assert dense["published"]["within_10_percent"] < dense["within_10_percent"] < 1
    assert dense["confident"]["coverage"] == confident["all"]["coverage"]
    assert 0 < dense["boundary"]["1"]["f_score"] <= dense["boundary"]["4"]["f_score"] <= 1
    assert 0 < dense["std_dev"]["within_one"] < dense["std_dev"]["within_two"] <= 1
    pixels = sum(entry["count"] for entry in cell["reliability"])
    assert pixels == pytest.approx(HEIGHT * WIDTH, rel=0.01)
    table = call(capsys, "bench", "accuracy", "scenes", folder, "--levels", 12)
    assert (table.status, table.err) == (0, "")
    assert "near edges" in table.out
    assert "worst first" in table.out
    recorded = cell["recording"]
    assert f"| table | {recorded['camera']} | {recorded['range']} | " in table.out
    assert "f/1.4" in recorded["camera"]


RANDOM = ("bench", "accuracy", "scenes", "--size", "128x96", "--levels", 8, "--jobs", 1)


@pytest.mark.slow
def test_random_scenes_are_scored_one_by_one_and_together(capsys):
    pytest.importorskip("numba", reason="random scenes need numba")
    words = (*RANDOM, "--random", 11, "--masks", "levin", "zhou", "--regularize", "none")
    results = json_of(capsys, *words)
    cells, shown = results["cells"], results["shown"]
    assert len(cells) == 22
    assert cells[0]["scene"] == "far 1000000" and cells[-1]["scene"] == "far 1000010"
    together = [row for row in shown if row["frames"] == 11]
    assert [(row["scene"], row["mask"]) for row in together] == [
        ("11 far", "levin"),
        ("11 far", "zhou"),
    ]
    assert len(shown) == 2 + 20
    for row in together:
        parts = [cell["dense"] for cell in cells if cell["mask"] == row["mask"]]
        for name in ("within_10_percent", "delta_1.05"):
            mean = np.mean([part[name] for part in parts])
            assert row["dense"][name] == pytest.approx(mean, abs=1e-3)
        assert row["dense"]["pixels"] == 11 * 128 * 96
        assert 0 < row["dense"]["std_dev"]["within_one"] < 1
        edges = sum(part["boundary"]["1"]["recall"] is not None for part in parts)
        assert edges > 6
        # The best of the eleven is not shown.
        worst = [
            each["dense"]["within_10_percent"]
            for each in shown
            if each["frames"] == 1 and each["mask"] == row["mask"]
        ]
        assert worst == sorted(part["within_10_percent"] for part in parts)[:10]
    one = ("--random", 1, "--masks", "levin", "--regularize", "none", "--first-seed", 1000005)
    other = json_of(capsys, *RANDOM, *one)["cells"]
    assert other[0]["scene"] == "far 1000005"


@pytest.mark.slow
def test_rods_of_random_scenes_are_counted(capsys):
    pytest.importorskip("numba", reason="random scenes need numba")
    results = json_of(capsys, *RANDOM, "--random", 2, "--rods", "--side", "both", "--masks", "zhou")
    counted = results["cells"][0]["rods"]
    assert 3 <= sum(width["pieces"] for width in counted.values()) <= 8
    assert counted["2-4"]["pieces"] <= 3
    for name, width in results["shown"][0]["rods"].items():
        parts = [cell["rods"][name] for cell in results["cells"]]
        assert width["pieces"] == sum(part["pieces"] for part in parts)
        assert width["found"] == sum(part["found"] for part in parts)
    table = call(capsys, *RANDOM, "--random", 2, "--rods", "--masks", "zhou").out
    assert "rods 2-4" in table and "2 rods far" in table


@pytest.mark.slow
def test_rods_count_where_what_is_behind_is_clearly_farther():
    pytest.importorskip("numba", reason="random scenes need numba")
    from coded_aperture_benchmarks.datasets.random_scenes import RandomScene

    from coded_aperture_ros.simulation.layered import LayeredScene, rod_scene

    counted = all_of_them = 0
    for seed in range(1_000_000, 1_000_004):
        (view,) = RandomScene(seed, "far", (120, 160), rods=True).views("levin")
        widths = view.rods.widths_px
        assert len(widths) == 8 and 2 <= min(widths) < max(widths) <= 20
        scene, labels = rod_scene(seed, Mask.named("levin"), widths, "far", (120, 160))
        kept = view.rods.labels > 0
        np.testing.assert_array_equal(view.rods.labels[kept], labels[kept])
        room = LayeredScene(scene.layers[8:], scene.camera).depth_m()
        ratio = room / view.depth_m
        assert ratio[kept].min() >= 1.24
        assert ratio[(labels > 0) & ~kept].max(initial=0) <= 1.26
        counted, all_of_them = counted + kept.sum(), all_of_them + (labels > 0).sum()
    assert 0.3 * all_of_them < counted < all_of_them


def test_known_rods_are_found_if_half_of_their_pixels_are_right():
    from coded_aperture_benchmarks.datasets.ray_traced import Rods
    from coded_aperture_benchmarks.metrics.dense import score_rods

    labels = np.repeat(np.int32([[1, 2, 3, 0]]), 4, axis=0)
    errors = np.full((4, 4), 0.5)
    errors[:2, 0] = 0.05  # half of it
    errors[:1, 1] = 0.05  # a quarter
    errors[:, 2] = np.nan  # no depth
    # The last one is hidden.
    row = score_rods([errors], [Rods(labels, (2.0, 3.9, 20.0, 8.0))])
    assert row["2-4"] == {"pieces": 2, "found": 1, "recall": 0.5, "pixels_right": 0.375}
    assert row["4-8"]["pieces"] == 0 and row["8-20"]["pieces"] == 1
    assert row["8-20"]["found"] == 0


def test_a_folder_that_is_no_scene_is_named(capsys, tmp_path, folder):
    missing = call(capsys, "bench", "accuracy", "scenes", tmp_path)
    assert (missing.status, missing.out) == (1, "")
    assert str(tmp_path) in missing.err
    mask = call(capsys, "bench", "accuracy", "scenes", folder, "--masks", "disk")
    assert (mask.status, mask.out) == (1, "")
    assert "disk" in mask.err
    assert mask.err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (("stair", "--methods", "magic"), "bank-graphcut"),
        (("stair", "--textures", "soft", "hard"), "natural"),
        (("stair", "--sigmas", "-1"), "0 to 0.5"),
        (("stair", "--repeats", "0"), "at least 1"),
        (("stair", "--window", "33"), "even"),
        (("two-plane", "--blurs", "10-14"), "10-14"),
        (("two-plane", "--methods", "magic"), "bank-graphcut"),
        (("scenes",), "FOLDER"),
        (("scenes", "--random", "2", "--side", "left"), "far"),
        (("scenes", "--random", "2", "--size", "big"), "640x480"),
        (("scenes", "desk", "--regularize", "much"), "graphcut"),
        (("hall",), "two-plane"),
        ((), "FRAMES"),
    ],
)
def test_wrong_usage_is_refused_with_a_hint(capsys, arguments, hint):
    result = call(capsys, "bench", "accuracy", *arguments)
    assert (result.status, result.out) == (2, "")
    assert hint in result.err
    assert "usage: coded_aperture bench accuracy" in result.err


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [(("--masks", "nonsense"), "nonsense"), (("--images", "no_such_folder"), "no_such_folder")],
)
def test_bad_input_is_one_line(capsys, tmp_path, monkeypatch, arguments, hint):
    monkeypatch.chdir(tmp_path)
    for frames in (STAIR, TWO_PLANE):
        result = call(capsys, *frames, *arguments)
        assert (result.status, result.out) == (1, "")
        assert hint in result.err
        assert result.err.count("\n") == 1


def test_results_that_cannot_be_written_are_not_computed(capsys, tmp_path, monkeypatch):
    from coded_aperture_benchmarks import run

    monkeypatch.setattr(run, "map_in_processes", pytest.fail)
    (tmp_path / "file").touch()
    result = call(capsys, *STAIR, "--output", tmp_path / "file")
    assert (result.status, result.out) == (1, "")
    assert "it is a file" in result.err


@pytest.mark.parametrize("words", [(), ("stair",), ("two-plane",), ("scenes",)])
def test_help_shows_examples(capsys, words):
    text = call(capsys, "bench", "accuracy", *words, "--help").out
    examples = text.partition("examples:")[2]
    command = " ".join(("coded_aperture bench accuracy", *words))
    assert examples.count(command) >= min(2, 1 + len(words))
    assert max(map(len, text.splitlines())) <= 100


@pytest.mark.slow
def test_an_interrupt_ends_all_processes_quietly():
    program = subprocess.Popen(
        [
            *(sys.executable, "-m", "coded_aperture_ros.cli.main", "bench", "accuracy", "stair"),
            *("--textures", "random", "--jobs", "2"),
            *("--repeats", "1000"),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert wait_until(lambda: len(_group(program.pid)) >= 3, every_s=0.05)
        time.sleep(0.3)  # they are busy importing, or already at work
        os.killpg(program.pid, signal.SIGINT)
        out, err = output_of(program)
        assert (program.returncode, out, err) == (130, "", "")
        # Python's own tracker of shared resources ends just after the program.
        assert wait_until(lambda: not _group(program.pid), every_s=0.05)
    finally:
        for pid in _group(program.pid):
            os.kill(int(pid), signal.SIGKILL)


def _group(leader):
    """Return the processes of a process group."""
    if not shutil.which("ps"):
        pytest.skip("needs ps")
    listed = run_program("ps", "-eo", "pid=,pgid=,stat=")
    lines = [line.split() for line in listed.stdout.splitlines()]
    return [pid for pid, group, state in lines if group == str(leader) and state[0] != "Z"]


def test_planes_are_found_if_they_are_of_the_same_camera(tmp_path, folder):
    from coded_aperture_benchmarks.suites.scenes import planes_of

    assert planes_of(folder, "levin") == []
    planes = tmp_path / "calib"
    planes.mkdir()
    (planes / "planes.json").write_text("[]")
    shutil.copy(folder / "meta.json", planes)
    assert planes_of(folder, "levin") == [planes]
    other = json.loads((folder / "meta.json").read_text()) | {"focus_distance_m": 3.0}
    (planes / "meta.json").write_text(json.dumps(other))
    assert planes_of(folder, "levin") == []


@pytest.mark.parametrize("words", [(), ("accuracy",), ("speed",)])
def test_bench_hands_on_everything_after_its_name(capsys, words):
    """Even where that begins with an option, which the program itself has too."""
    result = call(capsys, "bench", *words, "--help")
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith(" ".join(("usage: coded_aperture bench", *words)))
    refused = call(capsys, "bench", *words, "--version")
    assert (refused.status, refused.out) == (2, "")


def test_bench_names_the_program_of_other_benchmarks(capsys):
    result = call(capsys, "bench", "blind", "--masks", "levin")
    assert (result.status, result.out, result.err.count("\n")) == (1, "", 1)
    assert "use 'python -m coded_aperture_benchmarks blind'" in result.err
    refused = call(capsys, "bench", "no-such-benchmark")
    assert refused.status == 2 and "no-such-benchmark" in refused.err


@pytest.mark.parametrize("words", [(), ("motion",), ("blind",)])
def test_every_benchmark_has_a_program_of_its_own(capsys, words):
    result = call_benchmarks(capsys, *words, "--help")
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith(" ".join(("usage: python -m coded_aperture_benchmarks", *words)))
    assert call_benchmarks(capsys, *words, "--nothing").status == 2


def test_benchmarks_that_are_not_there_are_one_line(capsys, tmp_path, monkeypatch):
    elsewhere = dataclasses.replace(extension.BENCH, package="no_such_benchmarks")
    monkeypatch.setitem(program.COMMANDS, "bench", elsewhere)
    result = call(capsys, "bench", "speed")
    assert (result.status, result.out, result.err.count("\n")) == (1, "", 1)
    assert "pip install ./benchmarks" in result.err


def test_what_a_package_beside_needs_is_named(capsys, tmp_path, monkeypatch):
    (tmp_path / "needs_more").mkdir()
    (tmp_path / "needs_more" / "__main__.py").write_text("import no_such_library\n")
    monkeypatch.syspath_prepend(tmp_path)
    elsewhere = dataclasses.replace(extension.VIEWER, package="needs_more")
    monkeypatch.setitem(program.COMMANDS, "view", elsewhere)
    result = call(capsys, "view")
    assert (result.status, result.err.count("\n")) == (1, 1)
    assert "view: needs no_such_library: 'pip install ./viewer'" in result.err


def test_ranges_of_cameras_need_scenes_and_a_range(tmp_path, capsys, checkout):
    camera = checkout / "config" / "cameras" / "cmount_25mm_f1.4.yaml"
    result = call_benchmarks(capsys, "cameras", "--cameras", camera, "--scenes", tmp_path)
    assert result.status == 1
    assert "no folder in it has sharp_srgb.png and disparity.npz" in result.err
    plain = checkout / "config" / "example_camera.yaml"
    result = call_benchmarks(capsys, "cameras", "--cameras", plain)
    assert result.status == 1
    assert "states no range: use --depth-range" in result.err


@pytest.mark.slow
def test_the_range_of_a_camera_on_a_random_scene(capsys, checkout):
    camera = checkout / "config" / "cameras" / "cmount_25mm_f1.4.yaml"
    found = json_of_benchmarks(capsys, "cameras", "--cameras", camera, "--random", 1)
    (row,) = found["rows"]
    assert row["range_m"] == [1.55, 4.65]
    assert len(row["distances"]) == 5
    assert row["right"] > 0.8
    assert row["fill"] > 0.7
