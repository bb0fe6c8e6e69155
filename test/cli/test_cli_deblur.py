"""The commands `deblur` and `simulate`: the two ends of the chain."""

import dataclasses
import fcntl
import json
import logging
import os
import pty
import select
import shutil
import struct
import sys
import termios

import cv2
import numpy as np
import pytest
from bad_frames import names, write_frames
from bag_scene import recording, write_bag
from cli_scene import (
    FAR_M,
    HEIGHT,
    NEAR_M,
    WIDTH,
    call,
    camera_file,
    everything,
    forbid_work,
    refused,
    wrong_usage,
)

from coded_aperture_ros.calibration.psf import nominal
from coded_aperture_ros.cli.main import main
from coded_aperture_ros.core import progress
from coded_aperture_ros.deblur import Parallax, anaglyph, side_by_side, stereo_pair
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import read_image
from coded_aperture_ros.likelihood.bank import load_bank, save_bank
from coded_aperture_ros.optics import PsfStack, load_camera
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.simulation import render_coded_frame


def gain_db(frame, scene):
    """How much nearer to the sharp scene than the coded frame it is, away from the depth edge."""
    where = scene.away_from_the_edge()

    def error(image):
        return np.mean((image - scene.sharp)[where] ** 2)

    return 10 * np.log10(error(np.load(scene.coded_npy)) / error(frame))


def with_pictures(*files):
    """Names of linear pictures, and of those to look at beside them."""
    beside = [file.replace(".png", ".picture.png") for file in files]
    return sorted([*files, *beside])


def deblur(capsys, scene, output, *options, depth="auto"):
    arguments = ("--bank", scene.bank, "--depth", depth, scene.coded_png, "-o", output, *options)
    return call(capsys, "deblur", *arguments)


def test_the_whole_chain(scene, tmp_path, capsys):
    """The frame that `simulate` made: its depth by `depth`, and with that sharp by `deblur`."""
    depth = tmp_path / "depth.npy"
    assert call(capsys, "depth", "--bank", scene.bank, scene.coded_png, "-o", depth).status == 0
    known = np.isfinite(np.load(depth)) & scene.away_from_the_edge()
    for side_m in (NEAR_M, FAR_M):
        side = known & (scene.depth_m == np.float32(side_m))
        assert np.median(np.load(depth)[side]) == pytest.approx(side_m, rel=0.03)
    result = deblur(capsys, scene, tmp_path / "sharp.png", depth=depth)
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith(f"{tmp_path / 'sharp.png'}: deblurred in ")
    assert gain_db(read_image(tmp_path / "sharp.png"), scene) > 3


@pytest.mark.parametrize("suffix", [".npy", ".tiff", ".png"])
def test_formats_of_the_output(scene, tmp_path, capsys, suffix):
    output = tmp_path / f"sharp{suffix}"
    result = deblur(capsys, scene, output, "--json")
    assert (result.status, result.err) == (0, "")
    (summary,) = json.loads(result.out)
    assert summary["output"] == str(output)
    assert names(tmp_path) == sorted([output.name, "sharp.picture.png"])
    sharp = read_image(output)
    assert sharp.shape == (HEIGHT, WIDTH, 3)
    assert gain_db(sharp, scene) > 3
    if suffix == ".png":
        assert cv2.imread(str(output), cv2.IMREAD_UNCHANGED).dtype == np.uint16


@pytest.mark.parametrize("name", ["depth_npy", "depth_png", "depth_half"])
def test_with_a_depth_file(scene, tmp_path, capsys, name):
    if name == "depth_half":
        depth = tmp_path / "half.npy"
        np.save(depth, scene.depth_m[::2, ::2])
    else:
        depth = getattr(scene, name)
    output = tmp_path / "sharp.png"
    assert deblur(capsys, scene, output, depth=depth).status == 0
    assert gain_db(read_image(output), scene) > 3


def test_the_depth_file_is_what_counts(scene, tmp_path, capsys):
    np.save(tmp_path / "wrong.npy", scene.depth_m[:, ::-1])
    assert deblur(capsys, scene, tmp_path / "a.png", depth=tmp_path / "wrong.npy").status == 0
    assert gain_db(read_image(tmp_path / "a.png"), scene) < 1


def test_a_bank_without_depths_takes_a_camera_or_the_frame_s_own_blur(scene, tmp_path, capsys):
    def with_index_bank(output, depth, *options):
        bank = ("--bank", scene.index_bank, "--depth", depth, scene.coded_npy)
        return call(capsys, "deblur", *bank, "-o", tmp_path / output, *options)

    refused(
        with_index_bank("no.npy", scene.depth_npy),
        *(scene.index_bank, "give --camera, or --depth auto"),
    )
    assert everything(tmp_path) == {}
    assert with_index_bank("given.npy", scene.depth_npy, "--camera", scene.camera).status == 0
    assert with_index_bank("auto.npy", "auto").status == 0
    for name in ("given.npy", "auto.npy"):
        assert gain_db(np.load(tmp_path / name), scene) > 3


