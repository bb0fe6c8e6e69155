"""Scenes that move: simulated, deblurred, behind the best masks, and from the command line."""

import json

import numpy as np
import pytest
from cli_scene import CAMERA, HEIGHT, WIDTH, call, call_benchmarks, camera_file, texture
from coded_aperture_benchmarks.datasets.moving_frame import MovingObject, render_moving_frame
from deblur_scene import assert_adjoint
from scipy.signal import fftconvolve

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.deblur.blur_map import smooth_within_surfaces
from coded_aperture_ros.deblur.operator import SpreadingBlur, crop_to_frame, motion_parts
from coded_aperture_ros.deblur.problem import full_resolution_motion
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.design.fragmentation import (
    analyse_fragmentation,
    hole_side_mm,
    most_holes,
    round_mask,
)
from coded_aperture_ros.io import write_image
from coded_aperture_ros.likelihood.motion import Motions, blurred_psf, motion_kernel
from coded_aperture_ros.optics import Camera, Mask, render_psf, render_psf_stack
from coded_aperture_ros.simulation import render_coded_frame

STACK = render_psf_stack(Mask.named("levin"), np.linspace(3, 11, 9))
BASIS = PsfBasis.from_stack(STACK)
SHAPE = (72, 96)
SCENE_CAMERA = Camera(**{**CAMERA, "mask": Mask.named("levin")})
OBJECT_M, SCENE_M = 1.7, 2.8


def fields(motion=(6.0, 2.0)):
    """Return blur and motion of a moving square in front of a static plane."""
    blur = np.full(SHAPE, 9.0, np.float32)
    motion_px = np.zeros((*SHAPE, 2), np.float32)
    blur[20:52, 30:70] = 5.0
    motion_px[20:52, 30:70] = motion
    return blur, motion_px


def moving_blur(basis, blur, motion_px):
    return SpreadingBlur(basis, blur, motion=motion_parts(motion_px))


@pytest.mark.parametrize("seed", range(3))
def test_the_adjoint_is_the_transpose(seed):
    assert_adjoint(moving_blur(BASIS, *fields()), seed)


def test_motion_is_brought_to_the_size_of_the_frame():
    _, motion_px = fields()
    large = full_resolution_motion(motion_px[::2, ::2], SHAPE)
    assert np.array_equal(large, motion_px)
    assert full_resolution_motion(np.zeros_like(motion_px), SHAPE) is None


def test_a_plane_that_moves_is_convolved_with_both():
    basis = PsfBasis.from_stack(STACK, 1e-5)
    blur = np.full(SHAPE, STACK.blur_sizes_px[4], np.float32)
    motion = np.broadcast_to(np.float32([5.0, -3.0]), (*SHAPE, 2))
    operator = moving_blur(basis, blur, motion)
    scene = operator.extend(texture(*SHAPE))
    exact = fftconvolve(scene[0], blurred_psf(STACK.psfs[4], (5.0, -3.0)), mode="same")
    assert operator.forward(scene) == pytest.approx(crop_to_frame(exact, operator), abs=2e-4)


def test_nothing_moves_is_defocus_alone():
    blur, motion_px = fields((0.0, 0.0))
    moving, static = moving_blur(BASIS, blur, motion_px), SpreadingBlur(BASIS, blur)
    scene = static.extend(texture(*SHAPE))
    assert moving.forward(scene) == pytest.approx(static.forward(scene), abs=1e-5)
    assert sum(np.square(share) for share, _ in moving.ranges(3)) == pytest.approx(1, abs=1e-5)


def test_smoothed_blur_sizes_keep_their_edges():
    random = np.random.default_rng(0)
    true = np.where(np.arange(96) < 48, 5.0, 9.0) + np.zeros(SHAPE)
    noisy = (true + 0.3 * random.standard_normal(SHAPE)).astype(np.float32)
    smoothed = smooth_within_surfaces(noisy)
    assert np.abs(smoothed - true).max() < 0.3
    assert np.abs(smoothed - true).mean() < 0.05


