"""Learning from pictures of planes whose mask nobody tells."""

import dataclasses

import numpy as np
import pytest
from asymmetric_planes import (
    DEPTHS_M,
    FOCUS_M,
    LARGEST_PX,
    MASK,
    NOISE,
    WINDOW,
    few_steps,
    folder_of,
    plane,
)
from cli_scene import call, everything, refused, wrong_usage
from scipy.signal import fftconvolve

from coded_aperture_ros.calibration.mask.fit import Variables
from coded_aperture_ros.calibration.mask.sizes import FreeSizes
from coded_aperture_ros.calibration.mask.spectra import autocorrelation_to_power, half_plane
from coded_aperture_ros.calibration.planes.calibrate import learn_bank_from_planes
from coded_aperture_ros.calibration.planes.folder import load_folder
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.calibration.planes.search import MaskSearch
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank import LearnConfig, WindowedFourierBasis, load_bank
from coded_aperture_ros.optics import Mask, render_psf


@pytest.fixture(scope="module")
def planes():
    images = tuple(plane(depth, seed) for seed, depth in enumerate(DEPTHS_M))
    return Planes(images, DEPTHS_M, tuple(f"{i}.png" for i in range(len(images))))


@pytest.fixture(scope="module")
def learned(planes):
    # Half of the starts and of the steps.
    config = LearnConfig(window_px=WINDOW)
    return learn_bank_from_planes(
        planes, 13, config, progress=lambda steps: [*steps[:6:2], *steps[8:10]]
    )


def test_new_planes_are_put_where_they_are(learned):
    for seed, depth in ((100, 1.5), (101, 2.2), (102, 3.1)):
        image = plane(depth, seed)
        energies = learned.energies(image, 6, 1.1 * NOISE)
        found = learned.stack.interpolate_depth(energies.argmin(axis=-1).astype(float))
        spacing = np.interp(depth, learned.stack.depths_m[:-1], np.diff(learned.stack.depths_m))
        assert np.median(np.abs(found - depth)) < 0.75 * spacing


def test_bank_knows_depths_focus_and_the_size_of_the_blur(learned):
    assert learned.stack.depths_m[[0, -1]] == pytest.approx(DEPTHS_M[[0, -1]])
    assert np.ptp(np.diff(learned.blur_sizes_px)) < 1e-9
    inverse = 1 / learned.stack.depths_m
    sizes = learned.blur_sizes_px
    focus = 1 / (inverse[0] - sizes[0] * (inverse[-1] - inverse[0]) / (sizes[-1] - sizes[0]))
    assert focus == pytest.approx(FOCUS_M, rel=0.05)
    assert sizes[-1] == pytest.approx(LARGEST_PX, abs=1.6)
    assert f"{len(DEPTHS_M)} planes" in learned.learned_from
    assert not learned.mask_digest  # its own depths hold beside any camera file


def test_psfs_of_the_bank_have_the_autocorrelation_of_the_true_ones(learned):
    def power(psf):
        return np.abs(np.fft.rfft2(psf, (32, 32))) ** 2

    true = power(render_psf(MASK, LARGEST_PX))
    ours = power(learned.stack.psfs[-1])
    disc = power(render_psf(Mask.named("disc"), LARGEST_PX))
    assert np.linalg.norm(ours - true) < 0.5 * np.linalg.norm(disc - true)


def test_planes_in_front_of_the_focus_are_recognised(planes):
    # Blur that grows towards the camera.
    mirrored = Planes(planes.images, 1 / (0.25 + 0.85 - 1 / DEPTHS_M), planes.names)
    assert mirrored.depths_m == pytest.approx(DEPTHS_M)
    search = MaskSearch(mirrored, WINDOW, lambda steps: [steps[0], steps[1], steps[4], steps[5]])
    sizes = search.mixture().sizes
    assert sizes.sign == -1
    assert sizes.lens.focus_distance_m > DEPTHS_M[-1]
    assert sizes.lens.depth_m(-sizes.px) == pytest.approx(DEPTHS_M)


def test_power_is_linear_in_the_autocorrelation():
    fourier = WindowedFourierBasis(16)
    psf = render_psf(MASK, 6.3).astype(float)
    lags = half_plane(len(psf) - 1)
    correlation = fftconvolve(psf, psf[::-1, ::-1])[tuple((lags + len(psf) - 1).T)]
    power = autocorrelation_to_power(fourier, 2.4, lags) @ correlation
    assert power == pytest.approx(fourier.expected_power(psf, 2.4), abs=1e-6)
    assert power.max() > 1


def test_gradient_is_that_of_the_likelihood(planes):
    search = MaskSearch(planes, 16)
    start = search.start(2, 1.6, 1, 0.2)
    free = dataclasses.replace(start, sizes=FreeSizes(start.sizes_px, 8.0))
    random = np.random.default_rng(0)
    for fit, masks in ((start, True), (free, True), (free, False)):
        variables = Variables(fit, search.likelihood, masks)
        x = variables.start
        _, gradient = variables.value_and_gradient(x)
        for _ in range(3):
            direction = random.normal(size=x.size) * np.maximum(np.abs(x), 0.1)
            step = 1e-5
            above, below = (
                variables.value_and_gradient(x + sign * step * direction)[0] for sign in (1, -1)
            )
            assert (above - below) / (2 * step) == pytest.approx(gradient @ direction, rel=1e-3)