@pytest.mark.parametrize("depth", ["given", "auto"])
@pytest.mark.parametrize("bank", ["bank", "index_bank"])
def test_a_camera_file_of_another_resolution_is_fitted_to_the_frames(
    scene, tmp_path, capsys, bank, depth
):
    camera = camera_file(
        tmp_path, focal_length_px=200, image_width=WIDTH // 2, image_height=HEIGHT // 2
    )
    depth = scene.depth_npy if depth == "given" else "auto"
    arguments = ("--bank", getattr(scene, bank), "--camera", camera, "--depth", depth)
    output = tmp_path / "sharp.npy"
    assert call(capsys, "deblur", *arguments, scene.coded_npy, "-o", output).status == 0
    assert gain_db(np.load(output), scene) > 3


def test_measured_depths_of_psfs_hold_whatever_the_camera_file_says(
    scene, tmp_path, capsys, monkeypatch
):
    """PSFs without sizes have indices in their place, which no camera file can tell."""
    monkeypatch.setattr(nominal, "fitting_share", lambda *_: 1.0)  # a check of its own takes long
    stack = load_bank(scene.bank).stack
    np.savez(tmp_path / "psfs.npz", psfs=stack.psfs, depths_m=stack.depths_m)
    bank, output = tmp_path / "b.npz", tmp_path / "sharp.npy"
    assert call(capsys, "learn", "--psfs", tmp_path / "psfs.npz", "-o", bank).status == 0
    arguments = ("--bank", bank, "--camera", scene.camera, "--depth", scene.depth_npy)
    assert call(capsys, "deblur", *arguments, scene.coded_npy, "-o", output).status == 0
    assert gain_db(np.load(output), scene) > 3


def test_8_bit_pictures_keep_their_encoding(scene, tmp_path, capsys):
    light = np.load(scene.coded_npy)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    cv2.imwrite(str(tmp_path / "in.png"), np.rint(255 * srgb[..., ::-1]).astype(np.uint8))
    output = tmp_path / "out.png"
    arguments = ("--bank", scene.bank, "--depth", scene.depth_npy, tmp_path / "in.png")
    assert call(capsys, "deblur", *arguments, "--gamma", "srgb", "-o", output).status == 0
    assert cv2.imread(str(output), cv2.IMREAD_UNCHANGED).dtype == np.uint8
    assert gain_db(read_image(output, SRGB), scene) > 2


@pytest.fixture
def terminal():
    """A terminal, and what has been written to it since one last asked."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    with open(theirs, "w") as stderr:  # noqa: PTH123  a number, no path

        def written():
            stderr.flush()
            text = b""
            while select.select([ours], [], [], 0.2)[0]:
                text += os.read(ours, 4096)
            return text.decode()

        yield stderr, written
    os.close(ours)


@pytest.mark.parametrize(("method", "steps"), [("sparse", 3 * 3), ("cg", 3 * 3), ("fast", 0)])
@pytest.mark.parametrize("depth", ["auto", "file"])
def test_progress_of_one_picture_goes_over_its_iterations(
    scene, tmp_path, terminal, monkeypatch, method, steps, depth
):
    stderr, written = terminal
    monkeypatch.setattr(sys, "stderr", stderr)
    depth = scene.depth_npy if depth == "file" else depth
    arguments = ["deblur", "--bank", scene.bank, "--depth", depth, "-o", tmp_path / "a.png"]
    arguments += ["--method", method, "--iterations", 3, scene.coded_npy]
    monkeypatch.setattr(progress, "_BAR_DELAY_S", 600)
    assert main([str(argument) for argument in arguments]) == 0
    assert "it" not in written()  # what is quick shows nothing
    monkeypatch.setattr(progress, "_BAR_DELAY_S", 0)
    assert main([str(argument) for argument in arguments]) == 0
    assert (f"/{steps} [" in written()) == bool(steps)


def test_progress_of_several_pictures_goes_over_them(scene, tmp_path, terminal, monkeypatch):
    stderr, written = terminal
    monkeypatch.setattr(sys, "stderr", stderr)
    monkeypatch.setattr(progress, "_BAR_DELAY_S", 0)
    folder = tmp_path / "frames"
    folder.mkdir()
    for name in "ab":
        shutil.copy(scene.coded_npy, folder / f"{name}.npy")
    arguments = ["deblur", "--bank", scene.bank, "--depth", "auto", folder, "-o", tmp_path / "b"]
    assert main([str(argument) for argument in arguments]) == 0
    assert "/2 [" in written()


def test_smoothness_and_noise_reach_the_filter(scene, tmp_path, capsys):
    output = tmp_path / "sharp.npy"
    frames = {}
    for option in ((), ("--smoothness", 100), ("--noise", 0.1)):
        assert deblur(capsys, scene, output, *option, depth=scene.depth_npy).status == 0
        frames[option] = np.load(output)
    plain = frames.pop(())
    for frame in frames.values():
        assert np.diff(frame, axis=1).std() < 0.9 * np.diff(plain, axis=1).std()


@pytest.mark.parametrize("depth", ["auto", "depth_npy"])
def test_noise_is_that_of_the_option_the_camera_the_bank_or_the_frame(
    scene, tmp_path, capsys, depth
):
    """In this order, whatever the depth comes from; shot noise of the camera's file counts too."""
    noisy_bank = tmp_path / "bank.npz"
    save_bank(dataclasses.replace(load_bank(scene.bank), noise=0.1), noisy_bank)
    noisy_camera = camera_file(tmp_path, "noisy.yaml", noise=0.05)
    shot_camera = camera_file(tmp_path, "shot.yaml", noise=0.001, noise_gain=0.005)
    frames = {}
    for name, bank, *options in (
        ("frame", scene.bank),
        ("bank", noisy_bank),
        ("camera", noisy_bank, "--camera", noisy_camera),
        ("camera 2", scene.bank, "--noise", 0.05),
        ("option", noisy_bank, "--camera", noisy_camera, "--noise", 0.01),
        ("option 2", scene.bank, "--noise", 0.01),
        ("shot", scene.bank, "--camera", shot_camera),
        ("shot 2", scene.bank, "--noise", 0.001, "--noise-gain", 0.005),
    ):
        depth_of = "auto" if depth == "auto" else getattr(scene, depth)
        arguments = ("--bank", bank, "--depth", depth_of, scene.coded_png, *options)
        output = tmp_path / f"{name}.npy"
        assert call(capsys, "deblur", *arguments, "-o", output).status == 0
        frames[name] = np.load(output)
    for name in ("camera", "option", "shot"):
        assert frames[name] == pytest.approx(frames[f"{name} 2"], abs=1e-3)
    roughness = {name: float(np.diff(frame, axis=1).std()) for name, frame in frames.items()}
    assert roughness["frame"] > roughness["option"] > roughness["camera"] > roughness["bank"]
    assert roughness["shot"] < roughness["option"]