def test_the_parts_of_a_frame_are_the_motions_that_occur():
    motion = np.zeros((4, 5, 2), np.float32)
    motion[0] = 3.0, 1.0
    motion[1, :2] = -3.0, -1.0  # the same line, the other way
    motion[3, 3] = np.nan
    parts = motion_parts(motion)
    assert parts.vectors_px.tolist() == [[0, 0], [3, 1]]
    assert (parts.labels == 1).sum() == 7
    many = np.random.default_rng(0).uniform(-9, 9, (30, 30, 2)).astype(np.float32)
    parts = motion_parts(many)
    assert len(parts.vectors_px) == len(parts.traces()) == 8
    assert set(np.unique(parts.labels)) <= set(range(8))


@pytest.mark.parametrize("method", ["cg", "sparse"])
def test_deblurring_with_the_motion_is_better_where_it_was(method):
    sharp = texture(*SHAPE)
    blur, motion_px = fields((8.0, 0.0))
    operator = moving_blur(BASIS, blur, motion_px)
    coded = operator.forward(operator.extend(sharp))
    coded += 0.001 * np.random.default_rng(0).standard_normal(SHAPE).astype(np.float32)
    config = DeblurConfig(method=method, occlusion="no", noise=0.001, iterations=48)
    deblurrer = Deblurrer(STACK, config)
    inside = np.s_[26:46, 38:62]
    errors = [
        np.sqrt(np.mean((deblurrer.deblur(coded, blur, motion_px=each) - sharp)[inside] ** 2))
        for each in (None, motion_px)
    ]
    assert errors[1] < 0.9 * errors[0]


def test_motion_that_cannot_be_removed_is_refused():
    frame, (blur, motion_px) = texture(*SHAPE), fields()
    with pytest.raises(InputError, match="fast removes no motion"):
        Deblurrer(STACK).deblur(frame, blur, motion_px=motion_px)
    static = Deblurrer(STACK).deblur(frame, blur, motion_px=np.zeros_like(motion_px))
    assert static == pytest.approx(Deblurrer(STACK).deblur(frame, blur))
    for wrong in (motion_px[..., 0], motion_px.astype(int)):
        with pytest.raises(InputError, match="motion: expected"):
            Deblurrer(STACK).deblur(frame, blur, motion_px=wrong)


def test_a_moving_plane_is_rendered_as_its_kernels_say():
    sharp = texture(HEIGHT, WIDTH).astype(np.float64)
    depth = np.full(sharp.shape, OBJECT_M)
    motion = (6.0, 0.0)
    everywhere = MovingObject(sharp, depth, np.ones(sharp.shape, bool), motion)
    frame = render_moving_frame(sharp, depth, [everywhere], SCENE_CAMERA)
    psf = render_psf(SCENE_CAMERA.mask, float(SCENE_CAMERA.blur_size_px(OBJECT_M)))
    exact = fftconvolve(sharp, fftconvolve(psf, motion_kernel(motion)), mode="same")
    inside = np.s_[20:-20, 24:-24]
    assert frame.coded[inside] == pytest.approx(exact[inside], abs=3e-3)
    assert (frame.motion_px == motion).all()


def test_what_an_object_hides_for_a_part_of_the_exposure_is_seen_for_the_rest():
    dark, bright = np.zeros((60, 80)), np.ones((60, 80))
    covered = np.zeros((60, 80), bool)
    covered[20:40, 30:50] = True
    # In focus, so that only motion blurs.
    camera = Camera(**{**CAMERA, "mask": Mask.named("levin"), "mask_extent_mm": 0.001})
    depths = np.full((60, 80), SCENE_M), np.full((60, 80), OBJECT_M)
    thing = MovingObject(bright, depths[1], covered, (8.0, 0.0))
    frame = render_moving_frame(dark, depths[0], [thing], camera)
    row = frame.coded[30]
    assert row[40] == pytest.approx(1, abs=1e-3)
    assert row[29] == pytest.approx(0.5, abs=0.1)
    assert row[24] == pytest.approx(0, abs=1e-3)
    assert np.diff(row[24:36]).min() > -1e-6
    assert row.sum() == pytest.approx(20, abs=0.5)  # its light is spread, not lost
    assert frame.depth_m[30, 40] == pytest.approx(OBJECT_M)
    assert frame.depth_m[30, 20] == np.float32(SCENE_M)


