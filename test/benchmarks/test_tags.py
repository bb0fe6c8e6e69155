"""`python -m coded_aperture_benchmarks tags`: cards, what is read of them, and over what range."""

import dataclasses
import sys

import cv2
import numpy as np
import pytest
from cli_scene import call_benchmarks, json_of_benchmarks
from coded_aperture_benchmarks.datasets.tag_cards import QR, TAG, Card, card_scene, modules_of
from coded_aperture_benchmarks.metrics.codes import Code, CodeReader, code_of, distance_error
from coded_aperture_benchmarks.suites import tags
from coded_aperture_benchmarks.suites.tags_tables import MIDDLE, part_edges_m, part_of, range_of

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io import read_image
from coded_aperture_ros.optics import Mask

pytest.importorskip("numba", reason="cards before a random wall need numba")
if not hasattr(getattr(cv2, "aruco", None), "ArucoDetector"):
    pytest.skip("tags need OpenCV 4.7 or newer", allow_module_level=True)

LENS = tags.Lens("levin")
CAMERA = LENS.coded()
CARD = Card(TAG, "12", 32.0, (200.0, 100.0), 2.0, 0.2)


@pytest.fixture(scope="module")
def reader():
    """Return what reads tags and QR codes."""
    pytest.importorskip("zxingcpp", reason="QR codes need zxing-cpp")
    return CodeReader()


@pytest.mark.parametrize("module_px", [3.0, 4.0])
def test_every_card_of_a_sharp_frame_is_read_where_it_is(reader, module_px):
    scene = card_scene(1, module_px)
    codes = reader.read(scene.seen_by(CAMERA).all_in_focus())
    kinds = [card.kind for card in scene.cards]
    assert kinds.count(TAG) == kinds.count(QR) == {4.0: 6, 3.0: 10}[module_px]
    errors = []
    for card in scene.cards:
        code = code_of(card, codes)
        assert code is not None, card
        if card.kind == TAG:
            off = code.corners_px - card.corners_px()
            assert np.abs(off.mean(axis=0)).max() < 0.25
            # OpenCV's corners are least exact where a tag is hardly turned.
            error = distance_error(card, code, CAMERA)
            assert error < (0.01 if abs(card.angle) > 0.05 else 0.02), card
            errors.append(error)
        else:  # zxing-cpp rounds corners to pixels
            np.testing.assert_allclose(code.corners_px, card.corners_px(), atol=2.5)
    assert np.median(errors) < 0.005
    assert reader.read(np.full((480, 640), 0.5, np.float32)) == []


def test_encoded_frames_are_read_as_pictures_are(reader):
    frame = np.full((120, 120), 0.6, np.float32)
    modules = modules_of(TAG, "3")
    frame[20:100, 20:100] = np.where(np.kron(modules, np.ones((8, 8))) > 0, 0.6, 0.04)
    card = dataclasses.replace(CARD, says="3", side_px=64.0, middle_px=(59.5, 59.5), angle=0.0)
    soft = cv2.GaussianBlur(frame, (0, 0), 1.5)
    sides = []
    for each in (reader, CodeReader("srgb")):
        corners = code_of(card, each.read(soft)).corners_px
        sides.append(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())
    assert sides[0] == pytest.approx(64, abs=0.3)
    assert sides[1] < sides[0] - 0.3  # white is wider where grey is brighter


def test_a_code_has_to_say_the_right_thing_in_the_right_place():
    found = Code(TAG, "12", CARD.corners_px() + 3)
    assert code_of(CARD, [found]) is found
    assert code_of(CARD, [dataclasses.replace(found, says="13")]) is None
    assert code_of(CARD, [dataclasses.replace(found, kind=QR)]) is None
    assert code_of(CARD, [dataclasses.replace(found, corners_px=CARD.corners_px() + 8)]) is None


def test_the_distance_of_a_tag_goes_by_its_size():
    corners = CARD.corners_px()
    assert distance_error(CARD, Code(TAG, "12", corners), CAMERA) < 1e-4
    smaller = corners.mean(axis=0) + (corners - corners.mean(axis=0)) / 1.1
    assert distance_error(CARD, Code(TAG, "12", smaller), CAMERA) == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("camera", [CAMERA, LENS.ordinary(0.5)])
def test_cards_and_wall_have_the_blur_of_their_distance(camera):
    scene = card_scene(0, 4.0)
    blur = scene.seen_by(camera).blur_size_px()
    for card in scene.cards:
        right, down = np.rint(card.middle_px).astype(int)
        expected = camera.blur_size_px(card.distance_m)
        assert blur[down, right] == pytest.approx(expected, abs=1e-3), card
    nearest, farthest = camera.blur_size_px([4.0, 4.3])
    wall = blur[blur > camera.blur_size_px(3.99)]
    assert nearest - 1e-3 <= wall.min() <= wall.max() <= farthest + 1e-3
    assert wall.size > 0.2 * blur.size