@pytest.mark.parametrize(
    ("options", "changes"),
    [
        ((), {}),
        (("--saturation", 0.6), {"saturation": 0.6}),
        (("--threads", 1), {"threads": 1}),
        (("--threads", 2, "--noise", 0.01), {"threads": 2, "noise": 0.01}),
    ],
)
def test_settings_reach_the_depth_that_is_estimated(
    scene, tmp_path, capsys, monkeypatch, options, changes
):
    configs, make = [], FramePipeline.__init__

    def spy(self, model, camera, depth, *others):
        configs.append(depth)
        make(self, model, camera, depth, *others)

    monkeypatch.setattr(FramePipeline, "__init__", spy)
    assert deblur(capsys, scene, tmp_path / "sharp.png", *options).status == 0
    assert configs == [DepthConfig(check_fit=False, **changes)]


def test_a_folder_of_frames(scene, tmp_path, capsys):
    (tmp_path / "in").mkdir()
    for name in ("a.png", "b.png"):
        shutil.copy(scene.coded_png, tmp_path / "in" / name)
    options = ("--bank", scene.bank, "--depth", scene.depth_npy, "-o", tmp_path / "out")
    assert call(capsys, "deblur", *options, tmp_path / "in").status == 0
    assert names(tmp_path / "out") == with_pictures("a.png", "b.png")
    before = everything(tmp_path)
    options = ("--bank", scene.bank, "--depth", scene.depth_npy, "-o", tmp_path / "in")
    refused(call(capsys, "deblur", *options, tmp_path / "in"), "a.png", "use another name")
    assert everything(tmp_path) == before


def test_every_folder_is_a_video_of_its_own(scene, tmp_path, capsys):
    """What a first one has shown is not averaged into a second one."""
    coded = np.load(scene.coded_npy)
    for name, noise_seed in (("a", 1), ("b", 2)):
        (tmp_path / name).mkdir()
        noise = np.random.default_rng(noise_seed).normal(0, 0.01, coded.shape)
        np.save(tmp_path / name / f"{name}.npy", (coded + noise).astype(np.float32))
    memory = ("--bank", scene.bank, "--depth", "auto", "--temporal-frames", 3)
    both = (tmp_path / "a", tmp_path / "b", "-o", tmp_path / "both")
    assert call(capsys, "deblur", *memory, *both).status == 0
    assert call(capsys, "deblur", *memory, tmp_path / "b", "-o", tmp_path / "one/").status == 0
    one, other = (read_image(tmp_path / folder / "b.png") for folder in ("one", "both"))
    np.testing.assert_array_equal(one, other)


def test_a_bag_of_frames(scene, tmp_path, capsys):
    bag = write_bag(tmp_path / "in", recording(scene, frames=2))
    arguments = ("--bank", scene.bank, "--depth", scene.depth_npy, bag, "-o", tmp_path / "out")
    result = call(capsys, "deblur", *arguments)
    assert (result.status, result.err) == (0, "")
    assert names(tmp_path / "out") == with_pictures("in_000000.png", "in_000001.png")


