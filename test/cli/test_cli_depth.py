"""The command `depth`."""

import dataclasses
import json
import re
import shutil
import sys
from itertools import product

import cv2
import numpy as np
import pytest
import yaml
from bad_frames import names, write_frames
from bag_scene import recording, write_bag
from cli_scene import (
    FAR_M,
    HEIGHT,
    NEAR_M,
    WIDTH,
    Result,
    call,
    camera_file,
    everything,
    forbid_work,
    refused,
    wrong_usage,
)
from scipy import ndimage
from waiting import run_program, run_python

from coded_aperture_ros.depth import REGULARIZERS, DepthConfig, DepthEstimator, estimate_video
from coded_aperture_ros.frames import SRGB, encode, mosaic_from_colour
from coded_aperture_ros.io import read_depth, read_image, write_image
from coded_aperture_ros.likelihood.bank import load_bank
from coded_aperture_ros.likelihood.choose import new_model
from coded_aperture_ros.likelihood.motion import MotionConfig
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.simulation import render_coded_frame

# Few motions, so that a test takes no time.
FEW_MOTIONS = MotionConfig(
    motion_directions=2, motion_lengths=2, longest_motion_px=4.0, motion_rank=32
)
FEW = (
    *("--motion", "--motion-directions", 2, "--motion-lengths", 2),
    *("--longest-motion-px", 4, "--motion-rank", 32),
)


def relative_error(depth_m, scene):
    """Median relative error away from the depth edge, where depth is known, and how often it is."""
    where = scene.away_from_the_edge()
    error = np.abs(depth_m - scene.depth_m)[where] / scene.depth_m[where]
    return np.nanmedian(error), np.isfinite(error).mean()


@pytest.mark.parametrize("suffix", [".npy", ".png"])
def test_a_bound_on_free_space_beside_the_depth(scene, tmp_path, capsys, suffix):
    output = tmp_path / f"depth{suffix}"
    arguments = ("depth", "--bank", scene.bank, scene.coded_png, "-o", output)
    assert call(capsys, *arguments, "--free-space-risk", 0.01).status == 0
    bound_m = read_depth(tmp_path / f"depth.free_space{'.tiff' if suffix == '.png' else suffix}")
    assert bound_m.shape == scene.depth_m.shape
    assert (bound_m > scene.depth_m).mean() < 0.01
    assert np.median(bound_m) > NEAR_M * 0.9
    result = call(capsys, *arguments, "--free-space-risk", 0.01, "--regularize", "semiglobal")
    wrong_usage(result, "depth", "--free-space-risk: needs regularize: learned")


def test_a_second_surface_beside_the_depth(scene, tmp_path, capsys):
    arguments = ("depth", "--bank", scene.bank, scene.coded_png, "-o", tmp_path / "depth.npy")
    assert call(capsys, *arguments, "--second-surface").status == 0
    second_m, share = (
        read_depth(tmp_path / f"depth.{name}.npy") for name in ("second", "second_share")
    )
    assert second_m.shape == share.shape == scene.depth_m.shape
    assert np.array_equal(np.isnan(second_m), np.isnan(share))


def test_two_frames_of_one_view(scene, tmp_path, capsys):
    other_focus = 5.0
    other = dataclasses.replace(
        load_camera(scene.camera), focus_distance_m=other_focus, side="near"
    )
    coded = render_coded_frame(scene.sharp, scene.depth_m, other)
    write_image(tmp_path / "second.tiff", coded.astype(np.float32))
    output = tmp_path / "depth.npy"
    one = ("depth", "--bank", scene.bank, "--camera", scene.camera)
    one = (*one, scene.coded_png, "-o", output)
    second = ("--refocused-frame", tmp_path / "second.tiff", "--refocused-to", other_focus)
    result = call(capsys, *one, *second)
    assert (result.status, result.err) == (0, "")
    error, known = relative_error(np.load(output), scene)
    assert error < 0.05 and known > 0.5
    # A bank of both sides, and a second focus before all: the maps are whole without the sides.
    camera = yaml.safe_load(scene.camera.read_text())
    camera |= {"focus_distance_m": 2.2, "side": "both", "mask_extent_mm": 100.0}
    (tmp_path / "both.yaml").write_text(yaml.safe_dump(camera))
    both, random = load_camera(tmp_path / "both.yaml"), np.random.default_rng(0)
    for name, focus_m in (("first", 2.2), ("before", 1.4)):
        focused = dataclasses.replace(both, focus_distance_m=focus_m)
        coded = render_coded_frame(scene.sharp, scene.depth_m, focused)
        coded += random.normal(0, 0.001, coded.shape)
        write_image(tmp_path / f"{name}.tiff", coded.astype(np.float32))
    learn = ("--depth-range", NEAR_M, FAR_M, "--level-count", 30, "-o", tmp_path / "both.npz")
    assert call(capsys, "learn", "--camera", tmp_path / "both.yaml", *learn).status == 0
    files = ("--bank", tmp_path / "both.npz", "--camera", tmp_path / "both.yaml")
    refocused = ("--refocused-frame", tmp_path / "before.tiff", "--refocused-to", 1.4)
    pair = ("depth", *files, tmp_path / "first.tiff", *refocused, "-o", tmp_path / "of_both.npy")
    result = call(capsys, *pair)
    assert (result.status, result.err) == (0, "")
    assert not (tmp_path / "of_both.side.npy").exists()
    error, known = relative_error(np.load(tmp_path / "of_both.npy"), scene)
    assert error < 0.05 and known > 0.5
    wrong_usage(call(capsys, *one, *second[:2]), "depth", "needs --refocused-to too")
    wrong_usage(call(capsys, *one, *second, "--temporal-frames", 2), "depth", "--temporal-frames")
    wrong_usage(call(capsys, *one, *second, "--frame-scale", 2), "depth", "--frame-scale")
    before = output.read_bytes()
    broken = (*one, "--refocused-frame", tmp_path / "none.png", "--refocused-to", 2)
    refused(call(capsys, *broken), "none.png")
    kept = (*one[:-1], second[1], *second)
    refused(call(capsys, *kept), "second.tiff")
    assert output.read_bytes() == before


@pytest.mark.parametrize("suffix", [".npy", ".tiff", ".png"])
def test_depth_of_the_simulated_planes(scene, tmp_path, capsys, suffix):
    output = tmp_path / f"depth{suffix}"
    result = call(capsys, "depth", "--bank", scene.bank, scene.coded_png, "-o", output)
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith(f"{output}: depth at ")
    confidence_file, deviation_file = (
        tmp_path / f"depth.{name}{'.npy' if suffix == '.npy' else '.tiff'}"
        for name in ("confidence", "std_dev")
    )
    beside = [confidence_file.name, deviation_file.name]
    beside += ["depth.picture.png"] if suffix == ".png" else []
    assert names(tmp_path) == sorted([output.name, *beside])
    depth_m = read_depth(output)
    assert depth_m.shape == (HEIGHT, WIDTH)
    median, known = relative_error(depth_m, scene)
    assert median < 0.03
    assert known > 0.8
    confidence = read_image(confidence_file)
    assert confidence.shape == (HEIGHT, WIDTH)
    assert (confidence.min() >= 0, confidence.max() <= 1) == (True, True)
    assert (confidence[np.isnan(depth_m)] < DepthConfig().confidence_threshold).all()
    std_dev_m = read_depth(deviation_file)
    assert np.array_equal(np.isnan(std_dev_m), np.isnan(depth_m))
    assert f"standard deviation {np.nanmedian(std_dev_m):.2g} m; noise" in result.out
    within = np.abs(depth_m - scene.depth_m)[scene.away_from_the_edge()]
    assert np.mean(within < 2 * std_dev_m[scene.away_from_the_edge()]) > 0.7
    if suffix == ".png":
        assert cv2.imread(str(output), cv2.IMREAD_UNCHANGED).dtype == np.uint16


