"""What a camera can tell, against the thesis, against geometry, and against brute force."""

import dataclasses
import math
import sys

import numpy as np
import pytest
from cameras import THESIS, pinhole
from hypothesis import given
from hypothesis import strategies as st

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design import (
    DesignConfig,
    best_settings,
    default_extent_range_mm,
    default_focus_range_m,
    design_curves,
    design_setting,
    mask_openings,
)
from coded_aperture_ros.design.figures import draw_design
from coded_aperture_ros.io import read_image
from coded_aperture_ros.optics import MASK_NAMES, Camera, Mask, camera_from_mapping

# Focus, side and depth range of the thesis' three pictures (section 3.4.3), and its table 3.1.
CORRIDOR_A = (3.0, "far", 6.0, 28.0, 4.9)
CORRIDOR_B = (35.0, "near", 6.0, 28.0, 4.8)
REINDEER = (1.6, "near", 0.83, 1.33, 14.7)


def thesis_camera(focus_m=3.0, side="far", **changes):
    return camera_from_mapping({**THESIS, "focus_distance_m": focus_m, "side": side, **changes})


@pytest.mark.parametrize(
    ("focus_m", "side", "near_m", "far_m", "levels"), [CORRIDOR_A, CORRIDOR_B, REINDEER]
)
def test_levels_of_the_thesis(focus_m, side, near_m, far_m, levels):
    setting = design_setting(thesis_camera(focus_m, side), near_m, far_m)
    assert setting.levels == pytest.approx(levels, abs=0.1)


def test_the_arm_of_the_teddy_bear_is_four_levels_away():
    """Thesis 3.4.3: from 0.83 to 0.93 m the PSF shrinks by 4 levels, as in the resolution chart."""
    camera = thesis_camera(1.6, "near")
    nearest, arm = camera.blur_size_px([0.83, 0.93])
    assert arm - nearest == pytest.approx(4, abs=0.1)
    edges = design_curves(camera, 0.83, 1.33).level_edges_m
    assert edges[4] == pytest.approx(0.93, abs=0.0025)


def test_smallest_opening_of_the_thesis():
    """Eq. 3.21: 50 mm, 750 nm and pixels of 8.2 um need holes of 2.79 mm radius."""
    camera = thesis_camera(1e5, "near", pixel_pitch_um=8.2)
    limit_mm = design_setting(camera, 6, 28, DesignConfig(wavelength_nm=750)).diffraction_limit_mm
    assert limit_mm / 2 == pytest.approx(2.79, abs=0.005)


def test_the_airy_disc_is_two_pixels_wide_at_the_limit():
    camera = thesis_camera()
    limit_mm = design_setting(camera, 6, 28).diffraction_limit_mm
    share = mask_openings(camera.mask).smallest_width
    for factor, negligible in ((1.01, True), (0.99, False)):
        changed = dataclasses.replace(camera, mask_extent_mm=factor * limit_mm / share)
        setting = design_setting(changed, 6, 28)
        assert setting.airy_width_px == pytest.approx(2 / factor)
        assert setting.diffraction_is_negligible == negligible
        assert setting.hole_width_mm == pytest.approx(factor * limit_mm)


def test_numbers_by_hand():
    # S = 0.03 m * 800 px * (1/0.9 - 1/z): 2.6667 px at 1 m, 14.6667 px at 2 m; Levin has 11 cells.
    setting = design_setting(pinhole(), 1.0, 2.0)
    assert setting.blur_size_near_px == pytest.approx(2.66667, abs=1e-5)
    assert setting.blur_size_far_px == pytest.approx(14.66667, abs=1e-5)
    assert setting.levels == pytest.approx(13)
    assert setting.hole_blur_near_px == pytest.approx(2.66667 / 11, abs=1e-5)
    assert setting.hole_blur_far_px == pytest.approx(14.66667 / 11, abs=1e-5)
    # 1/z falls by 1/24 for each pixel.
    assert setting.resolution_near_m == pytest.approx(1 / (1 - 1 / 24) - 1)
    assert setting.resolution_far_m == pytest.approx(1 / (1 / 2 - 1 / 24) - 2)
    assert setting.open_fraction == pytest.approx(43 / 121)
    assert (setting.f_number, setting.f_number_of_light) == (None, None)


