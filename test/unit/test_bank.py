"""The filter bank: its energies, what they identify, and its file."""

import dataclasses

import numpy as np
import pytest
from textures import blurred_texture

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank import (
    LearnConfig,
    NaturalImagePrior,
    check_frame_size,
    check_setting,
    learn_bank,
    learn_bank_for_camera,
    load_bank,
    save_bank,
)
from coded_aperture_ros.likelihood.bank.hypotheses import factor_weights
from coded_aperture_ros.likelihood.scoring import MIN_NOISE_SHARE
from coded_aperture_ros.optics import Camera, Mask, PsfStack, render_psf_stack

SIZES = np.linspace(3.0, 13.0, 9)
NOISE = 0.002


@pytest.fixture(scope="module")
def bank():
    return learn_bank(render_psf_stack(Mask.named("levin"), SIZES), LearnConfig(window_px=32))


def direct_energies(bank, image, noise):
    """The energies as their definition says, patch by patch, trying many noises."""
    fourier, prior = bank.fourier, bank.prior
    power, _ = fourier.power(image, 16)
    counts = fourier.multiplicity.astype(float)
    energies = np.full((*power.shape[:2], bank.levels), np.inf)
    variances = noise**2 * np.geomspace(0.01, 3000, 600)[:, None, None, None]

    def energy(texture):
        """For noise alone, or a texture that many times as strong as the noise."""
        expected = variances * (texture + 1)
        # The patch has a little noise of its own beside what is seen.
        own = MIN_NOISE_SHARE * noise**2 / variances[..., 0] * counts.sum()
        return ((power / expected + np.log(expected / noise**2)) @ counts + own).min(axis=0)

    # For each ratio of contrast to noise that is plausible at the noise that is told.
    for ratio in np.array(prior.contrasts) / noise**2:
        for slope in prior.slopes:
            for level, psf in enumerate(bank.stack.psfs):
                texture = ratio * (fourier.expected_power(psf, slope) + prior.model_error**2)
                energies[..., level] = np.minimum(energies[..., level], energy(texture))
    return np.minimum(energies, energy(0)[..., None]) - counts.sum()


def test_energies_are_those_of_the_definition(bank):
    # With this noise the contrasts of the prior fall onto the bank's ratios.
    noise = float(np.sqrt(bank.prior.contrasts[0] / bank.ratios[5]))
    few = PsfStack(bank.blur_sizes_px[1:4], bank.stack.psfs[1:4])
    full = learn_bank(few, LearnConfig(window_px=16, rank=4096))
    # Twice the noise that is told, so that the best noise is not the least.
    image = blurred_texture(few.psfs[1], noise=2 * noise, size=64)
    energies = full.energies(image, 16, noise)
    assert energies == pytest.approx(direct_energies(full, image, noise), rel=2e-3)


@pytest.mark.parametrize("level", [0, 4, 8])
@pytest.mark.parametrize("contrast", [0.002, 0.05])
def test_the_level_of_a_texture_is_found_whatever_its_contrast(bank, level, contrast):
    image = blurred_texture(bank.stack.psfs[level], contrast)
    found = bank.energies(image, 8, 1.1 * NOISE).argmin(axis=-1)
    assert np.mean(found == level) > 0.85
    assert np.mean(np.abs(found - level) <= 1) > 0.95


def test_common_basis_loses_little_and_says_how_much(bank):
    small = learn_bank(bank.stack, LearnConfig(window_px=32, rank=16))
    full = learn_bank(bank.stack, LearnConfig(window_px=32, rank=4096))
    assert full.truncation_error < 1e-5 < bank.truncation_error < small.truncation_error
    image = blurred_texture(bank.stack.psfs[4])

    def found(bank):
        return bank.energies(image, 4, NOISE).argmin(axis=-1)

    assert np.mean(np.abs(found(bank) - found(full))) < 0.05


@pytest.mark.parametrize("filters", [20, 40])
def test_factorisation_is_the_best_one_for_its_scale(filters):
    random = np.random.default_rng(0)
    weights, scale = random.random((filters, 30)), random.uniform(0.1, 10, 30)
    singular = np.linalg.svd(weights * scale, compute_uv=False)
    for rank in (1, 7, 30, 99):
        basis, coefficients = factor_weights(weights[None], scale[None], rank)
        residual = np.linalg.norm(((basis @ coefficients[:, 0]).T - weights) * scale)
        assert residual == pytest.approx(np.linalg.norm(singular[rank:]), abs=1e-3)


