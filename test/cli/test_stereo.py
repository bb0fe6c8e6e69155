"""Stereo pairs and anaglyphs of scenes whose disparities are known."""

import cv2
import numpy as np
import pytest
from scipy import ndimage
from square_scene import red_square

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur import Parallax, anaglyph, check_parallax, side_by_side, stereo_pair

HEIGHT, WIDTH = 96, 160
TOP, BOTTOM, LEFT, RIGHT = 24, 72, 60, 104
FAR_PX, NEAR_PX = 10.0, 4.0


@pytest.fixture(scope="module")
def square():
    """A red square before a blue background, and their blur sizes."""
    return red_square((HEIGHT, WIDTH), np.s_[TOP:BOTTOM, LEFT:RIGHT], NEAR_PX, FAR_PX)


def shift_of(patch, image, row, column):
    """How many columns farther right than `column` a patch of a picture is found in another."""
    reach = 14
    strip = image[row : row + patch.shape[0], column - reach : column + patch.shape[1] + reach]
    (errors,) = cv2.matchTemplate(np.ascontiguousarray(strip), patch, cv2.TM_SQDIFF)
    best = int(errors.argmin())
    before, least, after = errors[best - 1 : best + 2]
    return best - reach + (before - after) / (2 * (before - 2 * least + after))


@pytest.mark.parametrize("scale", [1.0, 1.7, 2.5])
def test_disparities_in_both_views(square, scale):
    sharp, blur = square
    left, right = stereo_pair(sharp, blur, Parallax(screen_px=8.0, scale=scale, largest_px=40.0))
    for channel, row, column, size_px in ((0, TOP + 8, LEFT + 8, 4.0), (2, 4, 60, 10.0)):
        patch = np.ascontiguousarray(sharp[row : row + 16, column : column + 28, channel])
        expected = scale * (8.0 - size_px) / 2
        assert shift_of(patch, left[..., channel], row, column) == pytest.approx(expected, abs=0.2)
        assert shift_of(patch, right[..., channel], row, column) == pytest.approx(
            -expected, abs=0.2
        )


def test_the_foreground_is_whole_and_covers_what_is_behind(square):
    sharp, blur = square
    left, right = stereo_pair(sharp, blur, Parallax(screen_px=10.0, scale=2.0, largest_px=40.0))
    rows = np.s_[TOP:BOTTOM]
    given = sharp[rows, LEFT:RIGHT]
    assert left[rows, LEFT + 6 : RIGHT + 6] == pytest.approx(given, abs=1e-5)
    assert right[rows, LEFT - 6 : RIGHT - 6] == pytest.approx(given, abs=1e-5)
    # The background is at the screen, so it stays where it is.
    assert left[: TOP - 4] == pytest.approx(sharp[: TOP - 4], abs=1e-5)
    assert left[rows, RIGHT + 6 + 4 :] == pytest.approx(sharp[rows, RIGHT + 6 + 4 :], abs=1e-5)


def test_what_is_far_does_not_cover_what_is_near(square):
    """Nor where it moves, and the foreground stays."""
    sharp, blur = square
    left, _ = stereo_pair(sharp, blur, Parallax(screen_px=NEAR_PX, scale=2.0, largest_px=40.0))
    inside = np.s_[TOP:BOTTOM, LEFT:RIGHT]
    assert left[inside] == pytest.approx(sharp[inside], abs=1e-5)
    assert shift_of(sharp[4:20, 60:88, 2].copy(), left[..., 2], 4, 60) == pytest.approx(-6, abs=0.1)


def test_holes_show_the_background_and_its_texture(square):
    sharp, blur = square
    left, right = stereo_pair(sharp, blur, Parallax(screen_px=10.0, scale=4.0, largest_px=40.0))
    rows = np.s_[TOP + 4 : BOTTOM - 4]
    # But for two pixels of rim beside the foreground, which moves by 12 px.
    holes = left[rows, LEFT : LEFT + 8], right[rows, RIGHT - 8 : RIGHT]
    for hole in holes:
        assert np.isfinite(hole).all()
        assert hole[..., 0].max() < 0.01
        assert hole[..., 2].min() > 0.15
        step = np.abs(np.diff(hole[..., 2], axis=1)).mean()
        assert step > 0.5 * np.abs(np.diff(sharp[:TOP, :, 2], axis=1)).mean()


def test_a_hole_between_two_foregrounds_shows_neither():
    """The background between them is narrower than the hole."""
    sharp = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    sharp[..., 2] = 0.6
    blur = np.full((HEIGHT, WIDTH), FAR_PX, np.float32)
    for columns, size_px in (((50, 80), 6.0), ((92, 122), 2.0)):
        sharp[:, slice(*columns)] = (0.6, 0, 0)
        blur[:, slice(*columns)] = size_px
    left, _ = stereo_pair(sharp, blur, Parallax(screen_px=10.0, scale=4.0, largest_px=40.0))
    # Each moves by twice the distance of its blur size from 10: they end at 88 and begin at 108.
    assert left[:, 92:105] == pytest.approx(np.broadcast_to(sharp[0, 0], (HEIGHT, 13, 3)), abs=1e-5)
    assert (left[:, 60:86, 0] > 0.5).all()
    assert (left[:, 110:136, 0] > 0.5).all()


