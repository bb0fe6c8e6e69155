"""Data sheets of cameras: limits, tables, the page and its pictures."""

import cv2
import numpy as np
import pytest
from cli_scene import call_benchmarks, json_of_benchmarks
from coded_aperture_benchmarks import sheets
from coded_aperture_benchmarks.suites import datasheet

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io import read_image

GOOD = (0.01, 0.9)
WRONG = (0.06, 0.9)
SPARSE = (0.01, 0.6)
NONE = (None, 0.0)


@pytest.mark.parametrize(
    ("values", "limits_m"),
    [
        ((NONE, GOOD, GOOD, SPARSE), [2, 3]),
        ((GOOD, WRONG, GOOD, GOOD), [3, 4]),
        ((GOOD, GOOD, NONE, GOOD), [1, 2]),
        (((0.05, 0.7), (0.051, 0.7)), [1, 1]),
        ((WRONG, SPARSE, NONE), None),
    ],
)
def test_limits(values, limits_m):
    rows = [
        {"depth_m": z, "error": error, "fill": fill} for z, (error, fill) in enumerate(values, 1)
    ]
    assert datasheet.limits(rows) == limits_m


def test_pictures_are_small_files():
    noise = np.random.default_rng(0).integers(0, 255, (380, 1362, 3), np.uint8)
    data = sheets.encoded(cv2.GaussianBlur(noise, (0, 0), 1.5))
    assert data[8:12] == b"WEBP"
    assert len(data) <= 60_000


@pytest.mark.parametrize("text", [None, "# A page without the mark\n"])
def test_pages_without_a_place_for_sheets_are_refused_at_once(tmp_path, capsys, text):
    page = tmp_path / "page.md"
    if text is not None:
        page.write_text(text)
    with pytest.raises(InputError, match="expected a page with the line <!-- sheets -->"):
        sheets.check_page(page)
    result = call_benchmarks(capsys, "datasheet", "--page", page)
    assert (result.status, "page.md: expected a page" in result.err) == (1, True)


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        (("--depth-range", 3.0, 1.5), 2, "expected 0 < NEAR < FAR"),
        ((), 1, "states no range: use --depth-range"),
    ],
)
def test_cameras_need_a_range(capsys, checkout, arguments, status, reason):
    camera = checkout / "config" / "example_camera.yaml"
    result = call_benchmarks(capsys, "datasheet", "--camera", camera, *arguments)
    assert result.status == status
    assert reason in result.err


def test_limits_are_searched_on_both_sides_of_the_range(tmp_path):
    camera = datasheet.load_offer(camera_file(tmp_path)).camera
    nearer, farther = datasheet._searched(camera, 1.12, 2.4)
    assert camera.blur_size_px(nearer) == pytest.approx([1.179, 1.429, 1.679], abs=0.001)
    assert camera.focus_distance_m < nearer[0] < nearer[-1] < 1.12
    assert farther[0] > 2.4
    assert farther[-1] == pytest.approx(4.8)


def camera_file(folder):
    path = folder / "camera.yaml"
    path.write_text(
        "focal_length_px: 300\nfocus_distance_m: 1.0\nimage_width: 160\nimage_height: 120\n"
        "side: far\nmask: {name: levin}\nmask_extent_mm: 60\n"
    )
    return path


@pytest.mark.slow
def test_a_camera_gets_its_data_sheet(capsys, tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Sheets\n<!-- sheets -->\nformer ones\n")
    path = camera_file(tmp_path)
    arguments = ("--depth-range", 1.12, 2.4, "--pictures", 1, "--levels", 12, "--page", page)
    results = json_of_benchmarks(capsys, "datasheet", "--camera", path, *arguments)
    (sheet,) = results["sheets"]
    across, down = sheet["field_of_view_deg"]
    assert across == pytest.approx(2 * np.degrees(np.arctan(80 / 300)), abs=0.1)
    assert down == pytest.approx(2 * np.degrees(np.arctan(60 / 300)), abs=0.1)
    depths_m = [row["depth_m"] for row in sheet["rows"]]
    assert (len(depths_m), depths_m[0], depths_m[-1]) == (5, 1.12, 2.4)
    inner = sheet["rows"][2:]
    assert all(row["fill"] > 0.5 and row["error"] < 0.1 for row in inner)
    assert all(0 < row["temporal"] < row["rms"] for row in inner)
    assert sheet["ends_m"] == pytest.approx([1.070, 4.8], abs=0.001)
    rows = sorted(sheet["rows"] + sheet["searched"], key=lambda row: row["depth_m"])
    assert sheet["limits_m"] == datasheet.limits(rows)
    assert {row["temporal"] for row in sheet["searched"]} == {None}
    assert "fill rate" in datasheet.SUITE.text(results)
    text = page.read_text()
    assert text.startswith("# Sheets\n<!-- sheets -->\n\n| camera |")
    assert "former" not in text
    assert "| 1.12 m | 1.9 px |" in text
    picture = read_image(tmp_path / "images" / "sheets" / "camera.webp")
    assert picture.shape[1] > 3 * 400
