"""Pictures to look at beside files of linear light, and depth compared with the truth."""

import json

import cv2
import numpy as np
import pytest
from cli_scene import HEIGHT, WIDTH, call, refused

from coded_aperture_ros.frames import encode
from coded_aperture_ros.io import picture_files, read_depth, read_image, write_depth


def assert_looks_like(picture, light):
    """That a file of 8 bits holds light as screens show it."""
    stored = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    assert stored.dtype == np.uint8
    stored = stored if stored.ndim == 2 else stored[..., ::-1]
    np.testing.assert_allclose(stored / 255, encode(np.clip(light, 0, 1), "srgb"), atol=0.003)


@pytest.mark.parametrize("name", ["sharp.png", "sharp.tif", "sharp.npy"])
def test_deblur_writes_a_picture_to_look_at(scene, tmp_path, capsys, name):
    output = tmp_path / name
    arguments = ("deblur", "--bank", scene.bank, "--depth", scene.depth_npy, scene.coded_npy)
    assert call(capsys, *arguments, "-o", output).status == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([name, "sharp.picture.png"])
    assert_looks_like(tmp_path / "sharp.picture.png", read_image(output))


@pytest.mark.parametrize("options", [("--gamma", "srgb"), ("--no-pictures",)])
def test_deblur_writes_none_where_it_is_not_needed(scene, tmp_path, capsys, options):
    arguments = ("deblur", "--bank", scene.bank, "--depth", scene.depth_npy, scene.coded_npy)
    assert call(capsys, *arguments, "-o", tmp_path / "sharp.png", *options).status == 0
    assert [path.name for path in tmp_path.iterdir()] == ["sharp.png"]


def test_a_picture_to_look_at_does_not_replace_an_input(scene, tmp_path, capsys):
    (tmp_path / "a.picture.png").write_bytes(scene.coded_png.read_bytes())
    arguments = ("deblur", "--bank", scene.bank, "--depth", "auto", tmp_path / "a.picture.png")
    result = call(capsys, *arguments, "-o", tmp_path / "a.png")
    refused(result, "a.picture.png", "this is an input")


def test_simulate_writes_a_picture_to_look_at(tmp_path, capsys):
    output = tmp_path / "random.png"
    arguments = ("simulate", "--random", 7, "--size", 96, 80)
    assert call(capsys, *arguments, "-o", output).status == 0
    for name in ("random", "random.all_in_focus"):
        light = read_image(tmp_path / f"{name}.png")
        assert_looks_like(tmp_path / f"{name}.picture.png", light)


def test_depth_in_a_png_has_a_coloured_picture(scene, tmp_path, capsys):
    output = tmp_path / "d.png"
    arguments = ("depth", "--bank", scene.bank, scene.coded_npy, "-o", output)
    assert call(capsys, *arguments).status == 0
    picture = cv2.imread(str(tmp_path / "d.picture.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (HEIGHT + 40, WIDTH, 3)
    assert np.ptp(picture[:HEIGHT].astype(int), axis=2).max() > 100
    assert not (tmp_path / "d.confidence.picture.png").exists()


def test_folders_are_read_without_pictures_to_look_at(scene, tmp_path, capsys):
    arguments = ("deblur", "--bank", scene.bank, "--depth", scene.depth_npy, scene.coded_npy)
    assert call(capsys, *arguments, "-o", f"{tmp_path}/").status == 0
    assert len(list(tmp_path.iterdir())) == 2
    assert [path.name for path in picture_files(tmp_path)] == ["coded.png"]


@pytest.mark.parametrize("kind", ["png", "npy", "half.npy"])
def test_depth_is_compared_with_the_truth(scene, tmp_path, capsys, kind):
    truth = tmp_path / f"truth.{kind}"
    write_depth(truth, scene.depth_m[::2, ::2] if "half" in kind else scene.depth_m)
    output = tmp_path / "d.npy"
    arguments = ("depth", "--bank", scene.bank, scene.coded_npy, "-o", output, "--truth", truth)
    result = call(capsys, *arguments, "--json")
    assert (result.status, result.err) == (0, "")
    errors = json.loads(result.out)[0]["truth"]
    found = read_depth(output)
    error = np.abs(found - scene.depth_m) / scene.depth_m
    tolerance = 0.01 if "half" in kind else 2e-4  # at the edges of things
    assert errors["median_relative_error"] == pytest.approx(np.nanmedian(error), abs=tolerance)
    share = np.mean(error[np.isfinite(error)] <= 0.1)
    assert errors["within_10_percent"] == pytest.approx(share, abs=0.02)
    assert errors["coverage"] == pytest.approx(np.isfinite(found).mean(), abs=0.01)
    picture = cv2.imread(errors["comparison"])
    assert errors["comparison"] == str(tmp_path / "d.comparison.png")
    assert picture.shape[0] > 2 * HEIGHT and picture.shape[1] > 3 * WIDTH
    assert f"error median {errors['median_relative_error']:.1%}" in call(capsys, *arguments).out


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda depth_m: 1000 * depth_m, "they seem to be in mm"),
        (lambda depth_m: 1 / depth_m, "inverse depth"),
        (lambda depth_m: np.full_like(depth_m, np.nan), "no pixel has a known depth"),
        (lambda depth_m: depth_m.T.copy(), "proportions"),
    ],
)
def test_truth_that_is_none_is_refused(scene, tmp_path, capsys, change, reason):
    truth = tmp_path / "truth.npy"
    np.save(truth, change(scene.depth_m))
    arguments = ("depth", "--bank", scene.bank, scene.coded_npy, "-o", tmp_path / "d.npy")
    refused(call(capsys, *arguments, "--truth", truth), truth, reason)
