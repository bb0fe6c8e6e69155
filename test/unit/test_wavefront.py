"""A lens whose PSF changes over the image: its rays, banks for its parts, what planes show."""

import dataclasses

import numpy as np
import pytest
from cameras import STRAIGHT as STRAIGHT_FILE
from cli_scene import texture

from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.calibration.planes.wavefront import fit_wavefront
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import View
from coded_aperture_ros.likelihood import Plan, new_engine
from coded_aperture_ros.likelihood.bank import (
    learn_bank,
    learn_bank_for_camera,
    load_bank,
    save_bank,
)
from coded_aperture_ros.optics import Camera, FieldCurvature, Mask, Wavefront, render_psf
from coded_aperture_ros.optics.camera_file import camera_from_mapping
from coded_aperture_ros.optics.wavefront import TERM_NAMES, TERMS
from coded_aperture_ros.simulation.render import render_coded_frame

SHAPE = (192, 256)
LEVIN = Mask.named("levin")
STRAIGHT = Camera(500.0, 0.9, 256, 192, LEVIN, 36.0)
CORNER = float(np.hypot(96, 128) / 500)


def wavefront(**terms):
    return Wavefront(CORNER, tuple(terms.pop(name, 0.0) for name in TERM_NAMES), **terms)


LENS = dataclasses.replace(
    STRAIGHT,
    field_curvature=FieldCurvature(0.8, 0.0),
    wavefront=wavefront(
        W220=-0.8 * CORNER**2, W222=-0.1, W131=0.05, W242=-0.06, rims=(1.2, 0.5, 1.1, -0.4)
    ),
)


def psf(lens, size_px, tangent=(0.0, 0.0), width=31, unit=18.0):
    return lens.psf(LEVIN, size_px, unit, tangent, width)


def unlike(one, other):
    return np.linalg.norm(one - other) / np.linalg.norm(other)


@pytest.mark.parametrize("size_px", [4.0, 11.3, -11.3, 22.0])
def test_without_aberrations_it_is_a_thin_lens(size_px):
    thin = render_psf(LEVIN, size_px, 31)
    assert unlike(psf(wavefront(), size_px, (0.1, -0.05)), thin) < 0.06


def test_defocus_is_blur_size():
    bent = wavefront(W220=-0.1)
    at_the_corner = psf(bent, 12.0, (0.0, CORNER))
    assert unlike(at_the_corner, render_psf(LEVIN, 12.0 - 0.1 * 18.0, 31)) < 0.06
    assert bent.defocus(LEVIN, CORNER) == pytest.approx(-0.1)


def test_astigmatism_narrows_along_the_field():
    lens = wavefront(W222=-0.2)
    down, across = (psf(lens, 14.0, t) for t in ((CORNER, 0.0), (0.0, CORNER)))
    # Light is shared with the next pixel: at its ends there is less than half of it.
    sides = [down.sum(axis=axis) for axis in (1, 0)]
    seen = np.array([np.ptp(np.flatnonzero(side > side.mean() / 2)) + 1 for side in sides])
    # 2 dW222 / 4 of M f: along the field alone.
    assert seen.tolist() == [pytest.approx(14 - 0.2 * 18, abs=2), pytest.approx(14, abs=2)]
    levin_turned = Mask("turned", LEVIN.transmission.T)
    turned = lens.psf(levin_turned, 14.0, 18.0, (0.0, CORNER), 31)
    assert unlike(turned.T, down) < 1e-3
    assert unlike(across, down) > 0.3


def test_a_rim_cuts_off_the_side_that_is_away_from_it():
    cut = psf(wavefront(rims=(1.0, 0.8, 100.0, 0.0)), 14.0, (0.0, CORNER))
    columns = np.nonzero(cut)[1]
    assert columns.min() > 15 - 0.2 * 7 - 2  # nothing left of 0.8 - 1 of the half extent
    with pytest.raises(InputError, match="no light"):
        psf(wavefront(rims=(0.5, 9.0, 100.0, 0.0)), 14.0, (0.0, CORNER))


