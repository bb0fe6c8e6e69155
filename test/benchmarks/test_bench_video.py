"""Depth of videos: the scores, the videos, and `coded_aperture bench accuracy video`."""

import json

import cv2
import numpy as np
import pytest
from cli_scene import call, call_benchmarks, texture
from coded_aperture_benchmarks.datasets.video import (
    CodedVideo,
    check_rgbd_video,
    check_video,
    load_video,
    moving_pixels,
    score_video,
)
from coded_aperture_benchmarks.datasets.walks import of_video
from coded_aperture_benchmarks.suites.video import ratios, tables_of, ways

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import SRGB, pixels_from_linear
from coded_aperture_ros.io import read_image, write_image
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation import render_coded_frame

LENGTH, HEIGHT, WIDTH = 8, 96, 128
WALL_M, BOX_M = 2.0, 1.25
BOX_ROWS = slice(30, 62)


def box_columns(frame):
    return slice(20 + 5 * frame, 52 + 5 * frame)  # at the end it has left where it began


def room(length=LENGTH):
    """Return true depths: a box that moves to the right in front of a wall."""
    depth_m = np.full((length, HEIGHT, WIDTH), WALL_M, np.float32)
    for frame in range(length):
        depth_m[frame, BOX_ROWS, box_columns(frame)] = BOX_M
    return depth_m


def camera():
    return Camera(400.0, 1.0, WIDTH, HEIGHT, Mask.named("levin"), 40.0)


def video_of(depth_m, moves=False):
    blank = [np.zeros((*depth_m.shape[1:], 3), np.float32)] * len(depth_m)
    return CodedVideo(blank, depth_m, camera(), None if moves else moving_pixels(depth_m))


def alternating(depth_m, share):
    """Return depths that are too large and too small by a share of the truth, in turns."""
    sign = np.resize([1, -1], len(depth_m))[:, None, None]
    return (depth_m * (1 + share * sign)).astype(np.float32)


def test_moving_objects_and_points_at_rest_are_found():
    depth_m = room()
    depth_m[:, 0, 0] = np.nan
    video = video_of(depth_m)
    np.testing.assert_array_equal(video.moving, depth_m == BOX_M)
    at_rest = np.ones((HEIGHT, WIDTH), bool)
    at_rest[BOX_ROWS, box_columns(0).start : box_columns(LENGTH - 1).stop] = False
    at_rest[0, 0] = False  # not known
    np.testing.assert_array_equal(video.static_points(), at_rest)
    band = video.around_moving(12)[0]
    left = box_columns(0).start
    middle = (BOX_ROWS.start + BOX_ROWS.stop) // 2
    np.testing.assert_array_equal(np.flatnonzero(band[middle, :left]), np.arange(left - 12, left))
    assert not (band & video.moving[0]).any()
    assert not band[BOX_ROWS.start - 12, left - 12]  # round corners


def test_an_object_that_never_leaves_a_pixel_is_found_by_its_changes():
    depth_m = np.full((6, 20, 20), WALL_M, np.float32)
    depth_m[:, 5:15, 5:15] = (BOX_M + 0.005 * np.arange(6))[:, None, None]
    moving = moving_pixels(depth_m)
    np.testing.assert_array_equal(moving[3], depth_m[3] < WALL_M)
    assert not moving[:, :5].any()


def test_nothing_moves_in_a_still_room():
    video = video_of(np.full((LENGTH, 20, 30), WALL_M, np.float32))
    assert not video.moving.any()
    assert not video.around_moving().any()
    score = score_video(video.depth_m, video)
    assert np.isnan(score.moving.median)
    assert score.moving.pixels == 0


def test_right_depth_has_no_error_and_no_flicker():
    video = video_of(room())
    score = score_video(video.depth_m, video)
    for part in (score.everywhere, score.moving, score.around_moving):
        assert (part.median, part.mean, part.within_10_percent, part.coverage) == (0, 0, 1, 1)
    assert (score.flicker.median, score.flicker.mean) == (0, 0)
    assert score.flicker.points == np.count_nonzero(video.static_points())
    assert (score.change.std, score.change.robust_std) == (0, 0)
    scored = LENGTH - 5
    assert score.moving.pixels == scored * 32 * 32
    assert score.everywhere.pixels == scored * HEIGHT * WIDTH


def test_depth_that_is_steadily_wrong_does_not_flicker():
    video = video_of(room())
    score = score_video(np.float32(1.2) * video.depth_m, video)
    assert score.everywhere.median == pytest.approx(0.2, rel=1e-5)
    assert score.everywhere.within_10_percent == 0
    assert score.flicker.mean == pytest.approx(0, abs=1e-6)
    assert score.change.std == pytest.approx(0, abs=1e-6)