def expected_pair(scene, sharp, shift_px):
    """The views that the library renders with the true depth; the bank's sizes are the camera's."""
    return stereo_pair(sharp, load_camera(scene.camera).blur_size_px(scene.depth_m), shift_px)


def test_3d_pictures_beside_the_sharp_one(scene, tmp_path, capsys):
    output, red_cyan, both = (tmp_path / name for name in ("sharp.npy", "3d.png", "both.npy"))
    options = ("--anaglyph", red_cyan, "--stereo", both, "--parallax", 9, "--json")
    result = deblur(capsys, scene, output, *options, depth=scene.depth_npy)
    assert (result.status, result.err) == (0, "")
    (summary,) = json.loads(result.out)
    assert [summary[key] for key in ("output", "anaglyph", "stereo")] == [
        *(str(output), str(red_cyan), str(both))
    ]
    assert names(tmp_path) == ["3d.png", "both.npy", "sharp.npy", "sharp.picture.png"]
    left, right = expected_pair(scene, np.load(output), 9.0)
    assert np.abs(left - right).max() > 0.05
    assert np.load(both) == pytest.approx(side_by_side(left, right), abs=0.02)
    # For looking at: 8 bits in sRGB.
    assert cv2.imread(str(red_cyan), cv2.IMREAD_UNCHANGED).dtype == np.uint8
    difference = np.abs(read_image(red_cyan, SRGB) - anaglyph(left, right))
    assert np.quantile(difference, 0.99) < 0.02


def test_how_far_it_can_be_relied_on_beside_the_sharp_one(scene, tmp_path, capsys):
    result = deblur(capsys, scene, tmp_path / "a.npy", "--std-dev", depth=scene.depth_npy)
    assert (result.status, result.err) == (0, "")
    assert names(tmp_path) == ["a.kind.png", "a.npy", "a.picture.png", "a.uncertainty.npy"]
    kind = cv2.imread(str(tmp_path / "a.kind.png"), cv2.IMREAD_UNCHANGED)
    std_dev, size = np.load(tmp_path / "a.uncertainty.npy"), np.load(tmp_path / "a.npy").shape[:2]
    assert kind.shape == std_dev.shape == size and set(np.unique(kind)) <= {0, 127, 254}
    assert kind.mean() > 127 and 0 < np.median(std_dev) < 0.1
    # The standard deviations of its depth have another name.
    written = json.loads(
        deblur(capsys, scene, tmp_path / "b.png", "--std-dev", "--json", depth=scene.depth_npy).out
    )
    assert written[0]["std_dev"] == str(tmp_path / "b.uncertainty.npy")
    assert written[0]["kind"] == str(tmp_path / "b.kind.png")


def test_no_frame_of_a_video_overwrites_what_came_of_a_picture(scene, tmp_path, capsys):
    """Its map of kinds would have the name of the picture that is called so."""
    bag = write_bag(tmp_path / "in", recording(scene, frames=1))
    picture = tmp_path / "in_000000.kind.png"
    picture.write_bytes(scene.coded_png.read_bytes())
    given = ("--bank", scene.bank, "--depth", scene.depth_npy, picture, bag)
    result = call(capsys, "deblur", *given, "-o", tmp_path / "out", "--std-dev")
    assert result.status == 1 and "two results cannot go to one file" in result.err


def test_default_parallax_is_a_share_of_the_width(scene, tmp_path, capsys):
    options = ("--stereo", tmp_path / "both.npy")
    assert deblur(capsys, scene, tmp_path / "a.npy", *options, depth=scene.depth_npy).status == 0
    expected = expected_pair(scene, np.load(tmp_path / "a.npy"), 0.03 * WIDTH)
    assert np.load(tmp_path / "both.npy") == pytest.approx(side_by_side(*expected), abs=0.02)


@pytest.mark.parametrize("bank", ["bank", "index_bank"])
def test_3d_pictures_with_estimated_depth(scene, tmp_path, capsys, bank):
    """A bank need not know its depths: blur sizes tell what is nearer."""
    both = tmp_path / "both.npy"
    options = ("--stereo", both, "--parallax", 12, "--depth", "auto", scene.coded_npy)
    arguments = ("--bank", getattr(scene, bank), *options, "-o", tmp_path / "sharp.npy")
    assert call(capsys, "deblur", *arguments).status == 0
    left, right = np.split(np.load(both), 2, axis=1)
    near, far = np.s_[40:90, 30:60], np.s_[40:90, 115:145]
    for where, nearer in ((near, True), (far, False)):
        strip = np.ascontiguousarray(left[where[0], where[1].start - 14 : where[1].stop + 14, 1])
        patch = np.ascontiguousarray(right[(*where, 1)])
        disparity = cv2.matchTemplate(strip, patch, cv2.TM_SQDIFF).argmin() - 14
        assert disparity > 3 if nearer else disparity <= 0, disparity


