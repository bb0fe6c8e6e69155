"""Printed masks: true scale, the right way round, and the command `mask print`."""

import json
import math
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import cv2
import numpy as np
import pytest
import yaml
from cameras import THESIS
from cli_scene import call, everything, refused, wrong_usage

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.openings import mask_outlines, narrowest_bar, recut
from coded_aperture_ros.design.sheet import mask_sheet
from coded_aperture_ros.design.sheet_files import sheet_pdf, sheet_svg
from coded_aperture_ros.optics import MASK_NAMES, Mask

SVG = "{http://www.w3.org/2000/svg}"
POINT_MM = 25.4 / 72


def area(outline):
    """Signed, of a closed outline; positive clockwise with y down."""
    x, y = np.array(outline).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


@pytest.mark.parametrize("name", MASK_NAMES)
def test_outlines_enclose_what_is_open(name):
    mask = Mask.named(name)
    outlines = mask_outlines(mask)
    assert sum(map(area, outlines)) == pytest.approx(mask.open_fraction, rel=2e-3)
    fine = 990
    grid = np.zeros((fine, fine), np.uint8)
    corners = [np.rint((np.array(o) + 0.5) * fine * 16 - 8).astype(np.int32) for o in outlines]
    cv2.fillPoly(grid, corners, 255, shift=4)
    rendered = cv2.resize(
        grid, mask.transmission.shape[::-1], interpolation=cv2.INTER_AREA
    ) / np.float32(255)
    assert np.abs(rendered - mask.transmission).mean() < 0.03


def test_openings_that_touch_at_a_corner_are_cut_one_by_one():
    outlines = mask_outlines(Mask.from_rows(["10", "01"]))
    assert sorted(map(sorted, outlines)) == [
        [(-0.5, -0.5), (-0.5, 0.0), (0.0, -0.5), (0.0, 0.0)],
        [(0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5)],
    ]
    ring = mask_outlines(Mask.from_rows(["111", "101", "111"]))
    assert sorted(map(area, ring)) == pytest.approx([-1 / 9, 1])


def test_a_mask_wider_than_high_is_centred_and_keeps_its_width():
    (outline,) = mask_outlines(Mask.from_rows(["1111", "1111"]))
    assert sorted(outline) == [(-0.5, -0.25), (-0.5, 0.25), (0.5, -0.25), (0.5, 0.25)]


def test_grey_masks_cannot_be_cut(tmp_path):
    grey = Mask("soft.png", np.tile(np.linspace(0, 1, 20, dtype=np.float32) ** 3, (20, 1)))
    with pytest.raises(InputError, match=r"mask soft.png: it has grey cells"):
        mask_outlines(grey)


@pytest.mark.parametrize(
    ("rows", "bar"),
    [
        (["1001", "0000", "0000", "0000"], 0.5),
        (["1000", "0100", "0000", "0001"], 2**0.5 / 4),  # two touch, and have no bar
        (["1000", "0100", "0000", "0000"], np.inf),
        (["1100", "1100", "0000", "0001"], 2**0.5 / 4),
        (["1111", "1111", "0000", "1111"], 0.25),
    ],
)
def test_the_narrowest_bar_does_not_depend_on_how_finely_a_mask_is_stored(rows, bar):
    mask = Mask.from_rows(rows)
    fine = Mask("fine", np.kron(mask.transmission, np.ones((7, 7), np.float32)))
    assert narrowest_bar(mask) == pytest.approx(bar)
    assert narrowest_bar(fine) == pytest.approx(bar)


