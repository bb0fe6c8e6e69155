"""The command `calibrate psf`: tables, files, errors."""

import json
import shutil

import numpy as np
import pytest
import yaml
from cli_scene import call, everything, examples, refused, wrong_usage
from psf_pictures import dot_picture, error_of

from coded_aperture_ros.io import read_image, write_image
from coded_aperture_ros.optics import PsfStack, camera_from_mapping

CAMERA = {
    "focal_length_px": 1194.0,
    "focus_distance_m": 1.9,
    "image_width": 320,
    "image_height": 260,
    "mask": {"name": "levin"},
    "mask_extent_mm": 40.0,
}
DEPTHS = {"dots_2.3m.png": 2.3, "dots_2.9m.png": 2.9}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Pictures of dots at two depths, one without a depth in its name, and the camera file."""
    folder = tmp_path_factory.mktemp("dots")
    camera = camera_from_mapping(CAMERA)
    for name, depth in DEPTHS.items():
        size = float(camera.blur_size_px(depth))
        picture = dot_picture("levin", size, size=(260, 320), spacing_px=29.3, seed=int(10 * depth))
        write_image(folder / name, picture)
    write_image(folder / "unnamed.png", picture)
    (folder / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
    return folder


@pytest.fixture
def folder(made, tmp_path, monkeypatch):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_from_dots_to_a_stack_and_a_bank(folder, capsys):
    given = ("calibrate", "psf", *DEPTHS, "--camera", "camera.yaml", "--level-count", 3)
    output = ("-o", "new/psfs.npz", "--parents", "--picture", "psfs.png")
    result = call(capsys, *given, *output, "--json")
    assert (result.status, result.err) == (0, "")
    summary = json.loads(result.out)
    camera = camera_from_mapping(CAMERA)
    for row, (name, depth) in zip(summary["pictures"], DEPTHS.items(), strict=True):
        assert (row["picture"], row["depth_m"]) == (name, depth)
        assert row["blur_size_px"] == pytest.approx(float(camera.blur_size_px(depth)), abs=0.05)
        assert row["snr"] > 50
        assert row["field_variation"] < 0.03
        assert row["dots_used"] > 60
    stack = PsfStack.load("new/psfs.npz")
    assert len(stack) == summary["levels"] == 3
    np.testing.assert_allclose(stack.depths_m[[0, -1]], [2.3, 2.9])
    for psf, size in zip(stack.psfs, stack.blur_sizes_px, strict=True):
        assert error_of(psf, "levin", size) < 0.04
    drawn = read_image("psfs.png", 2.2)
    assert (drawn.ndim, drawn.max()) == (2, pytest.approx(1))
    small = ("--window-px", 32, "--rank", 16, "-o", "bank.npz")
    assert call(capsys, "learn", "--psfs", "new/psfs.npz", *small).status == 0


@pytest.mark.slow
def test_the_table_of_a_folder_and_a_camera_file_that_is_wrong(folder, capsys, caplog):
    (folder / "camera.yaml").write_text(yaml.safe_dump({**CAMERA, "mask_extent_mm": 35.0}))
    (folder / "pictures").mkdir()
    for name in DEPTHS:
        (folder / name).rename(folder / "pictures" / name)
    given = ("calibrate", "psf", "pictures", "--camera", "camera.yaml", "-o", "psfs.npz")
    result = call(capsys, *given)
    assert result.status == 0
    head, *rows, last = result.out.splitlines()
    assert "SNR  field  dots  saturated  unlike  missing" in head
    assert [len(row) for row in rows] == [len(head)] * 2
    assert last.startswith("psfs.npz: 2 PSFs of 4.")
    told = [message for message in caplog.messages if "by the camera file" in message]
    assert len(told) == 2
    assert "the blur is 4.3" in told[0]


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (lambda picture: 0 * picture + 0.1, "no dots that repeat"),
        (lambda picture: np.minimum(4 * picture, 1), "are saturated: expose for a shorter time"),
        (lambda picture: picture[:-10], "has 320x250 px, but dots_2.3m.png has 320x260 px"),
    ],
)
def test_a_bad_picture_is_named_and_nothing_written(folder, capsys, change, phrase):
    write_image("dots_2.9m.png", change(read_image("dots_2.9m.png")))
    before = everything(folder)
    # What is wrong with one alone is seen before the other is measured.
    pictures = list(DEPTHS) if "but dots_2.3m.png" in phrase else ["dots_2.9m.png", "dots_2.3m.png"]
    refused(
        call(capsys, "calibrate", "psf", *pictures, "-o", "psfs.npz"), "dots_2.9m.png: ", phrase
    )
    assert everything(folder) == before


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (("dots_2.3m.png", "camera.yaml"), "camera.yaml"),
        (("missing_2m.png", "dots_2.3m.png"), "missing_2m.png"),
        (("dots_2.3m.png", "unnamed.png"), "unnamed.png: no depth at the end of its name"),
        (("dots_2.3m.png", "--mask", "levine"), "did you mean levin"),
        (("dots_2.3m.png", "--mask", "two_hole"), "dots_2.3m.png: the PSF differs from that of"),
        (("dots_2.3m.png", "--picture", "psfs.jpg"), "use a name that ends in .png"),
        (("dots_2.3m.png", "--picture", "dots_2.3m.png"), "this is an input"),
        (("dots_2.3m.png", "-o", "psfs.npy"), "use a name that ends in .npz"),
    ],
)
def test_what_makes_no_sense_is_one_line(folder, capsys, arguments, phrase):
    before = everything(folder)
    refused(call(capsys, "calibrate", "psf", "-o", "psfs.npz", *arguments), phrase)
    assert everything(folder) == before


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        ((), "the following arguments are required: FOLDER|PICTURE"),
        (("a.png", "--depths", "1,2"), "--depths: 2 for 1 pictures"),
        (("a.png", "--depths", "1;2"), "expected numbers with commas between"),
        (("a.png", "--depths", "0"), "expected distances of more than 0 m"),
        (("a.png", "--level-count", 3), "one PSF cannot be interpolated"),
        (("a.png", "b.png", "--level-count", 1), "--level-count: at least 2"),
    ],
)
def test_wrong_usage(capsys, arguments, phrase):
    wrong_usage(
        call(capsys, "calibrate", "psf", "-o", "o.npz", *arguments), "calibrate psf", phrase
    )


def test_nothing_is_half_written(folder, capsys):
    """The stack cannot be written after the picture was."""
    (folder / "psfs.npz").mkdir()
    before = everything(folder)
    given = ("dots_2.3m.png", "-o", "psfs.npz", "--picture", "psfs.png")
    refused(call(capsys, "calibrate", "psf", *given), "psfs.npz: it is a folder")
    assert everything(folder) == before


def test_the_examples_are_of_files_as_they_are_here(capsys):
    assert [line[2] for line in examples(capsys, "calibrate psf")] == ["dots_2.3m.png", "dots"]
