"""The entrance pupil bounds every mask: in camera files, searches, trials, prints and advice."""

import dataclasses
import json
import math

import numpy as np
import pytest
import yaml
from cli_scene import call

from coded_aperture_ros.calibration.planes.field import measured_beyond_pupil
from coded_aperture_ros.checkup import camera_findings
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design import best_settings, default_extent_range_mm
from coded_aperture_ros.design.trials import trials_of
from coded_aperture_ros.optics import MASK_NAMES, Mask, load_camera
from coded_aperture_ros.optics.camera_file import camera_from_mapping, load_sensor
from coded_aperture_ros.optics.pupil import largest_extent_mm, openings_diameter
from coded_aperture_ros.simulation.exposure import Exposure

ENTRIES = {
    "focal_length_mm": 25.0,
    "lens_f_number": 1.4,
    "pixel_pitch_um": 13.8,
    "focus_distance_m": 0.5,
    "image_width": 1024,
    "image_height": 750,
    "mask": {"name": "four_hole"},
    "mask_extent_mm": 12.6,
}
SENSOR = {
    "width": 4096,
    "height": 3000,
    "pixel_pitch_um": 3.45,
    "binning": 4,
    "full_well": 10500.0,
    "read_noise": 2.4,
    "quantum_efficiency": 0.6,
}


def camera(**changes):
    return camera_from_mapping({**ENTRIES, **changes})


@pytest.mark.parametrize("name", MASK_NAMES)
def test_openings_of_the_largest_mask_lie_within_the_pupil(name):
    mask = Mask.named(name)
    # By sampling: the farthest point of any cell that is open.
    cells = mask.transmission > 0.5
    rows, columns = np.nonzero(cells)
    corners = [
        math.hypot(row + down - cells.shape[0] / 2, column + right - cells.shape[1] / 2)
        for row, column in zip(rows, columns, strict=True)
        for down in (0, 1)
        for right in (0, 1)
    ]
    sampled = 2 * max(corners) / max(cells.shape)
    tolerance = 0.02 if name in ("disc", "annulus") else 1e-6  # their rims are round
    assert openings_diameter(mask) == pytest.approx(sampled, abs=tolerance)
    largest_mm = largest_extent_mm(mask, 25 / 1.4)
    assert 0.98 * 25 / 1.4 <= largest_mm * openings_diameter(mask) <= 25 / 1.4


@pytest.mark.parametrize(
    ("focal_mm", "f_number", "name", "largest_mm"),
    [
        (25, 1.4, "four_hole", 12.6),  # pupil / sqrt(2), open in its corners
        (25, 1.4, "levin", 14.9),
        (25, 1.4, "disc", 17.8),
        (6, 1.2, "four_hole", 3.53),
        (50, 1.4, "four_hole", 25.2),
    ],
)
def test_largest_mask_by_hand(focal_mm, f_number, name, largest_mm):
    found = largest_extent_mm(Mask.named(name), focal_mm / f_number)
    assert found == pytest.approx(largest_mm, abs=0.11)
    assert found <= focal_mm / f_number / openings_diameter(Mask.named(name))


def test_mask_of_one_open_corner_is_bounded_by_it():
    assert openings_diameter(Mask.from_rows(["1.", ".."])) == pytest.approx(math.sqrt(2))
    assert openings_diameter(Mask.from_rows(["...", ".1.", "..."])) == pytest.approx(
        math.sqrt(2) / 3
    )
    assert openings_diameter(Mask.from_rows(["1111", "1111"])) == pytest.approx(
        math.hypot(4, 2) / 4
    )


def test_camera_files_beyond_the_pupil_are_refused_with_the_reason(tmp_path):
    assert camera().pupil_mm == pytest.approx(25 / 1.4)
    path = tmp_path / "wide.yaml"
    path.write_text(yaml.safe_dump({**ENTRIES, "mask_extent_mm": 16.0}))
    with pytest.raises(
        InputError,
        match=r"wide.yaml: mask_extent_mm: 16 mm is too wide for the entrance pupil of 17.86 mm "
        r".*reach 1.41 times its extent: use at most 12.6 mm",
    ):
        load_camera(path)
    assert camera(mask={"name": "disc"}, mask_extent_mm=17.8).pupil_mm  # closed in its corners
    with pytest.raises(InputError, match="too wide"):
        dataclasses.replace(camera(), mask_extent_mm=20.0)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"lens_f_number": 0}, r"lens_f_number: 0 is out of range \(0.4 to 200\)"),
        ({"lens_f_number": math.nan}, "lens_f_number: nan is out of range"),
        ({"lens_f_number": "1.4"}, "lens_f_number: expected float"),
        ({"lens_f_number": True}, "lens_f_number: expected float"),
        ({"sensor": 3}, "sensor: expected width"),
        ({"sensor": {**SENSOR, "fullwell": 3}}, "sensor: unknown key"),
        ({"sensor": {**SENSOR, "binning": 0}}, "sensor: binning: 0 is out of range"),
        (
            {"sensor": {**SENSOR, "binning": 5}},
            "pixel_pitch_um: 13.8 is not the sensor's 3.45 time",
        ),
        ({"sensor": {**SENSOR, "width": 2000}}, "1024x750 is more than the sensor gives"),
    ],
)
def test_impossible_entries_are_refused(changes, reason):
    with pytest.raises(InputError, match=reason):
        camera(**changes)


def test_an_f_number_needs_a_focal_length():
    pinhole = {key: value for key, value in ENTRIES.items() if key[:5] not in ("focal", "pixel")}
    with pytest.raises(InputError, match=r"lens_f_number: .*with focal_length_mm"):
        camera_from_mapping({**pinhole, "focal_length_px": 1800.0})