def test_openings_cut_wider_and_narrower():
    square = Mask.from_rows(["000", "010", "000"])
    for change in (-0.1, 0.04):
        changed = recut(square, change)
        side = 1 / 3 + change
        # Corners of a wider opening are round, as those of a cutter's way are.
        rounded = (4 - np.pi) * (max(change, 0) / 2) ** 2
        assert changed.open_fraction == pytest.approx(side**2 - rounded, rel=0.01)
    levin = Mask.named("levin")
    assert recut(levin, 0.0).open_fraction == pytest.approx(levin.open_fraction)
    # At the grid's edge openings lose as much as elsewhere, and gain nothing.
    for change, size in ((-0.02, 0.98), (-0.0012, 0.9988), (0.02, 1.0)):
        cut = [np.array(one) for one in mask_outlines(recut(levin, change))]
        assert extent_of(cut)[0] == pytest.approx([size, size], abs=6e-4)
    # Curves stay as fine as they are printed.
    disc = Mask.named("disc")
    expected = np.pi / 4 * 0.98**2
    assert recut(disc, -0.02).open_fraction == pytest.approx(expected, rel=5e-3)
    with pytest.raises(InputError, match="13 of 13 openings are narrower than 0"):
        recut(levin, -0.3)
    with pytest.raises(InputError, match="too little to draw"):
        recut(levin, -1e-4)
    grey = Mask("grey", np.linspace(0, 1, 49).reshape(7, 7))
    with pytest.raises(InputError, match="grey cells"):
        recut(grey, -0.01)


# ---- true scale, read from the files ----


def paths_of_svg(text):
    """Return the outlines of each class of paths, in mm on paper, from the SVG alone."""
    root = ElementTree.fromstring(text)
    across, down = (float(re.fullmatch(r"([\d.]+)mm", root.get(k))[1]) for k in ("width", "height"))
    left, top, width, height = map(float, root.get("viewBox").split())
    assert (left, top) == (0, 0)
    scale = np.array([across / width, down / height])
    found = {}
    for path in root.iter(f"{SVG}path"):
        for part in path.get("d").split("M")[1:]:
            points = np.array(re.findall(r"-?[\d.]+", part), float).reshape(-1, 2)
            found.setdefault(path.get("class"), []).append(points * scale)
    return found, (across, down)


def paths_of_pdf(data):
    """The same from a PDF, whose unit is 1/72 inch and whose y goes up."""
    text = data.decode("cp1252")
    (box,) = re.findall(r"/MediaBox \[([^\]]+)\]", text)
    left, bottom, right, top = map(float, box.split())
    assert (left, bottom) == (0, 0)
    assert "cm" not in re.findall(r"[a-zA-Z*]+$", text, re.M)  # no change of scale
    found = {}
    for kind, body in re.findall(r"^% (\w+)\n(.*?)(?=^%|^BT)", text, re.M | re.S):
        for part in re.findall(r"^[-\d. ]+ m\n(?:[-\d. ]+ l\n)*", body, re.M):
            points = np.array(re.findall(r"-?[\d.]+", part), float).reshape(-1, 2)
            points = np.stack([points[:, 0], top - points[:, 1]], axis=1) * POINT_MM
            found.setdefault(kind, []).append(points)
    return found, (right * POINT_MM, top * POINT_MM)


READERS = {
    "svg": lambda sheet: paths_of_svg(sheet_svg(sheet)),
    "pdf": lambda sheet: paths_of_pdf(sheet_pdf(sheet)),
}


def extent_of(outlines):
    points = np.concatenate(outlines)
    return np.ptp(points, axis=0), (points.max(axis=0) + points.min(axis=0)) / 2


@pytest.mark.parametrize("kind", READERS)
def test_true_scale(kind):
    found, page_mm = READERS[kind](mask_sheet(Mask.named("levin"), 33.0, 60.0))
    assert page_mm == pytest.approx((210, 297), abs=1e-3)
    size_mm, centre = extent_of(found["hole"])
    assert size_mm == pytest.approx([33, 33], abs=1e-3)
    rim_mm, rim_centre = extent_of(found["rim"])
    assert rim_mm == pytest.approx([60, 60], abs=1e-3)
    assert centre == pytest.approx(rim_centre, abs=1e-3)
    assert len(found["hole"]) == 13
    smallest = min(np.ptp(outline, axis=0).min() for outline in found["hole"])
    assert smallest == pytest.approx(3, abs=1e-3)
    # All of the black is the piece less its holes.
    black = sum(abs(area(o)) for o in found["rim"]) - sum(abs(area(o)) for o in found["hole"])
    assert black == pytest.approx(np.pi * 30**2 - 43 * 3**2, rel=1e-3)
    everything_drawn = np.concatenate([points for paths in found.values() for points in paths])
    assert (everything_drawn.min(axis=0) > 5).all()
    assert (everything_drawn.max(axis=0) < np.array(page_mm) - 5).all()