def test_objects_that_cannot_be():
    image = np.zeros((20, 20))
    with pytest.raises(InputError, match="one size"):
        MovingObject(image, image[:10], np.ones((20, 20), bool), (1.0, 0.0))
    with pytest.raises(InputError, match="motion"):
        MovingObject(image, image, np.ones((20, 20), bool), (float("nan"), 0.0))
    small = np.full((30, 30), 2.0)
    thing = MovingObject(image, image + 2, np.ones((20, 20), bool), (1.0, 0.0))
    with pytest.raises(InputError, match="that of the scene"):
        render_moving_frame(small, small, [thing], SCENE_CAMERA)


def test_without_objects_it_is_the_usual_frame():
    sharp = texture(64, 96)
    depth = np.full(sharp.shape, SCENE_M)
    frame = render_moving_frame(sharp, depth, [], SCENE_CAMERA)
    usual = render_coded_frame(sharp, depth, SCENE_CAMERA, aperture_blocks=2)
    assert frame.coded == pytest.approx(usual)
    assert not frame.motion_px.any()


def test_holes_of_equal_light_are_those_of_the_thesis():
    assert most_holes(50, 9) == 3
    assert hole_side_mm(50, 7.1, 3) == pytest.approx(3.6, abs=0.01)
    assert 3 * hole_side_mm(50, 7.1, 3) ** 2 == pytest.approx(np.pi * (50 / 7.1 / 2) ** 2)
    assert round_mask(3, 3).open_fraction == pytest.approx(3 / 9, abs=1e-3)
    for wrong in ((0, 9), (50, -1), (50, float("nan"))):
        with pytest.raises(InputError, match="expected more than 0"):
            most_holes(*wrong)
    with pytest.raises(InputError, match="larger than the grid"):
        round_mask(3, 8)


def test_fragmented_apertures_preserve_more_than_the_disc():
    few = Motions.grid(4, [3.0, 9.0], static=False)
    analysis = analyse_fragmentation(3, 3, [8.0, 16.0], few, (0.02, 0.06))
    assert analysis.placements == 84
    assert len(analysis.masks) == 16  # Burnside's count of 3 cells of 9 under 8 symmetries
    assert analysis.exhaustive
    best = analysis.preserved[analysis.best(0.05, 0.07)]
    assert best[1] > analysis.disc_preserved[1]
    # Holes in a row that touch are a narrow slit: hardly better than a disc.
    slit = [mask.name for mask in analysis.masks].index("010-010-010")
    assert slit >= len(analysis.masks) - 2
    # Without blur all frequencies are kept.
    whole = analyse_fragmentation(2, 1, [1e-6], Motions(np.zeros((1, 2))), (0.5,))
    assert whole.preserved.max() == pytest.approx(1)
    with pytest.raises(InputError, match="none of the levels"):
        analysis.best(0.5, 0.6)
    with pytest.raises(InputError, match="holes"):
        analyse_fragmentation(3, 10, [8.0], few)


@pytest.fixture(scope="module")
def moving_file(tmp_path_factory):
    """Return a folder with a bank and a frame of a plane that moves."""
    folder = tmp_path_factory.mktemp("moving")
    camera = camera_file(folder)
    sharp = texture(HEIGHT + 40, WIDTH + 40)
    size = float(SCENE_CAMERA.blur_size_px(OBJECT_M))
    psf = blurred_psf(render_psf(SCENE_CAMERA.mask, size), (0.0, 8.0))
    coded = fftconvolve(sharp, psf, mode="same")[20:-20, 20:-20]
    coded += 0.0005 * np.random.default_rng(0).standard_normal(coded.shape)
    write_image(folder / "coded.tiff", coded.astype(np.float32))
    return folder, camera


