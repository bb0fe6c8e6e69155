"""Which mask for a camera and a range: the trials, and the command."""

import json

import numpy as np
import pytest
import yaml
from cli_scene import call, wrong_usage

from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation.exposure import Exposure

pytest.importorskip("numba")
pytest.importorskip("skimage")

CAMERA = {
    "focal_length_px": 1000.0,
    "focus_distance_m": 0.45,
    "image_width": 640,
    "image_height": 480,
    "side": "far",
    "mask": {"name": "levin"},
    "mask_extent_mm": 10.0,
}


@pytest.fixture
def camera_file(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(CAMERA))
    return path


def test_light_by_hand():
    camera = Camera(1000.0, 0.45, 640, 480, Mask.from_rows(["1"]), 10.0)
    light = Exposure(10.0, 1.0, 1e9, 0.0)
    # An open square of 10 mm, 1 m before a white wall of 10 lux, which sends 10 / pi candela from
    # each square metre; a pixel sees a millimetre square of it.
    arriving = 10 / np.pi * 0.01**2 * 0.001**2  # lumen
    electrons = arriving * 1e16 * 1e-3 * 0.85 * 0.6
    assert light.electrons(camera) == pytest.approx(electrons)
    frame = light.exposed(np.full((200, 200), 0.5, np.float32), camera, np.random.default_rng(0))
    assert frame.mean() == pytest.approx(0.5, rel=0.01)
    assert frame.std() == pytest.approx(np.sqrt(0.5 / electrons), rel=0.05)
    assert Exposure(1e6, 1.0, 500.0, 0.0).electrons(camera) == 500


@pytest.mark.slow
def test_masks_are_compared_and_the_best_is_written(tmp_path, capsys, camera_file):
    pytest.importorskip("matplotlib")
    folder = tmp_path / "design"
    asked = ("--camera", camera_file, "--depth-range", 0.5, 4, "--illuminance-lux", 2)
    few = ("--masks", "disc", "four_wide", "--rounds", 0, "--scenes", 1, "--unseen", 1)
    result = call(capsys, "mask", "design", *asked, *few, "--output", folder)
    assert (result.status, result.err) == (0, "")
    found = json.loads((folder / "results.json").read_text())
    assert found["chosen"] == "four_wide"
    assert found["against_first"]["mask"] == "disc"
    assert found["against_first"]["unseen"] > 0
    by_name = {row["mask"]: row for row in found["masks"]}
    assert by_name["disc"]["electrons"] > by_name["four_wide"]["electrons"]
    assert by_name["disc"]["unseen"]["error"] > by_name["four_wide"]["unseen"]["error"]
    assert "chosen: four_wide" in result.out
    for name in ("pareto.png", "four_wide.svg", "four_wide.png", "disc.svg"):
        assert (folder / name).stat().st_size > 100
    assert Mask.from_file(folder / "four_wide.png") == Mask.named("four_wide")


@pytest.mark.slow
def test_a_search_finds_masks_to_try(capsys, camera_file, monkeypatch):
    monkeypatch.setattr("coded_aperture_ros.design.trials._SIZE", (160, 208))
    asked = ("--camera", camera_file, "--depth-range", 0.5, 4, "--masks", "levin", "--rounds", 1)
    few = ("--found", 2, "--scenes", 1, "--unseen", 0, "--cells", 7, "--jobs", 1, "--json")
    result = call(capsys, "mask", "design", *asked, *few)
    assert result.status == 0, result.err
    masks = {row["mask"]: row for row in json.loads(result.out)["masks"]}
    assert set(masks) == {"levin", "found_1", "found_2"}
    assert all(len(row["rows"]) == 7 for name, row in masks.items() if name != "levin")
    assert masks["found_1"]["light"] < masks["found_2"]["light"]


def test_what_cannot_be_designed(tmp_path, capsys, camera_file):
    range_m = ("--depth-range", 0.5, 4)
    both = tmp_path / "both.yaml"
    both.write_text(yaml.safe_dump(CAMERA | {"side": "both", "mask": {"name": "zhou"}}))
    result = call(capsys, "mask", "design", "--camera", both, *range_m)
    assert (result.status, "side: both" in result.err) == (1, True)
    result = call(capsys, "mask", "design", "--camera", camera_file, "--depth-range", 0.2, 4)
    assert (result.status, "focus at 0.45 m" in result.err) == (1, True)
    asked = ("--camera", camera_file, *range_m, "--illuminance-lux", 0)
    wrong_usage(call(capsys, "mask", "design", *asked), "mask design", "--illuminance-lux")
