"""Printable holders: closed surfaces, measures, the right way round, and `mask print -o x.stl`."""

import io
import json

import cv2
import numpy as np
import pytest
import yaml
from cameras import THESIS
from cli_scene import call, everything, refused, wrong_usage

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.holder import HolderConfig, holder_mesh, mask_holder, printable_cells
from coded_aperture_ros.design.openings import mask_openings
from coded_aperture_ros.design.solid import stl
from coded_aperture_ros.optics import MASK_NAMES, Mask

trimesh = pytest.importorskip("trimesh")

EXTENT_MM = 12.0
LENS_MM = 33.0
# Of those with names, what has a closed part that hangs on nothing.
LOOSE = ("annulus", "four_wide")
PX_PER_MM = 20


def loaded(mask, extent_mm, lens_mm, config=None, **kind):
    """The holder as another program reads it from the STL file."""
    config = config or HolderConfig()
    holder = mask_holder(mask, extent_mm, lens_mm, config, **kind)
    data = stl(holder_mesh(holder, mask, extent_mm, config), "test")
    return holder, trimesh.load(io.BytesIO(data), file_type="stl")


def assert_printable(mesh):
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0


def floor_of(mesh):
    """What stands on the bed, drawn as seen from the lens: x right and y up; 1 is closed."""
    side = 2 * round(mesh.extents[0] * PX_PER_MM / 2) + 2
    picture = np.zeros((side, side), np.uint8)
    on_bed = mesh.triangles[(mesh.triangles[:, :, 2] == 0).all(axis=1)][:, :, :2]
    corners = (on_bed * [1, -1] * PX_PER_MM + side / 2 - 0.5) * 16
    for triangle in np.rint(corners).astype(np.int32):
        cv2.fillConvexPoly(picture, triangle, 1, shift=4)
    return picture


@pytest.mark.parametrize("kind", [{}, {"cap": True}])
@pytest.mark.parametrize("name", MASK_NAMES)
def test_a_holder_is_closed_and_has_the_measures_asked_for(name, kind):
    mask = Mask.named(name)
    config = HolderConfig(fit_mm=0.3, depth_mm=4.0, floor_mm=1.0, margin_mm=1.5)
    holder, mesh = loaded(mask, EXTENT_MM, LENS_MM, config, **kind)
    assert_printable(mesh)
    pocket_mm = LENS_MM + 0.3 if kind else LENS_MM - 0.3 - 2 * 1.2
    outer_mm = pocket_mm + 2.4 if kind else LENS_MM + 4
    assert mesh.extents == pytest.approx([outer_mm, outer_mm, 5.0], abs=0.05)
    assert mesh.extents[0] == pytest.approx(outer_mm, abs=1e-5)
    assert mesh.bounds[0] == pytest.approx([-outer_mm / 2, -outer_mm / 2, 0], abs=1e-5)
    assert holder.piece_mm == pytest.approx(pocket_mm - 0.3)
    # One round opening, the circle around what is open and the margin; the piece lies around it.
    assert mesh.euler_number == 0
    radii = np.hypot(*mesh.vertices[:, :2].T)
    assert 2 * radii.min() == pytest.approx(holder.opening_mm, abs=1e-5)
    reach = {"levin": 1.185, "zhou": 1.185, "disc": 1.0, "annulus": 1.0, "two_hole": 1.027}
    opening_mm = EXTENT_MM * reach.get(name, 2**0.5) + 1.5
    assert holder.opening_mm == pytest.approx(opening_mm, abs=0.03)
    volume = (
        np.pi / 4 * ((outer_mm**2 - opening_mm**2) * 1.0 + (holder.wall_mm**2 - pocket_mm**2) * 4.0)
    )
    assert mesh.volume == pytest.approx(volume, rel=2e-3)