def test_levels_and_a_summary_as_json(scene, tmp_path, capsys):
    output = tmp_path / "level.npy"
    result = call(
        capsys,
        "depth",
        "--bank",
        scene.bank,
        scene.coded_npy,
        "-o",
        output,
        "--as-levels",
        "--json",
    )
    assert (result.status, result.err) == (0, "")
    (summary,) = json.loads(result.out)
    assert (summary["output"], summary["unit"]) == (str(output), "level")
    assert 0.8 < summary["known"] <= 1
    # The estimate errs upward: some of the texture counts as noise.
    assert 0.0005 < summary["noise"] < 0.007
    level = np.load(output)
    assert 0 <= np.nanmin(level) < np.nanmax(level) < 15 + 1e-3
    assert summary["median"] == pytest.approx(np.nanmedian(level), abs=1e-4)
    assert summary["median_std_dev_m"] is None


def test_a_bank_without_depths_gives_levels_or_takes_a_camera(scene, tmp_path, capsys):
    bank = ("--bank", scene.index_bank, scene.coded_npy)
    refused(
        call(capsys, "depth", *bank, "-o", tmp_path / "no.npy"),
        *(scene.index_bank, "give --camera, or --as-levels"),
    )
    assert everything(tmp_path) == {}
    assert call(capsys, "depth", *bank, "--as-levels", "-o", tmp_path / "level.npy").status == 0
    camera = ("--camera", scene.camera)
    assert call(capsys, "depth", *bank, *camera, "-o", tmp_path / "depth.npy").status == 0
    level, depth_m = np.load(tmp_path / "level.npy"), np.load(tmp_path / "depth.npy")
    assert np.nanmax(level) <= 8
    median, known = relative_error(depth_m, scene)
    assert median < 0.04
    assert known > 0.5


@pytest.mark.parametrize("unit", ["m", "level"])
def test_pictures(scene, tmp_path, capsys, unit):
    levels = ("--as-levels",) if unit == "level" else ()
    arguments = ("--bank", scene.bank, scene.coded_npy, "-o", tmp_path / "d.npy", "--pictures")
    assert call(capsys, "depth", *arguments, *levels).status == 0
    assert names(tmp_path) == [
        *("d.confidence.npy", "d.confidence.picture.png", "d.npy", "d.picture.png"),
        *(("d.std_dev.npy",) if unit == "m" else ()),
    ]
    picture = read_image(tmp_path / "d.picture.png")
    assert picture.shape[0] > HEIGHT
    assert picture.shape[1:] == (WIDTH, 3)
    assert read_image(tmp_path / "d.confidence.picture.png").shape == picture.shape


def test_points_in_the_colours_of_the_frame(scene, tmp_path, capsys):
    output = tmp_path / "depth.npy"
    arguments = ("depth", "--bank", scene.bank, scene.coded_png, "-o", output, "--points")
    wrong_usage(call(capsys, *arguments), "depth", "--points: needs --camera")
    assert call(capsys, *arguments, "--camera", scene.camera).status == 0
    header, data = (tmp_path / "depth.ply").read_bytes().split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    names = [line.split()[-1] for line in lines if line.startswith("property")]
    kinds = ["<f4"] * 3 + ["u1"] * 3 + ["<f4"] * 2
    points = np.frombuffer(data, list(zip(names, kinds, strict=True)))
    depth = np.load(output)
    known = np.isfinite(depth)
    assert lines[2] == f"element vertex {known.sum()}"
    np.testing.assert_array_equal(points["z"], depth[known])
    std_dev = np.load(tmp_path / "depth.std_dev.npy")
    np.testing.assert_array_equal(points["std_dev"], std_dev[known])
    matrix = load_camera(scene.camera).intrinsics.camera_matrix
    columns = np.nonzero(known)[1]
    expected = (columns - matrix[2]) / matrix[0] * depth[known]
    np.testing.assert_allclose(points["x"], expected, atol=1e-4)
    coded = np.rint(255 * np.clip(read_image(scene.coded_png), 0, 1))
    np.testing.assert_allclose(points["green"], coded[known][:, 1], atol=1)


@pytest.mark.parametrize("method", ["none", "tv", "graphcut"])
def test_every_regularisation(scene, tmp_path, capsys, method):
    if method == "graphcut":
        pytest.importorskip("maxflow")
    output = tmp_path / "depth.npy"
    arguments = ("--bank", scene.bank, scene.coded_npy, "-o", output, "--regularize", method)
    result = call(capsys, "depth", *arguments)
    assert (result.status, result.err) == (0, "")
    median, known = relative_error(np.load(output), scene)
    assert median < 0.03
    assert known > 0.8


def test_options_reach_the_estimate(scene, tmp_path, capsys):
    def depth(*options):
        output = tmp_path / "d.npy"
        arguments = ("--bank", scene.bank, scene.coded_npy, "-o", output, "--json")
        result = call(capsys, "depth", *arguments, *options)
        return json.loads(result.out)[0]

    assert depth("--noise", 0.02)["noise"] == 0.02
    assert depth("--confidence-threshold", 0)["known"] == 1
    assert depth("--confidence-threshold", 1)["known"] < 0.5
    assert depth("--saturation", 0.1)["known"] == 0


def test_a_folder_of_frames(scene, tmp_path, capsys):
    frames, output = tmp_path / "frames", tmp_path / "depth.maps"
    frames.mkdir()
    for name in ("wall.001.png", "wall.002.png"):
        shutil.copy(scene.coded_png, frames / name)
    result = call(capsys, "depth", "--bank", scene.bank, frames, "-o", f"{output}/", "--json")
    assert (result.status, result.err) == (0, "")
    expected = [output / "wall.001.npy", output / "wall.002.npy"]
    assert [entry["output"] for entry in json.loads(result.out)] == [str(p) for p in expected]
    others = [f"wall.00{n}.{name}.npy" for n in (1, 2) for name in ("confidence", "std_dev")]
    assert names(output) == sorted([path.name for path in expected] + others)
    for path, entry in zip(expected, json.loads(result.out), strict=True):
        median = np.nanmedian(np.load(path.with_name(f"{path.stem}.std_dev.npy")))
        assert entry["median_std_dev_m"] == pytest.approx(median, abs=1e-4)
    assert relative_error(np.load(expected[1]), scene)[0] < 0.03


def _seen(linear):
    """Return linear light of 8 bits as a screen shows it."""
    return 255 * encode(linear / 255, SRGB)


def test_a_movie_has_one_kind_of_file(scene, tmp_path, capsys):
    asked = "--bank", scene.bank, scene.coded_png, "-o", tmp_path / "d.npy"
    result = call(capsys, "depth", *asked, "--movie", tmp_path / "movie.gif")
    assert result.status == 1 and ".mp4" in result.err
    assert names(tmp_path) == []