@pytest.mark.parametrize("kind", READERS)
def test_rulers_have_a_tick_each_millimetre(kind):
    found, _ = READERS[kind](mask_sheet(Mask.named("levin"), 33.0))
    lines = found["ruler"]
    lengths = [np.ptp(line, axis=0) for line in lines]
    assert sum(1 for size in lengths if size == pytest.approx([100, 0], abs=2e-3)) == 1
    assert sum(1 for size in lengths if size == pytest.approx([0, 100], abs=2e-3)) == 1
    for axis in (0, 1):  # the ruler across has upright ticks, and the other way round
        ticks = sorted(
            line[0, axis]
            for line, size in zip(lines, lengths, strict=True)
            if size[axis] < 1e-6 and size[1 - axis] < 10
        )
        assert len(ticks) == 101
        assert np.diff(ticks) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("kind", READERS)
def test_the_page_shows_the_mask_as_stored(kind):
    """Open cells at the upper left and in the middle of the right side."""
    mask = Mask.from_rows(["100", "001", "000"])
    found, _ = READERS[kind](mask_sheet(mask, 30.0))
    _, centre = extent_of(found["rim"])
    middles = sorted(tuple(np.round(outline.mean(axis=0) - centre)) for outline in found["hole"])
    assert middles == [(-10, -10), (10, 0)]


def test_printed_side_to_the_sensor_gives_the_psf_as_stored():
    """Rays through an opening at the upper left of the page, which is seen from the sensor's side.

    Axes as seen from behind the camera: x right, y up. The sensor turns pictures upside down.
    """
    focal, focus, depth = 0.05, 1.0, 3.0  # beyond the focus: a positive blur size
    sensor = 1 / (1 / focal - 1 / focus)
    opening = np.array([-0.01, 0.01])  # left and up on the page
    on_sensor = opening + sensor * (opening / depth - opening / focal)
    in_image = -on_sensor  # x right, y up
    assert in_image[0] < 0 < in_image[1]  # left and up in the picture too


def test_text_of_the_page():
    sheet = mask_sheet(Mask.named("annulus"), 30.0, label="50 mm (f/1.4) \\ \x07<b>")
    svg, pdf = sheet_svg(sheet), sheet_pdf(sheet).decode("cp1252")
    text = "".join(element.text for element in ElementTree.fromstring(svg).iter(f"{SVG}text"))
    assert "50 mm (f/1.4) \\ ?<b>" in text
    assert r"(50 mm \(f/1.4\) \\ ?<b>) Tj" in pdf
    for phrase in ("Mask annulus, 30 mm", "This side faces the sensor", "both rulers must be 100"):
        assert phrase in text
        assert phrase in pdf
    assert "One closed part hangs on nothing" in text
    assert "/PrintScaling /None" in pdf


def test_the_pdf_is_whole():
    data = sheet_pdf(mask_sheet(Mask.named("zhou"), 30.0, label="Привет €"))
    assert data.startswith(b"%PDF-1.4\n")
    table = int(re.search(rb"startxref\n(\d+)\n%%EOF\n$", data)[1])
    assert data[table:].startswith(b"xref\n0 7\n")
    offsets = [int(offset) for offset in re.findall(rb"^(\d{10}) 00000 n $", data, re.M)]
    assert len(offsets) == 6
    for number, offset in enumerate(offsets, start=1):
        assert data[offset:].startswith(b"%d 0 obj\n" % number)
    length = int(re.search(rb"/Length (\d+)", data)[1])
    stream = data.index(b"stream\n") + len(b"stream\n")
    assert data[stream + length :].startswith(b"\nendstream")


