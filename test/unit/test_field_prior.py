"""A lens that was not measured away from the axis is doubted there."""

import dataclasses

import numpy as np
import pytest

from coded_aperture_ros.checkup import OK, WARNING, camera_findings
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import Frame, View
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.optics import Camera, FieldCurvature, Mask, camera_from_mapping
from coded_aperture_ros.optics.field_prior import unmeasured_defocus
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.simulation.render import render_coded_frame

SHAPE = (192, 256)
CAMERA = Camera(
    400.0, 0.6, SHAPE[1], SHAPE[0], Mask.named("levin"), 16.0, focal_length_mm=16.0
)  # fmt: skip
EVERYTHING = DepthConfig(confidence_threshold=0.0, check_fit=False, free_space_risk=0.01)


@pytest.fixture(scope="module")
def coded():
    sharp = np.random.default_rng(0).random(SHAPE, np.float32)
    frame = render_coded_frame(sharp, np.full(SHAPE, 1.2, np.float32), CAMERA)
    noise = 0.002 * np.random.default_rng(1).standard_normal(SHAPE, dtype=np.float32)
    return np.clip(frame + noise, 0, 1)


@pytest.fixture(scope="module")
def bank():
    return learn_bank_for_camera(CAMERA, 0.7, 3.0, 20)


def estimate(bank, camera, frame, **settings):
    pipeline = FramePipeline(bank, camera, dataclasses.replace(EVERYTHING, **settings), deblur=None)
    found = pipeline(frame)
    pipeline.close()
    return found


def test_outer_field_of_a_nominal_lens_is_doubted(bank, coded):
    known = estimate(bank, dataclasses.replace(CAMERA, calibrated="traced"), coded)
    nominal = estimate(bank, CAMERA, coded)
    middle, corner = np.s_[88:104, 120:136], np.s_[:16, :16]
    np.testing.assert_array_equal(nominal.depth_m, known.depth_m)
    assert nominal.confidence[middle].mean() > 0.95 * known.confidence[middle].mean() > 0.5
    assert nominal.confidence[corner].mean() < 0.5 * known.confidence[corner].mean()
    # At the corner t^2 is 0.16: 0.15 * 0.16 / 16 mm is 1.5 dioptres, of 0.83.
    assert nominal.std_dev_m[corner].mean() == pytest.approx(1.2**2 * 1.42, rel=0.15)
    # Free space is what lies before the bound: less of it where the lens is doubted.
    bounds = nominal.values("free_space"), known.values("free_space")
    assert np.nanmean(bounds[0][corner]) < np.nanmean(bounds[1][corner])
    np.testing.assert_array_equal(bounds[0][middle], bounds[1][middle])


@pytest.mark.parametrize(
    "change",
    [{"calibrated": "field"}, {"focal_length_mm": None}, {"field_curvature": FieldCurvature(1e-6)}],
)
def test_measured_lenses_are_believed(bank, coded, change):
    known = estimate(bank, dataclasses.replace(CAMERA, calibrated="traced"), coded)
    other = estimate(bank, dataclasses.replace(CAMERA, **change), coded)
    np.testing.assert_allclose(other.confidence, known.confidence, atol=1e-3)


def test_region_of_the_corner_is_doubted_as_in_the_whole_view(bank, coded):
    whole = estimate(bank, CAMERA, coded)
    view = View(left=0, top=0, width=128, height=96, whole_width=256, whole_height=192)
    part = estimate(bank, CAMERA, Frame(coded[:96, :128], view=view))
    away = np.s_[:48, :64]
    assert part.confidence[away].mean() == pytest.approx(whole.confidence[away].mean(), abs=0.1)
    assert part.confidence[away].mean() < 0.5


def test_threshold_withholds_the_corners(bank, coded):
    found = estimate(bank, CAMERA, coded, confidence_threshold=0.45)
    assert np.isnan(found.depth_m[:16, :16]).all()
    assert np.isfinite(found.depth_m[88:104, 120:136]).all()


def test_camera_file_says_how_the_lens_is_known():
    entries = {
        "focal_length_px": 400.0, "focus_distance_m": 0.6, "image_width": 256,
        "image_height": 192, "mask": {"name": "levin"}, "mask_extent_mm": 16.0,
    }  # fmt: skip
    assert camera_from_mapping(entries).calibrated == "nominal"
    assert camera_from_mapping({**entries, "calibrated": "field"}).calibrated == "field"
    with pytest.raises(InputError, match=r"calibrated: .* use one of nominal, planes"):
        camera_from_mapping({**entries, "calibrated": "yes"})


def test_check_says_what_measuring_would_gain():
    def finding(camera):
        return next(f for f in camera_findings(camera, 0.7, 3.0) if f.about == "field")

    nominal = finding(CAMERA)
    assert nominal.state == WARNING
    assert "calibrate field" in nominal.remedy
    assert nominal.numbers["corner_px"] == pytest.approx(
        unmeasured_defocus(CAMERA, SHAPE).max() * 16e-3 * 400
    )
    assert finding(dataclasses.replace(CAMERA, calibrated="traced")).state == OK
    assert "focal_length_mm" in finding(dataclasses.replace(CAMERA, focal_length_mm=None)).text