def test_a_movie_never_takes_the_place_of_what_is_there(scene, tmp_path, capsys):
    video, other = tmp_path / "in.mp4", tmp_path / "other.mp4"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"mp4v"), 10, (WIDTH, HEIGHT))
    writer.write(np.rint(255 * np.load(scene.coded_npy)).astype(np.uint8)[..., ::-1].copy())
    writer.release()
    before = video.read_bytes()
    asked = "depth", "--bank", scene.bank, "-o", f"{tmp_path}/depth/"
    result = call(capsys, *asked, video, "--movie", video)
    assert result.status == 1 and "is an input" in result.err
    assert video.read_bytes() == before
    # Of no frame that could be used there is no movie.
    other.write_bytes(before)
    small = tmp_path / "small"
    small.mkdir()
    for name in ("a.png", "b.png"):
        (small / name).write_bytes(b"not a picture")
    result = call(capsys, *asked, small, "--movie", other)
    assert result.status == 1 and f"{other} was not written" in result.err
    assert other.read_bytes() == before


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"x", "not a picture"), (b"", "empty"), (None, "smaller"), (b"\x89PNG", "truncated")],
)
def test_of_a_movie_without_a_frame_the_reasons_are_told(
    scene, tmp_path, capsys, count, content, reason
):
    files = [tmp_path / f"{number}.png" for number in range(count)]
    for file in files:
        if content is None:
            cv2.imwrite(str(file), np.zeros((3, 4), np.uint8))
        else:
            file.write_bytes(content)
    asked = "--bank", scene.bank, *files, "-o", f"{tmp_path}/depth/"
    result = call(capsys, "depth", *asked, "--movie", tmp_path / "movie.mp4")
    assert result.status == 1

    for file in files:
        assert re.search(rf"{file}.*{reason}", result.err)
    assert "Traceback" not in result.err
    assert sorted(tmp_path.glob("*.mp4")) == []


def test_a_movie_that_was_cut_off_is_not_left_behind(tmp_path):
    """A limit of the size of files stands in for a full disk."""
    program = (
        "import resource, signal, numpy as np\n"
        "from coded_aperture_ros.io.movie_file import movie\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))\n"
        "random = np.random.default_rng(0)\n"
        "with movie('full.mp4') as add:\n"
        "    for _ in range(20):\n"
        "        add(random.integers(0, 256, (240, 320, 3), np.uint8))\n"
    )
    ran = [sys.executable, "-c", program]
    result = run_program(*ran, cwd=tmp_path)
    assert "cannot write full.mp4: is the disk full?" in result.stderr
    assert names(tmp_path) == []


def test_a_video(scene, tmp_path, capsys):
    pixels = np.rint(255 * np.load(scene.coded_npy)).astype(np.uint8)
    video = tmp_path / "pan.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"FFV1"), 10, (WIDTH, HEIGHT))
    for _ in range(2):
        writer.write(pixels[..., ::-1].copy())
    writer.release()
    movie = "--movie", tmp_path / "movie.mp4"
    result = call(capsys, "depth", "--bank", scene.bank, video, "-o", tmp_path / "depth", *movie)
    assert result.status == 0
    depths = ["pan_000000.npy", "pan_000001.npy"]
    shown = cv2.VideoCapture(str(movie[1]))
    pictures = [shown.read()[1] for _ in range(2)]
    assert not shown.read()[0]
    assert all(picture.shape[1] == 2 * WIDTH for picture in pictures)
    # The frame on the left is as it was, but for the compression of the video.
    apart = np.abs(
        pictures[0][:HEIGHT, :WIDTH].mean((0, 1)) - _seen(pixels)[..., ::-1].mean((0, 1))
    )
    assert apart.max() < 6
    assert [n for n in names(tmp_path / "depth") if n.count(".") == 1] == depths
    assert relative_error(np.load(tmp_path / "depth" / depths[0]), scene)[0] < 0.05


@pytest.mark.parametrize("command", ["depth", "deblur"])
def test_pictures_with_results_of_one_name(scene, tmp_path, capsys, command):
    """A picture like a frame of a video or a bag, and one like another result of a picture."""
    inputs = [tmp_path / f"{name}.npy" for name in ("clip_000000", "a", "a.std_dev", "clip")]
    for file in inputs:
        shutil.copy(scene.coded_npy, file)
    bag = write_bag(tmp_path / "clip.bag", recording(scene, frames=1)).rename(tmp_path / "clip.b")
    arguments = (command, "--bank", scene.bank, "-o", tmp_path / "out/")
    arguments += ("--depth", "auto") if command == "deblur" else ()
    for given in ([bag, inputs[0]], [inputs[0], bag]):
        refused(call(capsys, *arguments, *given), "several inputs are named clip_000000")
    result = call(capsys, *arguments, *inputs[1:3])
    if command == "depth":
        refused(result, "a.std_dev.npy: two results cannot go to one file")
        assert not (tmp_path / "out").exists()
    else:
        assert result.status == 0
    assert call(capsys, *arguments, bag, inputs[3]).status == 0


@pytest.mark.parametrize("scale", [0.5, 2])
def test_a_video_of_resampled_frames(scene, tmp_path, capsys, scale):
    """It has their own size, which is that of their depth."""
    shape = round(WIDTH / scale), round(HEIGHT / scale)
    np.save(tmp_path / "frame.npy", cv2.resize(np.load(scene.coded_npy), shape))
    options = ("--frame-scale", scale, "--movie", tmp_path / "v.mp4", "-o", tmp_path / "d.npy")
    options += ("--confidence-threshold", 0)  # for depth, if not a good one
    result = call(capsys, "depth", "--bank", scene.bank, tmp_path / "frame.npy", *options)
    assert (result.status, result.err) == (0, "")
    shown, picture = cv2.VideoCapture(str(tmp_path / "v.mp4")).read()
    assert shown and picture.shape[1] == 2 * shape[0]


def test_as_a_process_with_nothing_but_json_on_stdout(scene, tmp_path):
    result = run_python(
        *("-W", "error", "-m", "coded_aperture_ros.cli.main", "depth"),
        *("--bank", scene.bank, scene.coded_png, "-o", tmp_path / "d.tif", "--json"),
        check=True,
    )
    assert json.loads(result.stdout)[0]["output"] == str(tmp_path / "d.tif")


@pytest.mark.parametrize("value", [0.0, 1.0, np.nan, 0.5])
def test_frames_without_texture_have_no_depth(scene, tmp_path, capsys, value):
    frame = tmp_path / "flat.npy"
    np.save(frame, np.full((HEIGHT, WIDTH, 3), value, np.float32))
    output = tmp_path / "depth.npy"
    arguments = ("--bank", scene.bank, frame, "-o", output, "--pictures")
    result = call(capsys, "depth", *arguments)
    reason = "no frame has depth: too dark, saturated, or without texture"
    assert (result.status, result.err) == (1, f"coded_aperture: error: {frame}: {reason}\n")
    assert "depth unknown everywhere" in result.out
    assert np.isnan(np.load(output)).all()
    assert (np.load(tmp_path / "depth.confidence.npy") == 0).all()
    result = call(capsys, "depth", *arguments, "--json")
    assert json.loads(result.out)[0]["median"] is None


