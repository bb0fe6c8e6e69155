"""`coded_aperture check`: a camera, a bank and frames on one page."""

import dataclasses
import json
import shutil

import cv2
import numpy as np
import pytest
from cli_scene import FAR_M, HEIGHT, NEAR_M, WIDTH, call, camera_file, refused, wrong_usage

from coded_aperture_ros.likelihood.bank import load_bank, save_bank


def findings(result):
    found = json.loads(result.out)["findings"]
    return {
        name: {one["about"]: one["state"] for one in reversed(some)} for name, some in found.items()
    }


def test_a_camera_alone(scene, tmp_path, capsys):
    arguments = ("check", "--camera", scene.camera, "--depth-range", NEAR_M, FAR_M)
    result = call(capsys, *arguments)
    assert result.status == 0
    for phrase in ("depth resolution", "can be told apart from 1.6 to 3 m", "Airy disc", "next:"):
        assert phrase in result.out
    assert findings(call(capsys, *arguments, "--json"))["camera"]["depth resolution"] == "ok"


def test_a_camera_that_tells_nothing_apart_fails(tmp_path, capsys):
    camera = camera_file(tmp_path, mask_extent_mm=2.0)
    result = call(capsys, "check", "--camera", camera, "--depth-range", 1.6, 3, "--json")
    assert result.status == 1
    assert findings(result)["camera"]["depth resolution"] == "failed"
    assert "use a wider mask" in result.out


@pytest.mark.parametrize("bank", [True, False])
def test_a_frame_that_fits(scene, capsys, bank):
    known = ("--bank", scene.bank) if bank else ("--depth-range", NEAR_M, FAR_M)
    result = call(capsys, "check", "--camera", scene.camera, *known, scene.coded_npy, "--json")
    assert result.status == 0
    (frame,) = (found for name, found in findings(result).items() if name != "camera")
    assert frame["size"] == frame["fit"] == "ok"


def test_frames_with_faults(scene, tmp_path, capsys):
    coded = np.load(scene.coded_npy)
    large = cv2.resize(coded, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)[:HEIGHT, :WIDTH]
    np.save(tmp_path / "enlarged.npy", large)
    np.save(tmp_path / "small.npy", coded[::2, ::2])
    np.save(tmp_path / "bright.npy", np.clip(2.2 * coded, 0, 1))
    np.save(tmp_path / "dark.npy", np.clip(coded - np.quantile(coded, 0.05), 0, 1))
    arguments = ("check", "--camera", scene.camera, "--bank", scene.bank, tmp_path)
    result = call(capsys, *arguments, "--json")
    assert result.status == 1
    found = findings(result)
    assert found["enlarged"]["fit"] == "failed"
    assert found["small"] == {"size": "failed"}
    assert found["bright"]["light"] in ("warning", "failed")
    assert found["dark"]["light"] == "warning"
    text = call(capsys, *arguments).out
    assert "5.0 % black" in text
    assert "[ FAIL ] size: frame of 88x64: the bank is for 176x128, and" in text
    assert "expose for less time" in text.partition("next:")[2]


@pytest.mark.parametrize("fits", [True, False], ids=["resized", "another view"])
def test_a_camera_file_of_another_resolution(scene, tmp_path, capsys, fits):
    """It is fitted to the frames, as `depth` fits it."""
    height = 2 * HEIGHT if fits else HEIGHT
    camera = camera_file(tmp_path, focal_length_px=800, image_width=2 * WIDTH, image_height=height)
    arguments = ("check", "--camera", camera, "--bank", scene.index_bank, "--depth-range", 1.6, 3)
    result = call(capsys, *arguments, scene.coded_npy, "--json")
    (frame,) = (found for name, found in findings(result).items() if name != "camera")
    assert (result.status, frame["size"]) == ((0, "ok") if fits else (1, "failed"))
    if not fits:
        text = call(capsys, *arguments, scene.coded_npy).out.partition("next:")[2]
        assert "give a camera file of such frames" in text


def test_another_setting_is_refused(scene, tmp_path, capsys):
    camera = camera_file(tmp_path, focus_distance_m=1.2)
    result = call(capsys, "check", "--camera", camera, "--bank", scene.bank, scene.coded_npy)
    refused(result, scene.bank, "another setting of the camera")


def test_a_depth_range_is_needed(scene, capsys):
    result = call(capsys, "check", "--camera", scene.camera)
    wrong_usage(result, "check", "--depth-range: needed")