def test_every_ratio_is_factored_in_its_own_scale():
    """Spectra without noise span decades; their filters are not sacrificed to the others."""
    random = np.random.default_rng(0)
    scales = np.stack([np.ones(30), np.geomspace(1, 1e5, 30)])
    weights = random.random((2, 40, 30)) / scales[:, None]
    basis, coefficients = factor_weights(weights, scales, 12)
    fitted = coefficients[:, 1].T @ basis.T
    common = np.sqrt(scales.prod(axis=0))
    in_common = np.linalg.lstsq(basis * common[:, None], (weights[1] * common).T, rcond=None)[0]

    def error(filters):
        return np.linalg.norm((filters - weights[1]) * scales[1])

    assert error(fitted) < 0.9 * error((basis @ in_common).T)


def test_patch_without_texture_has_no_preference(bank):
    black = bank.energies(np.zeros((64, 64), np.float32), 8, NOISE)
    assert np.ptp(black, axis=-1).max() < 1e-3
    noise = np.random.default_rng(3).normal(0.5, NOISE, (96, 96)).astype(np.float32)
    flat = bank.energies(noise, 8, 1.15 * NOISE)
    assert np.mean(np.ptp(flat, axis=-1) < 1e-3) > 0.9


def test_bank_file_round_trip(bank, tmp_path):
    path = tmp_path / "bank.npz"
    save_bank(bank, path)
    loaded = load_bank(path)
    image = blurred_texture(bank.stack.psfs[2])
    ours = bank.energies(image, 8, NOISE)
    assert np.array_equal(ours, loaded.energies(image, 8, NOISE))
    assert loaded.prior == bank.prior
    assert loaded.learned_from == bank.learned_from
    np.testing.assert_array_equal(loaded.ratios, bank.ratios)
    assert np.array_equal(loaded.blur_sizes_px, SIZES)
    assert [entry.name for entry in tmp_path.iterdir()] == ["bank.npz"]


def test_bank_file_remembers_that_sizes_are_indices(bank, tmp_path):
    import dataclasses

    stack = dataclasses.replace(bank.stack, in_pixels=False)
    save_bank(dataclasses.replace(bank, stack=stack), tmp_path / "bank.npz")
    assert not load_bank(tmp_path / "bank.npz").stack.in_pixels
    save_bank(bank, tmp_path / "bank.npz")
    assert load_bank(tmp_path / "bank.npz").stack.in_pixels


def rewritten(path, **changes):
    with np.load(path) as archive:
        arrays = {**archive, **changes}
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda path: path.unlink(), "no such file"),
        (lambda path: path.write_bytes(b""), "truncated"),
        (lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]), "truncated"),
        (lambda path: path.write_text("not a bank"), "truncated, or not an .npz"),
        (lambda path: np.savez(path, a=np.zeros(3)), "some other .npz file"),
        (lambda path: rewritten(path, schema_version=99), "version 99.*upgrade"),
        (lambda path: rewritten(path, basis=None), "without basis: learn it again"),
        (lambda path: rewritten(path, basis=np.zeros((3, 3))), "damaged.*basis"),
        (lambda path: rewritten(path, basis=1.0), "damaged.*basis"),
        (lambda path: rewritten(path, log_determinants=np.full((16, 3, 9), np.nan)), "damaged"),
        (lambda path: rewritten(path, window_px=33), "damaged.*even"),
        (
            lambda path: rewritten(path, blur_sizes_px=[3.0], psfs=np.full((1, 3, 3), 1 / 9)),
            "damaged.*at least 2 levels",
        ),
    ],
)
def test_unusable_bank_file_is_refused_by_name(bank, tmp_path, spoil, reason):
    path = tmp_path / "bank.npz"
    save_bank(bank, path)
    spoil(path)
    with pytest.raises(InputError, match=f"bank.npz.*{reason}") as refusal:
        load_bank(path)
    assert "\n" not in str(refusal.value)


def test_pickled_objects_are_never_loaded(tmp_path):
    path = tmp_path / "bank.npz"
    np.savez(path, schema="coded-aperture filter bank", basis=np.array([{}], dtype=object))
    with pytest.raises(InputError, match="plain arrays"):
        load_bank(path)