@pytest.mark.parametrize("kind", [{}, {"cap": True}])
@pytest.mark.parametrize("name", [name for name in MASK_NAMES if name not in LOOSE])
def test_a_printed_mask_is_closed_and_has_the_openings_of_the_mask(name, kind):
    mask = Mask.named(name)
    _, mesh = loaded(mask, EXTENT_MM, LENS_MM, print_openings=True, **kind)
    assert_printable(mesh)
    assert mesh.euler_number == 2 - 2 * mask_openings(mask).count
    floor = floor_of(mesh)
    middle = len(floor) // 2
    half = round(EXTENT_MM / 2 * PX_PER_MM)
    window = floor[middle - half : middle + half, middle - half : middle + half]
    expected = cv2.resize(mask.transmission, window.shape, interpolation=cv2.INTER_NEAREST) < 0.5
    # What is closed stays so, but for the lines of the drawing; bridges close more (mura has 36).
    assert not (window < cv2.erode(expected.astype(np.uint8), np.ones((3, 3)))).any()
    bridges = np.mean(cv2.erode(window, np.ones((3, 3))) > expected)
    assert bridges < (0.06 if name == "mura" else 0.02)


@pytest.mark.parametrize("seed", range(8))
def test_any_mask_of_cells_is_closed(seed):
    random = np.random.default_rng(seed)
    cells = random.random(random.integers(2, 9, 2)) < random.uniform(0.2, 0.6)
    cells[0, 0] = True
    extent_mm = random.uniform(8, 30)
    lens_mm = 1.42 * extent_mm + random.uniform(6, 20)
    mask = Mask("random", cells.astype(np.float32))
    _, mesh = loaded(mask, extent_mm, lens_mm, print_openings=True, cap=bool(seed % 2))
    assert_printable(mesh)


@pytest.mark.parametrize(
    ("config", "lens_mm"),
    [
        (HolderConfig(rim_mm=0.0), 25.0),
        (HolderConfig(wall_mm=3.0, margin_mm=0.0), 25.0),
        (HolderConfig(fit_mm=0.0, depth_mm=0.5, floor_mm=0.2), 25.0),
        (HolderConfig(nozzle_mm=0.25, wall_mm=0.5, rim_mm=0.5), 19.0),
        (HolderConfig(depth_mm=30.0, rim_mm=20.0), 180.0),
    ],
)
def test_other_options(config, lens_mm):
    mask = Mask.named("three_wide")
    for print_openings in (False, True):
        holder, mesh = loaded(mask, 10.0, lens_mm, config, print_openings=print_openings)
        assert_printable(mesh)
        assert mesh.extents[0] == pytest.approx(holder.outer_mm, abs=1e-4)
        assert mesh.extents[2] == pytest.approx(config.floor_mm + config.depth_mm, abs=1e-5)
        rim_mm = config.rim_mm or -config.fit_mm / 2
        assert holder.outer_mm == pytest.approx(lens_mm + 2 * rim_mm)


def test_seen_from_the_lens_the_mask_is_as_stored_and_the_notch_is_up():
    """Open cells at the upper left and in the middle of the right side; see the printed page."""
    mask = Mask.from_rows(["100", "001", "000"])
    _, mesh = loaded(mask, 15.0, LENS_MM, print_openings=True)
    floor = floor_of(mesh)
    middle = len(floor) // 2
    count, _, _, middles = cv2.connectedComponentsWithStats(1 - floor)
    around = floor.shape[0] / 2 - 0.5
    found = {tuple(np.round((one - around) / PX_PER_MM).astype(int).tolist()) for one in middles}
    assert {(-5, -5), (5, 0)} <= found
    edge = np.hypot(*mesh.vertices[:, :2].T)
    rim = mesh.vertices[edge > LENS_MM / 2]
    angles = np.degrees(np.arctan2(rim[:, 1], rim[:, 0]))
    radii = np.hypot(rim[:, 0], rim[:, 1])
    notched = np.abs(radii - radii.max()) > 1e-3
    assert notched.any()
    assert np.abs(angles[notched] - 90).max() < 6
    assert radii[notched].min() == pytest.approx(radii.max() - 1.05, abs=0.01)
    assert floor[middle, 2] == 1 and floor[2, middle] == 0  # closed on the left, not at the top
    assert count >= 4  # the floor, around it, and two openings


