"""The command `calibrate psf`: tables, files, errors; and that `calibrate` alone still designs."""

import json
import shutil

import numpy as np
import pytest
import yaml
from cli_scene import call, everything
from dot_grid import dot_picture
from test_calibration_psf import CAMERA, pair, transmission
from test_cli_examples import examples
from test_cli_learn import refused, wrong_usage

from coded_aperture_ros.images import read_image, write_image
from coded_aperture_ros.optics import Mask, PsfStack, camera_from_mapping, render_psf

DEPTHS = (2.3, 2.9, 4.0)
GRID = {"size": (300, 360), "spacing_px": 32.3}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Pictures of dots at three depths, a pair, and the camera file."""
    folder = tmp_path_factory.mktemp("dots")
    camera = camera_from_mapping(CAMERA)
    for name, depth in zip(("near", "middle", "far"), DEPTHS, strict=True):
        size = float(camera.blur_size_px(depth))
        picture = dot_picture(transmission("levin"), size, **GRID, seed=int(10 * depth))
        write_image(folder / f"{name}.png", picture)
    sharp, coded = pair("levin", float(camera.blur_size_px(2.9)))
    write_image(folder / "sharp_page.png", sharp)
    write_image(folder / "coded_page.png", coded)
    (folder / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
    return folder


@pytest.fixture
def folder(made, tmp_path):
    for path in made.iterdir():
        shutil.copy(path, tmp_path)
    return tmp_path


def dots(folder):
    return [folder / f"{name}.png" for name in ("near", "middle", "far")]


def test_from_dots_to_a_stack(folder, capsys):
    output, picture = folder / "new" / "psfs.npz", folder / "psfs.png"
    result = call(
        capsys,
        *("calibrate", "psf", "--dots", *dots(folder), "--depths", *DEPTHS),
        *("--camera", folder / "camera.yaml", "--levels", 9),
        *("-o", output, "--picture", picture, "--json"),
    )
    assert (result.status, result.err) == (0, "")
    summary = json.loads(result.out)
    camera = camera_from_mapping(CAMERA)
    for row, depth in zip(summary["pictures"], DEPTHS, strict=True):
        assert row["depth_m"] == depth
        assert row["blur_size_px"] == pytest.approx(float(camera.blur_size_px(depth)), abs=0.03)
        assert row["snr"] > 30
        assert row["field_variation"] < 0.05
        assert row["dots_used"] > 40
        assert row["mask_misfit"] < 0.03
    stack = PsfStack.load(output)
    assert len(stack) == summary["levels"] == 9
    np.testing.assert_allclose(stack.depths_m, camera.depth_m(stack.blur_sizes_px))
    for psf, size in zip(stack.psfs, stack.blur_sizes_px, strict=True):
        true = render_psf(Mask.named("levin"), size)
        true = np.pad(true, (len(psf) - len(true)) // 2)
        assert np.linalg.norm(psf - true) < 0.03 * np.linalg.norm(true)
    drawn = read_image(picture, 2.2)
    assert drawn.ndim == 2
    assert drawn.max() == pytest.approx(1)


def test_the_table(folder, capsys):
    result = call(capsys, "calibrate", "psf", "--dots", *dots(folder), "-o", folder / "psfs.npz")
    head, *rows, last = result.out.splitlines()
    assert "SNR  field  dots used  rejected  missing" in head
    assert len(rows) == 3
    assert all(len(row) == len(head) for row in rows)
    assert f"{folder / 'psfs.npz'}: 3 PSFs of 5." in last


def test_a_bank_learns_from_it(folder, capsys):
    psfs = folder / "psfs.npz"
    arguments = ("--dots", *dots(folder), "--mask", "levin", "--levels", 6, "-o", psfs)
    assert call(capsys, "calibrate", "psf", *arguments).status == 0
    small = ("--window-px", 32, "--rank", 16)
    result = call(capsys, "learn", "--psfs", psfs, *small, "-o", folder / "bank.npz")
    assert (result.status, result.err) == (0, "")


def test_a_camera_file_that_is_wrong_is_told(folder, capsys, caplog):
    (folder / "camera.yaml").write_text(yaml.safe_dump({**CAMERA, "mask_extent_mm": 47.0}))
    result = call(
        capsys,
        *("calibrate", "psf", "--dots", *dots(folder), "--depths", *DEPTHS),
        *("--camera", folder / "camera.yaml", "-o", folder / "psfs.npz"),
    )
    assert result.status == 0
    assert len(caplog.messages) == 3
    assert "the blur is 5.68 px, by the camera file 5.14 px" in caplog.messages[0]


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (lambda picture: 0 * picture + 0.1, "no dots that repeat"),
        (lambda picture: np.minimum(3 * picture, 1), "are saturated: expose for a shorter time"),
        (lambda picture: picture[:-10], "360x290 px, but"),
        (lambda picture: picture[:90, :90], "px, but"),
    ],
)
def test_a_bad_picture_is_named_and_nothing_written(folder, capsys, change, phrase):
    bad = folder / "middle.png"
    write_image(bad, change(read_image(bad)))
    before = everything(folder)
    result = call(capsys, "calibrate", "psf", "--dots", *dots(folder), "-o", folder / "psfs.npz")
    refused(result, bad, phrase)
    assert everything(folder) == before


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (("--depths", 1.0, 2.9, 4.0, "--camera", "camera.yaml"), "lies inside the depth range"),
        (("--depths", -1, 2.9, 4.0), "depths: expected distances of more than 0 m"),
        (("--mask", "four_hole"), "differs from that of mask four_hole"),
        (("--mask", "levine"), "did you mean levin"),
        (("--picture", "psfs.jpg"), "use a name that ends in .png"),
        (("--picture", "near.png"), "this is an input"),
        (("-o", "psfs.npy"), "use a name that ends in .npz"),
        (("--depths", 2.9, 2.3, 4.0), "does not grow with the distance"),
        (("--largest-blur-px", 30), "the dots overlap"),
    ],
)
def test_what_makes_no_sense_is_one_line(folder, capsys, monkeypatch, arguments, phrase):
    monkeypatch.chdir(folder)
    before = everything(folder)
    given = ("--dots", "near.png", "middle.png", "far.png", "-o", "psfs.npz", *arguments)
    refused(call(capsys, "calibrate", "psf", *given), phrase)
    assert everything(folder) == before


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        ((), "one of the arguments --dots --pair is required"),
        (("--dots", "a.png", "--depths", 1, 2), "2 depths for 1 pictures"),
        (("--pair", "a.png", "b.png", "--depths", 1, 2), "2 depths for 1 pair"),
        (("--dots", "a.png", "--levels", 3), "one PSF alone cannot be interpolated"),
        (("--dots", "a.png", "b.png", "--levels", 1), "--levels: expected at least 2"),
        (("--dots", "a.png", "--largest-blur-px", -3), "expected 1 px or more"),
    ],
)
def test_wrong_usage(capsys, arguments, phrase):
    result = call(capsys, "calibrate", "psf", *arguments, "-o", "psfs.npz")
    wrong_usage(result, "calibrate psf", phrase)


def test_an_unknown_action_is_told(capsys):
    wrong_usage(call(capsys, "calibrate", "psff"), "calibrate", "invalid choice: 'psff'")


def test_nothing_is_half_written(folder, capsys, monkeypatch):
    """The stack fails after the picture was drawn."""

    def save(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(PsfStack, "save", save)
    before = everything(folder)
    result = call(
        capsys,
        *("calibrate", "psf", "--dots", *dots(folder), "--mask", "levin"),
        *("-o", folder / "psfs.npz", "--picture", folder / "psfs.png"),
    )
    refused(result, "No space left")
    assert everything(folder) == before


def test_every_example_works(folder, capsys, monkeypatch, checkout):
    monkeypatch.chdir(folder)
    (folder / "config").symlink_to(checkout / "config")
    found = examples(capsys, "calibrate psf")
    assert len(found) == 3
    for arguments in found:
        result = call(capsys, *arguments)
        assert (result.status, result.err) == (0, ""), arguments
    assert (folder / "psfs.png").is_file()
    stack = PsfStack.load("page.npz")
    assert stack.blur_sizes_px[0] == pytest.approx(11.268, abs=0.01)
    assert stack.depths_m[0] == pytest.approx(2.9)