def test_an_entry_of_a_camera_file_comes_back():
    assert LENS.wavefront is not None
    entry = LENS.wavefront.entry
    again = Wavefront.from_entry(entry)
    assert np.allclose(again.coefficients, LENS.wavefront.coefficients, atol=1e-5)
    assert again.rims == LENS.wavefront.rims
    assert camera_from_mapping({**STRAIGHT_FILE, "wavefront": entry}).wavefront == again
    for wrong in (3, {"W222": 1.0}, {"corner": 0.3, "W999": 1.0}, {"corner": 0}, {"corner": "x"}):
        with pytest.raises(InputError, match="wavefront: "):
            camera_from_mapping({**STRAIGHT_FILE, "wavefront": wrong})
    with pytest.raises(InputError, match="four numbers"):
        camera_from_mapping({**STRAIGHT_FILE, "wavefront": {"corner": 0.3, "rims": [1, 0]}})


def plane(camera, depth_m, seed):
    light = render_coded_frame(
        texture(*SHAPE, seed=seed), np.full(SHAPE, depth_m, np.float32), camera
    )
    random = np.random.default_rng(seed)
    return (light + 0.001 * random.standard_normal(light.shape)).astype(np.float32)


@pytest.fixture(scope="module")
def bank():
    return learn_bank_for_camera(LENS, 1.2, 3.4, 16)


def error_in_the_corners(bank, camera, frame, depth_m):
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0), camera)
    estimate = estimator.estimate(frame)
    estimator.close()
    error = np.abs(estimate.depth_m / depth_m - 1)
    return np.nanmedian(error[:50, :50]), np.nanmedian(error[-50:, -50:])


def test_depth_is_right_where_the_psf_is_another(bank):
    frame = plane(LENS, 2.0, 31)
    one_psf = dataclasses.replace(LENS, wavefront=None)
    without = error_in_the_corners(
        learn_bank_for_camera(one_psf, 1.2, 3.4, 16), one_psf, frame, 2.0
    )
    with_ = error_in_the_corners(bank, LENS, frame, 2.0)
    assert max(with_) < 0.05
    assert max(with_) < 0.5 * max(without)


@pytest.mark.slow
def test_a_frame_through_the_lens_fits_its_bank(bank):
    """Only the middle is compared with what else it may be: the PSFs are those of the axis."""
    strong = dataclasses.replace(
        LENS, wavefront=wavefront(W222=-0.6, W131=0.3, rims=(1.2, 0.5, 1.1, -0.4))
    )
    own = learn_bank_for_camera(strong, 1.2, 3.4, 16)
    frame = plane(strong, 2.0, 31)
    for known, fits in ((own, True), (dataclasses.replace(own, field=None), False)):
        estimator = DepthEstimator(known, DepthConfig(), strong)
        health = estimator.estimate(frame).health
        estimator.close()
        assert health is not None
        assert health.fits == fits


def test_a_part_of_the_view_has_the_psfs_of_its_place(bank):
    """A region of interest in the corner is not taken for the middle."""
    view = View(96, 96, 256, 192)
    estimator = DepthEstimator(
        bank, DepthConfig(confidence_threshold=0.0, check_fit=False), LENS.for_view(view)
    )
    own = Plan.for_frames(estimator.model, (96, 96), 8)
    estimator.close()
    whole = Plan.for_frames(bank, SHAPE, 8)
    assert np.array_equal(own.areas[0].hypotheses, whole.areas[0].hypotheses)
    assert len(own.areas) < len(whole.areas)


def test_every_patch_is_in_one_area(bank):
    plan = Plan.for_frames(bank, SHAPE, 8)
    seen = np.zeros((plan.grid.rows, plan.grid.columns), int)
    for area in plan.areas:
        seen[area.rows, area.columns] += 1
    assert (seen == 1).all()


@pytest.mark.slow
def test_parts_are_scored_as_banks_of_their_own(bank):
    """Energies in a corner are those of a bank of the PSFs there, but for the basis."""
    frame = plane(LENS, 1.6, 5)
    own = learn_bank(dataclasses.replace(bank.stack, psfs=bank.field.field.psfs[0]))
    axis = dataclasses.replace(bank, field=None)
    parts, alone, elsewhere = (each.energies(frame, 8, 0.001)[:2, :2] for each in (bank, own, axis))
    assert np.abs(parts - alone).mean() < 0.3 * np.abs(elsewhere - alone).mean()


def test_torch_knows_the_parts(bank):
    pytest.importorskip("torch", reason="needs PyTorch")
    frame, plan = plane(LENS, 1.6, 5), Plan.for_frames(bank, SHAPE, 8)
    energies = []
    for backend in ("numpy", "torch"):
        engine = new_engine(plan, backend)
        engine.project(frame)
        energies.append(engine.energies(0.001).copy())
        engine.close()
    assert np.abs(energies[0] - energies[1]).max() < 1e-3 * np.ptp(energies[0])