def test_depth_that_alternates_flickers_by_as_much():
    video = video_of(room(9))  # an even number of them is scored
    score = score_video(alternating(video.depth_m, 0.03), video)
    assert score.flicker.median == pytest.approx(0.03, rel=1e-4)
    assert score.flicker.mean == pytest.approx(0.03, rel=1e-4)
    assert np.nanmax(score.unrest) == pytest.approx(0.03, rel=1e-4)
    np.testing.assert_array_equal(np.isfinite(score.unrest), video.static_points())


def test_of_a_moving_camera_the_changes_are_scored():
    # It comes nearer by 1 % in every frame; once an edge passes.
    depth_m = (WALL_M * 0.99 ** np.arange(9))[:, None, None] * np.ones((1, 4, 6))
    depth_m = depth_m.astype(np.float32)
    depth_m[7:, :, 3:] *= 0.5
    video = video_of(depth_m, moves=True)
    score = score_video(alternating(depth_m, 0.03), video)
    assert score.moving is score.around_moving is score.flicker is None
    np.testing.assert_allclose(score.unrest, 0.06, rtol=1e-4)
    # Up, down and up by 0.06; the half where the edge passes does not count just then.
    assert score.change.std == pytest.approx(np.std([0.06, -0.06, 0.06, 0.06, 0.06]), rel=1e-4)
    constant = np.float32(1.1) * depth_m
    constant[7:, :, 3:] *= 3  # beyond the edge
    assert score_video(constant, video).change.std == pytest.approx(0, abs=1e-5)


def test_changes_spread_like_the_errors():
    random = np.random.default_rng(0)
    depth_m = np.full((12, 60, 80), WALL_M, np.float32)
    noisy = depth_m * (1 + 0.01 * random.standard_normal(depth_m.shape)).astype(np.float32)
    score = score_video(noisy, video_of(depth_m, moves=True), warm_up=2)
    assert score.change.std == pytest.approx(0.01 * np.sqrt(2), rel=0.02)
    assert score.change.robust_std == pytest.approx(0.01 * np.sqrt(2), rel=0.02)
    noisy[5, 10:20] = 100  # outliers matter to one of them only
    score = score_video(noisy, video_of(depth_m, moves=True), warm_up=2)
    assert score.change.std > 0.1
    assert score.change.robust_std == pytest.approx(0.01 * np.sqrt(2), rel=0.1)


def test_frames_of_the_warm_up_do_not_count():
    video = video_of(room())
    estimated = video.depth_m.copy()
    estimated[:5] = 100
    assert score_video(estimated, video).everywhere.mean == 0
    assert score_video(estimated, video, warm_up=4).everywhere.mean > 1


def test_unknown_depths_lower_the_coverage_only():
    depth_m = room()
    depth_m[:, :10] = np.nan
    estimated = np.float32(1.05) * depth_m
    estimated[:, :10] = 7
    estimated[-1, 10:] = np.nan
    estimated[-1, -1, -1] = np.inf
    score = score_video(estimated, video_of(depth_m))
    assert score.everywhere.coverage == pytest.approx(2 / 3)
    assert score.everywhere.pixels == 3 * (HEIGHT - 10) * WIDTH
    assert score.everywhere.mean == pytest.approx(0.05, rel=1e-4)
    nothing = score_video(np.full_like(depth_m, np.nan), video_of(depth_m))
    assert nothing.everywhere.coverage == 0
    assert np.isnan([nothing.everywhere.median, nothing.flicker.median, nothing.change.std]).all()


def test_depths_that_do_not_fit_are_refused():
    video = video_of(room())
    with pytest.raises(InputError, match="shape"):
        score_video(video.depth_m[1:], video)
    with pytest.raises(InputError, match="at least 9"):
        score_video(video.depth_m, video, warm_up=7)