def test_encoding_of_3d_pictures_is_that_of_the_input(scene, tmp_path, capsys):
    frame = tmp_path / "in.png"
    cv2.imwrite(str(frame), np.full((HEIGHT, WIDTH, 3), round(255 * 0.5 ** (1 / 3.0)), np.uint8))
    arguments = ("--bank", scene.bank, "--depth", scene.depth_npy, frame, "--gamma", 3)
    options = ("-o", tmp_path / "out.png", "--anaglyph", tmp_path / "3d.png")
    assert call(capsys, "deblur", *arguments, *options).status == 0
    assert np.median(read_image(tmp_path / "3d.png", 3.0)) == pytest.approx(0.5, abs=0.01)


def test_a_measured_bank_tells_by_its_depths_what_is_nearer(scene):
    """Sizes that lost their sign before the focus, and indices of levels, may be in any order."""
    from coded_aperture_ros.cli.stereo_output import _direction

    psfs = np.ones((3, 5, 5), np.float32) / 25
    for depths_m, direction in (([1, 2, 3], 1), ([3, 2, 1], -1), (None, 1)):
        assert _direction(PsfStack(np.arange(3.0), psfs, depths_m)) == direction


def test_frames_of_a_folder_share_the_scale_of_their_parallax(scene, tmp_path, capsys, monkeypatch):
    (tmp_path / "in").mkdir()
    for name in ("a.png", "b.png"):
        shutil.copy(scene.coded_png, tmp_path / "in" / name)
    scales = []
    monkeypatch.setattr(
        "coded_aperture_ros.cli.stereo_output.stereo_pair",
        lambda sharp, _, parallax: (scales.append(parallax), (sharp, sharp))[1],
    )
    arguments = ("--bank", scene.bank, "--depth", "auto", "-o", tmp_path / "out", tmp_path / "in")
    options = ("--anaglyph", f"{tmp_path}/3d", "--stereo", f"{tmp_path}/3d/both.views/")
    assert call(capsys, "deblur", *arguments, *options).status == 0
    assert names(tmp_path / "out") == with_pictures("a.png", "b.png")
    assert names(tmp_path / "3d") == ["a.png", "b.png", "both.views"]
    assert names(tmp_path / "3d" / "both.views") == ["a.png", "b.png"]
    first, second = scales
    assert isinstance(first, Parallax)
    assert first is second


@pytest.mark.parametrize(
    ("output", "options", "phrase"),
    [
        ("a.png", ("--anaglyph", "3d.exr"), "3d.exr: unknown format"),
        ("a.png", ("--stereo", "both"), "both: unknown format"),
        ("a.png", ("--stereo", "a.png"), "a.png: two results cannot go to one file"),
        ("a.png", ("--stereo", "3d.png", "--anaglyph", "./3d.png"), "two results cannot go to"),
        ("a.png", ("--stereo", "file/both.png"), "is not a folder"),
        ("a.png", ("--anaglyph", "in/f.png"), "f.png: this is an input"),
        ("a.png", ("--anaglyph", "3d.png", "--parallax", 89), "89 px is more than half of the"),
        ("out/", ("--anaglyph", "3d.png"), "3d.png: the all-in-focus pictures go to a folder"),
        ("out/", ("--stereo", "out"), "f.png: two results cannot go to one file"),
    ],
)
def test_impossible_3d_pictures_are_refused_before_deblurring(
    scene, tmp_path, capsys, monkeypatch, output, options, phrase
):
    forbid_work(monkeypatch, "deblur.Deblurrer.deblur", "depth.DepthEstimator.estimate")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    (tmp_path / "in").mkdir()
    shutil.copy(scene.coded_png, tmp_path / "in" / "f.png")
    before = everything(tmp_path)
    arguments = ("--bank", scene.bank, "--depth", "auto", "in/f.png", "-o", output, *options)
    refused(call(capsys, "deblur", *arguments), phrase)
    assert everything(tmp_path) == before


@pytest.mark.parametrize("size", [(HEIGHT, WIDTH), (HEIGHT, WIDTH, 3)])
def test_an_all_black_frame_is_refused_or_stays_black(scene, tmp_path, capsys, size):
    frame = tmp_path / "black.npy"
    np.save(frame, np.zeros(size, np.float32))
    arguments = ("--bank", scene.bank, frame, "-o", tmp_path / "out.npy")
    result = call(capsys, "deblur", *arguments, "--depth", "auto")
    refused(result, frame, "no pixel has a known depth")
    assert names(tmp_path) == ["black.npy"]
    result = call(capsys, "deblur", *arguments, "--depth", scene.depth_npy)
    assert (result.status, result.err) == (0, "")
    assert (np.load(tmp_path / "out.npy") == 0).all()


def test_nan_and_saturated_pixels_stay_where_they_are(scene, tmp_path, capsys):
    frame = np.load(scene.coded_npy)
    frame[20:24, 20:24] = np.nan
    frame[100:110, 150:160] = 1.0
    np.save(tmp_path / "holes.npy", frame)
    arguments = ("--bank", scene.bank, "--depth", "auto", tmp_path / "holes.npy")
    result = call(capsys, "deblur", *arguments, "-o", tmp_path / "out.npy")
    assert (result.status, result.err) == (0, "")
    sharp = np.load(tmp_path / "out.npy")
    assert np.isfinite(sharp).all()
    assert (sharp.min() >= 0, sharp.max() <= 1) == (True, True)


