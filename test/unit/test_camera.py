import dataclasses
import math

import numpy as np
import pytest
import yaml
from cameras import THESIS, pinhole
from hypothesis import given
from hypothesis import strategies as st

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera, Mask, camera_from_mapping, load_camera

# The camera of the thesis, section 3.4.3: Canon 50 mm lens, mask of 11 mm, 1920 pixels on 36 mm.


def thesis_camera(focus_distance_m, side):
    return camera_from_mapping({**THESIS, "focus_distance_m": focus_distance_m, "side": side})


# Computed by hand with eq. 3.28 and 3.29; the thesis' table 3.1 has 4.9, 4.8 and 14.7.
@pytest.mark.parametrize(
    ("focus_m", "side", "near_m", "far_m", "levels", "in_thesis"),
    [
        (3.0, "far", 6, 28, 4.9126, 4.9),
        (35.0, "near", 6, 28, 4.8529, 4.8),
        (1.6, "near", 0.83, 1.33, 14.7368, 14.7),
    ],
)
def test_number_of_levels_of_the_thesis(focus_m, side, near_m, far_m, levels, in_thesis):
    camera = thesis_camera(focus_m, side)
    assert camera.number_of_levels(near_m, far_m) == pytest.approx(levels, abs=1e-4)
    assert camera.number_of_levels(near_m, far_m) == pytest.approx(in_thesis, abs=0.06)


def test_noise_of_a_camera_file():
    measured = camera_from_mapping({**THESIS, "noise": 0.001, "noise_gain": 0.0002})
    assert (measured.noise, measured.noise_gain) == (0.001, 0.0002)
    assert (camera_from_mapping(THESIS).noise, camera_from_mapping(THESIS).noise_gain) == (0, 0)
    for name, value in (("noise", -0.1), ("noise", 0.6), ("noise_gain", 0.2), ("noise", "low")):
        with pytest.raises(InputError, match=f"{name}: .*(range|expected)"):
            camera_from_mapping({**THESIS, name: value})


def test_finer_resolution_gives_more_levels():
    camera = thesis_camera(3.0, "far")
    assert camera.number_of_levels(6, 28, 0.5) == pytest.approx(2 * 3.9126 + 1, abs=1e-3)


def test_blur_size_by_hand():
    # 0.03 m * 800 px * (1/0.9 - 1/2.5) 1/m = 17.0667 px; in front of the focus it is negative.
    assert pinhole().blur_size_px(2.5) == pytest.approx(17.0667, abs=1e-4)
    assert pinhole().blur_size_px([0.9, 0.6]) == pytest.approx([0, -13.3333], abs=1e-4)
    assert pinhole().blur_size_px(math.inf) == pytest.approx(0.03 * 800 / 0.9)


def test_mask_in_front_of_the_lens_by_hand():
    # 17.0667 px * 2.5 / (2.5 - 0.05); a mask behind the lens makes the PSF smaller instead.
    assert pinhole(lens_mask_distance_mm=50.0).blur_size_px(2.5) == pytest.approx(17.4150, abs=1e-4)
    behind = pinhole(lens_mask_distance_mm=-50.0).blur_size_px(2.5)
    assert behind == pytest.approx(17.0667 * 2.5 / 2.55, abs=1e-4)


def test_blur_size_agrees_with_ray_geometry():
    # A ray through the edge of a mask at distance C, refracted by the thin lens, traced to the
    # sensor: an independent derivation of eq. 3.28.
    focal, focus, pitch, extent, mask_at = 0.05, 3.0, 18.72e-6, 0.011, 0.02
    camera = camera_from_mapping({**THESIS, "lens_mask_distance_mm": mask_at * 1e3})
    sensor = 1 / (1 / focal - 1 / focus)
    for depth in (1.5, 6.0, 28.0):
        hits = []
        for height in (extent / 2, -extent / 2):
            slope = height / (depth - mask_at)
            at_lens = slope * depth
            hits.append(at_lens + (slope - at_lens / focal) * sensor)
        assert camera.blur_size_px(depth) == pytest.approx((hits[1] - hits[0]) / pitch)