@pytest.fixture(scope="module")
def ray_traced(tmp_path_factory):
    """Return the folder of a static camera's video, as a ray tracer would have left it."""
    folder = tmp_path_factory.mktemp("box")
    rows = ["".join(".#"[int(cell)] for cell in row) for row in Mask.named("levin").transmission]
    seen_by = camera()
    meta = {
        "fx": seen_by.focal_length_px,
        "focus_distance_m": seen_by.focus_distance_m,
        "width": WIDTH,
        "height": HEIGHT,
        "aperture_width_m": seen_by.mask_extent_mm / 1e3,
        "masks": {"levin": rows},
        "frames": LENGTH,
    }
    (folder / "meta.json").write_text(json.dumps(meta))
    wall, box = texture(HEIGHT, WIDTH, 1), texture(HEIGHT, WIDTH, 2)
    for frame, depth_m in enumerate(room()):
        here = BOX_ROWS, box_columns(frame)
        sharp = wall.copy()
        sharp[here] = box[BOX_ROWS, box_columns(0)]
        sharp = np.repeat(sharp[..., None], 3, axis=2)
        write_image(
            folder / f"coded_levin_{frame:03d}.png", render_coded_frame(sharp, depth_m, seen_by)
        )
        write_image(folder / f"aif_{frame:03d}.png", pixels_from_linear(sharp, 8, SRGB))
        tenths = np.rint(depth_m * 1e4).astype(np.uint16)
        cv2.imwrite(str(folder / f"depth_{frame:03d}.png"), tenths)
    return folder


@pytest.fixture(scope="module")
def rgbd(tmp_path_factory):
    """Return the folder of a moving camera's video: a slanted wall, with a hole in its depth."""
    folder = tmp_path_factory.mktemp("slant")
    intrinsics = {"width": WIDTH, "height": HEIGHT, "fx": 150.0}
    (folder / "intrinsics.json").write_text(json.dumps(intrinsics))
    wide = texture(HEIGHT, WIDTH + 2 * LENGTH)
    for frame in range(LENGTH):
        picture = pixels_from_linear(wide[:, 2 * frame : 2 * frame + WIDTH], 8, SRGB)
        cv2.imwrite(str(folder / f"color_{frame:05d}.jpg"), np.repeat(picture[..., None], 3, 2))
        slant_mm = np.linspace(1000, 2500, WIDTH + 2 * LENGTH)[2 * frame : 2 * frame + WIDTH]
        depth_mm = np.repeat(slant_mm[None], HEIGHT, axis=0).round().astype(np.uint16)
        depth_mm[:5, :7] = 0
        cv2.imwrite(str(folder / f"depth_{frame:05d}.png"), depth_mm)
    return folder


def test_a_ray_traced_video_is_read(ray_traced):
    video = load_video(ray_traced, 5)
    np.testing.assert_allclose(video.depth_m, room(5), atol=1e-4)
    np.testing.assert_array_equal(video.moving, room(5) == BOX_M)
    assert [frame.shape for frame in video.frames] == [(HEIGHT, WIDTH, 3)] * 5
    assert video.camera.focal_length_px == 400


def test_an_rgbd_video_is_simulated(rgbd):
    video = load_video(rgbd, 3)
    assert video.moving is None
    assert video.static_points() is video.around_moving() is None
    assert video.depth_m.shape == (3, HEIGHT, WIDTH)
    assert np.isnan(video.depth_m[:, :5, :7]).all()
    assert np.isfinite(video.depth_m[:, 5:]).all()
    # All eight frames say how far it is to the nearest and the farthest point.
    np.testing.assert_allclose(video.camera.blur_range_px(1.0, 2.49), (4, 20), atol=0.1)
    assert video.camera.side == "far"
    assert video.camera.focal_length_px == 150
    for frame in video.frames:
        assert frame.dtype == np.float32
        assert np.isfinite(frame).all()
        assert 0 < frame.min() < frame.max() <= 0.901
    sharp = read_image(rgbd / "color_00000.jpg", SRGB)
    assert video.frames[0].std() < 0.9 * sharp.std()  # it is blurred


def test_a_video_is_walked_through(rgbd, ray_traced):
    walk = of_video(rgbd, "zhou")
    assert walk.poses is None
    assert walk.count == LENGTH
    assert walk.camera.mask.name == "zhou"
    assert walk.range_m == pytest.approx((1.0, 2.48), abs=0.01)
    views = list(walk.views)
    assert len(views) == LENGTH
    for (sharp, depth_m, coded), expected in zip(views, load_video(rgbd, 99).depth_m, strict=True):
        assert sharp.shape == coded.shape == (HEIGHT, WIDTH)
        assert coded.std() < sharp.std()
        assert abs(coded.mean() - sharp.mean()) < 0.01
        np.testing.assert_array_equal(depth_m, expected)
    check_rgbd_video(rgbd)
    with pytest.raises(InputError, match=r"no RGB-D video: expected intrinsics\.json"):
        check_rgbd_video(ray_traced)