@pytest.mark.parametrize("nozzle_mm", [0.2, 0.4])
@pytest.mark.parametrize("fineness", [1, 20])
def test_openings_that_touch_at_a_corner_are_apart_by_a_bridge_of_two_lines(fineness, nozzle_mm):
    cells = np.zeros((5, 5), bool)
    cells[1, 1] = cells[2, 2] = cells[3, 1] = True
    stored = np.kron(cells.astype(np.float32), np.ones((fineness, fineness), np.float32))
    found = printable_cells(Mask("corner", stored), 10.0, nozzle_mm)
    # The ways past the corner 1 mm left of the middle and above it, on the two diagonals.
    along_mm = np.linspace(-1.5, 1.5, 1501)

    def is_closed(x_mm, y_mm):
        rows = np.searchsorted(-found.y_mm, -y_mm) - 1
        return found.closed[rows, np.searchsorted(found.x_mm, x_mm) - 1]

    width_mm = is_closed(along_mm - 1, 1 - along_mm).mean() * 3 * 2**0.5
    assert width_mm > 2 * nozzle_mm - 0.02
    # Not wider than it must be, to whole cells of a mask that is stored finely.
    assert width_mm < 2 * nozzle_mm + (0.02 if fineness == 1 else 0.29)
    assert is_closed(along_mm - 1, along_mm + 1).all()


def test_a_middle_that_corners_hold_is_held_by_bridges():
    mask = Mask.from_rows(["00000", "00100", "01010", "00100", "00000"])
    assert mask_openings(mask).loose_parts == 1
    _, mesh = loaded(mask, 10.0, 30.0, print_openings=True)
    assert_printable(mesh)
    assert mesh.euler_number == 2 - 2 * mask_openings(mask).count


@pytest.mark.parametrize(
    ("name", "extent_mm", "config", "phrase"),
    [
        ("annulus", 18.0, HolderConfig(), "one closed part hangs on nothing: print the holder al"),
        ("four_wide", 12.0, HolderConfig(), "one closed part hangs on nothing"),
        ("levin", 8.0, HolderConfig(), "narrowest opening of the mask: 0.73 mm, less than the"),
        ("mura", 12.0, HolderConfig(nozzle_mm=0.5), "narrowest opening of the mask: 0.92 mm"),
        ("zhou", 8.0, HolderConfig(), "narrowest bar of the mask: 0.73 mm"),
        ("levin", 26.0, HolderConfig(), "grid of the mask: 36.8 mm across; a holder for 33 mm"),
        ("levin", 12.0, HolderConfig(wall_mm=9.0), "has room for 12.2 mm: use a smaller mask, mar"),
        ("levin", 12.0, HolderConfig(wall_mm=0.7), "wall of 0.7 mm: a nozzle of 0.4 mm makes 0.8"),
        ("levin", 12.0, HolderConfig(rim_mm=0.7), "rim of 0.7 mm: a nozzle of 0.4 mm makes 0.8"),
    ],
)
def test_masks_that_cannot_be_printed(name, extent_mm, config, phrase):
    mask = Mask.named(name)
    with pytest.raises(InputError, match=phrase):
        holder_mesh(
            mask_holder(mask, extent_mm, LENS_MM, config, print_openings=True),
            mask,
            extent_mm,
            config,
        )


@pytest.mark.parametrize("lens_mm", [0.0, -1.0, np.nan, np.inf, 250.0])
def test_lenses_that_there_are_not(lens_mm):
    with pytest.raises(InputError, match="lens diameter: expected more than 0 and at most 200 mm"):
        mask_holder(Mask.named("levin"), 9.0, lens_mm)


