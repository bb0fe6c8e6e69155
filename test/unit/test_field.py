"""Field curvature: a lens that is focused at another distance away from the image's middle."""

import dataclasses
import json
import re

import numpy as np
import pytest
import yaml
from cameras import STRAIGHT as STRAIGHT_FILE
from cli_scene import call, refused, texture, wrong_usage
from hypothesis import given
from hypothesis import strategies as st

from coded_aperture_ros.calibration.planes.field import fit_field
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import View
from coded_aperture_ros.io import read_image, write_image
from coded_aperture_ros.likelihood.bank import learn_bank, learn_bank_for_camera
from coded_aperture_ros.optics import (
    Camera,
    FieldCurvature,
    Mask,
    camera_from_mapping,
    load_camera,
    render_psf_stack,
)
from coded_aperture_ros.simulation.render import render_coded_frame

SHAPE = (192, 256)
DEPTHS_M = (1.25, 1.4, 1.6, 1.9, 2.4, 3.2)
STRAIGHT = Camera(500.0, 0.9, 256, 192, Mask.named("levin"), 36.0)
# In the corner the plane in focus is 0.98 m away.
BENT = dataclasses.replace(STRAIGHT, field_curvature=FieldCurvature(1.2, -1.0))


def plane(camera, depth_m, seed):
    picture = texture(*SHAPE, seed=seed)
    light = render_coded_frame(picture, np.full(SHAPE, depth_m, np.float32), camera)
    random = np.random.default_rng(seed)
    return (light + 0.001 * random.standard_normal(light.shape)).astype(np.float32)


@pytest.fixture(scope="module")
def planes():
    images = tuple(plane(BENT, depth_m, seed) for seed, depth_m in enumerate(DEPTHS_M))
    return Planes(images, np.array(DEPTHS_M), tuple(f"{depth:g} m" for depth in DEPTHS_M))


@given(st.floats(0.95, 50), st.floats(-3, 3), st.floats(-3, 3), st.floats(-30, 30))
def test_depth_and_blur_of_the_field_are_inverses(depth_m, second, fourth, mask_distance_mm):
    camera = dataclasses.replace(
        STRAIGHT,
        field_curvature=FieldCurvature(second, fourth),
        lens_mask_distance_mm=mask_distance_mm,
    )
    depth = np.full((6, 8), depth_m, np.float32)
    axial_m = camera.depth_m(camera.blur_map_px(depth)).astype(np.float32)
    seen = np.isfinite(axial_m)
    np.testing.assert_allclose(camera.field_corrected_depth(axial_m)[seen], depth_m, rtol=1e-3)


def test_curvature_is_of_angles():
    """By hand: at 250 px from the middle with 500 px of focal length the tangent is 1/2."""
    bent = dataclasses.replace(
        STRAIGHT, image_width=501, image_height=1, field_curvature=FieldCurvature(2.0, -4.0)
    )
    missing = bent.field_curvature.defocus_map(bent.intrinsics, (1, 501))
    assert missing[0, [0, 250, 500]] == pytest.approx([0.25, 0, 0.25])
    half = bent.field_curvature.defocus_map(bent.intrinsics, (1, 251))
    assert half[0, 125] == pytest.approx(0, abs=1e-5)
    straight = dataclasses.replace(bent, field_curvature=None).blur_map_px(np.full((1, 501), 2.0))
    assert (straight - bent.blur_map_px(np.full((1, 501), 2.0)))[0, 0] == pytest.approx(
        0.25 * 0.036 * 500
    )
    # A region has its own part of the curvature.
    cut = bent.for_view(View(101, 1, 501, 1, left=400.0))
    assert cut.field_curvature.defocus_map(cut.intrinsics, (1, 101))[0, -1] == pytest.approx(0.25)


def test_levels_reach_as_far_as_the_blur_of_the_field():
    low, high = BENT.field_blur_range_px(1.25, 3.2)
    sizes = BENT.blur_map_px(np.full(SHAPE, 1.25)), BENT.blur_map_px(np.full(SHAPE, 3.2))
    assert low == pytest.approx(sizes[0].min(), abs=0.05)
    assert high == pytest.approx(sizes[1].max(), abs=0.05)
    bank = learn_bank_for_camera(BENT, 1.25, 3.2, 12)
    assert bank.blur_sizes_px[[0, -1]] == pytest.approx([low, high])
    # Next to the focus it ends before there is next to no blur.
    assert BENT.field_blur_range_px(1.0, 3.2)[0] == 1.5


