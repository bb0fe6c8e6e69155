"""The command `design`: its numbers, its files, and the page, in a real browser."""

import functools
import json
import math
import re

import cv2
import numpy as np
import pytest
import yaml
from browser import browser, values_of  # noqa: F401  a fixture
from cameras import THESIS
from cli_scene import call, everything, refused, wrong_usage
from waiting import run_python

from coded_aperture_ros.cli.design_for import wide_range
from coded_aperture_ros.cli.main import main
from coded_aperture_ros.design import design_setting
from coded_aperture_ros.design.choice import Wanted
from coded_aperture_ros.optics import Mask, camera_from_mapping, load_camera
from coded_aperture_ros.optics.camera_file import load_sensor

CONTRACT = {
    "levels", "blur_size_near_px", "blur_size_far_px", "hole_blur_near_px", "hole_blur_far_px",
    "resolution_near_m", "resolution_far_m",
}  # fmt: skip
FILES = {"design.json", "design.html", "design.png"}


def camera_file(folder, name="camera.yaml", **changes):
    path = folder / name
    values = {**THESIS, **changes}
    path.write_text(yaml.safe_dump({key: v for key, v in values.items() if v is not None}))
    return path


def numbers(capsys, *arguments):
    result = call(capsys, "design", *arguments, "--json")
    assert result.status == 0, result.err
    return json.loads(result.out)


@pytest.mark.parametrize(
    ("changes", "depth_range", "levels"),
    [
        ({"focus_distance_m": 3.0}, (6, 28), 4.9),
        ({"focus_distance_m": 35.0, "side": "near"}, (6, 28), 4.8),
        ({"focus_distance_m": 1.6, "side": "near"}, (0.83, 1.33), 14.7),
    ],
)
def test_table_of_the_thesis(tmp_path, capsys, changes, depth_range, levels):
    camera = camera_file(tmp_path, **changes)
    found = numbers(capsys, "--camera", camera, "--depth-range", *depth_range)
    assert found.keys() >= CONTRACT
    assert found["levels"] == pytest.approx(levels, abs=0.1)
    setting = design_setting(load_camera(camera), *depth_range)
    for name in CONTRACT:
        assert found[name] == getattr(setting, name)
    table = call(capsys, "design", "--camera", camera, "--depth-range", *depth_range).out
    assert re.search(rf"depth levels told apart +{setting.levels:.1f}\n", table)
    assert f"mask four_hole, 11 mm; focus at {changes['focus_distance_m']:g} m" in table
    assert everything(tmp_path).keys() == {camera.relative_to(tmp_path)}


def test_json_has_no_infinity(tmp_path, capsys):
    camera = camera_file(tmp_path)
    found = numbers(capsys, "--camera", camera, "--depth-range", 6, 1000)
    assert found["resolution_far_m"] is None
    table = call(capsys, "design", "--camera", camera, "--depth-range", 6, 1000).out
    assert re.search(r"to the next depth told apart +\d\.\d\d +none m\n", table)


def test_the_best_setting_and_its_ranges(tmp_path, capsys):
    arguments = ("--camera", camera_file(tmp_path), "--depth-range", 6, 28)
    wide = numbers(capsys, *arguments)
    assert wide["mask_range_mm"] == [5.5, 22]
    assert wide["best"]["levels"] > wide["levels"]
    ranges = ("--focus-range", 2, 5, "--mask-range", 8, 14)
    narrow = numbers(capsys, *arguments, *ranges)
    assert narrow["best"]["mask_extent_mm"] == 14
    assert 2 <= narrow["best"]["focus_distance_m"] <= 5
    assert narrow["best_on_other_side"] is None
    text = call(capsys, "design", *arguments, *ranges).out
    assert "best with the focus before the scene" in text
    assert "beyond the scene" not in text
    none = numbers(capsys, *arguments, "--largest-blur-px", 3.5)
    assert none["best"] is None
    text = call(capsys, "design", *arguments, "--largest-blur-px", 3.5).out
    assert "best: none, no focus of 1.5 to 112 m" in text


def test_a_hole_below_the_diffraction_limit_is_told(tmp_path, capsys, caplog):
    camera = camera_file(tmp_path, mask_extent_mm=9)
    arguments = ("--camera", camera, "--depth-range", 6, 28)
    (warning,) = numbers(capsys, *arguments, "--wavelength-nm", 750)["warnings"]
    assert "2.12 mm, is below the diffraction limit of 2.49 mm" in warning
    assert caplog.messages == [warning]
    # With green light, as camera files have it, it is not.
    assert numbers(capsys, *arguments)["warnings"] == []