@pytest.mark.slow
def test_focus_of_ray_traced_planes_is_found(data_dir):
    planes = load_folder(data_dir / "rendered" / "calib")
    sizes = MaskSearch(planes, 32, lambda steps: [steps[1], steps[8]]).mixture().sizes
    assert sizes.lens.focus_distance_m == pytest.approx(0.75, rel=0.04)
    assert sizes.lens.depth_m(sizes.px[[0, -1]]) == pytest.approx([0.8182, 4.5], rel=1e-4)


@pytest.mark.slow
def test_blur_wider_than_half_the_window_is_told(planes, caplog, monkeypatch):
    monkeypatch.setattr("coded_aperture_ros.calibration.mask.cells._STARTS", 4)
    search = MaskSearch(planes, 16, lambda steps: steps)
    search.single(search.mixture())
    assert "half the window of 16 px, or more" in caplog.text


def changed(number, **values):
    """Change one entry; None removes a key."""

    def change(entries):
        entry = {**entries[number], **values}
        entries[number] = {key: value for key, value in entry.items() if value is not None}
        return entries

    return change


FLAT = np.full((48, 48), 0.4, np.float32)
NOISY = FLAT + np.random.default_rng(0).normal(0, 0.004, FLAT.shape).astype(np.float32)
CLIPPED = np.where(np.arange(48) < 24, 1, plane(2.1, 3, 48)).astype(np.float32)


@pytest.mark.parametrize(
    ("entries", "pictures", "phrases"),
    [
        (lambda _: "[", {}, ["planes.json: not JSON"]),
        (lambda _: {"file": 3}, {}, ["planes.json: expected a list"]),
        (lambda _: [1, 2], {}, ["planes.json: entry 0", "got 1"]),
        (changed(2, file=None), {}, ["planes.json: entry 2 has no file"]),
        (changed(2, depth_m=None), {}, ["planes.json: entry 2 has no depth_m"]),
        (changed(2, depth_m="far"), {}, ["planes.json: entry 2: depth_m cannot be 'far'"]),
        (changed(2, depth_m=True), {}, ["planes.json: entry 2: depth_m cannot be True"]),
        (changed(2, depth_m=-1.5), {}, ["plane_2.png: depth_m -1.5 is not a positive"]),
        (changed(2, depth_m=float("nan")), {}, ["plane_2.png: depth_m nan is not a positive"]),
        (changed(2, depth_m=1.2), {}, ["plane_2.png: depth_m 1.2", "plane_0.png"]),
        (changed(2, file="no.png"), {}, ["cannot read", "no.png"]),
        (lambda entries: entries[:3], {}, ["3 planes are too few", "at least 4"]),
        (lambda _: [], {}, ["0 planes are too few"]),
        (None, {"plane_3": FLAT[:40]}, ["plane_3.png: 48x40 px", "plane_0.png has 48x48"]),
        (None, {"plane_3": FLAT}, ["plane_3.png: contrast 0 is not above the noise", "texture"]),
        (None, {"plane_3": NOISY}, ["plane_3.png: contrast", "is not above the noise", "texture"]),
        (None, {"plane_3": CLIPPED}, ["plane_3.png: 50% of the pixels are saturated"]),
    ],
)
def test_unusable_planes(tmp_path, capsys, entries, pictures, phrases):
    folder = folder_of(tmp_path, entries, **pictures)
    before = everything(tmp_path)
    arguments = ("--planes", folder, "--window-px", WINDOW, "-o", tmp_path / "bank.npz")
    refused(call(capsys, "learn", *arguments), *phrases)
    assert everything(tmp_path) == before


def test_unusable_folders(tmp_path, capsys):
    output = ("-o", tmp_path / "bank.npz")
    refused(call(capsys, "learn", "--planes", tmp_path, *output), "planes.json", '"depth_m"')
    folder = folder_of(tmp_path)
    small = call(capsys, "learn", "--planes", folder, "--window-px", 64, *output)
    refused(small, "plane_0.png: image of 48x48 px is smaller than the bank's 64 px window")
    one = call(capsys, "learn", "--planes", folder, "--level-count", 1, *output)
    wrong_usage(one, "learn", "--level-count: 1 is out of range")


def test_planes_out_of_order_are_refused(planes):
    """And those from the farthest to the nearest are turned round."""
    turned = Planes(planes.images[::-1], planes.depths_m[::-1], planes.names[::-1])
    assert np.array_equal(turned.depths_m, planes.depths_m)
    assert turned.names == planes.names
    order = [0, 2, 1, *range(3, len(planes.names))]
    shuffled = (
        [planes.images[i] for i in order],
        planes.depths_m[order],
        [planes.names[i] for i in order],
    )
    depth = f"{planes.depths_m[1]:g}"
    with pytest.raises(InputError, match=rf"{planes.names[1]}: depth_m {depth} is out of order"):
        Planes(tuple(shuffled[0]), shuffled[1], tuple(shuffled[2]))


def test_planes_with_holes_are_refused(planes):
    with pytest.raises(InputError, match="NaN"):
        dataclasses.replace(planes, images=(planes.images[0] * np.nan, *planes.images[1:]))


def test_from_the_command_line(tmp_path, capsys, monkeypatch):
    few_steps(monkeypatch)
    folder = folder_of(tmp_path)
    bank_file = tmp_path / "bank.npz"
    result = call(
        capsys,
        *("learn", "--planes", folder, "--level-count", 5, "--window-px", WINDOW, "--rank", 8),
        *("-o", bank_file),
    )
    assert (result.status, result.err) == (0, "")
    assert "from 6 planes at 1.2 to 4 m" in result.out
    bank = load_bank(bank_file)
    assert bank.levels == 5
    assert bank.stack.depths_m[[0, -1]] == pytest.approx([1.2, 4.0])