def test_both_forms_of_a_camera_file_agree():
    distance = 50 * 3000 / (3000 - 50)
    values = {key: value for key, value in THESIS.items() if "pitch" not in key}
    del values["focal_length_mm"]
    pinhole_form = camera_from_mapping({**values, "focal_length_px": distance / 18.72e-3})
    assert pinhole_form.blur_size_px(6.0) == pytest.approx(
        camera_from_mapping(THESIS).blur_size_px(6.0)
    )


@given(depth=st.floats(0.1, 1e4), focus=st.floats(0.3, 100), lens_mask_mm=st.floats(-90, 90))
def test_blur_and_depth_are_inverse(depth, focus, lens_mask_mm):
    camera = pinhole(focus_distance_m=focus, lens_mask_distance_mm=lens_mask_mm)
    blur = camera.blur_size_px(depth)
    # Far away the blur size hardly changes, so compare where it is well conditioned.
    assert camera.blur_size_px(camera.depth_m(blur)) == pytest.approx(blur, rel=1e-9, abs=1e-9)
    assert 1 / camera.depth_m(blur) == pytest.approx(1 / depth, rel=1e-6, abs=1e-9)


@given(st.floats(0.1, 100), st.floats(0.1, 100))
def test_blur_grows_with_depth(one, other):
    camera = pinhole(lens_mask_distance_mm=30.0)
    if abs(one - other) > 1e-6:
        assert (camera.blur_size_px(one) < camera.blur_size_px(other)) == (one < other)


def test_values_without_depth():
    camera = pinhole()
    assert np.isnan(camera.blur_size_px([np.nan, 0.0, -1.0])).all()
    assert camera.depth_m([camera.blur_at_infinity_px, 1e3]).tolist() == [math.inf, math.inf]
    assert np.isnan(camera.depth_m(np.nan))
    # In front of a mask behind the lens no point has a blur beyond the one at the lens.
    assert np.isnan(pinhole(lens_mask_distance_mm=-50.0).depth_m(-1e4))
    assert np.isnan(pinhole(lens_mask_distance_mm=50.0).blur_size_px(0.04))


def test_focus_inside_the_range_is_refused_with_the_reason():
    with pytest.raises(InputError, match=r"inside the depth range.*same blur.*focus before"):
        thesis_camera(10.0, "far").blur_range_px(6, 28)


def test_range_on_the_other_side_is_refused():
    with pytest.raises(InputError, match="set side: near"):
        thesis_camera(35.0, "far").blur_range_px(6, 28)
    with pytest.raises(InputError, match="set side: far"):
        thesis_camera(3.0, "near").number_of_levels(6, 28)


@pytest.mark.parametrize(("near_m", "far_m"), [(5, 4), (0, 4), (-1, 4), (math.nan, 4), (5, 5)])
def test_impossible_range_is_refused(near_m, far_m):
    with pytest.raises(InputError, match="increasing distances"):
        pinhole().blur_range_px(near_m, far_m)


def test_range_may_start_at_the_focus_and_end_at_infinity():
    smallest, largest = pinhole().blur_range_px(0.9, math.inf)
    assert smallest == 0
    assert largest == pytest.approx(pinhole().blur_at_infinity_px)