def test_a_folder_without_video_is_named(tmp_path, ray_traced):
    with pytest.raises(InputError, match=r"meta\.json.*intrinsics\.json") as refused:
        check_video(tmp_path)
    assert str(tmp_path) in str(refused.value)
    meta = json.loads((ray_traced / "meta.json").read_text())
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    with pytest.raises(InputError, match="coded_levin_000"):
        load_video(tmp_path, 5)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("{", "JSON"),
        ("[]", "JSON object"),
        ('{"width": 8, "height": 6}', "fx"),
        ('{"width": 9, "height": 6, "fx": 10}', "9 x 6"),
        ('{"width": 8, "height": 6, "fx": 10}', "all depths are 1 m"),
    ],
)
def test_bad_intrinsics_are_named(tmp_path, text, hint):
    (tmp_path / "intrinsics.json").write_text(text)
    with pytest.raises(InputError, match="at least 2"):
        load_video(tmp_path, 5)
    for frame in range(2):
        cv2.imwrite(str(tmp_path / f"color_{frame:05d}.jpg"), np.zeros((6, 8, 3), np.uint8))
        cv2.imwrite(str(tmp_path / f"depth_{frame:05d}.png"), np.full((6, 8), 1000, np.uint16))
    with pytest.raises(InputError, match=hint) as refused:
        load_video(tmp_path, 5)
    assert str(tmp_path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_rgbd_video_without_any_depth_is_refused(tmp_path):
    (tmp_path / "intrinsics.json").write_text('{"width": 8, "height": 6, "fx": 10}')
    for frame in range(2):
        cv2.imwrite(str(tmp_path / f"color_{frame:05d}.jpg"), np.zeros((6, 8, 3), np.uint8))
        cv2.imwrite(str(tmp_path / f"depth_{frame:05d}.png"), np.zeros((6, 8), np.uint16))
    with pytest.raises(InputError, match="no pixel has a known depth"):
        load_video(tmp_path, 5)


BENCH = ("bench", "accuracy", "video")
SMALL = ("--levels", 8, "--window", 32, "--stride", 8, "--frames", LENGTH, "--jobs", 1)


def test_videos_are_scored_without_a_filter(capsys, ray_traced, rgbd):
    result = call(capsys, *BENCH, ray_traced, rgbd, *SMALL, "--temporal", "--json")
    assert (result.status, result.err) == (0, "")
    results = json.loads(result.out)
    cells = results["cells"]
    assert [(cell["camera"], cell["regularize"]) for cell in cells] == [
        *(("static", "none"), ("static", "learned")),
        *(("moving", "none"), ("moving", "learned")),
    ]
    for cell in cells:
        assert (cell["filter"], cell["frames"]) == ("none", LENGTH)
        assert cell["everywhere"]["median"] < 0.1
        assert cell["everywhere"]["coverage"] > 0.95
    static, moving = cells[1], cells[3]
    assert static["flicker"]["mean"] < 0.2
    assert static["moving"]["pixels"] == 3 * 32 * 32
    assert moving["flicker"] is moving["moving"] is moving["around_moving"] is None
    assert moving["change"]["std"] < 0.2
    ratios = results["ratios_to_raw"]
    assert [(ratio["regularize"], ratio["filter"]) for ratio in ratios] == [("learned", "none")] * 2


def test_filters_over_time_are_measured_beside_none(capsys, ray_traced):
    arguments = (*SMALL, "--noise", 0.02, "--temporal", 3, "--regularize", "none", "--json")
    result = call(capsys, *BENCH, ray_traced, *arguments)
    assert (result.status, result.err) == (0, "")
    results = json.loads(result.out)
    filters = [(cell["filter"], cell["temporal_frames"]) for cell in results["cells"]]
    assert filters == [("none", 0), ("causal", 3), ("windowed", 3)]
    causal, windowed = results["ratios_to_raw"]
    assert (causal["filter"], windowed["filter"]) == ("causal", "windowed")
    for row in (causal, windowed):
        assert row["flicker mean"] < 0.9
        assert row["mean"] < 1.1


def test_tables_and_pictures_are_written(capsys, ray_traced, tmp_path):
    pytest.importorskip("matplotlib")
    arguments = (*SMALL, "--temporal", "--regularize", "none", "--output", tmp_path)
    result = call(capsys, *BENCH, ray_traced, *arguments)
    assert (result.status, result.err) == (0, "")
    assert "flicker" in result.out
    name = ray_traced.name
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.png", "results.json"}
    picture = read_image(tmp_path / f"{name}.png")
    assert picture.shape[1] == 3 * WIDTH
    assert picture.std() > 0.05
    assert len(json.loads((tmp_path / "results.json").read_text())["cells"]) == 1


def test_all_are_compared_with_every_frame_and_patch_by_itself():
    assert list(ways(["semiglobal"], [4.0])) == [
        ("none", "none", 0.0),
        ("semiglobal", "none", 0.0),
        ("semiglobal", "causal", 4.0),
        ("semiglobal", "windowed", 4.0),
    ]
    assert len(list(ways(["none", "tv", "tv"], [2.0, 8.0]))) == 10

    def row(how, time_filter, past, median):
        error = {"median": median, "mean": 2 * median, "within_10_percent": 1.0, "coverage": 1.0}
        return {
            "video": "room",
            "camera": "moving",
            "regularize": how,
            "filter": time_filter,
            "temporal_frames": past,
            "everywhere": error,
            "flicker": None,
            "change": {"std": 0.0, "robust_std": median / 2},
            "moving": None,
            "around_moving": None,
            "seconds_per_frame": 0.1,
        }

    rows = [
        row("none", "none", 0.0, 0.5),
        row("tv", "none", 0.0, 0.2),
        row("tv", "causal", 4.0, 0.1),
        row("none", "windowed", 2.5, 0.1),
    ]
    regularized, causal, windowed = ratios(rows)
    assert (regularized["filter"], regularized["median"]) == ("none", 0.4)
    assert (causal["regularize"], causal["median"], causal["mean"]) == ("tv", 0.2, 0.2)
    assert (windowed["regularize"], windowed["change robust"]) == ("none", 0.2)
    assert causal["flicker median"] is causal["moving mean"] is None
    assert causal["change"] is None  # nothing to divide by
    text = tables_of(rows, [causal, windowed])
    assert "causal 4" in text
    assert "windowed 2.5" in text
    assert "0.20" in text


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        ((), "FOLDER"),
        (("room", "--frames", 6), "at least 7"),
        (("room", "--temporal", 0), "more than 0"),
        (("room", "--temporal", "nan"), "more than 0"),
        (("room", "--regularize", "much"), "graphcut"),
        (("room", "--noise", 2), "0 to 0.5"),
    ],
)
def test_wrong_usage_is_refused_with_a_hint(capsys, arguments, hint):
    result = call(capsys, *BENCH, *arguments)
    assert (result.status, result.out) == (2, "")
    assert hint in result.err
    assert "usage: coded_aperture bench accuracy" in result.err