def test_distances_are_spread_evenly_in_dioptres():
    scenes = [card_scene(seed, 4.0).cards for seed in range(3)]
    for kind in (TAG, QR):
        for cards in scenes:
            inverse = np.sort([1 / card.distance_m for card in cards if card.kind == kind])
            strata = np.floor((inverse - 0.25) / 1.75 * len(inverse))
            np.testing.assert_array_equal(strata, np.arange(len(inverse)))
    assert scenes[0] == card_scene(0, 4.0).cards != scenes[1]


@pytest.mark.parametrize("mask", ["levin", "zhou"])
def test_the_ordinary_lens_lets_as_much_light_pass(mask):
    lens = tags.Lens(mask)
    coded = lens.coded()
    for stop in (1.0, 0.1):
        ordinary = lens.ordinary(stop)
        light = [
            camera.mask.open_fraction * camera.mask_extent_mm**2 for camera in (ordinary, coded)
        ]
        assert light[0] / light[1] == pytest.approx(stop)
        ends = ordinary.blur_size_px([0.5, 4.0])
        assert ends[0] == pytest.approx(-ends[1])  # in focus in the middle
    assert coded.blur_size_px([0.5, 4.0]) == pytest.approx([2, 16])
    wide = tags.Lens(mask, MIDDLE, 2.0).coded()
    assert wide.blur_size_px([0.5, 4.0]) == pytest.approx([-14, 14])
    assert ordinary.mask.open_fraction == Mask.named("disc").open_fraction


def test_the_range_is_the_longest_run_of_parts():
    assert range_of([1.0, 0.5, 0.4, 1.0, 1.0]) == (0, 2)  # the nearer one of two
    assert range_of([1.0, 0.4, 0.5, 0.6, 1.0]) == (2, 5)
    assert range_of([0.0, 0.2, 0.1, 0.0, 0.49]) == (0, 0)
    assert range_of([1.0, None, 1.0, 1.0, 1.0]) == (2, 5)
    assert part_edges_m() == pytest.approx([0.5, 0.606, 0.769, 1.053, 1.667, 4.0], abs=1e-3)
    assert [part_of(distance) for distance in (0.5, 0.6, 1.0, 1.7, 4.0)] == [0, 0, 2, 4, 4]


@pytest.mark.slow
def test_codes_are_read_from_every_frame(capsys, reader, tmp_path):
    pytest.importorskip("matplotlib")
    arguments = ("tags", "--scenes", 1, "--jobs", 1, "--electrons", 9000)
    results = json_of_benchmarks(capsys, *arguments, "--output", tmp_path)
    rows = {row["given"]: row for row in results["rows"]}
    assert results["cards"] == 12
    assert rows["sharp"]["read"] == rows["ordinary 1"]["read"] == 1
    assert rows["sharp"]["dioptres"] == pytest.approx(1.75)
    assert rows["coded"]["read"] < rows["sparse, true depth"]["read"]
    assert rows["sharp"]["distance_error"] < 0.01
    for row in rows.values():
        assert row["read"] == pytest.approx((row["read_tag"] + row["read_qr"]) / 2, abs=0.002)
    (goal,) = results["goal"]
    assert goal["ratio"] == pytest.approx(rows[goal["ours"]]["dioptres"] / 1.75, abs=0.002)
    assert list(results["blur_at_ends_px"].values()) == [4.71, 3.33, 2.35, 1.49]
    assert results["same_depth_of_field"] == "ordinary 0.5"
    assert {path.name for path in tmp_path.iterdir()} == {
        "codes_9000.jpg", "read.png", "results.json",
    }  # fmt: skip
    assert read_image(tmp_path / "codes_9000.jpg").std() > 0.05
    table = tags.SUITE.text(results)
    assert "9000 electrons make white" in table
    assert "no more than a module: ordinary, 50 % of the light" in table


def test_libraries_that_are_missing_are_one_line(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "zxingcpp", None)
    result = call_benchmarks(capsys, "tags")
    assert (result.status, result.out, result.err.count("\n")) == (1, "", 1)
    assert "pip install zxing-cpp" in result.err
    monkeypatch.delattr(cv2.aruco, "ArucoDetector")
    with pytest.raises(InputError, match=r"OpenCV 4\.7 or newer"):
        CodeReader.check()


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (("--module", "1"), "2 to 6 px"),
        (("--module", "nan"), "2 to 6 px"),
        (("--electrons", "0"), "at least 1"),
        (("--mask", "magic"), "levin"),
        (("--focus", "middle", "--mask", "zhou"), "half a turn"),
        (("--aperture", "3"), "--aperture"),
    ],
)
def test_wrong_usage_is_refused_with_a_hint(capsys, arguments, hint):
    result = call_benchmarks(capsys, "tags", *arguments)
    assert (result.status, result.out) == (2, "")
    assert hint in result.err


@pytest.mark.slow
def test_focused_in_the_middle_all_is_read(capsys, reader):
    arguments = ("tags", "--scenes", 1, "--jobs", 1, "--electrons", 9000)
    results = json_of_benchmarks(capsys, *arguments, "--focus", "middle")
    assert results["focus"] == "middle"
    assert results["goal"][0]["ratio"] == 1