def test_nan_and_saturated_pixels_are_unknown_and_harm_nothing_else(scene, tmp_path, capsys):
    frame = np.load(scene.coded_npy)
    frame[20:40, 20:40] = np.nan
    frame[70:100, 120:150] = 1.0
    np.save(tmp_path / "holes.npy", frame)
    output = tmp_path / "depth.npy"
    result = call(capsys, "depth", "--bank", scene.bank, tmp_path / "holes.npy", "-o", output)
    assert (result.status, result.err) == (0, "")
    depth_m = np.load(output)
    assert np.isnan(depth_m[28:32, 28:32]).all()
    assert np.isnan(depth_m[80:90, 130:140]).all()
    median, known = relative_error(depth_m, scene)
    assert median < 0.04
    assert known > 0.3


def test_two_frames_of_one_name(scene, tmp_path, capsys):
    shutil.copy(scene.coded_npy, tmp_path / "coded.npy")
    inputs = (scene.coded_png, tmp_path / "coded.npy")
    result = call(capsys, "depth", "--bank", scene.bank, *inputs, "-o", tmp_path / "depth/")
    refused(result, "several inputs are named coded", "use a folder for each")
    assert names(tmp_path) == ["coded.npy"]


def test_two_videos_or_bags_of_one_name(scene, tmp_path, capsys):
    """Their frames are numbered alike."""
    videos = [tmp_path / name / "clip.avi" for name in "ab"]
    bags = [write_bag(tmp_path / name / "clip", recording(scene, frames=1)) for name in "ab"]
    for path in videos:
        video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), 10, (WIDTH, HEIGHT))
        video.write(np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
        video.release()
    before = everything(tmp_path)
    for inputs in (videos, bags, (videos[0], bags[1]), (bags[0], f"bag:{bags[0]}")):
        arguments = ("depth", "--bank", scene.bank, *inputs, "-o", tmp_path / "out")
        refused(call(capsys, *arguments), "several inputs are named clip", "a folder for each")
        assert everything(tmp_path) == before


def test_inputs_are_not_overwritten(scene, tmp_path, capsys):
    shutil.copy(scene.coded_npy, tmp_path / "coded.npy")
    before = everything(tmp_path)
    for output in (tmp_path, tmp_path / "coded.npy"):
        arguments = ("--bank", scene.bank, tmp_path / "coded.npy", "-o", output)
        refused(call(capsys, "depth", *arguments), "coded.npy", "use another name")
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("output", "options", "phrase"),
    [
        ("depth.jpg", (), "unknown format, use .npy, .tif, .tiff, .png, or end a folder's name"),
        ("depth.v2", (), "unknown format"),
        ("depth.png", ("--as-levels",), "write levels to .npy or .tiff"),
        ("file/depth.npy", (), "is not a folder"),
        ("file", (), "is not a folder"),
        ("/proc/depth.npy", (), "cannot write /proc/depth.npy"),
        ("second.npy", (), "second.confidence.npy: it is a folder"),
        ("fourth.npy", (), "fourth.std_dev.npy: it is a folder"),
        ("third.npy", ("--pictures",), "third.confidence.picture.png: it is a folder"),
    ],
)
def test_impossible_outputs_are_refused_before_estimating(
    scene, tmp_path, capsys, monkeypatch, output, options, phrase
):
    forbid_work(monkeypatch, "depth.DepthEstimator.estimate")
    (tmp_path / "file").write_text("")
    (tmp_path / "second.confidence.npy").mkdir()
    (tmp_path / "fourth.std_dev.npy").mkdir()
    (tmp_path / "third.confidence.picture.png").mkdir()
    before = everything(tmp_path)
    arguments = ("--bank", scene.bank, scene.coded_npy, "-o", tmp_path / output, *options)
    refused(call(capsys, "depth", *arguments), output.partition(".")[0], phrase)
    assert everything(tmp_path) == before


def test_several_frames_do_not_fit_into_one_file(scene, tmp_path, capsys):
    inputs = (scene.coded_npy, scene.sharp_file)
    result = call(capsys, "depth", "--bank", scene.bank, *inputs, "-o", tmp_path / "depth.npy")
    refused(result, "depth.npy: 2 frames do not fit into one file, name a folder")
    assert everything(tmp_path) == {}


@pytest.mark.parametrize(
    ("name", "phrase"),
    [
        ("missing.png", "no such file or folder"),
        ("empty.png", "the file is empty"),
        ("text.png", "not a picture, or truncated"),
        ("cut.png", "not a picture, or truncated"),
        ("text.npy", "truncated, or not a .npy array"),
        ("video.avi", "not a video"),
        ("folder", "no pictures in this folder"),
        ("small.npy", "window"),
        ("four.npy", "got the shape [90, 90, 4]"),
        ("stack.npy", "got the shape [2, 90, 90, 3]"),
        ("line.npy", "got the shape [90]"),
        ("nothing.npy", "got the shape [0, 90]"),
        ("int64.npy", "expected 8-bit, 16-bit or float pixels"),
        ("complex.npy", "expected one numeric array"),
        ("objects.npy", "truncated, or not a .npy array"),
    ],
)
def test_unusable_frames(scene, tmp_path, capsys, name, phrase):
    write_frames(tmp_path)
    before = everything(tmp_path)
    output = ("-o", tmp_path / "depth" / "d.npy", "--parents")
    result = call(capsys, "depth", "--bank", scene.bank, tmp_path / name, *output)
    refused(result, tmp_path / name, phrase)
    assert everything(tmp_path) == before


@pytest.mark.parametrize("name", ["video.avi", "cut.png", "cut.tiff"])
def test_opencv_adds_nothing_to_the_message(scene, tmp_path, name):
    write_frames(tmp_path)
    (tmp_path / "cut.tiff").write_bytes(b"II*\0\x08\0\0\0\x01")
    result = run_python(
        *("-m", "coded_aperture_ros.cli.main", "depth"),
        *("--bank", scene.bank, tmp_path / name, "-o", tmp_path / "d.npy"),
    )
    refused(Result(result.returncode, result.stdout, result.stderr), tmp_path / name)


@pytest.mark.parametrize("command", ["depth", "deblur"])
def test_bad_frames_in_a_folder_are_named_and_the_others_done(scene, tmp_path, capsys, command):
    shutil.copy(scene.coded_png, tmp_path / "a.png")
    np.save(tmp_path / "b.npy", np.ones((20, 20), np.float32))
    (tmp_path / "c.png").write_text("no picture")
    shutil.copy(scene.coded_png, tmp_path / "d.png")
    out = tmp_path / "out"
    options = ("--depth", "auto") if command == "deblur" else ()
    result = call(capsys, command, "--bank", scene.bank, tmp_path, "-o", out, *options)
    assert result.status == 1
    unusable = result.err.splitlines()
    assert unusable[0].startswith(f"coded_aperture: not used: {tmp_path}, frame b: ")
    assert unusable[1].startswith(f"coded_aperture: not used: cannot read {tmp_path}/c.png: not a")
    assert len(unusable) == 2
    kinds = [".picture", ""] if command == "deblur" else [".confidence", "", ".std_dev"]
    suffix = ".png" if command == "deblur" else ".npy"
    assert names(out) == [f"{name}{kind}{suffix}" for name in "ad" for kind in kinds]


