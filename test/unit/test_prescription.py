"""The PSFs of a lens from its prescription."""

import numpy as np
import pytest
import yaml
from cli_scene import call

from coded_aperture_ros.optics import load_camera

# A double Gauss of 50 mm, f/2 (US patent 2,673,491, scaled).
DOUBLE_GAUSS = """# radius thickness index Abbe diameter
29.475  3.76  1.67  47.1 25.2
84.83   0.12  1     0    25.2
19.275  4.025 1.67  47.1 23
40.77   3.275 1.699 30.1 23
12.75   5.705 1     0    18
0       4.5   1     0    17.1 stop
-14.495 1.18  1.603 38.0 17
40.77   6.065 1.658 57.3 20
-20.385 0.19  1     0    20
437.065 3.22  1.717 48.0 20
-39.73  38.98 1     0    20
"""
CAMERA = {
    "focal_length_mm": 50.34,
    "pixel_pitch_um": 55.8,
    "focus_distance_m": 0.9,
    "image_width": 480,
    "image_height": 360,
    "mask": {"name": "levin"},
    "mask_extent_mm": 12,
    "wavelength_nm": 540,
}


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
    (tmp_path / "lens.txt").write_text(DOUBLE_GAUSS)
    return tmp_path


def traced(capsys, lens="lens.txt", status=0):
    found = call(
        capsys,
        *("calibrate", "trace", lens, "--camera", "camera.yaml"),
        *("--depth-range", "1", "4", "-o", "traced.yaml"),
    )
    assert found.status == status, found.err
    return found


def test_the_traced_camera_has_the_blur_of_the_lens(files, capsys):
    pytest.importorskip("optiland")
    said = traced(capsys).out
    assert "focal length 50.344 mm" in said
    camera = load_camera("traced.yaml")
    # By ray tracing of another program: widths of 15 mm on the axis, and towards the corner.
    assert camera.mask_extent_mm * 15 / 12 == pytest.approx(21.8, rel=0.01)
    scale = 15 / 12
    for depth_m, axis_px, field_px in ((1.5, 9.31, 8.14), (2.5, 14.88, 13.68), (4.0, 18.01, 16.79)):
        size_px = float(camera.blur_size_px(depth_m))
        for share, true_px in ((0.0, axis_px), (0.7, field_px)):
            # Across the field, where rays of the mask's edge come out.
            tangent = np.array([0.0, share * camera.wavefront.corner])
            edge = np.array([[-1.0, 1.0], [0.0, 0.0]])
            rays, _ = camera.wavefront.trace(edge, size_px, camera.blur_per_dioptre_px, tangent)
            assert np.ptp(rays[0]) * scale == pytest.approx(true_px, abs=0.9)
    assert camera.wavefront.transmitted_share(camera.mask, [0.0, 0.3156]) < 0.85


def zemax_of(table):
    """Write a table as a Zemax file would have it, with glasses by their numbers."""
    lines = ["MODE SEQ", "UNIT MM", "ENPD 20", "FTYP 0 0 1 1 0 0 0", "XFLN 0", "YFLN 0"]
    lines += ["WAVM 1 0.54 1", "PWAV 1", "SURF 0", "  TYPE STANDARD", "  CURV 0", "  DISZ INFINITY"]
    rows = [line.split() for line in table.splitlines() if not line.startswith("#")]
    for number, (radius, thickness, index, abbe, diameter, *stop) in enumerate(rows, 1):
        curvature = 1 / float(radius) if float(radius) else 0.0
        lines += [f"SURF {number}", *(["  STOP"] if stop else []), "  TYPE STANDARD"]
        lines += [f"  CURV {curvature} 0 0 0 0", f"  DISZ {thickness}"]
        if index != "1":
            lines.append(f"  GLAS ___BLANK 1 0 {index} {abbe} 0 0 0 0 0 0")
        lines.append(f"  DIAM {float(diameter) / 2} 1 0 0 1")
    lines += [
        f"SURF {len(rows) + 1}",
        "  TYPE STANDARD",
        "  CURV 0",
        "  DISZ 0",
        "  DIAM 20 0 0 0 1",
    ]
    return "\n".join(lines) + "\n"


def test_a_zemax_file_says_the_same_as_a_table(files, capsys):
    pytest.importorskip("optiland")
    (files / "lens.zmx").write_text(zemax_of(DOUBLE_GAUSS))
    traced(capsys)
    of_table = load_camera("traced.yaml")
    traced(capsys, "lens.zmx")
    found = load_camera("traced.yaml")
    # Glasses of two numbers are not quite the same in both.
    assert found.mask_extent_mm == pytest.approx(of_table.mask_extent_mm, rel=1e-3)
    assert found.wavefront.rims == pytest.approx(of_table.wavefront.rims, abs=0.02)
    assert found.wavefront.coefficients == pytest.approx(of_table.wavefront.coefficients, abs=0.01)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (DOUBLE_GAUSS.replace(" stop", ""), "no surface is the stop"),
        (DOUBLE_GAUSS.replace("84.83", "wide"), "line 3: expected radius"),
        (DOUBLE_GAUSS.replace("29.475", "-29.475"), "makes no image"),
    ],
)
def test_what_is_no_lens_is_refused_in_one_line(files, capsys, text, said):
    pytest.importorskip("optiland")
    (files / "lens.txt").write_text(text)
    found = traced(capsys, status=1)
    assert said in found.err and found.err.count("\n") == 1
    assert not (files / "traced.yaml").exists()


def test_lines_of_a_table_are_read_with_commas_and_remarks(files):
    from coded_aperture_ros.calibration.prescription.lens import _rows

    (files / "lens.txt").write_text("# a lens\n10, 2, 1.5, 60, 8 # front\n\n-10 9 1 0 8 stop\n")
    rows = list(_rows(files / "lens.txt"))
    assert rows == [(10, 2, 1.5, 60, 8, False), (-10, 9, 1, 0, 8, True)]


def test_the_camera_file_must_say_the_pitch(files, capsys):
    named = {**CAMERA, "focal_length_px": 950.0}
    del named["focal_length_mm"], named["pixel_pitch_um"]
    (files / "camera.yaml").write_text(yaml.safe_dump(named))
    assert "pixel_pitch_um" in traced(capsys, status=1).err