@pytest.mark.parametrize(
    ("content", "phrase"),
    [
        (np.full((HEIGHT, WIDTH), np.nan), "no pixel has a known depth"),
        (np.zeros((HEIGHT, WIDTH)), "no pixel has a known depth"),
        (np.ones((HEIGHT, WIDTH, 3)), "expected a depth map [row, column]"),
        (
            np.full((WIDTH, HEIGHT), 2.0),
            f"has {HEIGHT} x {WIDTH} pixels, this frame {WIDTH} x {HEIGHT}",
        ),
        (np.ones(5), "expected a depth map [row, column]"),
        (b"no array", "truncated, or not a .npy array"),
        (None, "No such file"),
    ],
)
def test_unusable_depth_files(scene, tmp_path, capsys, content, phrase):
    depth = tmp_path / "depth.npy"
    if isinstance(content, bytes):
        depth.write_bytes(content)
    elif content is not None:
        np.save(depth, content)
    before = everything(tmp_path)
    refused(deblur(capsys, scene, tmp_path / "out.png", depth=depth), depth, phrase)
    assert everything(tmp_path) == before


@pytest.mark.parametrize(("factor", "unit"), [(1000, "mm"), (100, "cm"), (-1, "1/m")])
def test_a_depth_file_in_another_unit(scene, tmp_path, capsys, factor, unit):
    depth = tmp_path / "depth.npy"
    np.save(depth, 1 / scene.depth_m if factor < 0 else factor * scene.depth_m)
    result = deblur(capsys, scene, tmp_path / "out.png", depth=depth)
    refused(result, depth, "none of the depths", f"they seem to be in {unit}")
    assert not (tmp_path / "out.png").exists()


def test_an_8_bit_depth_file_has_no_unit(scene, tmp_path, capsys):
    depth = tmp_path / "depth.png"
    cv2.imwrite(str(depth), np.full((HEIGHT, WIDTH), 2, np.uint8))
    refused(deblur(capsys, scene, tmp_path / "out.png", depth=depth), depth, "8-bit depth")


@pytest.mark.parametrize(
    "name", ["missing.png", "text.png", "four.npy", "stack.npy", "int64.npy", "small.npy"]
)
def test_unusable_frames(scene, tmp_path, capsys, name):
    write_frames(tmp_path)
    before = everything(tmp_path)
    arguments = ("--bank", scene.bank, "--depth", "auto", tmp_path / name)
    refused(call(capsys, "deblur", *arguments, "-o", tmp_path / "out.png"), tmp_path / name)
    assert everything(tmp_path) == before


def test_a_map_of_motion_of_another_kind_is_refused(scene, tmp_path, capsys):
    options = ("--method", "cg", "--motion", scene.bank)
    refused(deblur(capsys, scene, tmp_path / "out.png", *options), "expected a .npy as depth")


@pytest.mark.parametrize(
    ("output", "phrase"),
    [
        ("sharp.exr", "unknown format"),
        ("file/sharp.png", "is not a folder"),
        ("/proc/sharp.png", "cannot write /proc/sharp.png"),
    ],
)
def test_impossible_outputs_are_refused_before_deblurring(
    scene, tmp_path, capsys, monkeypatch, output, phrase
):
    forbid_work(monkeypatch, "deblur.Deblurrer.deblur", "depth.DepthEstimator.estimate")
    (tmp_path / "file").write_text("")
    before = everything(tmp_path)
    refused(deblur(capsys, scene, tmp_path / output), output, phrase)
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("options", "phrase"),
    [
        (("--method", "magic"), "'magic' is not allowed"),
        (("--rank", 1), "--rank: 1 is out of range (2 to 64)"),
        (("--smoothness", 0), "--smoothness: 0.0 is out of range"),
        (("--parallax", 5), "--parallax: only with --anaglyph or --stereo"),
        (("--parallax", 0), "--parallax: 0.0 is out of range (more than 0 px)"),
        (("--parallax", "wide"), "--parallax: invalid float value: 'wide'"),
    ],
)
def test_wrong_usage(scene, tmp_path, capsys, options, phrase):
    wrong_usage(deblur(capsys, scene, tmp_path / "out.png", *options), "deblur", phrase)
    assert everything(tmp_path) == {}


# simulate


def simulate(capsys, scene, output, *options, image=None, depth=None, camera=None):
    return call(
        capsys,
        *("simulate", "--camera", camera or scene.camera, "--image", image or scene.sharp_file),
        *("--depth", depth or scene.depth_npy, "-o", output, *options),
    )


