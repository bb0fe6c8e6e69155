"""Views through places of the aperture, of scenes whose places in them are known."""

import numpy as np
import pytest
from scipy import ndimage
from square_scene import red_square

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur import opening_centres, view_through
from coded_aperture_ros.metrics import psnr_db
from coded_aperture_ros.optics import MASK_NAMES, Mask, render_psf

HEIGHT, WIDTH = 80, 112
TOP, BOTTOM, LEFT, RIGHT = 24, 52, 40, 76


def square(near_px, far_px):
    """A red square before a blue background, and their blur sizes."""
    return red_square((HEIGHT, WIDTH), np.s_[TOP:BOTTOM, LEFT:RIGHT], near_px, far_px)


def centroid(picture):
    """Row and column of the middle of the light."""
    return np.array(ndimage.center_of_mass(picture))


@pytest.mark.parametrize("blur_px", [9.0, -9.0, 4.3, -12.6])
@pytest.mark.parametrize("cell", [(0, 4), (6, 5), (2, 0), (3, 6), (5, 3), (1, 1), (6, 0)])
def test_a_point_is_seen_where_the_psf_of_that_opening_alone_has_it(cell, blur_px):
    """All light of a point goes where an opening's image lies, on either side of the focus."""
    grid = np.zeros((7, 7))
    grid[cell] = 1
    ((found, place),) = opening_centres(Mask("one", grid)).items()
    assert found == cell
    psf = render_psf(Mask("one", grid), 70 * blur_px)  # on finer pixels
    expected = (centroid(psf) - (np.array(psf.shape) - 1) / 2) / 70
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    point = np.exp(-((row - 40) ** 2 + (column - 60) ** 2) / 8).astype(np.float32)
    view = view_through(point, np.full(point.shape, blur_px, np.float32), *place)
    # Cubic interpolation in OpenCV is off by up to a twentieth of a pixel.
    assert centroid(view) - centroid(point) == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize(
    "place", [(0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, 0), (0, -0.5), (0.25, -0.5)]
)
@pytest.mark.parametrize("sizes_px", [(4.0, 12.0), (-12.0, -4.0), (-8.0, 8.0)])
def test_the_nearer_covers_the_farther(place, sizes_px):
    """The square is whole where it is seen; what comes from behind it is background."""
    sharp, blur = square(*sizes_px)
    view = view_through(sharp, blur, *place)
    down, right = (round(each * sizes_px[0]) for each in place)
    seen = np.s_[TOP + down : BOTTOM + down, LEFT + right : RIGHT + right]
    assert view[seen] == pytest.approx(sharp[TOP:BOTTOM, LEFT:RIGHT], abs=1e-5)
    beside = np.ones((HEIGHT, WIDTH), bool)
    # Two pixels of rim go with the square; interpolation reaches another two.
    beside[seen[0].start - 4 : seen[0].stop + 4, seen[1].start - 4 : seen[1].stop + 4] = False
    assert view[beside][:, 0].max() < 0.01
    assert view[beside][:, 2].min() > 0.15
    # And where it was not hidden, the background has moved as it should.
    down, right = (round(each * sizes_px[1]) for each in place)
    rows, columns = np.s_[TOP + 2 : BOTTOM], np.s_[90:104]
    moved = view[rows.start + down : rows.stop + down, columns.start + right : columns.stop + right]
    assert moved == pytest.approx(sharp[rows, columns], abs=1e-5)


@pytest.mark.parametrize("place", [(0.31, -0.44), (-0.44, 0.31), (0.1, 0.5)])
def test_slanted_planes_are_stretched_without_cracks(place):
    """Of pictures that tell row and column."""
    row, column = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    blur = 8 + 0.1 * (column - 56) - 0.07 * (row - 40)
    # The point that a pixel shows is found by going back and forth.
    origin = [row, column]
    for _ in range(50):
        there = 8 + 0.1 * (origin[1] - 56) - 0.07 * (origin[0] - 40)
        origin = [row - place[0] * there, column - place[1] * there]
    inside = np.s_[12:-12, 12:-12]
    for values, expected in zip((row, column), origin, strict=True):
        view = view_through(values / WIDTH, blur, *place) * WIDTH
        assert np.abs(view - expected)[inside].max() < 0.1


def test_the_view_through_the_middle_is_the_frame():
    sharp, blur = square(2.0, 9.0)
    view = view_through(sharp, blur, 0, 0)
    assert view.dtype == np.float32
    assert view == pytest.approx(sharp, abs=1e-6)
    assert view_through(sharp, 0 * blur, 0.4, -0.3) == pytest.approx(sharp, abs=1e-6)