def test_frames_of_another_size_are_refused_or_resampled(scene, tmp_path, capsys):
    half = tmp_path / "half.npy"
    coded = np.load(scene.coded_npy)
    np.save(half, cv2.resize(coded, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA))
    arguments = ("--bank", scene.bank, half, "-o", tmp_path / "d.npy")
    result = call(capsys, "depth", *arguments)
    refused(result, half, f"the bank is for {WIDTH}x{HEIGHT}", "learn a bank for 132x96")
    assert "--frame-scale" not in result.err  # what is enlarged has lost what tells depth
    result = call(capsys, "depth", *arguments, "--frame-scale", 4 / 3, "--confidence-threshold", 0)
    assert result.status == 0
    assert np.load(tmp_path / "d.npy").shape == (round(0.75 * HEIGHT), round(0.75 * WIDTH))
    wrong_usage(
        call(capsys, "depth", *arguments, "--frame-scale", 20), "depth", "out of range (0.1 to 10)"
    )


@pytest.mark.parametrize("empty", ["--bank", "--camera", "-o", "input"])
def test_an_empty_argument_is_not_the_folder_where_the_command_runs(
    scene, tmp_path, capsys, monkeypatch, empty
):
    monkeypatch.chdir(tmp_path)
    given = {"--bank": scene.bank, "--camera": scene.camera, "-o": "d.npy"}
    given = {name: "" if name == empty else value for name, value in given.items()}
    words = [word for pair in given.items() for word in pair]
    frame = "" if empty == "input" else scene.coded_npy
    wrong_usage(call(capsys, "depth", frame, *words), "depth", "an argument is empty")
    assert everything(tmp_path) == {}


def test_a_scale_that_the_frame_does_not_need_is_to_be_left_out(scene, tmp_path, capsys):
    arguments = ("--bank", scene.bank, scene.coded_npy, "-o", tmp_path / "d.npy")
    result = call(capsys, "depth", *arguments, "--frame-scale", 0.5)
    refused(result, f"resampled to {WIDTH // 2}x{HEIGHT // 2}", "leave out --frame-scale")


def test_a_part_of_a_frame_is_not_said_to_be_resampled(scene, tmp_path, capsys):
    """No scale makes it as large as the bank's frames."""
    np.save(tmp_path / "part.npy", np.load(scene.coded_npy)[:-1])
    arguments = ("--bank", scene.bank, tmp_path / "part.npy", "-o", tmp_path / "d.npy")
    result = call(capsys, "depth", *arguments)
    refused(result, tmp_path / "part.npy", f"learn a bank for {WIDTH}x{HEIGHT - 1}")
    assert "--frame-scale" not in result.err


def test_the_scale_to_resample_by_is_that_of_the_frame_itself(scene, tmp_path, capsys):
    large = (WIDTH * 3, HEIGHT * 3)
    np.save(tmp_path / "large.npy", cv2.resize(np.load(scene.coded_npy), large))
    arguments = ("--bank", scene.bank, tmp_path / "large.npy", "-o", tmp_path / "d.npy")
    result = call(capsys, "depth", *arguments, "--frame-scale", 0.5)
    scale = re.search(r"of 528x384, resampled to 264x192: .* --frame-scale ([.0-9]*)$", result.err)
    assert scale, result.err
    assert call(capsys, "depth", *arguments, "--frame-scale", scale[1]).status == 0