def test_f_numbers():
    disc = thesis_camera(mask={"name": "disc"}, mask_extent_mm=25)
    setting = design_setting(disc, 6, 28)
    assert setting.f_number == pytest.approx(2)
    assert setting.f_number_of_light == pytest.approx(2, rel=1e-3)  # it is a round aperture
    four_holes = design_setting(thesis_camera(mask_extent_mm=25), 6, 28)
    area = 4 * (25 * 4 / 17) ** 2
    assert four_holes.f_number_of_light == pytest.approx(50 / math.sqrt(4 * area / math.pi))


def test_blur_in_front_of_the_focus_is_negative_and_its_width_is_not():
    setting = design_setting(thesis_camera(1.6, "near"), 0.83, 1.33)
    assert setting.blur_size_near_px < setting.blur_size_far_px < 0
    assert setting.hole_blur_near_px > setting.hole_blur_far_px > 0


@pytest.mark.parametrize("mask_at_mm", [0.0, 40.0, -40.0])
@pytest.mark.parametrize(("focus_m", "side"), [(0.9, "far"), (4.0, "near")])
def test_mean_blur_is_the_mean_over_depths(mask_at_mm, focus_m, side):
    camera = pinhole(focus_distance_m=focus_m, side=side, lens_mask_distance_mm=mask_at_mm)
    depths = 1.0 + 2.0 * (np.arange(20_000) + 0.5) / 20_000
    expected = np.abs(camera.blur_size_px(depths)).mean() / 11
    assert design_setting(camera, 1.0, 3.0).hole_blur_mean_px == pytest.approx(expected, rel=1e-6)


@given(depth=st.floats(1.0, 20.0), resolution_px=st.floats(0.1, 2.0), mask_at_mm=st.floats(-40, 40))
def test_the_next_depth_is_one_step_of_blur_away(depth, resolution_px, mask_at_mm):
    camera = pinhole(lens_mask_distance_mm=mask_at_mm)
    config = DesignConfig(resolution_px=resolution_px)
    step_m = design_setting(camera, depth, 30.0, config).resolution_near_m
    if math.isinf(step_m):
        assert camera.blur_at_infinity_px - camera.blur_size_px(depth) <= resolution_px
    else:
        before, after = camera.blur_size_px([depth, depth + step_m])
        assert after - before == pytest.approx(resolution_px, rel=1e-6)


def test_where_no_farther_depth_can_be_told_apart():
    assert design_setting(pinhole(), 1.0, 1000.0).resolution_far_m == math.inf


def test_moving_the_focus_moves_the_image():
    near_form, far_form = thesis_camera(1.0), thesis_camera(30.0)
    assert near_form.refocused(30.0).focal_length_px == pytest.approx(far_form.focal_length_px)
    assert near_form.refocused(30.0).refocused(1.0).blur_size_px(6) == pytest.approx(
        near_form.blur_size_px(6)
    )
    # Without the focal length, nobody knows where the image goes.
    assert pinhole().refocused(30.0).focal_length_px == pinhole().focal_length_px
    with pytest.raises(InputError, match=r"not beyond the focal length, use more than 0\.05 m"):
        near_form.refocused(0.04)


OPENINGS = {  # number, width over extent, closed parts that fall out; counted by hand
    "levin": (13, 1 / 11, 0),
    "two_hole": (2, 4 / 17, 0),
    "three_hole": (3, 4 / 17, 0),
    "four_hole": (4, 4 / 17, 0),
    "four_wide": (4, 2 / 11, 2),
    "three_wide": (3, 3 / 7, 0),
    "annulus": (1, 1 / 8, 1),
    "veeraraghavan": (8, 1 / 7, 1),
    "zhou": (2, 3 / 11, 0),
    "mura": (22, 1 / 13, 15),
    "disc": (1, 1, 0),
}