def test_the_program_estimates_and_removes_motion(moving_file, capsys):
    folder, camera = moving_file
    bank, depth = folder / "bank.npz", folder / "depth.npy"
    learn = ("--camera", camera, "--depth-range", 1.6, 3.0, "--level-count", 8)
    assert call(capsys, "learn", *learn, "-o", bank).status == 0
    options = ("--motion", "--motion-directions", 4, "--motion-lengths", 2)
    options = (*options, "--longest-motion-px", 8, "--json")
    coded = folder / "coded.tiff"
    result = call(capsys, "depth", "--bank", bank, *options, coded, "-o", depth)
    assert result.status == 0, result.err
    (summary,) = json.loads(result.out)
    assert summary["moving"] > 0.9
    motion = np.load(folder / "depth.motion.npy")
    assert motion.shape == (HEIGHT, WIDTH, 2)
    assert motion.dtype == np.float32
    assert np.median(motion, axis=(0, 1)) == pytest.approx((0, 8), abs=1e-3)
    assert np.load(folder / "depth.motion.confidence.npy").shape == (HEIGHT, WIDTH)
    assert summary["median"] == pytest.approx(OBJECT_M, rel=0.05)

    known = ("--camera", camera, "--angular-velocity", 1, 0, 0, "--exposure", 0.02)
    result = call(capsys, "depth", "--bank", bank, *options, *known, coded, "-o", depth)
    assert json.loads(result.out)[0]["searched"] == ""
    result = call(capsys, "depth", "--bank", bank, *options, *known[:-1], 0, coded, "-o", depth)
    assert result.status == 0, result.err
    assert "exposure of 0 s" in json.loads(result.out)[0]["searched"]

    sharp = ("--depth", depth, "--motion", folder / "depth.motion.npy", "-o", folder / "s.png")
    both = ("deblur", "--bank", bank, *sharp, coded)
    result = call(capsys, *both, "--method", "cg", "--iterations", 8)
    assert (result.status, result.err) == (0, "")
    result = call(capsys, *both)
    assert (result.status, "--motion: needs --method cg or --method sparse" in result.err) == (
        2,
        True,
    )
    (folder / "bad.npy").write_bytes(b"nothing")
    bad = [folder / "bad.npy" if str(each).endswith("motion.npy") else each for each in both]
    result = call(capsys, *bad, "--method", "cg")
    assert (result.status, "bad.npy" in result.err) == (1, True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--method", "two_pixel", "--motion"), "--motion: not with --method two_pixel"),
        (("--bank", "b.npz", "--angular-velocity", 0, 0, 1), "needs --motion"),
        (("--bank", "b.npz", "--exposure", 1), "only with --angular-velocity"),
        (("--bank", "b.npz", "--motion", "--angular-velocity", 0, 0, 1), "needs --camera"),
    ],
)
def test_options_that_do_not_go_together(capsys, arguments, message):
    result = call(capsys, "depth", *arguments, "coded.png", "-o", "depth.npy")
    assert result.status == 2
    assert message in result.err


def test_the_program_finds_masks_for_motion(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    folder = tmp_path / "fragmentation"
    arguments = ("mask", "motion", "--grid", 2, "--holes", 2, "--output", folder, "--json")
    result = call(capsys, *arguments)
    assert (result.status, result.err) == (0, "")
    found = json.loads(result.out)
    assert (found["placements"], found["different"]) == (6, 2)
    assert (folder / "fragmentation.png").is_file()
    mask = Mask.from_file(folder / f"{found['masks'][0]['mask']}.npy")
    assert mask.open_fraction == pytest.approx(0.5)
    assert "best for noise" in call(capsys, *arguments[:-3]).out


@pytest.mark.slow
def test_the_table_of_the_thesis(capsys):
    arguments = ("motion", "table", "--cases", "random,0", "--masks", "A", "--jobs", 1)
    result = call_benchmarks(capsys, *arguments, "--json")
    (cell,) = json.loads(result.out)["cells"]
    assert cell["defocus"]["thesis"] == [0.41, 0.808]
    assert cell["defocus"]["accuracy"] > 0.95
    assert cell["direction"]["accuracy"] > 0.95  # thesis: 0.94
    assert cell["length"]["accuracy"] > 0.6
    assert cell["length"]["mean_error"] < 0.8
    for wrong in (("--window", 41), ("--cases", "random")):
        assert call_benchmarks(capsys, *arguments, *wrong).status == 2
