"""`deblur --views`: what it writes, and what it refuses."""

import dataclasses
import shutil

import cv2
import numpy as np
import pytest
from bad_frames import names
from cli_scene import call, everything, forbid_work, json_of, refused, wrong_usage

from coded_aperture_ros.deblur import opening_centres, view_through
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import read_image
from coded_aperture_ros.likelihood.bank import load_bank, save_bank
from coded_aperture_ros.optics import Mask, load_camera

PLACES = opening_centres(Mask.named("levin"))


def test_views_of_one_frame(scene, tmp_path, capsys):
    output, folder = tmp_path / "sharp.npy", tmp_path / "views"
    arguments = ("--bank", scene.bank, "--depth", scene.depth_npy, "--camera", scene.camera)
    options = ("-o", output, "--views", folder)
    (summary,) = json_of(capsys, "deblur", *arguments, scene.coded_png, *options)
    assert summary["views"] == str(folder)
    assert names(tmp_path) == ["sharp.npy", "sharp.picture.png", "views"]
    assert names(folder) == [f"view_{row:02}_{column:02}.png" for row, column in PLACES]
    assert (len(PLACES), PLACES[5, 5]) == (43, (0, 0))
    blur = load_camera(scene.camera).blur_size_px(scene.depth_m).astype(np.float32)
    sharp = np.load(output)
    for at in ((0, 2), (10, 8), (5, 10)):
        file = folder / "view_{:02}_{:02}.png".format(*at)
        assert cv2.imread(str(file), cv2.IMREAD_UNCHANGED).dtype == np.uint8
        view, expected = read_image(file, SRGB), view_through(sharp, blur, *PLACES[at])
        assert np.quantile(np.abs(view - expected), 0.99) < 0.02
        assert np.abs(expected - sharp).mean() > 0.02


def test_each_frame_of_a_folder_has_views_of_its_own(scene, tmp_path, capsys):
    (tmp_path / "in").mkdir()
    for name in ("a.png", "b.png"):
        picture = cv2.imread(str(scene.coded_png), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(tmp_path / "in" / name), picture)
    arguments = ("--bank", scene.bank, "--depth", scene.depth_npy, "--camera", scene.camera)
    options = ("--views", tmp_path / "views")
    where = (tmp_path / "in", "-o", tmp_path / "out")
    assert call(capsys, "deblur", *arguments, *where, *options).status == 0
    out = names(tmp_path / "out")
    assert out == ["a.picture.png", "a.png", "b.picture.png", "b.png"]
    assert names(tmp_path / "views") == ["a", "b"]
    assert len(names(tmp_path / "views" / "b")) == len(PLACES)


@pytest.mark.parametrize(
    ("output", "options", "phrase"),
    [
        ("a.png", ("--views", "file"), "is not a folder"),
        ("out/", ("--anaglyph", "3d.png"), "name one for --anaglyph too"),
        ("a.png", ("--views", "in"), "view_05_05.png: this is an input"),
        ("a.png", ("--views", "kept"), "view_00_02.png: this is an input"),
        ("v/view_05_05.png", ("--views", "v"), "view_05_05.png: two results cannot go to one"),
        ("a.png", ("--views", "v", "--anaglyph", "v/view_00_02.png"), "two results cannot go to"),
        ("out/", ("--views", "v", "--stereo", "v/view_05_05"), "view_05_05.png: it is a folder"),
    ],
)
def test_impossible_views_are_refused_before_deblurring(
    scene, tmp_path, capsys, monkeypatch, output, options, phrase
):
    forbid_work(monkeypatch, "deblur.Deblurrer.deblur", "depth.DepthEstimator.estimate")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    for folder in ("in", "kept", "v/view_05_05/view_05_05.png"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copy(scene.coded_png, "in/view_05_05.png")
    shutil.copy(scene.depth_png, "kept/view_00_02.png")
    before = everything(tmp_path)
    arguments = ("--bank", scene.bank, "--camera", scene.camera, "in/view_05_05.png")
    how = ("--depth", "kept/view_00_02.png", "-o", output)
    refused(call(capsys, "deblur", *arguments, *how, *options), phrase)
    assert everything(tmp_path) == before


def test_views_need_a_mask_and_sizes_in_pixels(scene, tmp_path, capsys):
    arguments = ("--depth", "auto", scene.coded_png, "-o", tmp_path / "a.png")
    without = ("deblur", "--bank", scene.bank, *arguments, "--views", tmp_path / "v")
    wrong_usage(call(capsys, *without), "deblur", "--views: needs --camera")
    bank = load_bank(scene.bank)
    stack = dataclasses.replace(bank.stack, in_pixels=False)
    save_bank(dataclasses.replace(bank, stack=stack), tmp_path / "measured.npz")
    indices = ("deblur", "--bank", tmp_path / "measured.npz", *arguments)
    views = (*indices, "--views", tmp_path / "v", "--camera", scene.camera)
    refused(call(capsys, *views), "measured.npz: --views needs blur sizes in pixels")
    parallax = call(capsys, *views, "--parallax", 5)
    wrong_usage(parallax, "deblur", "--parallax: only with --anaglyph or --stereo")
    assert names(tmp_path) == ["measured.npz"]