@pytest.mark.parametrize("name", MASK_NAMES)
def test_openings(name):
    count, width, loose = OPENINGS[name]
    openings = mask_openings(Mask.named(name))
    assert (openings.count, openings.loose_parts) == (count, loose)
    tolerance = 0.02 if name in ("disc", "annulus") else 1e-9  # curves are stored as cells
    assert openings.smallest_width == pytest.approx(width, abs=tolerance)


def test_openings_that_touch_at_a_corner_are_two():
    openings = mask_openings(Mask.from_rows(["10", "01"]))
    assert (openings.count, openings.smallest_width) == (2, 0.5)
    ring = mask_openings(Mask.from_rows(["111", "101", "111"]))
    assert (ring.count, ring.loose_parts) == (1, 1)
    assert ring.smallest_width == pytest.approx(1 / 3)


def test_curves_agree_with_the_numbers_of_each_setting():
    camera = thesis_camera()
    curves = design_curves(camera, 6, 28)
    assert curves.focus_m.min() < 3 < curves.focus_m.max()
    assert not ((curves.focus_m > 6) & (curves.focus_m < 28)).any()
    assert (np.diff(curves.focus_m) > 0).all()
    for k in (0, 100, 250, 399):
        focus_m = curves.focus_m[k]
        setting = design_setting(thesis_camera(focus_m, "far" if focus_m <= 6 else "near"), 6, 28)
        assert curves.levels[k] == pytest.approx(setting.levels)
        assert curves.hole_blur_mean_px[k] == pytest.approx(setting.hole_blur_mean_px)
        assert curves.hole_blur_far_px[k] == pytest.approx(setting.hole_blur_far_px)
    setting = design_setting(camera, 6, 28)
    assert curves.resolution_m[[0, -1]] == pytest.approx(
        [setting.resolution_near_m, setting.resolution_far_m]
    )
    assert len(curves.level_edges_m) - 1 == math.ceil(setting.levels - 1)
    steps = np.diff(camera.blur_size_px(curves.level_edges_m))
    assert steps[:-1] == pytest.approx(1)
    assert 0 < steps[-1] <= 1


def test_the_best_setting_is_the_best_of_a_brute_force_search():
    camera, config = thesis_camera(), DesignConfig()
    best = best_settings(camera, 1.5, 4.0)
    assert sorted(one.side for one in best) == ["far", "near"]
    assert best[0].levels >= best[1].levels
    focus_range, extents = default_focus_range_m(camera, 1.5, 4.0), default_extent_range_mm(camera)
    levels = {"far": 0.0, "near": 0.0}
    for focus_m in np.geomspace(*focus_range, 150):
        if 1.5 < focus_m < 4.0:
            continue
        side = "far" if focus_m <= 1.5 else "near"
        for extent_mm in np.linspace(*extents, 60):
            tried = thesis_camera(focus_m, side, mask_extent_mm=float(extent_mm))
            small, large = sorted(np.abs(tried.blur_range_px(1.5, 4.0)))
            if small >= config.smallest_blur_px and large <= config.largest_blur_px:
                levels[side] = max(levels[side], tried.number_of_levels(1.5, 4.0))
    for one in best:
        assert one.levels == pytest.approx(levels[one.side], rel=0.03)
        sizes = sorted((abs(one.blur_size_near_px), abs(one.blur_size_far_px)))
        assert config.smallest_blur_px <= sizes[0] < sizes[1] <= config.largest_blur_px * 1.000001
        assert extents[0] <= one.mask_extent_mm <= extents[1]
        # And its numbers are those of the camera that it describes.
        rebuilt = thesis_camera(one.focus_distance_m, one.side, mask_extent_mm=one.mask_extent_mm)
        assert design_setting(rebuilt, 1.5, 4.0).levels == pytest.approx(one.levels)


