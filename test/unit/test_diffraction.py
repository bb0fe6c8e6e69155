"""PSFs with diffraction against what optics knows in closed form, and openings that it hides."""

import logging

import numpy as np
import pytest
import yaml
from cameras import THESIS
from cli_scene import call, camera_file
from scipy import signal, special

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design import mask_openings
from coded_aperture_ros.design.diffraction import airy_width_px, diffraction_warning
from coded_aperture_ros.likelihood.bank import load_bank
from coded_aperture_ros.likelihood.bank.for_camera import psf_stack_for_camera
from coded_aperture_ros.optics import (
    MASK_NAMES,
    Camera,
    Mask,
    camera_from_mapping,
    psf_width,
    render_psf,
    render_psf_stack,
)
from coded_aperture_ros.optics.diffraction import (
    diffracted_psf,
    diffraction_tail_px,
    scatter_length_px,
)
from coded_aperture_ros.simulation import render_coded_frame

SQUARE = Mask("square", np.ones((1, 1)))


def by_sums(mask, size_px, width_px, q, points, per_px):
    """The diffraction integral as a plain sum over squares of the mask, shared between pixels.

    Exact in each square but for the phase of defocus, which is that of its middle.
    """
    cells = np.kron(mask.transmission, np.ones((points // len(mask.transmission),) * 2))
    x = (np.arange(len(cells)) + 0.5) / len(cells) - 0.5
    pupil = np.sqrt(cells) * np.exp(1j * np.pi * size_px / q * (x[:, None] ** 2 + x**2))
    u = (np.arange((width_px + 1) * per_px) + 0.5) / per_px - (width_px + 1) / 2
    shares = np.clip(1 - np.abs(u - np.arange(width_px)[:, None] + (width_px - 1) / 2), 0, None)
    kernel = np.exp(-2j * np.pi * u[:, None] * x / q) * np.sinc(u[:, None] / q / len(cells))
    return shares @ np.abs(kernel @ pupil @ kernel.T) ** 2 @ shares.T


def minima(profile):
    """Places of the minima of samples, to a part of a sample."""
    places = np.flatnonzero((profile[1:-1] < profile[:-2]) & (profile[1:-1] < profile[2:])) + 1
    before, here, after = (profile[places + shift] for shift in (-1, 0, 1))
    return places + (before - after) / (2 * (before - 2 * here + after))


def test_a_round_aperture_in_focus_has_the_airy_pattern():
    """First dark ring at 1.22 wavelengths times the f-number; the whole profile is Airy's."""
    q, width = 20.0, 121
    psf = diffracted_psf(Mask.named("disc"), 0.0, width, q)
    across = psf[width // 2, width // 2 :]
    assert minima(across)[0] == pytest.approx(1.2197 * q, rel=0.005)
    x = np.pi * np.arange(1, width // 2 + 1) / q
    airy = (2 * special.j1(x) / x) ** 2
    assert across[1:] / across[0] == pytest.approx(airy, abs=0.003)
    # Of a hole half as wide the disc is twice as wide.
    hole = np.pad(Mask.named("disc").transmission, 48)
    half = diffracted_psf(Mask("hole", hole), 0.0, width, q)
    assert minima(half[width // 2, width // 2 :])[0] == pytest.approx(2 * 1.2197 * q, rel=0.005)


@pytest.mark.parametrize("closed", [3, 7])
def test_two_slits_have_fringes_at_wavelength_over_distance(closed):
    q, width, cells = 40.0, 201, closed + 2
    slits = np.zeros((cells, cells))
    slits[:, 0] = slits[:, -1] = 1
    profile = diffracted_psf(Mask("slits", slits), 0.0, width, q).sum(axis=0)
    distance = (cells - 1) / cells  # between their middles, as a share of the extent
    dark = minima(profile) - width // 2
    nearest = dark[np.abs(dark) < 2 * q / distance]
    expected = q / distance * np.array([-1.5, -0.5, 0.5, 1.5])
    assert nearest == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("name", ["zhou", "three_wide", "levin", "veeraraghavan"])
@pytest.mark.parametrize(
    ("size", "points", "per_px"),
    # Out of focus the phase over the mask is what changes fast; in focus, light over the sensor.
    [(9.0, 800, 40), (-6.5, 800, 40), (0.0, 100, 160)],
)
def test_defocus_agrees_with_the_integral_as_a_sum(name, size, points, per_px):
    """Another way to compute it; masks that are not symmetric tell both sides of the focus."""
    mask, q = Mask.named(name), 0.4
    expected = by_sums(mask, size, 21, q, points, per_px)
    found = diffracted_psf(mask, size, 21, q)
    assert found / found.sum() == pytest.approx(expected / expected.sum(), abs=3e-5)


@pytest.mark.parametrize("name", MASK_NAMES)
@pytest.mark.parametrize("size", [0.0, 5.3, -12.0])
def test_no_light_is_lost_but_beyond_the_width(name, size):
    mask, q = Mask.named(name), 0.2
    beyond = 30.0
    found = diffracted_psf(mask, size, psf_width(size) + 2 * int(beyond), q).sum()
    assert found < 1 + 1e-9
    # The tail of a pattern is that of its edges; those of round ones are softened by grey cells.
    tail = scatter_length_px(mask, q) / beyond
    assert (0.3 if name in ("disc", "annulus") else 0.65) < (1 - found) / tail < 1.35
    assert render_psf(mask, size, diffraction_px=q).sum() == pytest.approx(1, abs=3e-5)


@pytest.mark.parametrize("name", ["zhou", "four_hole"])
def test_short_waves_give_the_geometric_psf(name):
    mask, size = Mask.named(name), 8.3
    width = psf_width(size) + 2
    geometric = render_psf(mask, size, width)
    apart = [
        0.5 * np.abs(render_psf(mask, size, width, diffraction_px=q) - geometric).sum()
        for q in (0.64, 0.16, 0.04, 0.01)
    ]
    assert (np.diff(apart) < 0).all()
    assert apart[-1] < 0.04


def test_a_wide_opening_keeps_its_shape():
    geometric = render_psf(SQUARE, 12.0, 15)
    assert np.abs(render_psf(SQUARE, 12.0, 15, diffraction_px=0.005) - geometric).sum() < 0.02


def test_a_negative_size_is_turned_and_an_offset_moves():
    mask = Mask.named("zhou")
    turned = render_psf(mask, -9.0, diffraction_px=0.2)[::-1, ::-1]
    # Phases of defocus of both signs, of a mask and the same turned, have the same intensity.
    np.testing.assert_allclose(turned, render_psf(mask, 9.0, diffraction_px=0.2), atol=1e-7)
    moved = diffracted_psf(mask, 9.0, 31, 0.2, (2.0, -3.0))
    np.testing.assert_allclose(
        moved[4:-2, :-6], diffracted_psf(mask, 9.0, 31, 0.2)[2:-4, 3:-3], atol=1e-12
    )


def test_parts_of_a_mask_add_up_with_the_light_that_is_theirs():
    mask, parts = Mask.named("zhou"), []
    for number in range(3):
        cells = np.zeros_like(mask.transmission)
        cells[:, number::3] = mask.transmission[:, number::3]
        parts.append(Mask("part", cells))
    whole = diffracted_psf(mask, 9.0, 25, 0.1)
    of_parts = [diffracted_psf(mask, 9.0, 25, 0.1, part=part) for part in parts]
    np.testing.assert_allclose(np.sum(of_parts, axis=0), whole, atol=1e-12)
    for part, light in zip(parts, of_parts, strict=True):
        assert light.sum() == pytest.approx(part.open_fraction / mask.open_fraction, rel=0.02)


# ---- the camera ----


def test_f_number_and_wavelength_of_a_camera_file():
    camera = camera_from_mapping(THESIS)
    assert camera.f_number == pytest.approx(50 / 11)
    assert camera.wavelength_nm == 550
    # By hand: 0.55 um times the image distance of 50.85 mm over 11 mm, in pixels of 18.72 um.
    pitch_um, distance_mm = THESIS["pixel_pitch_um"], 50 * 3 / (3 - 0.05)
    assert camera.diffraction_px == pytest.approx(0.55 * distance_mm / 11 / pitch_um, rel=1e-6)
    red = camera_from_mapping({**THESIS, "wavelength_nm": 700})
    assert red.diffraction_px == pytest.approx(camera.diffraction_px * 700 / 550)
    for key, value in (("wavelength_nm", 5), ("wavelength_nm", "red"), ("diffraction", "some")):
        with pytest.raises(InputError, match=key):
            camera_from_mapping({**THESIS, key: value})


def pinhole(extent_mm, **others):
    return Camera(1200, 1.9, 640, 480, Mask.named("levin"), extent_mm, **others)


def test_diffraction_is_left_out_where_it_does_not_matter():
    wide, narrow = pinhole(52), pinhole(12, diffraction=True)
    assert wide.psf_diffraction_px == pinhole(12).psf_diffraction_px == 0
    assert narrow.psf_diffraction_px == narrow.diffraction_px > 0
    assert pinhole(52, diffraction=True).psf_diffraction_px == wide.diffraction_px
    assert pinhole(12, diffraction=False).psf_diffraction_px == 0
    # Not even where asked for, where it cannot be seen: it would only take time.
    assert pinhole(5000, diffraction=True).psf_diffraction_px == 0
    for camera in (wide, narrow):
        stack = psf_stack_for_camera(camera, 2.3, 5, 5)
        expected = render_psf_stack(camera.mask, stack.blur_sizes_px, camera.psf_diffraction_px)
        np.testing.assert_array_equal(stack.psfs, expected.psfs)


@pytest.mark.parametrize("name", MASK_NAMES)
def test_what_is_left_out_by_default_is_below_the_stated_bound(name):
    mask = Mask.named(name)
    q = 0.03 / scatter_length_px(mask, 1.0)
    apart = []
    for size in (3.0, 5.5, 7.0, 11.0, 13.0, 17.3, 24.0, 30.0):
        width = psf_width(size) + 2
        light = render_psf(mask, size, width, diffraction_px=q) - render_psf(mask, size, width)
        apart.append(0.5 * np.abs(light).sum())
    assert max(apart) < 0.15
    assert np.median(apart) < 0.08


def test_learn_takes_the_camera_s_diffraction(tmp_path, capsys):
    camera = {"mask_extent_mm": 8, "focal_length_px": 1200, "focus_distance_m": 1.5}
    for name, extra in (("with", {"diffraction": True}), ("without", {})):
        file = camera_file(tmp_path, f"{name}.yaml", **camera, **extra)
        arguments = ("--camera", file, "--depth-range", 4, 50, "--level-count", 4, "--rank", 16)
        assert call(capsys, "learn", *arguments, "-o", tmp_path / f"{name}.npz").status == 0
    with_it, without = (load_bank(tmp_path / f"{name}.npz").stack for name in ("with", "without"))
    np.testing.assert_array_equal(with_it.blur_sizes_px, without.blur_sizes_px)
    assert 0.5 * np.abs(with_it.psfs[-1]).sum() == pytest.approx(0.5, abs=1e-3)
    assert with_it.psfs.shape[1] == without.psfs.shape[1] + 2 * diffraction_tail_px(
        Mask.named("levin"), 550e-6 * 1200 / 8
    )


def test_a_simulated_plane_is_convolved_with_the_diffracted_psf():
    camera = pinhole(12, diffraction=True)
    image = np.random.default_rng(0).random((80, 96), dtype=np.float32)
    psf = render_psf(camera.mask, float(camera.blur_size_px(4.0)),
                     diffraction_px=camera.psf_diffraction_px)  # fmt: skip
    reach = len(psf) // 2
    expected = signal.convolve2d(np.pad(image, reach, mode="edge"), psf, "valid")
    rendered = render_coded_frame(image, np.full(image.shape, 4.0), camera)
    assert rendered == pytest.approx(expected, abs=5e-3)
    geometric = render_coded_frame(image, np.full(image.shape, 4.0), pinhole(12, diffraction=False))
    # Without it the difference is larger by far.
    assert np.abs(geometric - expected).mean() > 5 * np.abs(rendered - expected).mean()


# ---- openings ----


def test_every_opening_has_its_place_and_its_airy_width():
    camera = pinhole(34)
    cells = np.zeros((34, 34))
    cells[0:8, 0:8] = 1
    cells[32:34, 13:21] = 1
    camera = Camera(1200, 1.9, 640, 480, Mask("two", cells), 34)
    large, small = mask_openings(camera.mask).each
    assert (large.width * 34, large.x * 34, large.y * 34) == pytest.approx((8, -13, -13))
    assert (small.width * 34, small.x * 34, small.y * 34) == pytest.approx((2, 0, 16))
    # 2.44 wavelengths times the f-number of the opening, in pixels.
    for opening, width_mm in ((large, 8), (small, 2)):
        by_hand = 2.44 * 0.55e-3 * 1200 / width_mm
        assert airy_width_px(camera, opening.width) == pytest.approx(by_hand)
    # 2 mm blur by 10 px of 34 mm to 0.59 px; the Airy disc has 0.81 px.
    warning = diffraction_warning(camera, 10.0)
    assert warning.startswith("mask two: the opening 2 mm wide, +0.0 mm right and +16.0 mm below")
    assert "Airy disc of 0.8 px (550 nm), wider than its blur of 0.6 px" in warning
    assert diffraction_warning(camera, -14.0) == ""


def test_commands_warn_of_openings_that_diffraction_hides(tmp_path, capsys, caplog):
    np.save(tmp_path / "image.npy", np.full((64, 64), 0.5, np.float32))
    np.save(tmp_path / "depth.npy", np.full((64, 64), 8.0, np.float32))
    scene = ("--image", tmp_path / "image.npy", "--depth", tmp_path / "depth.npy")
    levels = ("--depth-range", 4, 50, "--level-count", 4, "--rank", 16)
    for command, options in (
        (("learn",), (*levels, "-o", tmp_path / "bank.npz")),
        (("simulate",), (*scene, "-o", tmp_path / "coded.npy")),
        (("mask", "print"), ("-o", tmp_path / "mask.svg")),
    ):
        for extent_mm, warned in ((4, True), (40, False)):
            lens = {"focal_length_px": 1200, "focus_distance_m": 1.5, "mask_extent_mm": extent_mm}
            camera = camera_file(tmp_path, **lens)
            caplog.clear()
            assert call(capsys, *command, "--camera", camera, *options).status == 0
            phrase = "diffraction hides its shape; take a wider mask"
            assert any(phrase in message for message in caplog.messages) == warned


def test_a_print_warns_of_what_cannot_be_cut(tmp_path, capsys, caplog):
    cells = np.zeros((10, 10), np.float32)
    cells[0:4, 0:4] = cells[0:4, 5:9] = cells[8:10, 0:10] = 1
    np.save(tmp_path / "mask.npy", cells)
    arguments = ("mask", "print", tmp_path / "mask.npy", "-o", tmp_path / "mask.svg", "--json")
    opening, bar = "the narrowest opening, 0.40 mm", "the narrowest bar between openings, 0.20 mm"
    for extra, warned in (
        (("--extent-mm", 2), (bar,)),
        (("--extent-mm", 2, "--smallest-cut-mm", 0.5), (opening, bar)),
        (("--extent-mm", 2, "--smallest-cut-mm", 0.1), ()),
        (("--extent-mm", 20), ()),
    ):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            assert call(capsys, *arguments, *extra).status == 0
        assert len(caplog.messages) == len(warned)
        for message, phrase in zip(caplog.messages, warned, strict=True):
            assert phrase in message
    summary = yaml.safe_load(call(capsys, *arguments, "--extent-mm", 2).out)
    assert summary["narrowest_bar_mm"] == pytest.approx(0.2)
    assert call(capsys, *arguments, "--extent-mm", 2, "--smallest-cut-mm", 0).status == 2