@pytest.mark.parametrize("entry", [3, [1], [1, 2, 3], [1, "2"], [1, float("nan")], [1, 1e9]])
def test_entries_that_are_no_curvature_are_refused(entry):
    assert camera_from_mapping({**STRAIGHT_FILE, "field_curvature": [1.5, -2]}).field_curvature
    with pytest.raises(InputError, match=r"field_curvature: "):
        camera_from_mapping({**STRAIGHT_FILE, "field_curvature": entry})


def median_error(camera, frame, depth_m, part):
    bank = learn_bank_for_camera(camera, 1.2, 3.4, 20)
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0), camera)
    estimate = estimator.estimate(frame)
    estimator.close()
    assert (estimate.std_dev_m[np.isfinite(estimate.depth_m)] > 0).all()
    return np.nanmedian(np.abs(estimate.depth_m / depth_m - 1)[part])


def test_depth_is_right_in_the_corners():
    frame, corner = plane(BENT, 2.0, 31), np.s_[:40, :40]
    assert median_error(STRAIGHT, frame, 2.0, corner) > 0.12
    assert median_error(BENT, frame, 2.0, corner) < 0.04
    assert median_error(BENT, frame, 2.0, np.s_[76:116, 108:148]) < 0.03


def test_planes_show_the_curvature_and_the_extent_of_the_mask(planes):
    wide = dataclasses.replace(STRAIGHT, mask_extent_mm=37.5)
    found = fit_field(wide, planes)
    assert found.mask_extent_mm == pytest.approx(36, rel=0.015)
    is_, was = (
        c.defocus_map(BENT.intrinsics, SHAPE) for c in (found.curvature, BENT.field_curvature)
    )
    assert np.abs(is_ - was).max() < 0.02
    assert found.errors.max() < 0.04
    assert found.errors.max() < 0.5 * found.errors_without.max()
    assert found.misplaced == ()


def test_a_wrong_distance_is_found(planes):
    depths = planes.depths_m.copy()
    depths[3] *= 1.1
    found = fit_field(STRAIGHT, dataclasses.replace(planes, depths_m=depths))
    assert [found.names[index] for index in found.misplaced] == ["1.9 m"]
    assert found.found_m[list(found.misplaced)] == pytest.approx(1.9, rel=0.03)


@pytest.mark.slow
def test_the_command(planes, tmp_path, capsys, caplog, monkeypatch):
    for index, image in enumerate(planes.images):
        write_image(tmp_path / f"{index}.png", image)
    listed = [
        {"file": f"{i}.png", "depth_m": z} for i, z in enumerate((1.25, 1.4, 1.6, 2.1, 2.4, 3.2))
    ]
    (tmp_path / "planes.json").write_text(json.dumps(listed))
    camera = tmp_path / "camera.yaml"
    camera.write_text(yaml.safe_dump(STRAIGHT_FILE))
    arguments = ("calibrate", "field", tmp_path, "--camera", camera)
    told = json.loads(call(capsys, *arguments, "--json").out)
    assert len(told["planes"]) == 6
    (found,) = re.findall(r"3.png: at 2.1 m, but blurred as at ([\d.]+) m", caplog.text)
    assert float(found) == pytest.approx(1.9, rel=0.02)
    # What it prints is what the camera file takes; the page says it, too, and where planes tell.
    report = tmp_path / "lens.html"
    fitted = tmp_path / "fitted.yaml"
    result = call(capsys, *arguments, "--report", report, "--output", fitted)
    printed = yaml.safe_load(result.out)
    assert yaml.safe_load(fitted.read_text()) == {**STRAIGHT_FILE, **printed}
    assert load_camera(fitted).field_curvature is not None
    refused(call(capsys, *arguments, "-o", tmp_path / "fitted.json"), "fitted.json", ".yaml")
    page = report.read_text()
    assert f"field_curvature: {printed['field_curvature']}" in page
    assert "3.png: at 2.1 m, but blurred as at" in page
    cells = re.findall(r"<td>(\d).png</td>.*?([\d.]+) / ([\d.]+)</td>", page)
    assert [int(name) for name, *_ in cells] == list(range(6))
    for name, measured, predicted in cells:
        # The misplaced one is predicted otherwise.
        assert (abs(float(measured) - float(predicted)) < 0.4) == (name != "3")
    refused(call(capsys, *arguments, "--report", tmp_path / "0.png"), "0.png", "input")
    assert printed == {
        key: told[key] for key in ("mask_extent_mm", "field_curvature", "calibrated")
    }
    assert camera_from_mapping({**STRAIGHT_FILE, **printed}).field_curvature
    for name, value in {"_ROUNDS": 1, "ROWS": 3, "COLUMNS": 4}.items():
        monkeypatch.setattr(f"coded_aperture_ros.calibration.planes.wavefront.{name}", value)
    picture = tmp_path / "found/psfs.png"
    picture.parent.mkdir()
    wrong_usage(call(capsys, *arguments, "--picture", picture), "calibrate field", "--psfs")
    for kept in (tmp_path / "0.png", camera):
        refused(call(capsys, *arguments, "--psfs", "--picture", kept), kept.name, "input")
    lens = yaml.safe_load(call(capsys, *arguments, "--psfs", "--picture", picture).out)
    assert set(lens) == {"mask_extent_mm", "field_curvature", "wavefront", "calibrated"}
    found = camera_from_mapping({**STRAIGHT_FILE, **lens})
    assert found.wavefront.corner == pytest.approx(np.hypot(128, 96) / 500, rel=0.01)
    assert read_image(picture).max() > 0.5
    camera.write_text(yaml.safe_dump({**STRAIGHT_FILE, "image_width": 512, "image_height": 384}))
    refused(call(capsys, *arguments), "the pictures have 256x192")
    camera.write_text(yaml.safe_dump({**STRAIGHT_FILE, "focus_distance_m": 3.4, "side": "near"}))
    refused(call(capsys, *arguments, "--depths", "3.1,3.15,3.2,3.25,3.3,3.35"), "3 are needed")