@pytest.mark.parametrize(("screen_px", "hole_px"), [(FAR_PX + 3, 9), (NEAR_PX, 4)])
def test_borders_show_the_surface_that_ends_there(screen_px, hole_px):
    """Not the foregrounds near them, which at first move away, and then stay."""
    sharp = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    sharp[..., 2] = 0.6
    blur = np.full((HEIGHT, WIDTH), FAR_PX, np.float32)
    for columns in (np.s_[6:20], np.s_[-20:-6]):
        sharp[:, columns], blur[:, columns] = (0.6, 0, 0), NEAR_PX
    left, right = stereo_pair(sharp, blur, Parallax(screen_px, scale=6.0, largest_px=80.0))
    # What lies beyond the screen leaves the other border of each view.
    at_left, at_right = (left, right) if screen_px > FAR_PX else (right, left)
    for border in (at_left[:, :hole_px], at_right[:, -hole_px:]):
        assert border == pytest.approx(np.broadcast_to(sharp[0, 0], border.shape), abs=1e-5)


@pytest.mark.parametrize(
    ("slope", "step"), [(-1.4, 1), (-0.3, 1), (0.2, 1), (0.9, 1), (1.6, 1), (-0.2, 4), (0.1, 4)]
)
def test_slanted_planes_have_no_cracks(slope, step):
    """Of a picture that tells the column; half the slope is what a view is stretched by."""
    column = np.arange(WIDTH, dtype=np.float32)
    sharp = np.tile(0.1 + 0.8 * column / WIDTH, (HEIGHT, 1)).astype(np.float32)
    blur = np.tile(FAR_PX - slope * (column - WIDTH / 2), (HEIGHT, 1)).astype(np.float32)
    blur = cv2.resize(blur, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)
    left, right = stereo_pair(sharp, blur, Parallax(FAR_PX, scale=1.0, largest_px=0.4 * WIDTH))
    unclipped = np.abs(slope * (column - WIDTH / 2)) < 0.4 * WIDTH - 8
    for view, sign in ((left, 1), (right, -1)):
        place = column + sign * slope * (column - WIDTH / 2) / 2
        middle = (column > 50) & (column < 110) & np.interp(column, place, unclipped).astype(bool)
        expected = np.interp(column, place, sharp[0])
        error = WIDTH / 0.8 * np.abs(view - expected)[:, middle]
        assert error.max() < 0.25, sign
        assert np.isfinite(view).all()


def test_constant_depth_gives_equal_views_up_to_the_place_of_the_screen(square):
    sharp, _ = square
    blur = np.full((HEIGHT, WIDTH), 7.0, np.float32)
    for view in stereo_pair(sharp, blur, 8.0):
        assert view == pytest.approx(sharp, abs=1e-6)
    left, right = stereo_pair(sharp, blur, Parallax(screen_px=9.0, scale=3.0, largest_px=40.0))
    assert left[:, 3:] == pytest.approx(sharp[:, :-3], abs=1e-5)
    assert right[:, :-3] == pytest.approx(sharp[:, 3:], abs=1e-5)
    # What comes into view at the border is mirrored.
    assert left[:, :3] == pytest.approx(sharp[:, 2::-1], abs=1e-5)


def test_left_and_right_are_mirror_images(square):
    sharp, blur = square
    left, right = stereo_pair(sharp, blur, 9.0)
    mirrored = stereo_pair(sharp[:, ::-1], blur[:, ::-1], 9.0)
    assert np.array_equal(mirrored[0], right[:, ::-1])
    assert np.array_equal(mirrored[1], left[:, ::-1])


def test_grey_frames_are_rendered_like_each_channel(square):
    sharp, blur = square
    pair, grey = stereo_pair(sharp, blur, 9.0), stereo_pair(sharp[..., 2], blur, 9.0)
    for colour, alone in zip(pair, grey, strict=True):
        assert alone.dtype == np.float32
        assert alone == pytest.approx(colour[..., 2], abs=1e-6)


def test_small_maps_with_gaps_keep_their_steps(square):
    sharp, blur = square
    small = blur[2::4, 2::4].copy()
    small[3:5, 4:8] = np.nan
    small[0, 0] = np.inf
    parallax = Parallax(screen_px=10.0, scale=2.0, largest_px=40.0)
    pair, expected = stereo_pair(sharp, small, parallax), stereo_pair(sharp, blur, parallax)
    for view, full in zip(pair, expected, strict=True):
        assert np.isfinite(view).all()
        wrong = np.abs(view - full).max(axis=2) > 0.02
        # The corners of the square are rounder, by a pixel of the small map.
        assert ndimage.binary_opening(wrong, np.ones((5, 5))).sum() == 0
        assert wrong.mean() < 0.02