def test_frames_of_one_name_are_told_apart(scene, tmp_path, capsys):
    """Also from the findings about the camera."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        shutil.copy(scene.coded_npy, tmp_path / name / "frame.npy")
    np.save(tmp_path / "b" / "frame.npy", np.load(scene.coded_npy)[::2, ::2])
    shutil.copy(scene.coded_npy, tmp_path / "camera.npy")
    inputs = [tmp_path / name for name in ("a/frame.npy", "b/frame.npy", "b", "camera.npy")]
    arguments = ("check", "--camera", scene.camera, "--bank", scene.bank, *inputs)
    result = call(capsys, *arguments, "--json")
    assert result.status == 1
    found = findings(result)
    assert found["camera"]["depth resolution"] == "ok"
    assert found["frame"]["fit"] == "ok"
    assert found[f"{inputs[1]}, frame"] == found[f"{inputs[2]}, frame"] == {"size": "failed"}
    assert found[f"{inputs[3]}, camera"]["fit"] == "ok"
    assert len(found) == 5


def test_what_cannot_be_read_is_reported_among_the_others(scene, tmp_path, capsys):
    (tmp_path / "a.png").write_text("not a picture")
    np.save(tmp_path / "b.npy", np.zeros((HEIGHT, WIDTH, 7), np.float32))
    shutil.copy(scene.coded_npy, tmp_path / "c.npy")
    arguments = ("check", "--camera", scene.camera, "--bank", scene.bank, tmp_path)
    result = call(capsys, *arguments, "--json")
    assert (result.status, result.err) == (1, "")
    assert findings(result)["c"]["fit"] == "ok"
    text = call(capsys, *arguments).out
    assert f"[ FAIL ] frame: cannot read {tmp_path / 'a.png'}: not a" in text
    assert "b.npy: " in text
    assert "leave out what cannot be read" in text.partition("next:")[2]


def test_a_bank_alone(scene, tmp_path, capsys):
    result = call(capsys, "check", "--bank", scene.bank)
    assert result.status == 0
    assert "nothing: refinement, check of fit, confidence and metres work" in result.out
    stack = load_bank(scene.bank).stack
    index = dataclasses.replace(stack, in_pixels=False, depths_m=None)
    nominal = dataclasses.replace(stack, nominal=True)
    wide = dataclasses.replace(stack, blur_sizes_px=4 * stack.blur_sizes_px)
    for name, one, phrases in (
        ("index", index, ("no refinement", "confidence is that of masks", "levels in place of")),
        ("wide", wide, ("no refinement", "frames are not checked: its blur of")),
        ("nominal", nominal, ("(nominal)", "no views, no other focus")),
    ):
        file = tmp_path / f"{name}.npz"
        save_bank(dataclasses.replace(load_bank(scene.bank), stack=one), file)
        found = call(capsys, "check", "--bank", file)
        assert found.status == 0
        for phrase in phrases:
            assert phrase in found.out
        assert findings(call(capsys, "check", "--bank", file, "--json"))["bank"] == {
            "levels": "ok",
            "not covered": "warning",
        }


def test_frames_are_checked_against_a_bank_alone(scene, capsys):
    result = call(capsys, "check", "--bank", scene.bank, scene.coded_npy, "--json")
    assert result.status == 0
    (frame,) = (found for name, found in findings(result).items() if name != "bank")
    assert frame["size"] == frame["noise"] == frame["fit"] == "ok"


def test_frames_that_cannot_be_checked_are_told(scene, tmp_path, capsys, caplog):
    bank = load_bank(scene.bank)
    wide = dataclasses.replace(bank.stack, blur_sizes_px=4 * bank.stack.blur_sizes_px)
    save_bank(dataclasses.replace(bank, stack=wide), tmp_path / "wide.npz")
    result = call(capsys, "check", "--bank", tmp_path / "wide.npz", scene.coded_npy)
    assert "fit: not checked: its blur of" in result.out
    call(
        capsys, "depth", "--bank", tmp_path / "wide.npz", scene.coded_npy, "-o", tmp_path / "d.npy"
    )
    assert "frames are not checked for fit: its blur of" in caplog.text


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        ((), "required: --camera or --bank"),
        (("--bank", "bank.npz", "--depth-range", 1, 2), "--depth-range: only with --camera"),
    ],
)
def test_check_needs_a_camera_or_a_bank(capsys, arguments, phrase):
    wrong_usage(call(capsys, "check", *arguments), "check", phrase)
