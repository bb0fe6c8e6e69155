"""Files that earlier releases wrote, kept as they are: they load, and tell what they told."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from textures import blurred_texture

from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood.bank import FilterBank, load_bank, save_bank
from coded_aperture_ros.optics import Camera, PsfStack, load_camera

STORED = Path(__file__).parents[1] / "stored"
# Blur sizes of the first two were asked for in pixels, of the others as depths before a camera.
IN_PIXELS = ("bank_version_1", "bank_version_2_without_stride")
OF_A_CAMERA = ("bank_version_1_with_depths", "bank_version_2")


def stored(name: str) -> FilterBank:
    return load_bank(STORED / f"{name}.npz")


def camera() -> Camera:
    return load_camera(STORED / "camera_version_1.yaml")


def test_every_stored_file_is_tested():
    banks = {f"{name}.npz" for name in (*IN_PIXELS, *OF_A_CAMERA)}
    others = {"camera_version_1.yaml", "psf_stack_version_1.npz"}
    assert {path.name for path in STORED.iterdir()} == banks | others


@pytest.mark.parametrize(
    ("name", "version"), [("bank_version_1", 1), ("bank_version_2_without_stride", 2)]
)
def test_the_stored_banks_are_as_old_as_their_names_say(name, version):
    with np.load(STORED / f"{name}.npz", allow_pickle=False) as arrays:
        assert arrays["schema_version"] == version
        assert "stride_px" not in arrays


@pytest.mark.parametrize("name", IN_PIXELS)
def test_banks_of_blur_sizes_tell_them_as_ever(name):
    bank = stored(name)
    np.testing.assert_allclose(bank.blur_sizes_px, [2, 3, 4, 5])
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0))
    # By its own PSFs, which are not those of today.
    for size, psf in zip((2, 4, 5), bank.stack.psfs[[0, 2, 3]], strict=True):
        frame = blurred_texture(psf, noise=0.001, contrast=0.05)
        found = estimator.estimate(frame).blur_size_px
        assert abs(np.median(found[24:-24, 24:-24]) - size) < 0.5


@pytest.mark.parametrize("name", OF_A_CAMERA)
def test_banks_of_a_camera_know_its_depths(name):
    bank, own = stored(name), camera()
    assert bank.stack.depths_m is not None
    np.testing.assert_allclose(bank.stack.depths_m[[0, -1]], [0.7, 0.9])
    np.testing.assert_allclose(own.blur_size_px(bank.stack.depths_m), bank.blur_sizes_px)
    assert bank.mask_digest == own.mask.digest


def test_only_banks_that_know_their_frames_refuse_others():
    assert (stored("bank_version_2").image_width, stored("bank_version_1").image_width) == (640, 0)


@pytest.mark.parametrize("name", (*IN_PIXELS, *OF_A_CAMERA))
def test_an_old_bank_saved_again_is_the_same(name, tmp_path):
    before = stored(name)
    save_bank(before, tmp_path / "bank.npz")
    after = load_bank(tmp_path / "bank.npz")
    for field in ("basis", "coefficients", "log_determinants", "ratios"):
        np.testing.assert_array_equal(getattr(after, field), getattr(before, field))
    assert (after.stride_px, after.highest_frequency) == (
        before.stride_px,
        before.highest_frequency,
    )


def test_the_first_stack_of_psfs_loads():
    stack = PsfStack.load(STORED / "psf_stack_version_1.npz")
    np.testing.assert_allclose(stack.blur_sizes_px, [2, 3, 4, 5])
    np.testing.assert_allclose(stack.psfs.sum(axis=(1, 2)), 1, atol=1e-5)


def test_the_first_camera_file_means_what_it_meant():
    own = camera()
    # Thesis 3.28, by hand: M f_px (1/z_focus - 1/z) with f_px = v / pitch, 1/v = 1/f - 1/z_focus.
    image_distance_m = 1 / (1 / 0.05 - 1 / 0.6)
    expected = 8e-3 * image_distance_m / 12e-6 * (1 / 0.6 - 1 / 0.9)
    assert own.blur_size_px(0.9) == pytest.approx(expected)
    assert yaml.safe_load((STORED / "camera_version_1.yaml").read_text())["side"] == own.side