def test_of_settings_with_as_many_levels_the_sharpest_is_best():
    """In the corridor the mask's size is the limit, and any focus gives nearly as many levels."""
    (best,) = best_settings(thesis_camera(), 6, 28)
    assert best.mask_extent_mm == 22
    for focus_m in (2.5, 3.5):
        other = design_setting(thesis_camera(focus_m, mask_extent_mm=22), 6, 28)
        assert other.levels == pytest.approx(best.levels, rel=0.02)
        assert other.hole_blur_mean_px > best.hole_blur_mean_px > 1


def test_no_setting_may_fit():
    config = DesignConfig(smallest_blur_px=20, largest_blur_px=21)
    assert best_settings(thesis_camera(), 6, 28, config) == []


@pytest.mark.parametrize("focus_range", [(1.0, 5.0), (29.0, 60.0)])
def test_the_search_keeps_to_its_ranges(focus_range):
    config = DesignConfig(smallest_blur_px=0, largest_blur_px=1000)
    (best,) = best_settings(thesis_camera(), 6, 28, config, focus_range, (8.0, 9.0))
    assert focus_range[0] <= best.focus_distance_m <= focus_range[1]
    assert best.mask_extent_mm == 9


@pytest.mark.parametrize(
    ("ranges", "reason"),
    [
        ({"focus_range_m": (7, 20)}, "lies within the depth range 6 to 28 m.*begins before 6 m"),
        ({"focus_range_m": (5, 2)}, "focus range 5 to 2 m: expected two increasing"),
        ({"focus_range_m": (-1, 2)}, "expected two increasing"),
        ({"focus_range_m": (math.nan, 2)}, "expected two increasing"),
        ({"focus_range_m": (0.01, 2)}, "focus range 0.01 to 2 m: .*not beyond the focal length"),
        ({"extent_range_mm": (-3, 2)}, "mask sizes -3 to 2 mm: expected"),
        ({"extent_range_mm": (3, 2)}, "mask sizes 3 to 2 mm: expected"),
    ],
)
def test_impossible_ranges_of_the_search(ranges, reason):
    with pytest.raises(InputError, match=reason) as caught:
        best_settings(thesis_camera(), 6, 28, **ranges)
    assert "\n" not in str(caught.value)


def test_ranges_of_depth_that_are_refused():
    with pytest.raises(InputError, match="inside the depth range"):
        design_setting(thesis_camera(10.0), 6, 28)
    with pytest.raises(InputError, match="has to end somewhere"):
        design_setting(thesis_camera(), 6, math.inf)


def test_settings_of_the_search_are_checked():
    with pytest.raises(InputError, match="smallest_blur_px: 30 px is not less than largest"):
        DesignConfig(smallest_blur_px=30.0)
    with pytest.raises(InputError, match=r"resolution_px: 0\.0 is out of range"):
        DesignConfig(resolution_px=0.0)


def test_the_example_cameras_have_sensible_defaults(checkout):
    """A mask far in front of the lens, or a long lens close by, must not break the default."""
    for camera in (
        thesis_camera(),
        pinhole(lens_mask_distance_mm=800.0),
        thesis_camera(focal_length_mm=400, focus_distance_m=0.9),
    ):
        assert isinstance(camera, Camera)
        design_curves(camera, 1.0 if camera.focus_distance_m < 1 else 6.0, 30.0)


def test_figure(tmp_path):
    pytest.importorskip("matplotlib")
    camera = thesis_camera()
    path = tmp_path / "a.png"
    draw_design(design_setting(camera, 6, 28), design_curves(camera, 6, 28), 6, 28, path)
    picture = read_image(path, 1)
    assert picture.shape == (380, 1300, 3)
    assert picture.std() > 0.05
    missing = tmp_path / "no" / "a.png"
    with pytest.raises(InputError, match="cannot write"):
        draw_design(design_setting(camera, 6, 28), design_curves(camera, 6, 28), 6, 28, missing)


def test_figure_without_matplotlib(monkeypatch, tmp_path):
    camera = thesis_camera()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(InputError, match="pip install matplotlib"):
        draw_design(
            design_setting(camera, 6, 28), design_curves(camera, 6, 28), 6, 28, tmp_path / "a.png"
        )