def test_the_farthest_of_a_field_that_bends_away_is_still_finite():
    """Levels that corners would need beyond infinity are not asked for."""
    away = dataclasses.replace(STRAIGHT, field_curvature=FieldCurvature(-0.5, 0.0))
    bank = learn_bank_for_camera(away, 1.2, 8.0, 10)
    assert np.isfinite(bank.stack.depths_m).all()
    assert bank.stack.depths_m.max() >= 8


def test_depth_of_what_is_at_infinity_on_the_axis_has_a_deviation():
    away = dataclasses.replace(STRAIGHT, field_curvature=FieldCurvature(-2.0, 0.0))
    infinity_px = away.blur_at_infinity_px
    sizes_px = np.linspace(infinity_px - 5, infinity_px + 1, 16)
    bank = learn_bank(render_psf_stack(away.mask, sizes_px))
    config = DepthConfig(confidence_threshold=0.0, check_fit=False)
    estimate = DepthEstimator(bank, config, away).estimate(plane(away, 30.0, seed=3))
    known = np.isfinite(estimate.depth_m)
    assert known.any()
    assert not np.isnan(estimate.std_dev_m[known]).any()


@pytest.mark.slow
def test_planes_of_a_lens_with_field_curvature_pass_and_give_its_bank(
    tmp_path, capsys, caplog, monkeypatch
):
    monkeypatch.setattr("coded_aperture_ros.calibration.planes.search._FINE_ROUNDS", 1)
    # More curved than planes by themselves can be explained with.
    bent = dataclasses.replace(STRAIGHT, field_curvature=FieldCurvature(4.0, -5.0))
    files = [f"{index}.png" for index in range(len(DEPTHS_M))]
    for seed, (name, depth_m) in enumerate(zip(files, DEPTHS_M, strict=True)):
        write_image(tmp_path / name, plane(bent, depth_m, seed))

    def listed(*depths_m):
        entries = [{"file": f, "depth_m": z} for f, z in zip(files, depths_m, strict=True)]
        (tmp_path / "planes.json").write_text(json.dumps(entries))

    camera = tmp_path / "camera.yaml"
    camera.write_text(yaml.safe_dump(STRAIGHT_FILE))
    bank = tmp_path / "bank.npz"
    arguments = ("calibrate", "planes", tmp_path, "--camera", camera, "-o", bank, "--json")
    listed(*DEPTHS_M)
    told = json.loads(call(capsys, *arguments).out)
    assert told["field_curvature"][0] > 1
    assert told["corner_px"] > 1 and told["corner_dioptres"] > 0.05
    assert "focused elsewhere towards the corners" in caplog.text
    assert bank.is_file()
    bank.unlink()
    listed(1.25, 1.4, 1.6, 2.09, 2.4, 3.2)
    refused(call(capsys, *arguments), "3.png: at 2.09 m, but blurred as at 1.")
    assert not bank.exists()