@pytest.mark.parametrize("command", ["depth", "deblur"])
def test_frames_of_another_view_than_the_camera_file_s(scene, tmp_path, capsys, command):
    frame, out = tmp_path / "frame.npy", tmp_path / "out.npy"
    np.save(frame, np.load(scene.coded_npy)[: HEIGHT // 2])
    options = ("--bank", scene.index_bank, "--camera", scene.camera, frame, "-o", out)
    options += ("--depth", "auto") if command == "deblur" else ()
    what = f"frames of {WIDTH}x{HEIGHT // 2} are not the camera file's {WIDTH}x{HEIGHT} resized"
    refused(call(capsys, command, *options), f"{frame}: {what}: give a camera file of such frames")
    np.save(frame, np.load(scene.coded_npy)[:30, :30])  # nor would it help to resample this one
    refused(call(capsys, command, *options), "image of 30x30 px is smaller than the bank's 48 px")
    assert names(tmp_path) == ["frame.npy"]


@pytest.mark.parametrize("bank", ["bank", "index_bank"])
@pytest.mark.parametrize("look_ahead", [False, True], ids=["alone", "look-ahead"])
def test_a_camera_file_of_another_resolution(scene, tmp_path, capsys, bank, look_ahead):
    """It is fitted to the frames, also where the bank does not say how large they are."""
    camera = camera_file(
        tmp_path, focal_length_px=200, image_width=WIDTH // 2, image_height=HEIGHT // 2
    )
    depths_m = {}
    for file in (scene.camera, camera):
        options = ("--camera", file, scene.coded_npy, "-o", tmp_path / "d.npy", "--points")
        options += ("--look-ahead", "--temporal-frames", 1) if look_ahead else ()
        assert call(capsys, "depth", "--bank", getattr(scene, bank), *options).status == 0
        depths_m[file] = np.load(tmp_path / "d.npy")
    np.testing.assert_allclose(depths_m[camera], depths_m[scene.camera], rtol=1e-5)
    assert relative_error(depths_m[camera], scene)[0] < 0.03


def test_two_pixel_method_with_a_camera_file_of_another_resolution(scene, tmp_path, capsys):
    frame, depths_m, mask = tmp_path / "coded.npy", [], {"name": "three_hole"}
    halves = {"focal_length_px": 200, "image_width": WIDTH // 2, "image_height": HEIGHT // 2}
    for changes in ({}, halves):
        camera = camera_file(tmp_path, mask=mask, **changes)
        if not changes:
            arguments = ("--image", scene.sharp_file, "--depth", scene.depth_npy, "-o", frame)
            assert call(capsys, "simulate", "--camera", camera, *arguments).status == 0
        options = ("--method", "two_pixel", "--camera", camera, "--depth-range", 1.4, 4, frame)
        assert call(capsys, "depth", *options, "-o", tmp_path / "d.npy").status == 0
        depths_m.append(np.load(tmp_path / "d.npy"))
    np.testing.assert_allclose(*depths_m, rtol=1e-5)


def test_resampled_frames_have_their_own_depths_and_points(scene, tmp_path, capsys):
    coded = np.load(scene.coded_npy)
    np.save(tmp_path / "frame.npy", cv2.resize(coded, None, fx=2, fy=2))
    options = ("--bank", scene.index_bank, "--camera", scene.camera, "--frame-scale", 0.5)
    arguments = (*options, tmp_path / "frame.npy", "-o", tmp_path / "depth.npy", "--points")
    assert call(capsys, "depth", *arguments).status == 0
    depth_m = np.load(tmp_path / "depth.npy")
    assert depth_m.shape == (2 * HEIGHT, 2 * WIDTH)
    assert np.nanmedian(depth_m[:, : WIDTH - 48]) == pytest.approx(NEAR_M, rel=0.05)
    assert np.nanmedian(depth_m[:, WIDTH + 48 :]) == pytest.approx(FAR_M, rel=0.05)
    _, data = (tmp_path / "depth.ply").read_bytes().split(b"end_header\n")
    count = np.isfinite(depth_m).sum()
    x, _, z = np.frombuffer(data, np.uint8).reshape(count, -1)[:, :12].copy().view("<f4").T
    columns = np.broadcast_to(np.arange(2 * WIDTH), depth_m.shape)[np.isfinite(depth_m)]
    np.testing.assert_allclose(x / z, (columns - WIDTH + 0.5) / (2 * 400), atol=1e-5)


def test_a_camera_of_another_focus_is_refused(scene, tmp_path, capsys):
    camera = camera_file(tmp_path, focus_distance_m=1.2)
    arguments = ("--bank", scene.bank, "--camera", camera, scene.coded_npy)
    result = call(capsys, "depth", *arguments, "-o", tmp_path / "depth.npy")
    refused(result, camera, "another setting of the camera", "learn --remap")


def test_jpeg_is_reckoned_with_more_noise(scene, tmp_path, capsys, caplog):
    picture = np.rint(255 * np.load(scene.coded_npy)).astype(np.uint8)[..., ::-1]
    noises = {}
    for quality in (95, 75):
        cv2.imwrite(str(tmp_path / "c.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
        arguments = ("--bank", scene.bank, tmp_path / "c.jpg", "-o", tmp_path / "d.npy", "--json")
        result = call(capsys, "depth", *arguments)
        assert "compressed with loss" in caplog.text
        noises[quality] = json.loads(result.out)[0]["noise"]
    # Of the mean of three channels the noise is that of one over the root of three.
    assert noises[75] / np.sqrt(3) == pytest.approx(0.0110, abs=0.003)
    assert noises[75] > 1.5 * noises[95]


def test_a_lossy_video_stays_one_video_when_the_light_changes(
    scene, tmp_path, capsys, caplog, monkeypatch
):
    begun, reset = [], FramePipeline.reset
    monkeypatch.setattr(FramePipeline, "reset", lambda self: [begun.append(1), reset(self)])
    picture, path = np.rint(255 * np.load(scene.coded_npy))[..., ::-1], tmp_path / "v.mp4"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 10, (WIDTH, HEIGHT))
    for light in (0.5, 0.7, 0.9):
        video.write((light * picture).astype(np.uint8))
    video.release()
    for number, more in enumerate(((), ("--look-ahead",)), 1):
        arguments = ("--bank", scene.bank, path, "-o", tmp_path / "d", "--gamma", 2.2, *more)
        result = call(capsys, "depth", *arguments, "--temporal-frames", 3)
        line = f"{path}: no frame has depth: compressed pictures: record them without loss"
        assert result.status == 1
        assert result.err.splitlines()[-1] == f"coded_aperture: error: {line}"
        assert caplog.text.count("compressed with loss") == len(begun) == number


@pytest.mark.parametrize("more", [(), ("--look-ahead",)])
def test_pictures_with_and_without_loss_in_one_folder(scene, tmp_path, capsys, caplog, more):
    folder, picture = tmp_path / "in", np.rint(255 * np.load(scene.coded_npy))[..., ::-1]
    folder.mkdir()
    for name in ("0.png", "1.jpg", "2.png"):
        cv2.imwrite(str(folder / name), picture.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 75])
    arguments = ("--bank", scene.bank, folder, "-o", tmp_path / "d", "--json", *more)
    result = call(capsys, "depth", *arguments, "--temporal-frames", 3)
    first, lossy, last = (frame["noise"] for frame in json.loads(result.out))
    assert lossy > 1.2 * max(first, last)
    assert caplog.text.count("compressed with loss") == caplog.text.count(", frame 1: ") == 1


def test_health_is_told(scene, tmp_path, capsys):
    arguments = ("--bank", scene.bank, "-o", tmp_path / "d.npy")
    fits = json.loads(call(capsys, "depth", scene.coded_npy, *arguments, "--json").out)[0]
    assert fits["health"] > 0.5
    assert fits["cause"] == ""
    coded = np.load(scene.coded_npy)
    large = cv2.resize(coded, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    np.save(tmp_path / "large.npy", large[:HEIGHT, :WIDTH])
    arguments = (tmp_path / "large.npy", *arguments)
    other = json.loads(call(capsys, "depth", *arguments, "--json").out)[0]
    assert other["health"] < 0.5
    assert other["cause"] == "scale"
    assert other["known"] < 0.5 * fits["known"]
    assert "does not fit" in call(capsys, "depth", *arguments).out


def write_banks(folder, good):
    """Write files that are no bank."""
    content = good.read_bytes()
    (folder / "truncated.npz").write_bytes(content[: len(content) // 2])
    flipped = bytearray(content)
    for entry in re.finditer(rb"PK\x01\x02", content):
        flipped[entry.start() + 8] |= 1  # says that the entry is encrypted
    (folder / "flipped.npz").write_bytes(flipped)
    (folder / "empty.npz").write_bytes(b"")
    (folder / "text.npz").write_text("no bank")
    np.savez(folder / "foreign.npz", weights=np.ones(3))
    np.save(folder / "array.npz.npy", np.ones(3))
    (folder / "array.npz.npy").rename(folder / "array.npz")
    with np.load(good) as archive:
        arrays = dict(archive)
    np.savez(folder / "newer.npz", **{**arrays, "schema_version": 99})
    np.savez(folder / "odd.npz", **{**arrays, "basis": arrays["basis"][:-1]})
    np.savez(folder / "nan.npz", **{**arrays, "coefficients": arrays["coefficients"] * np.nan})
    np.savez(folder / "part.npz", **{k: v for k, v in arrays.items() if k != "basis"})
    np.savez(folder / "pickle.npz", **{**arrays, "basis": np.array([{}], object)})


@pytest.mark.parametrize("command", ["depth", "deblur"])
@pytest.mark.parametrize(
    ("name", "phrase"),
    [
        ("missing.npz", "no such file"),
        (".", "Is a directory"),
        ("truncated.npz", "truncated, or not an .npz"),
        ("flipped.npz", "truncated, or not an .npz"),
        ("empty.npz", "truncated, or not an .npz"),
        ("text.npz", "truncated, or not an .npz"),
        ("pickle.npz", "truncated, or not an .npz of plain arrays"),
        ("array.npz", "a single array, not a coded-aperture filter bank"),
        ("foreign.npz", "expected a coded-aperture filter bank"),
        ("newer.npz", "upgrade the package"),
        ("odd.npz", "damaged coded-aperture filter bank: basis"),
        ("nan.npz", "damaged coded-aperture filter bank: coefficients"),
        ("part.npz", "without basis: learn it again"),
    ],
)
def test_unusable_banks(scene, tmp_path, capsys, command, name, phrase):
    write_banks(tmp_path, scene.index_bank)
    before = everything(tmp_path)
    options = ("--depth", "auto") if command == "deblur" else ()
    arguments = ("--bank", tmp_path / name, scene.coded_npy, "-o", tmp_path / "out.npy")
    refused(call(capsys, command, *arguments, *options), tmp_path / name, phrase)
    assert everything(tmp_path) == before


def test_a_camera_that_cannot_have_the_bank_s_blur_sizes(scene, tmp_path, capsys):
    camera = camera_file(tmp_path, mask_extent_mm=4.0)
    arguments = ("--bank", scene.bank, "--camera", camera, scene.coded_npy)
    result = call(capsys, "depth", *arguments, "-o", tmp_path / "depth.npy")
    refused(result, camera, "learn the bank for this camera")


@pytest.mark.parametrize(
    ("options", "phrases"),
    [
        (("--stride-px", -1), ["--stride-px", "-1 is out of range (0 to 64 px)"]),
        (("--stride-px", 2.5), ["--stride-px", "invalid int value: '2.5'"]),
        (("--noise", "nan"), ["--noise", "nan is out of range"]),
        (("--confidence-threshold", 2), ["--confidence-threshold", "out of range (0 to 1)"]),
        (("--regularize", "magic"), ["--regularize", "'magic' is not allowed", "graphcut"]),
        (("--gamma", "bright"), ["--gamma", "expected a number or srgb, got 'bright'"]),
        (("--gamma", 0), ["--gamma", "expected 0.1 to 10 or srgb"]),
        (("--window-px", 64), ["--window-px: only with --method two_pixel (a bank has its own"]),
        (("--level-count", 8), ["--level-count: only with --method two_pixel (a bank has its own"]),
        (("--finalists", 2), ["--finalists: only with --motion"]),
        (("--smoothness", 2), ["--smoothness: --regularize learned has none, use semiglobal"]),
        (("--smoothness", 2, "--regularize", "none"), ["--smoothness: --regularize none has"]),
    ],
)
def test_wrong_usage(scene, tmp_path, capsys, options, phrases):
    arguments = ("--bank", scene.bank, scene.coded_npy, "-o", tmp_path / "depth.npy")
    wrong_usage(call(capsys, "depth", *arguments, *options), "depth", *phrases)
    assert everything(tmp_path) == {}


def test_smoothness_counts_where_classical_regularisation_stands_in(scene, tmp_path, capsys):
    """The levels of this bank are farther apart than those that the network was trained for."""
    bank, maps = tmp_path / "bank.npz", []
    sizes = ("--mask", "levin", "--blur-sizes", 4, 12, 4, "--rank", 32)
    assert call(capsys, "learn", *sizes, "-o", bank).status == 0
    for smoothness in (1, 30):
        arguments = ("--bank", bank, "--as-levels", "--smoothness", smoothness, scene.coded_npy)
        assert call(capsys, "depth", *arguments, "-o", tmp_path / "levels.npy").status == 0
        maps.append(np.load(tmp_path / "levels.npy"))
    assert not np.array_equal(*maps, equal_nan=True)


@pytest.fixture(params=["bank", pytest.param("motion", marks=pytest.mark.slow), "two_pixel"])
def method(request, scene, tmp_path, capsys):
    """Options for every method, and a frame that it can use."""
    if request.param != "two_pixel":
        return ("--bank", scene.bank, *(FEW if request.param == "motion" else ()), scene.coded_npy)
    (tmp_path / "holes").mkdir()
    camera = camera_file(tmp_path / "holes", mask={"name": "three_hole"})
    frame = tmp_path / "holes" / "coded.npy"
    arguments = ("--image", scene.sharp_file, "--depth", scene.depth_npy, "-o", frame)
    assert call(capsys, "simulate", "--camera", camera, *arguments).status == 0
    depths = ("--depth-range", 1.4, 4, "--level-count", 16)
    return ("--method", "two_pixel", "--camera", camera, *depths, frame)


@pytest.mark.parametrize(("regularize", "frames"), list(product(REGULARIZERS, (0, 3))))
def test_no_pixel_without_depth_where_nearest_is_wanted(
    method, tmp_path, capsys, regularize, frames
):
    """With every method, regularisation and memory: as a robot does that avoids obstacles."""
    if regularize == "graphcut":
        pytest.importorskip("maxflow")
    settings = ("--regularize", regularize, "--temporal-frames", frames)
    depth_m = []
    for unknown, threshold in (("nothing", 0), ("nothing", 0.5), ("nearest", 0.5)):
        output = tmp_path / "depth.npy"
        options = (*settings, "--unknown", unknown, "--confidence-threshold", threshold)
        result = call(capsys, "depth", *method, *options, "-o", output)
        assert (result.status, result.err) == (0, "")
        depth_m.append(np.load(output))
    anyhow, sure, nearest = depth_m
    known = np.isfinite(sure)
    assert 0.1 < known.mean() < 0.999
    np.testing.assert_array_equal(nearest[known], sure[known])
    assert (nearest <= anyhow + 1e-5).all()  # and none is NaN
    assert (nearest[~known] < anyhow[~known]).any()


def video_of(scene, count):
    """Return frames of the scene, with noise; of every four, the last two are blurred by motion."""
    coded = np.load(scene.coded_npy)
    moved = ndimage.uniform_filter1d(coded, 5, axis=1)
    noise = np.random.default_rng(2).normal(0, 0.01, (count, *coded.shape))
    frames = [(moved if number % 4 > 1 else coded) for number in range(count)] + noise
    return np.clip(frames, 0, 1).astype(np.float32)


@pytest.mark.parametrize("motion", [False, True])
def test_look_ahead_estimates_with_frames_before_and_after(scene, tmp_path, capsys, motion):
    """Several blocks of frames, each with its own depth and motion, as the library has them."""
    frames = video_of(scene, 12)
    (tmp_path / "pan").mkdir()
    for number, frame in enumerate(frames):
        np.save(tmp_path / "pan" / f"{number:02}.npy", frame)
    options = (*(FEW if motion else ()), "--temporal-frames", 1, "--look-ahead", "--json")
    arguments = ("--bank", scene.bank, tmp_path / "pan", "-o", tmp_path / "depth", *options)
    result = call(capsys, "depth", *arguments)
    assert (result.status, result.err) == (0, "")
    assert len(json.loads(result.out)) == len(frames)
    model = new_model(
        "motion" if motion else "bank", bank=load_bank(scene.bank), motion=FEW_MOTIONS
    )
    estimator = DepthEstimator(model, DepthConfig(temporal_frames=1))
    for number, estimate in enumerate(estimate_video(estimator, frames)):
        written = tmp_path / "depth" / f"{number:02}.npy"
        np.testing.assert_array_equal(np.load(written), estimate.depth_m)
        np.testing.assert_array_equal(
            np.load(written.with_suffix(".confidence.npy")), estimate.confidence
        )
        np.testing.assert_array_equal(
            np.load(written.with_suffix(".std_dev.npy")), estimate.std_dev_m
        )
        if motion:
            np.testing.assert_array_equal(
                np.load(written.with_suffix(".motion.npy")), estimate.values("motion")
            )
    # Not what the past alone says, of which the first frame has none.
    first = DepthEstimator(model, DepthConfig(temporal_frames=1)).estimate(frames[0]).depth_m
    assert not np.array_equal(np.load(tmp_path / "depth" / "00.npy"), first, equal_nan=True)


def test_look_ahead_in_a_video(scene, tmp_path, capsys):
    video = tmp_path / "pan.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"MJPG"), 10, (WIDTH, HEIGHT))
    for frame in video_of(scene, 3):
        writer.write(np.rint(255 * frame[..., ::-1]).astype(np.uint8))
    writer.release()
    arguments = ("--bank", scene.bank, video, "--temporal-frames", 2, "-o", tmp_path / "depth")
    arguments += ("--confidence-threshold", 0)  # the video is compressed
    result = call(capsys, "depth", *arguments, "--look-ahead")
    assert (result.status, result.err) == (0, "")
    assert [line.partition(":")[0] for line in result.out.splitlines()] == [
        str(tmp_path / "depth" / f"pan_{number:06}.npy") for number in range(3)
    ]


@pytest.mark.parametrize("look_ahead", [(), ("--look-ahead",)])
def test_every_folder_is_a_video_of_its_own(scene, tmp_path, capsys, look_ahead):
    """What a first one has shown does not count in a second one."""
    frames = video_of(scene, 4)
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    for number, frame in enumerate(frames):
        np.save(tmp_path / "ab"[number // 2] / f"{number}.npy", frame)
    memory = ("--bank", scene.bank, "--temporal-frames", 3, *look_ahead)
    both = (tmp_path / "a", tmp_path / "b", "-o", tmp_path / "both")
    assert call(capsys, "depth", *memory, *both).status == 0
    assert call(capsys, "depth", *memory, tmp_path / "b", "-o", tmp_path / "one").status == 0
    for name in names(tmp_path / "one"):
        one, other = np.load(tmp_path / "one" / name), np.load(tmp_path / "both" / name)
        np.testing.assert_array_equal(one, other)
    # Frames that are given one by one are one video.
    given = [tmp_path / "ab"[number // 2] / f"{number}.npy" for number in range(4)]
    assert call(capsys, "depth", *memory, *given, "-o", tmp_path / "all").status == 0
    one, other = (np.load(tmp_path / folder / "2.npy") for folder in ("one", "all"))
    assert not np.array_equal(one, other, equal_nan=True)


def test_look_ahead_names_a_bad_frame_and_finishes_those_before_it(scene, tmp_path, capsys):
    arguments = ("--bank", scene.bank, "--temporal-frames", 1, "--look-ahead", "-o")
    folder = tmp_path / "frames"
    folder.mkdir()
    shutil.copy(scene.coded_npy, folder / "a.npy")
    (folder / "b.npy").write_text("no array")
    result = call(capsys, "depth", *arguments, tmp_path / "depth", folder)
    assert result.status == 1
    assert f"{folder}/b.npy: truncated, or not a .npy array" in result.err
    assert names(tmp_path / "depth") == ["a.confidence.npy", "a.npy", "a.std_dev.npy"]
    np.save(folder / "b.npy", np.ones((90, 90), np.float32))
    result = call(capsys, "depth", *arguments, tmp_path / "depth", folder)
    assert result.status == 1
    assert f"not used: {folder}, frame b: video: a frame of 90x90 px after" in result.err


@pytest.mark.parametrize(
    ("options", "phrase"),
    [
        (("--look-ahead",), "--look-ahead: needs --temporal-frames too"),
        (("--motion", "--method", "two_pixel"), "--motion: not with --method two_pixel"),
        (("--exposure", 0.01), "--exposure: only with --angular-velocity"),
        (
            ("--angular-velocity", 0, 1, 0),
            "needs --motion or --method motion, --camera, --exposure",
        ),
        (("--angular-velocity", 0, 1, 0, "--motion"), "--angular-velocity: needs --camera, --exp"),
        (
            (
                *("--angular-velocity", 0, 1, 0, "--exposure", 0.01, "--motion", "--camera", "c"),
                *("--look-ahead", "--temporal-frames", 1),
            ),
            "--look-ahead: not with --angular-velocity",
        ),
    ],
)
def test_options_that_do_not_go_together(scene, tmp_path, capsys, options, phrase):
    arguments = ("--bank", scene.bank, scene.coded_npy, "-o", tmp_path / "depth.npy")
    wrong_usage(call(capsys, "depth", *arguments, *options), "depth", phrase)
    assert everything(tmp_path) == {}


@pytest.mark.parametrize("more", [("--look-ahead", "--temporal-frames", 2), ()])
def test_a_frame_of_another_size_is_left_out_of_a_folder(scene, tmp_path, capsys, more):
    folder = tmp_path / "frames"
    folder.mkdir()
    for number, frame in enumerate(video_of(scene, 3)):
        np.save(folder / f"{number}.npy", frame)
    np.save(folder / "1b.npy", np.load(folder / "1.npy")[:-32])
    result = call(capsys, "depth", "--bank", scene.bank, *more, folder, "-o", tmp_path / "out")
    assert result.status == 1
    assert "frame 1b" in result.err
    depths = {name for name in names(tmp_path / "out") if re.fullmatch(r"\d\.npy", name)}
    assert depths == {"0.npy", "1.npy", "2.npy"}


@pytest.mark.parametrize("command", ["depth", "deblur"])
def test_a_coloured_picture_is_left_out_of_a_folder_of_mosaics(scene, tmp_path, capsys, command):
    folder = tmp_path / "frames"
    folder.mkdir()
    coded = np.load(scene.coded_npy)
    for name in ("0", "2"):
        mosaic = np.rint(65535 * mosaic_from_colour(coded, "rggb")).astype(np.uint16)
        cv2.imwrite(str(folder / f"{name}.png"), mosaic)
    cv2.imwrite(str(folder / "1.png"), np.rint(65535 * coded).astype(np.uint16))
    more = ("--depth", "auto", "--method", "inverse") if command == "deblur" else ()
    options = ("--bank", scene.bank, "--camera", scene.camera, "--bayer", "rggb", *more)
    result = call(capsys, command, *options, folder, "-o", tmp_path / "out")
    assert result.status == 1
    assert "frame 1: mosaic: expected a grey frame" in result.err
    assert len([name for name in names(tmp_path / "out") if name.partition(".")[0] == "2"]) > 0


@pytest.mark.parametrize("command", ["depth", "deblur"])
def test_mosaics_of_colour_filters(scene, tmp_path, capsys, command):
    coded = np.load(scene.coded_npy)
    mosaic = np.rint(4095 * mosaic_from_colour(coded, "gbrg")).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "mosaic.png"), mosaic)
    model = ("--bank", scene.bank, "--camera", scene.camera)
    raw = ("--bayer", "gbrg", "--bits", "12")
    more = ("--depth", "auto", "--method", "inverse") if command == "deblur" else ()
    output = tmp_path / ("sharp.png" if command == "deblur" else "depth.npy")
    result = call(capsys, command, *model, *more, tmp_path / "mosaic.png", "-o", output, *raw)
    assert (result.status, result.err) == (0, "")
    if command == "deblur":
        sharp = cv2.imread(str(output), cv2.IMREAD_UNCHANGED)[..., ::-1].reshape(-1, 3)
        np.testing.assert_allclose(
            sharp.mean(axis=0) / 65535, coded.reshape(-1, 3).mean(axis=0), rtol=0.05
        )
    else:
        error = np.abs(np.load(output) / np.load(scene.depth_npy) - 1)
        assert np.nanmedian(error) < 0.05
    colours = tmp_path / "colours.png"
    cv2.imwrite(str(colours), np.rint(65535 * coded).astype(np.uint16))
    refused = call(capsys, command, *model, *more, colours, "-o", output, *raw)
    assert refused.status == 1
    assert f"{colours}: mosaic: expected a grey frame" in refused.err


@pytest.mark.parametrize(("given", "checked"), [("--no-check-fit", False), ("--check-fit", True)])
def test_the_check_of_fit_can_be_turned_off(scene, tmp_path, capsys, given, checked):
    model = ("--bank", scene.bank, "--camera", scene.camera, scene.coded_npy)
    result = call(capsys, "depth", *model, "-o", tmp_path / "d.npy", given, "--json")
    (summary,) = json.loads(result.out)
    assert (summary.get("health") is not None) == checked


def test_a_switch_takes_no_value(scene, tmp_path, capsys):
    model = ("--bank", scene.bank, "--camera", scene.camera, scene.coded_npy)
    result = call(capsys, "depth", *model, "-o", tmp_path / "d.npy", "--check-fit", "no")
    wrong_usage(result, "depth", "unrecognized arguments: no")