def test_finer_nozzles_print_smaller_masks():
    fine = HolderConfig(nozzle_mm=0.25)
    _, mesh = loaded(Mask.named("levin"), 6.0, LENS_MM, fine, print_openings=True)
    assert_printable(mesh)


def test_fine_pictures_of_masks_make_small_files():
    cells = np.kron(Mask.named("levin").transmission, np.ones((25, 25), np.float32))
    _, mesh = loaded(Mask("fine.png", cells), EXTENT_MM, LENS_MM, print_openings=True)
    assert_printable(mesh)
    assert len(mesh.faces) < 80_000
    exact = loaded(Mask.named("levin"), EXTENT_MM, LENS_MM, print_openings=True)[1]
    assert mesh.volume == pytest.approx(exact.volume, rel=5e-3)


# ---- the command ----


def test_the_page_has_the_piece_that_the_holder_takes(tmp_path, capsys):
    arguments = ("mask", "print", "levin", "--extent-mm", 9.6, "--lens-mm", 26.4, "--fit-mm", 0.3)
    page = json.loads(call(capsys, *arguments, "-o", tmp_path / "mask.pdf", "--json").out)
    result = call(capsys, *arguments, "-o", tmp_path / "holder.stl", "--json")
    holder = json.loads(result.out)["holder"]
    assert result.err == ""
    assert page["holder"] is None
    assert page["outer_mm"] == pytest.approx(26.4 - 0.3 - 2.4 - 0.3)
    assert holder["pocket_mm"] - page["outer_mm"] == pytest.approx(0.3)
    assert holder["outer_mm"] == pytest.approx(30.4)
    data = (tmp_path / "holder.stl").read_bytes()
    assert not data.startswith(b"solid")
    assert len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
    assert b"mask levin, 9.6 mm" in data[:80]
    assert_printable(trimesh.load(tmp_path / "holder.stl"))


def test_command_prints_the_mask_of_a_camera_file(tmp_path, capsys, caplog):
    camera = tmp_path / "camera.yaml"
    camera.write_text(yaml.safe_dump(THESIS))
    output = tmp_path / "new" / "mask.stl"
    arguments = ("mask", "print", "--camera", camera, "--lens-mm", 55, "--cap", "--print-openings")
    result = call(capsys, *arguments, "-o", output, "--parents", "--label", "50 mm")
    assert (result.status, result.err) == (0, "")
    assert result.out == (
        f"{output}: holder of 57.6 mm, 3.8 mm high, with the openings of mask four_hole, 11 mm; "
        "print it with the floor on the bed, without supports; its open side faces the lens, with "
        "the notch up\n"
    )
    mesh = trimesh.load(output)
    assert_printable(mesh)
    assert mesh.extents == pytest.approx([57.6, 57.6, 3.8], abs=0.05)
    assert mesh.euler_number == 2 - 2 * 4
    caplog.clear()
    call(capsys, *arguments, "-o", output, "--floor-mm", 5)
    assert any("narrows openings of 2.59 mm by 2.0" in message for message in caplog.messages)
    caplog.clear()
    thick = ("--floor-mm", 5, "--margin-mm", 1)
    call(capsys, *arguments[:-1], "-o", output, *thick)
    (message,) = (message for message in caplog.messages if "shades" in message)
    margin_mm = message.split("--margin-mm ")[1].split()[0]
    caplog.clear()
    call(capsys, *arguments[:-1], "-o", output, *thick[:-1], margin_mm)
    assert not any("shades" in message for message in caplog.messages)