def test_bank_of_a_camera_has_equally_spaced_sizes_and_knows_depths():
    camera = Camera(800.0, 0.9, 640, 480, Mask.named("levin"), 25.4)
    bank = learn_bank_for_camera(camera, 1.0, 2.5, 7, LearnConfig(window_px=32))
    assert np.ptp(np.diff(bank.blur_sizes_px)) < 1e-9
    assert bank.stack.depths_m[[0, -1]] == pytest.approx([1.0, 2.5])
    halfway = bank.stack.interpolate_depth(np.array([2.5]))
    middle = bank.blur_sizes_px[2:4].mean()
    assert halfway == pytest.approx([float(camera.depth_m(middle))], rel=1e-6)
    assert bank.stack.interpolate_blur_size(halfway) == pytest.approx([middle], rel=1e-6)
    assert "levin" in bank.learned_from


def test_unusable_levels_of_a_camera_are_refused():
    camera = Camera(800.0, 0.9, 640, 480, Mask.named("levin"), 25.4)
    for levels in (-1, 0, 1):
        with pytest.raises(InputError, match=f"at least 2 levels, got {levels}"):
            learn_bank_for_camera(camera, 1.0, 2.5, levels)
    with pytest.raises(InputError, match="1 to inf m: a bank needs finite depths"):
        learn_bank_for_camera(camera, 1.0, np.inf, 7)


def test_unusable_levels_are_refused():
    stack = render_psf_stack(Mask.named("disc"), [3.0])
    with pytest.raises(InputError, match="at least 2 levels"):
        learn_bank(stack)
    with pytest.raises(InputError, match=r"41 px does not fit the 32 px window"):
        learn_bank(render_psf_stack(Mask.named("disc"), [3.0, 40.0]), LearnConfig(window_px=32))
    with pytest.raises(InputError, match="window_px: expected 0 or an even number from 16"):
        LearnConfig(window_px=33)
    with pytest.raises(InputError, match="prior slopes"):
        NaturalImagePrior(slopes=())
    assert (
        PsfStack(np.arange(2.0), stack.psfs.repeat(2, axis=0)).interpolate_depth(np.zeros(1))
        is None
    )


def test_levels_out_of_order_are_refused():
    stack = render_psf_stack(Mask.named("disc"), [3.0, 7.0, 5.0])
    with pytest.raises(InputError, match="blur sizes: levels must be in order"):
        learn_bank(stack)
    ordered = render_psf_stack(Mask.named("disc"), [7.0, 5.0, 3.0])
    learn_bank(ordered, LearnConfig(window_px=16))
    depths = PsfStack(np.arange(3.0), ordered.psfs, np.array([1.0, 3.0, 2.0]))
    with pytest.raises(InputError, match="depths: levels must be in order"):
        learn_bank(depths)


@pytest.mark.parametrize(("near_m", "far_m"), [(2100.0, 5100.0), (2.0, 2.001)])
def test_a_range_in_which_nothing_is_told_apart_is_refused(near_m, far_m):
    """Millimetres for metres, say."""
    camera = Camera(800.0, 1.0, 640, 480, Mask.named("levin"), 20.0)
    with pytest.raises(InputError, match=r"no two depths can be told apart: check the units"):
        learn_bank_for_camera(camera, near_m, far_m, 30)


def test_a_bank_knows_its_frames_and_its_camera(tmp_path):
    camera = Camera(800.0, 1.0, 640, 480, Mask.named("levin"), 20.0)
    save_bank(learn_bank_for_camera(camera, 1.5, 3.0, 4), tmp_path / "bank.npz")
    bank = load_bank(tmp_path / "bank.npz")
    assert (bank.image_width, bank.image_height) == (640, 480)
    check_frame_size(bank, 640, 480)
    with pytest.raises(InputError, match=r"of 1280x960: the bank is for 640x480.*scale 0.5$"):
        check_frame_size(bank, 1280, 960)
    with pytest.raises(InputError, match=r"frame of 320x240.*learn a bank for 320x240 \(sizes of"):
        check_frame_size(bank, 320, 240)
    with pytest.raises(InputError, match="another setting of the camera"):
        check_setting(bank, dataclasses.replace(camera, focus_distance_m=1.1))
    for scale in (1, 0.5):
        assert check_setting(bank, camera.scaled(scale)) == camera
    unknown = dataclasses.replace(bank, image_width=0, setting_digest="")
    check_frame_size(unknown, 320, 240)
    check_setting(unknown, dataclasses.replace(camera, focus_distance_m=1.1))