def test_files(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    folder = tmp_path / "new" / "design"
    arguments = ("--camera", camera_file(tmp_path), "--depth-range", 6, 28)
    printed = numbers(capsys, *arguments, "--output", folder)
    assert {path.name for path in folder.iterdir()} == FILES
    written = json.loads((folder / "design.json").read_text())
    curves = written.pop("curves")
    assert written == printed
    assert len(curves["focus_m"]) == len(curves["levels"]) == len(curves["hole_blur_mean_px"])
    assert (folder / "design.png").read_bytes().startswith(b"\x89PNG")
    again = call(capsys, "design", *arguments, "--output", folder)
    assert again.out.endswith("open design.html in a browser\n")


def test_without_matplotlib_the_page_has_the_graphs(tmp_path, capsys, caplog, monkeypatch):
    monkeypatch.setattr("coded_aperture_ros.design.figures.find_spec", lambda name: None)
    arguments = ("--camera", camera_file(tmp_path), "--depth-range", 6, 28)
    result = call(capsys, "design", *arguments, "--output", tmp_path / "design")
    assert result.status == 0
    (warning,) = caplog.messages
    assert "no design.png, which needs matplotlib" in warning
    assert {path.name for path in (tmp_path / "design").iterdir()} == FILES - {"design.png"}


@pytest.mark.parametrize(
    ("changes", "arguments", "phrase"),
    [
        ({}, (28, 6), "depth range 28 to 6 m: expected two increasing distances"),
        ({}, (6, 6), "expected two increasing"),
        ({}, (-1, 6), "expected two increasing"),
        ({}, ("nan", 6), "expected two increasing"),
        ({}, (6, "inf"), "it has to end somewhere"),
        ({}, (2, 28), "the focus at 3 m lies inside the depth range 2 to 28 m"),
        ({}, (1, 2), "set side: near or move the focus"),
        ({"side": "near"}, (6, 28), "set side: far or move the focus"),
        ({"mask": {"name": "levine"}}, (6, 28), "did you mean levin"),
        ({"mask_extent_mm": -11}, (6, 28), "mask_extent_mm: -11 is out of range"),
        ({}, (6, 28, "--focus-range", 7, 20), "lies within the depth range"),
        ({}, (6, 28, "--focus-range", 5, 2), "focus range 5 to 2 m: expected two increasing"),
        ({}, (6, 28, "--focus-range", 0.01, 2), "focus range 0.01 to 2 m"),
        ({}, (6, 28, "--mask-range", -2, 2), "mask sizes -2 to 2 mm"),
    ],
)
def test_what_makes_no_sense_is_one_line(tmp_path, capsys, changes, arguments, phrase):
    camera = camera_file(tmp_path, **changes)
    before = everything(tmp_path)
    result = call(
        capsys,
        *("design", "--camera", camera, "--output", tmp_path / "new"),
        *("--depth-range", *arguments),
    )
    refused(result, camera, phrase)
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (("--depth-range", 6, 28), "required: --for or --camera with --depth-range"),
        (("--camera", "c.yaml"), "required: --for or --camera with --depth-range"),
        (("--camera", "c.yaml", "--depth-range", 6), "expected 2 arguments"),
        (("--camera", "c.yaml", "--depth-range", 6, "x"), "invalid float value: 'x'"),
        (
            ("--camera", "c.yaml", "--depth-range", 6, 28, "--resolution-px", -1),
            "-1.0 is out of range",
        ),
        (
            ("--camera", "c.yaml", "--depth-range", 6, 28, "--smallest-blur-px", 30),
            "--smallest-blur-px: 30 px is not less than largest-blur-px",
        ),
    ],
)
def test_wrong_usage(capsys, arguments, phrase):
    wrong_usage(call(capsys, "design", *arguments), "design", phrase)


@pytest.mark.parametrize(
    ("output", "phrase"),
    [
        ("file", "is not a folder"),
        ("file/new", "is not a folder"),
        ("/proc/design", "cannot write /proc/design"),
    ],
)
def test_a_folder_that_cannot_be_written(tmp_path, capsys, monkeypatch, output, phrase):
    camera = camera_file(tmp_path)
    (tmp_path / "file").write_text("")
    before = everything(tmp_path)
    arguments = ("--camera", camera, "--depth-range", 6, 28, "--output", tmp_path / output)
    refused(call(capsys, "design", *arguments), output, phrase)
    assert everything(tmp_path) == before