def test_simulate_renders_what_the_library_renders(scene, tmp_path, capsys):
    output = tmp_path / "coded.npy"
    result = simulate(capsys, scene, output, "--json")
    assert (result.status, result.err) == (0, "")
    camera = load_camera(scene.camera)
    expected = render_coded_frame(scene.sharp, scene.depth_m, camera)
    assert np.array_equal(np.load(output), expected)
    summary = json.loads(result.out)
    assert (summary["width"], summary["height"]) == (WIDTH, HEIGHT)
    near_px, far_px = camera.blur_size_px([NEAR_M, FAR_M])
    assert summary["blur_size_min_px"] == pytest.approx(near_px, abs=1e-3)
    assert summary["blur_size_max_px"] == pytest.approx(far_px, abs=1e-3)


def test_simulated_noise_has_a_seed_and_bits(scene, tmp_path, capsys):
    frames = []
    for number, seed in enumerate((1, 1, 2)):
        output = tmp_path / f"{number}.npy"
        options = ("--noise", 0.01, "--seed", seed, "--bits", 8)
        assert simulate(capsys, scene, output, *options).status == 0
        frames.append(np.load(output))
    assert np.array_equal(frames[0], frames[1])
    assert (frames[0] - frames[2]).std() == pytest.approx(0.01 * 2**0.5, rel=0.05)
    assert frames[0] * 255 == pytest.approx(np.rint(frames[0] * 255), abs=1e-3)


def test_simulate_tells_the_blur_of_the_whole_field(scene, tmp_path, capsys):
    camera = camera_file(tmp_path, field_curvature=[1.2, -1.0])
    flat = tmp_path / "flat.npy"
    np.save(flat, np.full((HEIGHT, WIDTH), FAR_M, np.float32))
    options = ("--json",)
    found = simulate(capsys, scene, tmp_path / "a.npy", *options, camera=camera, depth=flat)
    blur_size_px = load_camera(camera).blur_map_px(np.load(flat))
    summary = json.loads(found.out)
    assert summary["blur_size_min_px"] == pytest.approx(blur_size_px.min(), abs=1e-3)
    assert summary["blur_size_max_px"] == pytest.approx(blur_size_px.max(), abs=1e-3)
    assert np.ptp(blur_size_px) > 0.5


def test_a_scene_at_infinity_is_simulated(scene, tmp_path, capsys):
    away = tmp_path / "away.npy"
    np.save(away, np.full((HEIGHT, WIDTH), np.inf, np.float32))
    summary = json.loads(simulate(capsys, scene, tmp_path / "a.npy", "--json", depth=away).out)
    infinity_px = load_camera(scene.camera).blur_at_infinity_px
    assert summary["blur_size_max_px"] == pytest.approx(infinity_px, abs=1e-3)


def test_a_picture_that_is_cut_has_the_middle_of_the_field(scene, tmp_path, capsys):
    camera = camera_file(tmp_path, field_curvature=[1.2, -1.0])
    middle = np.s_[HEIGHT // 4 : -HEIGHT // 4, WIDTH // 4 : -WIDTH // 4]
    np.save(tmp_path / "depth.npy", np.full((HEIGHT, WIDTH), FAR_M, np.float32))
    np.save(tmp_path / "cut_depth.npy", np.load(tmp_path / "depth.npy")[middle])
    np.save(tmp_path / "cut_sharp.npy", scene.sharp[middle])
    for name, image in (("", scene.sharp_file), ("cut_", tmp_path / "cut_sharp.npy")):
        files = {"image": image, "depth": tmp_path / f"{name}depth.npy", "camera": camera}
        assert simulate(capsys, scene, tmp_path / f"{name}coded.npy", **files).status == 0
    whole, cut = (np.load(tmp_path / f"{name}coded.npy") for name in ("", "cut_"))
    inside = np.s_[16:-16, 16:-16]
    # Layers of blur lie elsewhere, which changes hardly anything.
    assert np.abs(cut[inside] - whole[middle][inside]).max() < 0.004


@pytest.mark.parametrize(
    ("size", "what"),
    [((640, 480), "the middle of"), ((64, 48), "more than"), ((640, 48), "more than")],
)
def test_simulate_says_that_the_picture_is_not_the_camera_s(
    scene, tmp_path, capsys, caplog, size, what
):
    camera = camera_file(tmp_path, image_width=size[0], image_height=size[1])
    with caplog.at_level(logging.WARNING):
        assert simulate(capsys, scene, tmp_path / "coded.npy", camera=camera).status == 0
    sizes = f"has {WIDTH} x {HEIGHT} pixels, not the {size[0]} x {size[1]} of the camera file"
    assert f"{sizes}: taken as {what} its image" in caplog.text


@pytest.mark.parametrize(
    ("files", "phrase"),
    [
        ({"image": "missing.png"}, "No such file"),
        ({"depth": "missing.npy"}, "No such file"),
        ({"camera": "missing.yaml"}, "No such file"),
        ({"image": np.ones((20, 30))}, "must be of one size"),
        ({"image": np.full((HEIGHT, WIDTH), np.nan)}, "all pixels must be finite"),
        ({"depth": np.full((HEIGHT, WIDTH), np.nan)}, "no pixel has a known depth"),
        ({"depth": np.full((HEIGHT, WIDTH), 0.01)}, "too near the lens"),
        ({"depth": np.full((HEIGHT, WIDTH), 2000.0)}, None),
    ],
)
def test_scenes_that_cannot_be_simulated(scene, tmp_path, capsys, caplog, files, phrase):
    paths = {}
    for name, content in files.items():
        paths[name] = tmp_path / (content if isinstance(content, str) else f"{name}.npy")
        if not isinstance(content, str):
            np.save(paths[name], content.astype(np.float32))
    before = everything(tmp_path)
    result = simulate(capsys, scene, tmp_path / "coded.png", **paths)
    if phrase is None:
        assert result.status == 0
        return
    refused(result, *paths.values(), phrase)
    assert not caplog.messages
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("output", "phrase"),
    [
        ("coded.exr", "unknown format"),
        ("coded", "unknown format"),
        ("file/coded.png", "is not a folder"),
    ],
)
def test_simulate_refuses_impossible_outputs_before_rendering(
    scene, tmp_path, capsys, monkeypatch, output, phrase
):
    forbid_work(monkeypatch, "cli.simulate.render_coded_frame")
    (tmp_path / "file").write_text("")
    before = everything(tmp_path)
    refused(simulate(capsys, scene, tmp_path / output), output, phrase)
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("options", "phrase"),
    [
        (("--noise", 2), "--noise: 2.0 is out of range (0 to 1)"),
        (("--bits", 9), "--bits: 9 is not allowed, use one of 0, 8, 12, 16"),
        (("--seed", -1), "--seed: -1 is out of range (at least 0)"),
        (("--depth-scale", 0), "--depth-scale: 0.0 is out of range (more than 0 m)"),
        (("--gamma", "x"), "--gamma: expected a number or srgb"),
    ],
)
def test_wrong_usage_of_simulate(scene, tmp_path, capsys, options, phrase):
    wrong_usage(simulate(capsys, scene, tmp_path / "coded.png", *options), "simulate", phrase)
    assert everything(tmp_path) == {}