def test_scaled_camera_sees_the_same_blur_in_smaller_pixels():
    half = pinhole().scaled(0.5)
    assert (half.image_width, half.image_height) == (320, 240)
    assert half.blur_size_px(2.5) == pytest.approx(pinhole().blur_size_px(2.5) / 2)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"focal_length_mm": -50}, r"focal_length_mm: -50 is out of range \(0.1 to 10000 mm\)"),
        ({"focal_length_mm": "50mm"}, "focal_length_mm: expected float"),
        ({"pixel_pitch_um": 0}, "pixel_pitch_um: 0 is out of range"),
        ({"focus_distance_m": 0.04}, "focus_distance_m: 0.04 is not beyond the focal length"),
        ({"focus_distance_m": math.nan}, "focus_distance_m: nan is out of range"),
        ({"image_width": 0}, "image_width: 0 is out of range"),
        ({"image_width": 640.5}, "image_width: expected int"),
        ({"image_height": True}, "image_height: expected int"),
        ({"mask_extent_mm": -1}, "mask_extent_mm: -1 is out of range"),
        ({"side": "left"}, "side: 'left' is not allowed, use one of far, near"),
        ({"lens_mask_distance_mm": 5e3}, "lens_mask_distance_mm: 5000.0 is out of range"),
        ({"focal_lenght_mm": 50}, "unknown key 'focal_lenght_mm': did you mean focal_length_mm"),
        ({"colour": "red"}, "unknown key 'colour': use focal_length_mm"),
        ({"focal_length_px": 800}, "focal_length_mm: focal_length_px already says it"),
        ({"mask": "levin"}, "mask: expected {name: levin}"),
        ({"mask": {"name": "levine"}}, "did you mean levin"),
        ({"mask": {"name": "levin", "file": "x.png"}}, "mask: expected"),
        ({"mask": {"file": "nowhere.png"}}, "nowhere.png: No such file"),
        ({"mask": {"name": 3}}, "mask: expected the name as text"),
    ],
)
def test_impossible_camera_file_is_refused_by_file_and_key(tmp_path, changes, reason):
    path = tmp_path / "cam.yaml"
    path.write_text(yaml.safe_dump({**THESIS, **changes}))
    with pytest.raises(InputError, match=f"cam.yaml: .*{reason}") as error:
        load_camera(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("key", sorted(THESIS))
def test_missing_key_is_named(key):
    values = {name: value for name, value in THESIS.items() if name != key}
    with pytest.raises(InputError, match=f"my camera: missing {key}"):
        camera_from_mapping(values, "my camera")


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"", "expected keys"), (b"a: [", "not valid YAML in line"), (b"\xff\xfe\x00", "not valid")],
)
def test_unreadable_camera_file_is_refused(tmp_path, content, reason):
    path = tmp_path / "cam.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=f"cam.yaml: {reason}"):
        load_camera(path)


def test_missing_camera_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"cannot read camera file .*nowhere.yaml: No such file"):
        load_camera(tmp_path / "nowhere.yaml")


def test_mask_file_is_relative_to_the_camera_file(tmp_path):
    np.save(tmp_path / "mask.npy", Mask.named("zhou").transmission)
    path = tmp_path / "cam.yaml"
    path.write_text(yaml.safe_dump({**THESIS, "mask": {"file": "mask.npy"}}))
    assert load_camera(path).mask == Mask.named("zhou")


def test_camera_built_in_python_is_checked_too():
    with pytest.raises(InputError, match="focal_length_px: -1 is out of range"):
        pinhole(focal_length_px=-1)
    with pytest.raises(InputError, match="mask: expected a Mask"):
        pinhole(mask="levin")
    with pytest.raises(dataclasses.FrozenInstanceError):
        pinhole().side = "near"


@pytest.mark.parametrize(("extent_mm", "said"), [(0.02, "f/2.5e"), (200.0, "f/0.25")])
def test_no_lens_has_such_an_f_number(extent_mm, said):
    """A mask of 20 mm that is given in metres, say."""
    with pytest.raises(InputError, match=r"^mask_extent_mm: .*give both in millimetres$") as caught:
        Camera.from_lens(
            focal_length_mm=50.0,
            pixel_pitch_um=5.0,
            focus_distance_m=1.0,
            image_width=640,
            image_height=480,
            mask=Mask.named("levin"),
            mask_extent_mm=extent_mm,
        )
    assert said in str(caught.value)


def test_another_setting_has_another_digest():
    camera = Camera(800.0, 1.0, 640, 480, Mask.named("levin"), 20.0)
    assert camera.setting_digest == camera.scaled(0.5).setting_digest
    assert camera.setting_digest == dataclasses.replace(camera, noise=0.01).setting_digest
    for change in (
        {"focus_distance_m": 1.2},
        {"focal_length_px": 900.0},
        {"mask_extent_mm": 18.0},
        {"side": "near"},
        {"lens_mask_distance_mm": 5.0},
    ):
        assert dataclasses.replace(camera, **change).setting_digest != camera.setting_digest
