"""PSFs measured from dots, and their stack."""

import dataclasses

import numpy as np
import pytest
from psf_pictures import dot_picture, error_of

from coded_aperture_ros.calibration.pictures import psf_picture
from coded_aperture_ros.calibration.psf.centre import CentredPsf
from coded_aperture_ros.calibration.psf.dots import psf_from_dots
from coded_aperture_ros.calibration.psf.fine import mask_psf
from coded_aperture_ros.calibration.psf.stack import psf_stack
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask, render_psf

SMALL = {"size": (260, 320), "spacing_px": 29.3}


@pytest.mark.parametrize(
    ("mask", "blur_size_px"),
    [
        ("levin", 3.0),
        ("zhou", 3.0),
        pytest.param("zhou", -7.3, marks=pytest.mark.slow),
        ("four_hole", 5.0),
    ],
)
def test_dots_give_the_psf_within_3_percent(mask, blur_size_px):
    """Noise, dots 0.3 px off the grid, vignetting, uneven background light."""
    # A PSF of a few px hardly tells the side of the focus.
    sign = 1.0 if mask == "zhou" and blur_size_px == 3.0 else None
    measured = psf_from_dots(dot_picture(mask, blur_size_px), Mask.named(mask), sign)
    found = measured.centred(Mask.named(mask), sign)
    psf = found.psf(15)
    assert found.blur_size_px == pytest.approx(blur_size_px, abs=0.06)
    assert error_of(psf, mask, blur_size_px) < 0.03
    assert psf.sum() == pytest.approx(1)
    assert psf.min() >= 0
    assert found.misfit < 0.04
    assert measured.snr > 50
    assert measured.field_variation < 0.02
    assert (measured.missing, measured.saturated) == (0, 0)
    assert measured.used > 100


@pytest.mark.slow
def test_without_a_mask_the_centre_of_light_is_the_centre():
    """In three channels; blur sizes are right in proportion."""
    sizes = []
    for true in (6.0, 9.0):
        grey = dot_picture("levin", true, **SMALL)
        found = psf_from_dots(np.stack([0.8 * grey, grey, 1.2 * grey], axis=-1)).centred()
        assert error_of(found.psf(15), "levin", true) < 0.04
        assert np.isnan(found.misfit)
        sizes.append(found.blur_size_px)
    assert sizes[1] / sizes[0] == pytest.approx(1.5, rel=0.02)


@pytest.mark.slow
def test_field_variation_is_seen():
    """Blur that grows over the picture, as of a tilted grid."""
    sharp, soft = (dot_picture("levin", size, jitter_px=0.1, **SMALL) for size in (8.0, 9.5))
    share = np.linspace(0, 1, sharp.shape[1])
    assert psf_from_dots((1 - share) * sharp + share * soft).field_variation > 0.08
    assert psf_from_dots(sharp).field_variation < 0.03


def test_a_few_missing_and_saturated_dots_and_specks_are_left_out():
    picture = dot_picture("levin", 8.0, missing=0.06, **SMALL)
    picture[100:104, 100:104] = 0.6
    picture[196:204, 196:204] = 1.0
    mask = Mask.named("levin")
    measured = psf_from_dots(picture, mask)
    assert 1 <= measured.missing <= 10
    assert measured.saturated + measured.rejected >= 1
    assert error_of(measured.centred(mask).psf(13), "levin", 8.0) < 0.04


def one_direction():
    picture = dot_picture("levin", 7.0, angle_deg=0, spacing_px=40.0)
    picture[:215] = picture[270:] = 0.04
    return picture


def noise_alone():
    return 0.1 + 0.01 * np.random.default_rng(0).standard_normal((200, 200))


@pytest.mark.parametrize(
    ("make", "phrase"),
    [
        (noise_alone, "no (grid|dots)"),
        (lambda: np.full((200, 200), 0.1), "no dots that repeat"),
        (one_direction, "no grid of dots|no dots that repeat|whole dots"),
        (lambda: dot_picture("levin", 9.0, size=(120, 120)), "whole dots in the picture"),
        (
            lambda: dot_picture("levin", 26.0, spacing_px=29.0),
            "the dots overlap|no dots that repeat",
        ),
        (lambda: dot_picture("disc", 22.0, spacing_px=24.3), "the dots overlap"),
        (
            lambda: dot_picture("levin", 9.0, peak=2.0),
            "dots are saturated: expose for a shorter time",
        ),
        (
            lambda: dot_picture("levin", 9.0, missing=0.45, **SMALL),
            "of the grid are missing, cover|missing",
        ),
        (lambda: dot_picture("levin", 9.0, peak=0.004, noise=0.004, **SMALL), "light|no dots"),
        (lambda: np.full((200, 200), np.nan), "NaN"),
    ],
)
def test_pictures_that_cannot_be_used(make, phrase):
    with pytest.raises(InputError, match=phrase):
        psf_from_dots(make())


def test_another_mask_is_refused():
    picture = dot_picture("four_hole", 11.0, **SMALL)
    with pytest.raises(InputError, match="the PSF differs from that of mask levin by"):
        psf_from_dots(picture, Mask.named("levin"))


# ---- the stack ----


def rendered(mask, size):
    return CentredPsf(mask_psf(Mask.named(mask), size), np.zeros(2), 23, size, 0.0)


def test_what_the_stack_has_between_two_sizes():
    """A PSF is as good between two measured ones as at them, if only its width changes."""
    stack = psf_stack([rendered("levin", size) for size in (15.0, 6.0, 9.0)], 10, (4.0, 2.0, 2.5))
    np.testing.assert_allclose(stack.blur_sizes_px, np.arange(6, 16))
    for psf, size in zip(stack.psfs, stack.blur_sizes_px, strict=True):
        assert error_of(psf, "levin", size) < 1e-5
    np.testing.assert_allclose(stack.depths_m[[0, 3, 9]], [2.0, 2.5, 4.0])
    np.testing.assert_allclose(np.diff(1 / stack.depths_m)[:3], (0.4 - 0.5) / 3)


def test_a_turned_mask_is_that_of_a_negative_size():
    for size in (5.0, -5.0):
        np.testing.assert_allclose(
            rendered("zhou", size).psf(7), render_psf(Mask.named("zhou"), size, 7), atol=1e-6
        )


@pytest.mark.parametrize(
    ("sizes", "depths", "phrase"),
    [
        ((6.0, 6.0, 8.0), None, r"a\.png and b\.png have the same blur size of 6\.00 px"),
        ((-6.0, 7.0, 8.0), None, r"a\.png has a blur size of -6.* both sides of the focus"),
        ((6.0, 7.0, 8.0), (1.0, 3.0, 2.0), r"b\.png at 3 m .* c\.png at 2 m .* check the depths"),
    ],
)
def test_blur_sizes_that_make_no_stack(sizes, depths, phrase):
    measured = [dataclasses.replace(rendered("levin", 6.0), blur_size_px=size) for size in sizes]
    with pytest.raises(InputError, match=phrase):
        psf_stack(measured, depths_m=depths, names=("a.png", "b.png", "c.png"))


def test_picture_of_psfs():
    drawn = psf_picture([rendered("levin", size).psf(13) for size in (3.0, 9.0)] * 5)
    assert (drawn.min(), drawn.max()) == (0, pytest.approx(1))
    assert drawn.shape[1] / drawn.shape[0] == pytest.approx(4, rel=0.05)
