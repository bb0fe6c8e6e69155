"""What ordinary frames say of a camera: a turned mask, covered cells, another focus."""

import json

import cv2
import numpy as np
import pytest
import yaml
from cli_scene import call, texture

from coded_aperture_ros.calibration.service.focus import fit_focus
from coded_aperture_ros.calibration.service.mask import fit_mask, turned
from coded_aperture_ros.calibration.service.tracks import Tracks, track_points
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera, Mask, load_camera, render_psf

# An asymmetric mask, so that a cell is not taken for that on the other side.
MASK = Mask.named("veeraraghavan")
CAMERA = Camera(500.0, 1.0, 256, 256, MASK, 36.0)
SIZES_PX = (5.0, 7.5, 9.0, 11.5, 14.0)
LARGEST_PX = 15.0


def frames_through(mask, count=12):
    random, frames = np.random.default_rng(1), []
    for number in range(count):
        sharp = texture(256, 256, number).astype(np.float32)
        psf = render_psf(mask, SIZES_PX[number % len(SIZES_PX)])
        coded = cv2.filter2D(sharp, -1, psf[::-1, ::-1])
        coded += 0.001 * random.standard_normal(coded.shape, dtype=np.float32)
        frames.append(coded.clip(0, 1))
    return frames


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [0.0, 3.0, -2.0])
def test_a_turned_mask_is_found(degrees):
    found = fit_mask(CAMERA, frames_through(turned(MASK, degrees)), LARGEST_PX, iter)
    assert found.turned_deg == pytest.approx(degrees, abs=0.7)
    assert found.std_deg < 1
    assert not found.covered.any()


@pytest.mark.slow
def test_a_covered_cell_is_found_where_it_is():
    cells = np.array(MASK.transmission)
    row, column = np.argwhere(cells > 0)[3]
    cells[row, column] = 0.1
    found = fit_mask(CAMERA, frames_through(Mask("dirty", cells)), LARGEST_PX, iter)
    assert np.argwhere(found.covered).tolist() == [[row, column]]
    assert found.passed[row, column] < 0.6
    assert abs(found.turned_deg) < 0.7
    assert found.mask(MASK).transmission[row, column] < 0.6


def test_too_few_windows_are_refused():
    with pytest.raises(InputError, match="are too few to tell"):
        fit_mask(CAMERA, frames_through(MASK, 1), LARGEST_PX, iter)


def drive(shift, depth_m, forward_m, frames=12, noise=0.0):
    """Points seen from a camera that moves ahead, their inverse depths by blur, off by a shift."""
    random = np.random.default_rng(3)
    count = len(depth_m)
    rays = random.uniform(-0.25, 0.25, (count, 2))
    points = np.column_stack([rays, np.ones(count)]) * depth_m[:, None]
    places = []
    for number in range(frames):
        turn = cv2.Rodrigues(np.array([0.001, 0.004, 0.002]) * number)[0]
        way = np.array([0.01 * number, 0.0, -forward_m * number / (frames - 1)])
        seen = points @ turn.T + way
        places.append(seen[:, :2] / seen[:, 2:] + 0.2 / 900 * random.standard_normal((count, 2)))
    places[0] = rays
    inverse = 1 / depth_m + shift
    error = np.full(count, max(noise, 0.004))
    return (
        Tracks(0, np.zeros((count, 2), int), np.array(places)),
        (inverse + noise * random.standard_normal(count)),
        error,
    )


def test_another_focus_is_found_from_a_drive_past_things():
    depth_m = np.random.default_rng(0).uniform(1.2, 4.0, 150)
    found = fit_focus([drive(0.03, depth_m, 0.6, noise=0.004)], 900.0)
    assert found.dioptres == pytest.approx(0.03, abs=3 * found.std)
    assert found.std < 0.01
    assert found.depth_m == pytest.approx(np.median(depth_m), rel=0.1)


def test_a_wall_ahead_does_not_tell_the_focus():
    depth_m = np.random.default_rng(0).uniform(2.95, 3.05, 150)
    found = fit_focus([drive(0.03, depth_m, 0.3, noise=0.02)], 900.0)
    assert found.std > 0.02


def test_points_are_followed_and_do_not_drift():
    wide = cv2.GaussianBlur(cv2.resize(texture(256, 256), (400, 200)), (0, 0), 1.5)
    frames = [np.ascontiguousarray(wide[:, 3 * i : 3 * i + 240]) for i in range(12)]
    view = Camera(500.0, 1.0, 240, 200, MASK, 36.0).intrinsics
    (found, *_) = track_points(frames, view)
    moved_px = 500 * (found.places[-1] - found.places[0])
    alive = np.isfinite(moved_px[:, 0])
    assert alive.mean() > 0.5 and len(found.places) == 12
    assert np.median(np.abs(moved_px[alive] - [-33, 0])) < 0.1


@pytest.mark.slow
def test_the_command_says_what_has_changed_and_writes_it(tmp_path, capsys, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    content = {
        "focal_length_px": 500.0,
        "focus_distance_m": 1.0,
        "image_width": 256,
        "image_height": 256,
        "mask": {"name": "veeraraghavan"},
        "mask_extent_mm": 30.0,
    }
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(content))
    (tmp_path / "frames").mkdir()
    for number, frame in enumerate(frames_through(turned(MASK, 4.0))):
        cv2.imwrite(f"frames/{number:02}.png", np.rint(65535 * frame).astype(np.uint16))
    refine = "calibrate", "refine", "frames", "--camera", "camera.yaml"
    result = call(capsys, *refine, "-o", "refined.yaml", "--json")
    assert result.status == 0, result.err
    summary = json.loads(result.out)
    assert summary["turned_deg"] == pytest.approx(4, abs=0.8)
    assert summary["changed"] == [
        f"the mask is turned clockwise by {summary['turned_deg']:.1f} degrees"
    ]
    assert "focus: " in caplog.text  # every frame shows something else
    refined = load_camera("refined.yaml")
    assert refined.focus_distance_m == 1.0
    difference = refined.mask.transmission - turned(MASK, summary["turned_deg"]).transmission
    assert np.abs(difference).mean() < 0.02
    refused = call(capsys, *refine, "-o", "camera.yaml")
    assert refused.status == 1 and "camera.yaml" in refused.err