@pytest.mark.skipif(shutil.which("pdftoppm") is None, reason="needs pdftoppm: poppler-utils")
def test_the_rendered_pdf_is_the_mask(tmp_path):
    """By a PDF reader that shares nothing with the writer."""
    mask = Mask.named("zhou")
    (tmp_path / "a.pdf").write_bytes(sheet_pdf(mask_sheet(mask, 55.0, 90.0)))
    subprocess.run(
        ["pdftoppm", "-r", "254", "-png", "-gray", "a.pdf", "a"], cwd=tmp_path, check=True
    )
    (picture,) = tmp_path.glob("a*.png")
    page = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)  # 10 pixels a millimetre
    assert page.shape == pytest.approx((2970, 2100), abs=1)
    top, left = 620 + 450 - 275, 1050 - 275
    window = page[top : top + 550, left : left + 550] / 255
    cells = window.reshape(11, 50, 11, 50)[:, 10:-10, :, 10:-10].mean(axis=(1, 3))
    assert cells == pytest.approx(mask.transmission, abs=0.01)


# ---- the command ----


def test_lines_for_a_laser(tmp_path, capsys):
    ezdxf = pytest.importorskip("ezdxf")
    output = tmp_path / "mask.dxf"
    cut = ("--kerf-mm", 0.5, "--outer-mm", 60, "-o", output)
    result = call(capsys, "mask", "print", "levin", "--extent-mm", 33, *cut)
    assert (result.status, result.err) == (0, "")
    drawing = ezdxf.readfile(output)
    assert drawing.units == ezdxf.units.MM
    lines: dict[str, list] = {}
    for line in drawing.modelspace().query("LWPOLYLINE"):
        assert line.closed
        lines.setdefault(line.dxf.layer, []).append(np.array(line.get_points("xy")))
    assert extent_of(lines["hole"])[0] == pytest.approx([32.5, 32.5], abs=0.05)
    assert extent_of(lines["rim"])[0] == pytest.approx([60, 60], abs=1e-3)
    smallest = min(np.ptp(outline, axis=0).min() for outline in lines["hole"])
    assert smallest == pytest.approx(2.5, abs=0.05)
    call(
        capsys,
        "mask",
        "print",
        "levin",
        "--extent-mm",
        33,
        "--kerf-mm",
        0.5,
        "-o",
        tmp_path / "m.svg",
    )
    page = (tmp_path / "m.svg").read_text()
    assert "the narrowest takes a disc of 3.00 mm" in page
    assert "Lines lie 0.25 mm within the openings" in page
    # As printed: what is up stays up.
    mask = tmp_path / "corner.npy"
    np.save(mask, np.array([[1, 0], [0, 0]]))
    call(capsys, "mask", "print", mask, "--extent-mm", 20, "-o", output)
    (hole,) = ezdxf.readfile(output).modelspace().query('LWPOLYLINE[layer=="hole"]')
    (rim,) = ezdxf.readfile(output).modelspace().query('LWPOLYLINE[layer=="rim"]')
    right, up = (np.mean(hole.get_points("xy"), 0) - np.mean(rim.get_points("xy"), 0)).tolist()
    assert right < 0 < up


@pytest.mark.parametrize("suffix", [".pdf", ".svg"])
def test_command(tmp_path, capsys, suffix):
    output = tmp_path / "new" / f"mask{suffix}"
    arguments = ("mask", "print", "levin", "--extent-mm", 26, "-o", output)
    result = call(capsys, *arguments, "--parents")
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith(f"{output}: mask levin, 26 mm, on a round piece of 41 mm; ")
    sheet = mask_sheet(Mask.named("levin"), 26)
    expected = sheet_pdf(sheet) if suffix == ".pdf" else sheet_svg(sheet).encode()
    assert output.read_bytes() == expected


def test_command_with_a_camera_file_and_json(tmp_path, capsys):
    camera = tmp_path / "camera.yaml"
    camera.write_text(yaml.safe_dump(THESIS))
    output = tmp_path / "mask.svg"
    arguments = ("mask", "print", "--camera", camera, "--outer-mm", 40, "--label", "50 mm lens")
    summary = json.loads(call(capsys, *arguments, "-o", output, "--json").out)
    assert (summary["mask"], summary["extent_mm"], summary["outer_mm"]) == ("four_hole", 11, 40)
    assert summary["smallest_hole_mm"] == pytest.approx(11 * 4 / 17)
    assert "50 mm lens" in output.read_text()
    found, _ = paths_of_svg(output.read_text())
    assert extent_of(found["hole"])[0] == pytest.approx([11, 11], abs=1e-3)
    assert extent_of(found["rim"])[0] == pytest.approx([40, 40], abs=1e-3)
    half = call(capsys, *arguments, "--extent-mm", 5.5, "-o", output, "--json")
    half = json.loads(half.out)
    airy_px, of_half_px = (each["airy_widths_px"][0] for each in (summary, half))
    assert of_half_px == pytest.approx(2 * airy_px, abs=2e-3)


