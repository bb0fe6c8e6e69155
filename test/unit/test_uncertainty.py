"""How far the pixels of an all-in-focus frame can be relied on."""

import numpy as np
import pytest
from deblur_scene import NOISE, deblurrer, edges_and_texture, levin_stack, relief

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur import FILLED, SEEN, UNCERTAIN
from coded_aperture_ros.deblur.iterative import blur_operator
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.deblur.uncertainty import classify_pixels

SHAPE = (96, 128)


@pytest.fixture(scope="module")
def scene():
    """A frame with a square before a slant, its blur sizes, and the truth."""
    sharp, blur = edges_and_texture((12, 16), 8), relief(SHAPE)
    operator = blur_operator(PsfBasis.from_stack(levin_stack()), blur, Workers(), "yes")
    coded = operator.forward(operator.extend(sharp))
    noise = np.random.default_rng(0).normal(0, NOISE, SHAPE)
    return (coded + noise).astype(np.float32), blur, sharp


def test_it_is_of_every_pixel_and_at_least_the_noise(scene):
    frame, blur, _ = scene
    colour = np.repeat(frame[..., None], 3, axis=2)
    for given in (frame, colour):
        found = deblurrer().uncertainty(given, given, blur, NOISE)
        assert found.std_dev.shape == found.kind.shape == SHAPE
        assert found.std_dev.dtype == np.float32 and (found.std_dev >= NOISE).all()


def test_it_says_what_was_not_seen(scene):
    """A lamp that is clipped, a gap of the depth, the rim of the square, and what is plain."""
    frame, blur, _ = scene
    frame, blur = frame.copy(), blur.copy()
    frame[60:90, 95:125] = 1.0
    blur[5:20, 100:120] = np.nan
    of = deblurrer()
    found = of.uncertainty(frame, of.deblur(frame, blur, NOISE), blur, NOISE)
    kind = found.kind
    assert (kind[70:80, 105:115] == FILLED).all()
    # It may be anything that there is in the frame.
    assert (found.std_dev[60:90, 95:125] >= 0.9 * frame[:60].std()).all()
    assert (kind[8:17, 103:117] == UNCERTAIN).all() and (kind[32:68, 40:44] == UNCERTAIN).all()
    assert (kind[70:90, 3:20] == SEEN).all()
    assert (kind == FILLED).mean() < 0.15


def test_what_is_in_a_narrow_gap_is_filled():
    """Behind two near surfaces, 4 px apart, less than half of the aperture sees anything."""
    blur = np.full(SHAPE, 2.0, np.float32)
    blur[:, 62:66] = 11.0
    frame = edges_and_texture((12, 16), 8)
    kind = deblurrer().uncertainty(frame, frame, blur, NOISE).kind
    assert (kind[20:-20, 63:65] == FILLED).all() and (kind[:, :40] == SEEN).all()


def test_a_picture_of_another_frame_is_refused(scene):
    frame, blur, sharp = scene
    with pytest.raises(InputError, match=r"all-in-focus frame: expected \[96, 128\]"):
        deblurrer().uncertainty(frame, sharp[:-1], blur, NOISE)


def test_levels_without_sizes_are_different_surfaces():
    blur, everywhere = np.zeros(SHAPE, np.float32), np.ones(SHAPE, bool)
    blur[:, 64:] = 1
    kinds = [
        classify_pixels(blur, everywhere, everywhere.astype(np.float32), px) for px in (True, False)
    ]
    assert (kinds[0] == SEEN).all()
    assert (kinds[1][:, 56:72] == UNCERTAIN).all() and (kinds[1][:, :50] == SEEN).all()


def test_of_a_frame_without_light_nothing_is_certain():
    frame, blur = np.full(SHAPE, np.nan, np.float32), np.full(SHAPE, 5, np.float32)
    found = deblurrer().uncertainty(frame, np.zeros_like(frame), blur, NOISE)
    assert np.isinf(found.std_dev).all() and (found.kind == FILLED).all()
