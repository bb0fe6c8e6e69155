"""No command overwrites what it was given to read, whichever option names it."""

import json
import shutil

import numpy as np
import pytest
import yaml
from bad_frames import names
from bag_scene import recording, write_bag
from cli_scene import CAMERA, call, camera_file, everything, picture_folder, refused

from coded_aperture_ros.calibration.planes.folder import add_plane
from coded_aperture_ros.optics import Mask


@pytest.fixture
def here(scene, tmp_path, monkeypatch):
    """A folder to work in, with everything that a user may have there."""
    monkeypatch.chdir(tmp_path)
    np.save("mask.npy", Mask.named("levin").transmission)
    camera_file(tmp_path, "lens.yaml", mask={"file": "mask.npy"})
    camera_file(tmp_path)
    shutil.copy(scene.bank, "bank.npz")
    shutil.copy(scene.coded_png, "coded.png")
    np.save("d.npy", scene.depth_m)
    np.save("move.npy", np.zeros((*scene.depth_m.shape, 2), np.float32))
    np.save("sharp.npy", scene.sharp)
    random = np.random.default_rng(0)
    for depth_m in (1.2, 1.4, 1.7, 2.0, 2.4, 3.0):
        add_plane("planes", random.random((96, 96), np.float32), depth_m)
    return tmp_path


DEBLUR = "deblur --bank bank.npz coded.png "
PLANES = "calibrate planes planes -o new.npz "


@pytest.mark.parametrize(
    ("line", "kept"),
    [
        (DEBLUR + "--depth d.npy -o d.npy", "d.npy"),
        (DEBLUR + "--depth d.npy -o sharp.png --stereo d.npy", "d.npy"),
        (DEBLUR + "--depth d.npy -o sharp.png --anaglyph ./d.npy", "d.npy"),
        (DEBLUR + "--depth d.npy --motion move.npy --method cg -o move.npy", "move.npy"),
        (DEBLUR + "--depth auto --camera lens.yaml -o mask.npy", "mask.npy"),
        ("depth --bank bank.npz --camera lens.yaml coded.png -o mask.npy", "mask.npy"),
        ("simulate --camera lens.yaml --image sharp.npy --depth d.npy -o mask.npy", "mask.npy"),
        (PLANES + "--camera camera.yaml --output .", "camera.yaml"),
        (PLANES + "--camera lens.yaml --output .", "mask.npy"),
        ("calibrate blind mask.npy --output .", "mask.npy"),
        ("design --camera design.json --depth-range 1.4 4 --output .", "design.json"),
    ],
)
def test_no_input_is_overwritten(here, capsys, line, kept):
    (here / "design.json").write_text(json.dumps(CAMERA))
    before = everything(here)
    refused(call(capsys, *line.split()), f"{kept}: this is an input", "use another name or folder")
    assert everything(here) == before


def test_pictures_are_checked_before_the_first_is_written(here, capsys):
    """The second result would go where the depth map of both lies."""
    (here / "in").mkdir()
    for name in ("a.png", "b.png"):
        shutil.copy("coded.png", here / "in" / name)
    (here / "out").mkdir()
    shutil.copy("in/b.png", "out/b.png")
    before = everything(here)
    inputs = "in/a.png", "out/b.png"
    line = ("deblur", "--bank", "bank.npz", "--depth", "d.npy", *inputs, "-o", "out")
    refused(call(capsys, *line), "out/b.png: this is an input")
    assert everything(here) == before


def test_a_second_blind_calibration_does_not_take_the_results_of_the_first(tmp_path, capsys):
    """They lie among the pictures, and would pass for some of them."""
    folder = picture_folder(tmp_path)
    shutil.copy(folder / "0.png", folder / "mask.png")
    refused(call(capsys, "calibrate", "blind", folder, "--output", folder), "mask.png: this is an")
    assert names(tmp_path) == ["0.png", "1.png", "mask.png"]


def test_a_bag_is_not_replaced_with_what_is_read_in_it(scene, tmp_path, capsys):
    bag = write_bag(tmp_path / "in", recording(scene, frames=1))
    camera = tmp_path / "in" / "camera.yaml"
    camera.write_text(yaml.safe_dump(CAMERA))
    other = write_bag(tmp_path / "other", recording(scene, frames=1))
    before = everything(tmp_path)
    (file,) = bag.glob("*.mcap")
    for source in (file, other):
        options = ("--bank", scene.bank, "--camera", camera, "-o", bag, "--overwrite")
        refused(call(capsys, "bag", source, *options), f"{bag}: the input {tmp_path / 'in'}")
    assert everything(tmp_path) == before