@pytest.mark.parametrize(
    ("distance_mm", "extent_mm", "told"),
    [
        (0, 8, ""),
        (10, 4.9, ""),
        (10, 8, "passes the mask 2.3 mm beside its middle, and the pupil of 11.4 mm cuts off op"),
        (-10, 8, "or use a mask of at most 4.9 mm"),
        (30, 8, "bring the mask nearer to the lens's iris"),
    ],
)
def test_masks_far_from_the_pupil(tmp_path, capsys, caplog, distance_mm, extent_mm, told):
    camera = {
        "focal_length_mm": 16,
        "lens_f_number": 1.4,
        "pixel_pitch_um": 9.3,
        "focus_distance_m": 0.53,
        "image_width": 640,
        "image_height": 480,
        "mask": {"name": "four_hole"},
        "mask_extent_mm": extent_mm,
        "lens_mask_distance_mm": distance_mm,
    }
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    call(capsys, "mask", "print", "--camera", tmp_path / "camera.yaml", "-o", tmp_path / "m.pdf")
    found = [message for message in caplog.messages if "lens_mask_distance_mm" in message]
    assert bool(found) == bool(told)
    assert not told or told in found[0]


def test_bridges_are_told(tmp_path, capsys, caplog):
    arguments = ("mask", "print", "levin", "--extent-mm", 12, "--lens-mm", 33, "--print-openings")
    call(capsys, *arguments, "-o", tmp_path / "mask.stl")
    (message,) = caplog.messages
    assert message.startswith("mask levin: bridges where openings touch at a corner close ")
    share = float(message.split("close ")[1].split(" %")[0])
    # Four corners, and half of each square of 0.8 mm diagonal was open.
    assert share == pytest.approx(100 * 4 * 0.16 / (43 / 121 * 144), abs=0.06)


@pytest.mark.parametrize(
    ("arguments", "phrases"),
    [
        (("--lens-mm", 12), ["openings of the mask: 10.7 mm across", "12 mm has room for 6.8 mm"]),
        (("--lens-mm", 201), ["lens diameter", "got 201"]),
        (("--lens-mm", 30, "--wall-mm", 0.5), ["wall of 0.5 mm"]),
        (("--lens-mm", 30, "--floor-mm", 20), ["--floor-mm: 20.0 is out of range"]),
        (("--lens-mm", 30, "--nozzle-mm", 0), ["--nozzle-mm: 0.0 is out of range"]),
        (("--lens-mm", 30, "--print-openings", "--nozzle-mm", 0.5), ["mask levin: narrowest ope"]),
    ],
)
def test_holders_that_cannot_be_made(tmp_path, capsys, monkeypatch, arguments, phrases):
    monkeypatch.chdir(tmp_path)
    result = call(capsys, "mask", "print", "levin", "--extent-mm", 9, *arguments, "-o", "h.stl")
    if result.status == 2:
        wrong_usage(result, "mask print", phrases[0])
    else:
        refused(result, *phrases)
    assert everything(tmp_path) == {}


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (("-o", "h.stl"), "-o h.stl: needs --lens-mm too (where the holder sits)"),
        (("-o", "h.stl", "--cap"), "--cap: only with --lens-mm"),
        (("-o", "h.pdf", "--print-openings"), "--print-openings: only with --lens-mm"),
        (("-o", "h.pdf", "--lens-mm", 30, "--print-openings"), "--print-openings: only with -o x."),
        (("-o", "h.pdf", "--floor-mm", 2), "--floor-mm: only with --lens-mm"),
        (("-o", "h.stl", "--lens-mm", 30, "--outer-mm", 20), "--outer-mm: not with --lens-mm"),
        (("-o", "h.stl", "--lens-mm", 30, "--kerf-mm", 0.1), "--kerf-mm: not with -o h.stl"),
        (("-o", "h.stl", "--lens-mm", 30, "--cap", "--rim-mm", 1), "--rim-mm: not with --cap"),
        (("-o", "h.stl", "--lens-mm", 0), "--lens-mm: 0.0 is out of range (more than 0 mm)"),
        (("-o", "h.stl", "--lens-mm", "nan"), "--lens-mm: nan is out of range"),
    ],
)
def test_wrong_usage(tmp_path, capsys, monkeypatch, arguments, phrase):
    monkeypatch.chdir(tmp_path)
    result = call(capsys, "mask", "print", "levin", "--extent-mm", 9, *arguments)
    wrong_usage(result, "mask print", phrase)
    assert everything(tmp_path) == {}