def test_bad_input_is_one_line(capsys, ray_traced, tmp_path):
    for folders, hint in (((tmp_path,), "no video"), ((ray_traced, ray_traced), "this name too")):
        result = call(capsys, *BENCH, *folders)
        assert (result.status, result.out) == (1, "")
        assert hint in result.err
        assert result.err.count("\n") == 1


def test_a_video_that_is_too_short_is_refused(capsys, tmp_path, ray_traced):
    for path in ray_traced.iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "meta.json").unlink()
    meta = json.loads((ray_traced / "meta.json").read_text()) | {"frames": 4}
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    result = call(capsys, *BENCH, tmp_path, *SMALL)
    assert (result.status, result.out) == (1, "")
    assert "4 frames is too short" in result.err


def test_help_shows_examples(capsys):
    text = call(capsys, *BENCH, "--help").out
    examples = text.partition("examples:")[2]
    assert examples.count("coded_aperture bench accuracy video") >= 2
    assert max(map(len, text.splitlines())) <= 100


@pytest.mark.slow
def test_real_videos_are_read(data_dir):
    video = load_video(data_dir / "rendered" / "video", 12)
    assert video.depth_m.shape == (12, 240, 320)
    assert 0.2 < video.moving.mean() < 0.5  # a flag and a box
    assert 0.2 < video.static_points().mean() < 0.8
    room_video = load_video(data_dir / "video_livingroom1", 2)
    assert room_video.frames[1].shape == (480, 640, 3)
    smallest, largest = room_video.camera.blur_range_px(
        float(np.nanmin(room_video.depth_m)), float(np.nanmax(room_video.depth_m))
    )
    assert 3.9 < smallest < largest < 20.1


@pytest.mark.slow
def test_light_that_changes_in_a_video_is_measured(capsys, ray_traced, rgbd):
    result = call_benchmarks(capsys, "fitting", ray_traced, rgbd, "--jobs", 1, "--json")
    assert (result.status, result.err) == (0, "")
    results = json.loads(result.out)
    assert results["fitting"] == 2 * LENGTH
    assert results["changing"] == 6 * results["fitting"]
    steady = [row for row in results["rows"] if row["light"] == "as it is"]
    dimmed = [row for row in results["rows"] if row["light"] == "dimmed"]
    assert np.median([row["coverage"] for row in steady]) > 0.5
    told = "error", "coverage", "health"
    assert [dimmed[-1][name] for name in told] != [steady[-1][name] for name in told]