def test_a_bank_comes_back_from_its_file(bank, tmp_path):
    save_bank(bank, tmp_path / "bank.npz")
    again = load_bank(tmp_path / "bank.npz")
    frame = plane(LENS, 1.6, 5)
    assert np.array_equal(again.energies(frame, 8, 0.001), bank.energies(frame, 8, 0.001))
    assert again.field.field.intrinsics == bank.field.field.intrinsics


@pytest.mark.slow
def test_planes_show_how_the_psf_changes(monkeypatch):
    """A lens that changes much over the image is found with fewer parts, in fewer rounds."""
    few = {"ROWS": 3, "COLUMNS": 4, "_FIRST_ROUNDS": 2, "_ROUNDS": 4}
    for name, value in few.items():
        monkeypatch.setattr(f"coded_aperture_ros.calibration.planes.wavefront.{name}", value)
    lens = dataclasses.replace(
        LENS,
        wavefront=wavefront(
            W220=-0.8 * CORNER**2, W222=-0.3, W131=0.15, rims=(1.1, 0.5, 1.1, -0.4)
        ),
    )
    depths = (1.3, 1.6, 2.1, 3.2)
    images = tuple(plane(lens, depth_m, seed) for seed, depth_m in enumerate(depths))
    planes = Planes(images, np.array(depths), tuple(map(str, depths)))
    first = dataclasses.replace(lens, wavefront=None, mask_extent_mm=36.5)
    found = fit_wavefront(first, planes, [1, 3], iter)
    assert found.mask_extent_mm == pytest.approx(36, rel=0.03)
    true, told = (
        camera.field_psf(LEVIN, 12.0, np.array([0.13, 0.18]), 31) for camera in (lens, found)
    )
    assert unlike(told, true) < 0.5 * unlike(render_psf(LEVIN, 12.0, 31), true)
    assert len(TERMS) == len(TERM_NAMES)


@pytest.mark.slow
def test_deblurring_goes_by_the_parts_of_the_image():
    from coded_aperture_ros.deblur import DeblurConfig, Deblurrer, blur_levels, make_deblurrer

    bent = dataclasses.replace(
        LENS, wavefront=wavefront(W222=-0.3, W131=0.15, rims=(1.1, 0.5, 1.1, -0.4))
    )
    sharp = np.clip(texture(*SHAPE), 0, 1).astype(np.float32)
    depth_m = np.full(SHAPE, 2.0, np.float32)
    frame = render_coded_frame(sharp, depth_m, bent)
    frame += 0.001 * np.random.default_rng(0).standard_normal(SHAPE, dtype=np.float32)
    bank = learn_bank_for_camera(bent, 1.5, 3.0, 8)
    blur = np.asarray(bent.blur_map_px(depth_m), np.float32)
    config = DeblurConfig(method="cg")
    made = make_deblurrer(bank, config), Deblurrer(bank.stack, config)
    corner = np.s_[12:60, 12:60]
    by_parts, by_axis = (
        float(np.sqrt(np.mean((each.deblur(frame, blur) - sharp)[corner] ** 2))) for each in made
    )
    assert by_parts < 0.75 * by_axis
    # A map in steps of eight pixels does as well, and no seam is left between parts.
    small = made[0].deblur(frame, blur[4::8, 4::8])
    seam = np.abs(np.diff(small - sharp, axis=1)).mean(axis=0)
    assert seam.max() < 3 * np.median(seam)
    assert made[0].uncertainty(frame, small, blur).std_dev.shape == SHAPE
    made[0].prepare(SHAPE)
    for each in made:
        with pytest.raises(InputError, match="does not have the proportions"):
            each.deblur(frame, blur[:, ::2])
    for each in made:
        each.close()
    # What a node renders of a camera file does as well as a bank.
    rendered = make_deblurrer(
        blur_levels(camera=bent, depth_range_m=(1.5, 3.0), level_count=8), config
    )
    as_well = (rendered.deblur(frame, blur) - sharp)[corner]
    assert float(np.sqrt(np.mean(as_well**2))) == pytest.approx(by_parts, rel=0.05)
    rendered.close()
    assert isinstance(make_deblurrer(learn_bank_for_camera(STRAIGHT, 1.5, 3.0, 8)), Deblurrer)