def test_nothing_is_half_written(tmp_path, capsys, monkeypatch):
    """The last of the three files fails, and what was there before stays as it was."""
    pytest.importorskip("matplotlib")
    folder = tmp_path / "design"
    folder.mkdir()
    (folder / "design.json").write_text("old")

    def draw_design(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("coded_aperture_ros.cli.design.draw_design", draw_design)
    arguments = ("--camera", camera_file(tmp_path), "--depth-range", 6, 28, "--output", folder)
    refused(call(capsys, "design", *arguments), "design.png", "No space left")
    assert {path.name: path.read_text() for path in folder.iterdir()} == {"design.json": "old"}


@pytest.mark.parametrize("draws", [True, False])
def test_it_loads_matplotlib_only_to_draw(tmp_path, draws):
    """Most of the time of the whole program would be that import."""
    pytest.importorskip("matplotlib")
    code = (
        "import sys\n"
        "from coded_aperture_ros.cli.main import main\n"
        "print(main(sys.argv[1:]), 'matplotlib' in sys.modules, file=sys.stderr)\n"
    )
    arguments = ["design", "--camera", camera_file(tmp_path), "--depth-range", 6, 28]
    arguments += ["--output", tmp_path / "design"] if draws else []
    result = run_python("-c", code, *map(str, arguments), check=True)
    assert result.stderr.split() == ["0", str(draws)]


# ---- the page ----


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Return the function that makes the page of a camera, once for each."""

    @functools.cache
    def make(changes=()):
        folder = tmp_path_factory.mktemp("page")
        camera = camera_file(folder, **json.loads(changes or "{}"))
        arguments = ["--camera", camera, "--depth-range", 6, 28, "--output", folder]
        assert main(["design", *map(str, arguments)]) == 0
        return folder / "design.html"

    return lambda **changes: make(json.dumps(changes))


PINHOLE = {"focal_length_mm": None, "pixel_pitch_um": None, "focal_length_px": 2716.0}


def assert_equal_to_python(values, camera, near_m, far_m):
    setting = design_setting(camera, near_m, far_m)
    assert values.keys() >= CONTRACT
    for name, value in values.items():
        expected = getattr(setting, name)
        if expected is None:
            assert math.isnan(value)
        else:
            assert value == pytest.approx(expected, rel=1e-9), name


@pytest.mark.parametrize(
    ("changes", "focus", "extent", "near", "far"),
    [
        ({}, 3.0, 11.0, 6.0, 28.0),
        ({}, 35.0, 11.0, 6.0, 28.0),
        ({}, 1.6, 14.5, 0.83, 1.33),
        ({"lens_mask_distance_mm": 30}, 0.7, 5.0, 0.83, 900.0),
        ({"lens_mask_distance_mm": -30}, 3.0, 20.0, 3.5, 4.0),
        (PINHOLE, 5.0, 11.0, 6.0, 28.0),
        ({"mask": {"name": "levin"}}, 3.0, 11.0, 6.0, 28.0),
    ],
)
def test_the_page_computes_what_python_does(browser, page, changes, focus, extent, near, far):  # noqa: F811
    path = page(**changes)
    address = f"{path.as_uri()}#focus={focus}&extent={extent}&near={near}&far={far}"
    values, message = values_of(browser.page_after_scripts(address))
    side = "far" if focus <= near else "near"
    start = camera_from_mapping({k: v for k, v in {**THESIS, **changes}.items() if v is not None})
    camera = start.refocused(focus)
    camera = type(camera)(**{**vars(camera), "mask_extent_mm": extent, "side": side})
    assert_equal_to_python(values, camera, near, far)
    assert f"(side: {side})" in message or "diffraction limit" in message


def test_the_page_starts_from_the_camera_file(browser, page):  # noqa: F811
    path = page()
    values, message = values_of(browser.page_after_scripts(path.as_uri()))
    assert_equal_to_python(values, camera_from_mapping(THESIS), 6, 28)
    assert message.strip() == "The scene has to lie beyond the focus (side: far)."


@pytest.mark.parametrize(
    ("settings", "phrase"),
    [
        ("focus=10", "Ambiguous"),
        ("near=30", "less than the farthest"),
        ("focus=0.05", "nearer than its focal length, 50 mm"),
        ("extent=-3", "above 0"),
        ("extent=hello", "above 0"),
        ("extent=5", "diffraction limit"),
    ],
)
def test_the_page_says_what_is_wrong(browser, page, settings, phrase):  # noqa: F811
    values, message = values_of(browser.page_after_scripts(f"{page().as_uri()}#{settings}"))
    assert phrase in message
    assert math.isnan(values["levels"]) == (settings != "extent=5")


def test_sliders_fields_and_buttons_act(browser, page, tmp_path):  # noqa: F811
    """Moves the controls as a hand would, and reads what the page then shows."""
    act = """<script>
      const shown = [];
      function act(id, value) {
        element(id).value = value;
        element(id).dispatchEvent(new Event("input", { bubbles: true }));
        shown.push([state.focus, state.extent, element("focus").value, element("extent").value,
                    element("extent-slider").getAttribute("aria-valuetext"),
                    Number(element("levels").dataset.value)]);
      }
      act("extent-slider", 750);
      act("extent", 7);
      act("focus-slider", 0);
      document.querySelectorAll("button")[1].click();
      shown.push([state.focus, state.extent, Number(element("levels").dataset.value)]);
      document.querySelectorAll("button")[0].click();
      shown.push([state.focus, state.extent, Number(element("levels").dataset.value)]);
      const report = document.createElement("pre");
      report.id = "report";
      report.textContent = JSON.stringify(shown);
      document.body.append(report);
    </script>"""
    path = page()
    best = json.loads((path.parent / "design.json").read_text())["best"]
    (tmp_path / "acted.html").write_text(path.read_text().replace("</body>", act + "</body>"))
    html = browser.page_after_scripts((tmp_path / "acted.html").as_uri())
    (report,) = re.findall(r'<pre id="report">(.*?)</pre>', html)
    wide_mask, seven, close, at_best, start = json.loads(report)
    thesis = camera_from_mapping(THESIS)

    def levels(**changes):
        camera = thesis.refocused(changes.pop("focus_m", 3.0))
        return type(camera)(**{**vars(camera), **changes}).number_of_levels(6, 28)

    # Sliders are logarithmic: 5.5 mm * 4^(3/4).
    assert wide_mask[:5] == [3, 15.56, "3", "15.56", "15.6 mm"]
    assert wide_mask[5] == pytest.approx(levels(mask_extent_mm=15.56))
    assert seven[:5] == [3, 7, "3", "7", "7.00 mm"]
    assert seven[5] == pytest.approx(levels(mask_extent_mm=7.0))
    assert close[:2] == [1.5, 7]
    assert close[5] == pytest.approx(levels(mask_extent_mm=7.0, focus_m=1.5))
    assert at_best == pytest.approx([best["focus_distance_m"], 22, best["levels"]])
    assert start == pytest.approx([3, 11, levels()])


def test_the_page_needs_nothing_else(page):
    text = page().read_text()
    assert not re.findall(r"(?:https?:)?//[a-z]+\.[a-z]", text)
    assert not re.findall(r"<link|<img|<iframe|src=|@import|fetch\(|XMLHttpRequest", text)
    assert '<meta name="viewport" content="width=device-width' in text
    for identifier in re.findall(r'<input [^>]*id="(\w+)"[^>]*type="number"', text):
        assert f'<label for="{identifier}">' in text


def test_a_mask_file_cannot_break_the_page(browser, page, tmp_path_factory):  # noqa: F811
    name = "<b>&amp; '\"’.png"
    source = tmp_path_factory.mktemp("mask") / name
    source.write_bytes(cv2.imencode(".png", np.diag([255, 255, 255]).astype(np.uint8))[1])
    path = page(mask={"file": str(source)})
    html = browser.page_after_scripts(path.as_uri())
    assert "&lt;b&gt;&amp;amp; '\"’.png" in html
    assert values_of(html)[0]["levels"] == pytest.approx(4.9126, abs=1e-4)


REFERENCE = "config/cameras/cmount_25mm_f1.4.yaml"


def small_reference(checkout, folder, name="mine.yaml"):
    """Camera file of a reference camera with small frames, which take less time."""
    entries = yaml.safe_load((checkout / REFERENCE).read_text())
    del entries["reference"]
    path = folder / name
    path.write_text(yaml.safe_dump(entries | {"image_width": 320, "image_height": 240}))
    return path


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (("--for", 1, 2, "--camera", "c.yaml"), "--for: not with --camera"),
        (("--for", 1, 2, "--mask-range", 1, 2), "--for: not with --mask-range"),
        (("--for", 1, 2, "--resolution-px", 2), "--resolution-px: not with --for"),
        (("--lux", 5, "--camera", "c.yaml", "--depth-range", 1, 2), "--lux: only with --for"),
        (("c.yaml", "--camera", "c.yaml", "--depth-range", 1, 2), "CAMERA: only with --for"),
        (("--for", 1), "expected 2 arguments"),
        (("--for", 1, 2, "--rate-hz", 0), "--rate-hz"),
        (("--for", 1, 2, "--view-deg", 200), "--view-deg"),
        (("--binning", 2, "--camera", "c.yaml", "--depth-range", 1, 2), "--binning: only with"),
        (("--for", 1, 2, "--binning"), "--binning"),
        (("--for", 1, 2, "--no-reference", "--binning", 0), "--binning"),
        (("--for", 1, 2, "--no-reference", "--binning", 2, 65), "--binning"),
        (("--for", 1, 2, "--no-reference", "--binning", 1.5), "--binning"),
    ],
)
def test_wrong_usage_of_the_choice(capsys, arguments, phrase):
    wrong_usage(call(capsys, "design", *arguments), "design", phrase)


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (("--for", 2, 1), "expected two increasing distances"),
        (("--for", 1, 2, "--no-reference"), "no camera to choose from"),
        (("--for", 1, 2, "missing.yaml"), "missing.yaml"),
        (("--for", 1, 2, "--masks", "levinn"), "did you mean levin?"),
        (("--for", 0.001, 0.002), "not beyond the focal length"),
        (("--for", 1, 2, "--plot", "figure.jpg"), ".png"),
    ],
)
def test_what_cannot_be_chosen(tmp_path, capsys, monkeypatch, arguments, phrase):
    monkeypatch.chdir(tmp_path)
    result = call(capsys, "design", *arguments)
    assert result.status == 1
    assert phrase in result.err
    assert "Traceback" not in result.err
    assert everything(tmp_path) == {}


def test_a_camera_file_is_not_overwritten_by_what_is_chosen(tmp_path, capsys, checkout):
    path = small_reference(checkout, tmp_path)
    before = path.read_text()
    result = call(capsys, "design", "--for", 1, 2, path, "--no-reference", "-o", tmp_path)
    assert result.status == 1
    assert path.read_text() == before


def test_a_binning_does_not_take_the_name_of_another_camera_file(tmp_path, capsys, checkout):
    files = [small_reference(checkout, tmp_path, f"mine{end}.yaml") for end in ("", "_binning2")]
    asked = ("--for", 1, 2, *files, "--no-reference", "-o", tmp_path / "chosen")
    result = call(capsys, "design", *asked, "--binning", 2)
    assert result.status == 1
    assert "mine_binning2.yaml: two camera files have this name" in result.err
    assert not (tmp_path / "chosen").exists()


def test_a_range_wider_than_those_confirmed_is_warned_of():
    assert wide_range(Wanted(0.5, 1.5)) == []
    assert "1 : 5 is a wide range" in wide_range(Wanted(0.4, 2.0))[0]


@pytest.mark.slow
def test_a_camera_is_chosen_with_table_figure_and_file(tmp_path, capsys, checkout):
    pytest.importorskip("matplotlib")
    path = small_reference(checkout, tmp_path)
    np.save(tmp_path / "mask.npy", np.array(Mask.named("four_hole").transmission))
    masks = ("--masks", tmp_path / "mask.npy")
    asked = ("--for", 1.5, 3.5, path, "--no-reference", "--jobs", 1, "--view-deg", 30, *masks)
    asked += ("--binning", 8, 4)
    files = ("--plot", tmp_path / "plot.png", "--output", tmp_path / "chosen", "--parents")
    result = call(capsys, "design", *asked, *files)
    assert (result.status, result.err) == (0, "")
    assert re.search(r"mine +320 x 240 +1 x +1.50 to 3.50 m ", result.out)
    assert re.search(r"mine, binning 8 +160 x 120 +0.25 x +[\d.]+ to ", result.out)
    assert "field of view 9.9 of 30 degrees" in result.out  # small frames show less
    assert cv2.imread(str(tmp_path / "plot.png")).shape[1] > 600
    row, coarse = json.loads((tmp_path / "chosen" / "design.json").read_text())["cameras"]
    assert row["range_m"] == [1.5, 3.5]
    assert all(one["error"] < 0.03 and one["right"] > 0.8 for one in row["distances"])
    chosen = load_camera(tmp_path / "chosen" / "mine.yaml")
    assert (chosen.mask, chosen.mask.name) == (Mask.named("four_hole"), "mask.npy")
    assert chosen.focus_distance_m == row["focus_distance_m"]
    assert chosen.mask_extent_mm == pytest.approx(row["mask_extent_mm"], abs=0.01)
    assert chosen.blur_range_px(1.5, 3.5)[1] <= 12.1
    binned = tmp_path / "chosen" / "mine_binning8.yaml"
    assert load_camera(binned).mask_extent_mm == pytest.approx(coarse["mask_extent_mm"], abs=0.01)
    assert (load_camera(binned).image_width, load_sensor(binned).binning) == (160, 8)
    assert load_sensor(tmp_path / "chosen" / "mine.yaml").binning == 4