def test_opposite_views_are_those_of_the_turned_frame():
    sharp, blur = square(3.0, 9.0)
    turned = view_through(sharp[::-1, ::-1], blur[::-1, ::-1], -0.2, 0.37)[::-1, ::-1]
    view = view_through(sharp, blur, 0.2, -0.37)
    # The lines that pixels move along are rounded the other way round.
    assert (np.abs(turned - view).max(axis=2) > 0.05).mean() < 0.02


def test_grey_frames_small_maps_and_gaps():
    sharp, blur = square(3.0, 9.0)
    colour, grey = (view_through(each, blur, 0.3, 0.45) for each in (sharp, sharp[..., 2]))
    assert grey == pytest.approx(colour[..., 2], abs=1e-6)
    small = blur[2::4, 2::4].copy()
    small[0, :5] = np.nan
    wrong = np.abs(view_through(sharp, small, 0.3, 0.45) - colour).max(axis=2) > 0.02
    assert wrong.mean() < 0.03


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 3, 3)])
@pytest.mark.parametrize("place", [(0.5, 0.2), (-0.1, 0.5), (0, 0.5), (-0.5, 0)])
def test_tiny_frames(shape, place):
    sharp, blur = np.random.default_rng(0).random((2, *shape), dtype=np.float32)
    blur = 20 * blur.reshape(*shape[:2], -1)[..., 0]
    view = view_through(sharp, blur, *place)
    assert view.shape == shape
    assert np.isfinite(view).all()
    assert view.flags.c_contiguous


def test_wrong_input_is_refused():
    sharp, blur = square(3.0, 9.0)
    for place in ((0.51, 0), (0, -0.6), (np.nan, 0), (0, np.inf)):
        with pytest.raises(InputError, match=r"expected a place within 0\.5 of the middle"):
            view_through(sharp, blur, *place)
    with pytest.raises(InputError, match="no pixel has a known depth"):
        view_through(sharp, np.full_like(blur, np.nan), 0, 0.1)
    with pytest.raises(InputError, match=r"blur map of 80x112 px .* of 112x80 px"):
        view_through(sharp, blur.T, 0, 0.1)
    with pytest.raises(InputError, match="floating values"):
        view_through((255 * sharp).astype(np.uint8), blur, 0, 0.1)


@pytest.mark.parametrize("name", MASK_NAMES)
def test_openings_lie_where_a_mask_lets_light_pass(name):
    mask = Mask.named(name)
    found = opening_centres(mask)
    assert found
    assert max(max(at) for at in found) < 11
    side = max(mask.transmission.shape)
    if side <= 11:
        assert sorted(found) == [tuple(at) for at in np.argwhere(mask.transmission).tolist()]
        for (row, column), place in found.items():
            assert place == pytest.approx([(row + 0.5) / side - 0.5, (column + 0.5) / side - 0.5])
    for down, right in found.values():
        assert max(abs(down), abs(right)) < 0.5


def test_fine_and_oblong_masks():
    mask = Mask("oblong", np.repeat([[1.0, 0.0, 1.0]], 2, axis=0))
    assert list(opening_centres(mask)) == [(0, 0), (0, 2), (1, 0), (1, 2)]
    assert opening_centres(mask)[0, 2] == pytest.approx((-1 / 6, 1 / 3))
    fine = np.zeros((40, 40))
    fine[:3, 36:] = 1
    fine[20, 20] = 0.1  # next to nothing
    # Groups of four cells, of the first of which a quarter is shut.
    assert opening_centres(Mask("fine", fine)) == {
        (0, 9): pytest.approx((1.5 / 40 - 0.5, 38 / 40 - 0.5))
    }
    assert len(opening_centres(Mask("fine", fine), most=40)) == 12


@pytest.mark.parametrize("side", ["far", "near", "both"])
def test_views_of_random_scenes_are_those_that_are_traced(side):
    pytest.importorskip("numba", reason="random scenes need numba")
    from coded_aperture_ros.simulation.layered import random_scene
    from coded_aperture_ros.simulation.layered.tracing import traced

    scene = random_scene(2, Mask.named("levin"), side, (160, 200))
    sharp, blur = np.clip(scene.all_in_focus(), 0, 1), scene.blur_size_px()
    for place in ((-0.45, -0.27), (0.36, 0.45), (0.45, 0), (0, -0.45)):
        true = traced(list(scene.layers), scene.shape, np.array([[*place, 1]], np.float32))
        ours, opposite, still = (
            psnr_db(view_through(sharp, blur, *(sign * each for each in place)), true)
            for sign in (1, -1, 0)
        )
        assert ours > still + 3 > opposite