def test_camera_files_without_an_f_number_are_as_before():
    old = {key: value for key, value in ENTRIES.items() if key != "lens_f_number"}
    loaded = camera_from_mapping({**old, "mask_extent_mm": 30.0})
    assert loaded.pupil_mm is None
    assert default_extent_range_mm(loaded) == (15.0, 60.0)
    same = camera_from_mapping({**old, "sensor": SENSOR})
    assert dataclasses.replace(camera(), lens_f_number=None) == same


def test_design_suggests_no_mask_beyond_the_pupil():
    small = camera(mask_extent_mm=8.0)
    without = dataclasses.replace(small, lens_f_number=None)
    assert max(one.mask_extent_mm for one in best_settings(without, 1.0, 3.0)) > 13
    for asked in (None, (4.0, 30.0)):
        found = best_settings(small, 1.0, 3.0, extent_range_mm=asked)
        assert found
        assert all(one.mask_extent_mm <= 12.6 for one in found)
    with pytest.raises(InputError, match="mask sizes: 15 mm is too wide"):
        best_settings(small, 1.0, 3.0, extent_range_mm=(15.0, 30.0))


def test_design_command_says_why(tmp_path, capsys, caplog):
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(ENTRIES))
    asked = ("design", "--camera", path, "--depth-range", 0.8, 3)
    found = json.loads(call(capsys, *asked, "--json").out)
    assert found["pupil_mm"] == pytest.approx(17.857, abs=1e-3)
    assert found["largest_mask_mm"] == 12.6
    assert found["mask_range_mm"] == [6.3, 12.6]
    assert "pupil" in call(capsys, *asked).out
    assert call(capsys, *asked, "--mask-range", 8, 40).status == 0
    assert "--mask-range: 40 mm is too wide for the entrance pupil" in caplog.text
    refused = call(capsys, *asked, "--mask-range", 20, 40)
    assert refused.status == 1
    assert "use at most 12.6 mm" in refused.err


def test_printed_masks_fit_the_pupil(tmp_path, capsys):
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(ENTRIES))
    printed = ("mask", "print", "--camera", path, "-o", tmp_path / "mask.svg")
    assert call(capsys, *printed).status == 0
    refused = call(capsys, *printed, "--extent-mm", 14)
    assert refused.status == 1
    assert "14 mm is too wide for the entrance pupil" in refused.err


def test_trials_of_other_masks_stay_within_the_pupil():
    wide = camera(mask={"name": "levin"}, mask_extent_mm=14.9)
    exposure = Exposure(300.0, 20.0, 1e5, 10.0)
    masks = [Mask.named(name) for name in ("levin", "four_hole")]
    trials = trials_of(wide, masks, (0.6, 1.5), 12, exposure, (1, 0), 0.0)
    assert [trial.camera.mask_extent_mm for trial in trials] == [14.9, 12.6]


def test_advice_of_a_wider_mask_ends_at_the_pupil():
    def remedy(**changes):
        findings = camera_findings(camera(**changes), 4.0, 6.0)
        return next(one.remedy for one in findings if one.about == "depth resolution")

    assert "takes up to 12.6 mm" in remedy(mask_extent_mm=6.0)
    assert "a lens with a larger pupil" in remedy()
    old = dataclasses.replace(camera(), lens_f_number=None)
    assert any("use a wider mask:" in one.remedy for one in camera_findings(old, 4.0, 6.0))


def test_a_measured_mask_beyond_the_pupil_is_a_contradiction():
    mask = Mask.named("four_hole")
    assert measured_beyond_pupil(mask, 12.6, 25 / 1.4) == ""
    assert measured_beyond_pupil(mask, 30.0, None) == ""
    reason = measured_beyond_pupil(mask, 14.0, 25 / 1.4)
    assert "14 mm wide" in reason
    assert "takes at most 12.6 mm: check focal_length_mm, lens_f_number" in reason


def test_electrons_of_a_lens_by_hand(tmp_path):
    """300 lux on white at f/1.4: 300 / (4 x 1.96) lux on the sensor, here through an open disc."""
    path = tmp_path / "camera.yaml"
    entries = {**ENTRIES, "mask": {"name": "disc"}, "mask_extent_mm": 17.8, "sensor": SENSOR}
    path.write_text(yaml.safe_dump({**entries, "focus_distance_m": 1e4}))
    sensor = load_sensor(path)
    exposure = Exposure.with_sensor(sensor, 3.0, 5.0)
    lux = 0.85 * 3.0 / (4 * (25 / 17.8) ** 2)
    electrons = 0.6 * lux * 1e16 * (13.8e-6) ** 2 * 5e-3
    assert exposure.electrons(load_camera(path)) == pytest.approx(electrons, rel=2e-3)
    dark, gain = exposure.noise(load_camera(path))
    assert dark == pytest.approx(
        math.hypot(4 * 2.4 / electrons, 1 / 4095 / math.sqrt(12)), rel=0.01
    )
    assert gain == pytest.approx(1 / electrons, rel=2e-3)
    # With more light the exposure is shorter.
    bright = Exposure.with_sensor(sensor, 1e5, 50.0)
    assert bright.electrons(load_camera(path)) == 16 * 10500


def test_noise_of_exposed_frames_is_as_stated():
    exposure = Exposure(30.0, 5.0, 1e6, 20.0)
    random = np.random.default_rng(1)
    dark, gain = exposure.noise(camera())
    for light in (0.1, 0.6):
        frame = exposure.exposed(np.full((300, 300), light, np.float32), camera(), random)
        assert frame.std() == pytest.approx(math.sqrt(dark**2 + gain * light), rel=0.02)