def test_rims_of_the_foreground_move_with_it(square):
    """Edge pixels mix both sides; left behind they would be the foreground's ghost."""
    sharp, blur = square
    soft = cv2.GaussianBlur(sharp, (3, 3), 0.6)
    left, _ = stereo_pair(soft, blur, Parallax(screen_px=10.0, scale=4.0, largest_px=40.0))
    beside = left[TOP + 4 : BOTTOM - 4, LEFT - 8 : LEFT + 8, 0]
    assert beside.max() < 0.02


def test_parallax_of_a_scene():
    blur = np.linspace(2, 12, 1001, dtype=np.float32).reshape(7, 143)
    parallax = Parallax.from_scene(blur, 20.0)
    assert parallax.screen_px == pytest.approx(7.0)
    disparity = parallax.disparity_px(blur)
    assert disparity.dtype == np.float32
    assert (disparity.max(), disparity.min()) == (20.0, -20.0)
    assert disparity[0, 0] == 20.0  # what is near is in front of the screen
    assert np.median(disparity) == pytest.approx(0, abs=0.1)
    one_wrong = blur.copy()
    one_wrong[3, 3], one_wrong[4, 4] = 1000.0, np.nan
    assert Parallax.from_scene(one_wrong, 20.0).scale == pytest.approx(parallax.scale, rel=0.01)
    flat = 7 + 1e-3 * (blur - 7)
    assert np.abs(Parallax.from_scene(flat, 20.0).disparity_px(flat)).max() < 0.2


def test_anaglyph_of_colour(square):
    random = np.random.default_rng(0)
    left, right = random.random((2, 5, 7, 3), dtype=np.float32)
    picture = anaglyph(left, right)
    assert (picture.shape, picture.dtype) == ((5, 7, 3), np.float32)
    assert np.array_equal(picture[..., 1:], right[..., 1:])
    luminance = 0.2126 * left[..., 0] + 0.7152 * left[..., 1] + 0.0722 * left[..., 2]
    assert picture[..., 0] == pytest.approx(luminance, abs=1e-6)
    white = np.ones((2, 2, 3), np.float32)
    assert anaglyph(white, white) == pytest.approx(white)


def test_anaglyph_of_grey_is_red_and_cyan():
    left, right = np.random.default_rng(0).random((2, 5, 7), dtype=np.float32)
    picture = anaglyph(left, right)
    assert picture.shape == (5, 7, 3)
    for channel, view in enumerate((left, right, right)):
        assert np.array_equal(picture[..., channel], view)


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_side_by_side(shape):
    left, right = np.random.default_rng(0).random((2, *shape), dtype=np.float32)
    picture = side_by_side(left, right)
    assert picture.shape == (5, 14, *shape[2:])
    assert np.array_equal(picture[:, :7], left)
    assert np.array_equal(picture[:, 7:], right)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 3, 3)])
def test_tiny_frames(shape):
    sharp, blur = np.random.default_rng(0).random((2, *shape), dtype=np.float32)
    blur = 20 * blur.reshape(*shape[:2], -1)[..., 0]
    for view in stereo_pair(sharp, blur, shape[1] / 2):
        assert view.shape == shape
        assert np.isfinite(view).all()


def test_wrong_input_is_refused(square):
    sharp, blur = square
    with pytest.raises(InputError, match=r"blur map of 96x160 px .* of 160x96 px"):
        stereo_pair(sharp, blur.T, 8.0)
    with pytest.raises(InputError, match=r"blur map: expected \[rows, columns\]"):
        stereo_pair(sharp, sharp, 8.0)
    with pytest.raises(InputError, match="no pixel has a known depth"):
        stereo_pair(sharp, np.full_like(blur, np.nan), 8.0)
    with pytest.raises(InputError, match="no pixel has a known depth"):
        Parallax.from_scene(np.full_like(blur, np.inf), 8.0)
    with pytest.raises(InputError, match="floating values"):
        stereo_pair((255 * sharp).astype(np.uint8), blur, 8.0)
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="parallax: expected more than 0 px"):
            stereo_pair(sharp, blur, bad)
    with pytest.raises(InputError, match="81 px is more than half of the frame's width, 160 px"):
        stereo_pair(sharp, blur, 81.0)
    check_parallax(80.0, 160)
    for join in (anaglyph, side_by_side):
        with pytest.raises(InputError, match="left 160x96 px, 3 channels, right 159x96 px, 3"):
            join(sharp, sharp[:, 1:])
        with pytest.raises(InputError, match="3 channels, right 160x96 px, 1 channels"):
            join(sharp, blur)