def test_a_random_scene_is_simulated_with_its_truth_beside_it(tmp_path, capsys):
    pytest.importorskip("numba", reason="random scenes need numba")
    from coded_aperture_ros.simulation.layered import random_scene

    output = tmp_path / "coded.npy"
    cells = np.float32([[1, 1, 0], [0, 1, 0], [0, 1, 1]])
    np.save(tmp_path / "mask.npy", cells)
    options = ("--random", 7, "--mask", tmp_path / "mask.npy", "--side", "both", "--size", 90, 70)
    result = call(capsys, "simulate", *options, "-o", output, "--json")
    assert (result.status, result.err) == (0, "")
    camera = load_camera(output.with_suffix(".camera.yaml"))
    assert (camera.image_width, camera.image_height, camera.side) == (90, 70, "both")
    expected = random_scene(7, camera.mask, "both", (70, 90))
    np.testing.assert_array_equal(np.load(output), expected.coded())
    np.testing.assert_array_equal(
        np.load(tmp_path / "coded.all_in_focus.npy"), expected.all_in_focus()
    )
    depth = np.load(tmp_path / "coded.depth.npy")
    np.testing.assert_allclose(camera.blur_size_px(depth), expected.blur_size_px(), atol=2e-3)
    summary = json.loads(result.out)
    assert (summary["width"], summary["height"]) == (90, 70)
    assert summary["blur_size_min_px"] < 0 < summary["blur_size_max_px"]
    assert summary["depth_near_m"] == pytest.approx(depth.min(), abs=1e-3)
    again = call(capsys, "simulate", *options, "-o", tmp_path / "b.png", "--noise", 0.01)
    assert "blur sizes" in again.out
    noisy = read_image(tmp_path / "b.png") - expected.coded()
    assert noisy.std() == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize(
    ("options", "phrase"),
    [
        ((), "required: --camera or --random"),
        (("--image", "x.png", "--mask", "zhou"), "required: --camera or --random"),
        (("--random", 3, "--image", "x.png"), "--random: not with --image (it makes"),
        (("--random", -1), "--random: -1 is out of range (at least 0)"),
        (("--random", 1, "--depth-scale", 2), "--random: not with --depth-scale"),
        (("--random", 1, "--gamma", "srgb"), "--random: not with --gamma"),
        (("--random", "x"), "--random: invalid int value"),
        (("--random", 3, "--size", 5, 5), "--size: 5 is out of range (at least 16 px)"),
        (("--random", 3, "--side", "left"), "--side: 'left' is not allowed"),
    ],
)
def test_wrong_usage_of_random_scenes(tmp_path, capsys, options, phrase):
    result = call(capsys, "simulate", *options, "-o", tmp_path / "coded.png")
    wrong_usage(result, "simulate", phrase)
    assert everything(tmp_path) == {}


def test_a_mask_is_for_random_scenes_only(scene, tmp_path, capsys):
    result = simulate(capsys, scene, tmp_path / "coded.png", "--mask", "zhou")
    wrong_usage(result, "simulate", "--mask: only with --random")
