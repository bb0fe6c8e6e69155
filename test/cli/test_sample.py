"""The command that writes example files."""

import io
import json
from contextlib import redirect_stdout

import numpy as np
import pytest

from coded_aperture_ros.bags import Bag
from coded_aperture_ros.cli.main import main
from coded_aperture_ros.io import read_depth, read_image
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.simulation import render_coded_frame


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return the folder that was asked for, and what the command says about it."""
    folder, said = tmp_path_factory.mktemp("given") / "new" / "sample", io.StringIO()
    with redirect_stdout(said):
        assert main(["sample", str(folder), "--json"]) == 0
    return folder, said.getvalue()


@pytest.fixture(scope="module")
def sample(written):
    return written[0]


def test_the_coded_frame_is_that_of_its_truth(sample):
    camera = load_camera(sample / "camera.yaml")
    sharp, depth_m = read_image(sample / "sharp.png"), read_depth(sample / "depth.png")
    coded = read_image(sample / "coded.png")
    assert sharp.shape == coded.shape == (480, 640, 3)
    assert (depth_m.min() > 0.62, depth_m.max() < 1.54) == (True, True)
    rendered = render_coded_frame(sharp, depth_m, camera, aperture_blocks=2)
    inner = np.s_[24:-24, 24:-24]
    assert np.sqrt(np.mean((coded - rendered)[inner] ** 2)) < 0.004  # the noise is at most 0.0034
    assert np.sqrt(np.mean((coded - sharp)[inner] ** 2)) > 0.02
    np.testing.assert_array_equal(read_image(sample / "video" / "00.png"), coded)


def test_planes_are_listed_with_their_depths(sample):
    entries = json.loads((sample / "planes" / "planes.json").read_text())
    assert [entry["file"] for entry in entries] == [f"{index:02}.png" for index in range(12)]
    inverse = 1 / np.array([entry["depth_m"] for entry in entries])
    np.testing.assert_allclose(np.diff(inverse), np.diff(inverse).mean(), atol=2e-4)
    assert all((sample / "planes" / entry["file"]).is_file() for entry in entries)


def test_the_bag_has_frames_their_camera_and_their_depth(sample):
    stamps = {}
    with Bag(sample / "recording") as bag:
        for message in bag.messages():
            stamps.setdefault(message.topic, []).append(message.time_ns)
    assert set(stamps) == {"/image_raw", "/camera_info", "/ground_truth/depth"}
    assert all(times == list(range(10**9, 22 * 10**8, 10**8)) for times in stamps.values())


def test_nothing_that_exists_is_overwritten(tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "precious").write_text("keep")
    assert main(["sample", str(tmp_path / "mine")]) == 1
    assert "mine exists already: use another name" in capsys.readouterr().err
    assert [path.name for path in tmp_path.rglob("*")] == ["mine", "precious"]


def test_nothing_is_left_where_it_cannot_be_written(tmp_path, capsys):
    (tmp_path / "file").touch()
    assert main(["sample", str(tmp_path / "file" / "sample")]) == 1
    assert "cannot write" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_what_was_written_is_told(written):
    folder, said = written
    assert {path.name for path in folder.iterdir()} == set(json.loads(said)["files"])