def test_a_mask_from_a_file(tmp_path, capsys, caplog):
    cells = np.array([[255, 255, 255], [255, 0, 255], [255, 255, 255]], np.uint8)
    cv2.imwrite(str(tmp_path / "ring.png"), cells)
    arguments = ("mask", "print", tmp_path / "ring.png", "--extent-mm", 12)
    assert call(capsys, *arguments, "-o", tmp_path / "ring.svg").status == 0
    assert caplog.messages == [
        "mask ring.png: One closed part hangs on nothing: print on film instead, or leave thin "
        "bridges."
    ]


@pytest.mark.parametrize(
    ("arguments", "phrases"),
    [
        (("levine", "--extent-mm", 9), ["unknown mask 'levine'", "did you mean levin", "a file"]),
        (("nowhere.png", "--extent-mm", 9), ["nowhere.png"]),
        (("levin", "--extent-mm", 200), ["mask levin", "does not fit on an A4 page"]),
        (("levin", "--extent-mm", 26, "--outer-mm", 20), ["20 mm", "use at least 31.8 mm"]),
        (("--camera", "nowhere.yaml"), ["cannot read camera file nowhere.yaml"]),
    ],
)
def test_what_cannot_be_printed(tmp_path, capsys, monkeypatch, arguments, phrases):
    monkeypatch.chdir(tmp_path)
    output = ("-o", "new/mask.pdf", "--parents")
    refused(call(capsys, "mask", "print", *arguments, *output), *phrases)
    assert everything(tmp_path) == {}


@pytest.mark.parametrize(
    ("output", "phrase"),
    [
        ("mask.png", "use a name that ends in .pdf or .svg or .dxf or .stl"),
        ("folder.pdf", "it is a folder"),
        ("file/mask.pdf", "is not a folder"),
        ("/proc/mask.pdf", "cannot write /proc/mask.pdf"),
    ],
)
def test_outputs_that_cannot_be_written(tmp_path, capsys, output, phrase):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.pdf").mkdir()
    before = everything(tmp_path)
    arguments = ("mask", "print", "levin", "--extent-mm", 9, "-o", tmp_path / output)
    refused(call(capsys, *arguments), output, phrase)
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (("levin", "--extent-mm", 9, "--kerf-mm", -1, "-o", "a.pdf"), "--kerf-mm: -1.0 is out"),
        ((), "required: -o"),
        (("-o", "a.pdf"), "required: NAME|FILE or --camera"),
        (("levin", "--camera", "c.yaml", "-o", "a.pdf"), "NAME|FILE: not with --camera"),
        (("levin", "-o", "a.pdf"), "required: --extent-mm or --camera (how wide"),
        (("levin", "--extent-mm", -3, "-o", "a.pdf"), "-3.0 is out of range (more than 0 mm)"),
        (("levin", "--extent-mm", "nan", "-o", "a.pdf"), "--extent-mm: nan is out of range"),
        (
            ("levin", "--extent-mm", 9, "--outer-mm", 0, "-o", "a.pdf"),
            "--outer-mm: 0.0 is out of range (more than 0 mm)",
        ),
    ],
)
def test_wrong_usage(capsys, arguments, phrase):
    wrong_usage(call(capsys, "mask", "print", *arguments), "mask print", phrase)


def test_sheets_built_in_python_are_checked_too():
    for extent_mm in (0.0, -3.0, math.nan, math.inf):
        with pytest.raises(InputError, match="mask size: expected more than 0 mm"):
            mask_sheet(Mask.named("levin"), extent_mm)
