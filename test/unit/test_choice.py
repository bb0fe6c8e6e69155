"""Choice of a camera for a range: reference cameras, settings, simulated scenes, ranking."""

import dataclasses
import math

import numpy as np
import pytest
import yaml

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.choice import (
    PRICE_CLASSES,
    Outcome,
    Trial,
    Wanted,
    light_lost_stops,
    limits,
    load_offer,
    ranked,
    reference_files,
    row,
    set_for_range,
    trials_for,
    view_deg,
)
from coded_aperture_ros.design.relief import (
    DistanceFigures,
    measure_scenes,
    relief_scene,
    usable_range_m,
)
from coded_aperture_ros.optics import FieldCurvature, Mask
from coded_aperture_ros.optics.pupil import largest_extent_mm, openings_diameter

REFERENCES = reference_files()
WANTED = Wanted(0.6, 1.5)


def test_there_are_eight_reference_cameras():
    assert len(REFERENCES) == 8
    assert len({load_offer(path).name for path in REFERENCES}) == 8


@pytest.mark.parametrize("path", REFERENCES, ids=lambda path: path.stem)
def test_reference_camera_is_what_it_states(path):
    """Mask within the pupil, field of view of sensor and lens, light, range on its far side."""
    entries = yaml.safe_load(path.read_text())
    stated = entries["reference"]
    offer = load_offer(path)
    camera = offer.camera
    sensor = offer.sensor
    assert stated["pupil_mm"] == pytest.approx(camera.pupil_mm, abs=0.01)
    assert camera.pupil_mm == entries["focal_length_mm"] / entries["lens_f_number"]
    assert camera.mask_extent_mm * openings_diameter(camera.mask) <= camera.pupil_mm
    assert stated["largest_mask_mm"] == largest_extent_mm(camera.mask, camera.pupil_mm)
    # By the sensor's size and the image distance, not by pixels of the frame.
    image_mm = 1 / (1 / entries["focal_length_mm"] - 1e-3 / camera.focus_distance_m)
    for degrees, pixels in zip(
        stated["field_of_view_deg"], (sensor.width, sensor.height), strict=True
    ):
        half = math.atan(pixels * sensor.pixel_pitch_um * 1e-3 / 2 / image_mm)
        assert degrees == pytest.approx(2 * math.degrees(half), rel=0.01)
    assert stated["field_of_view_deg"] == list(view_deg(camera))
    assert stated["light_lost_stops"] == pytest.approx(light_lost_stops(camera), abs=0.06)
    assert offer.price_class in PRICE_CLASSES
    near_m, far_m = offer.depth_range_m
    near_px, far_px = camera.blur_range_px(near_m, far_m)
    assert 1.9 <= near_px < far_px <= 12.5
    assert camera.diffraction


def test_light_lost_by_hand(tmp_path):
    camera = load_offer(REFERENCES[0]).camera
    camera = dataclasses.replace(camera, mask=Mask.named("four_hole"), mask_extent_mm=8.0)
    # Four holes of 8/34 of the extent, in a round pupil.
    share = 4 * (8 / 34 * 8.0) ** 2 / (math.pi / 4 * camera.pupil_mm**2)
    assert light_lost_stops(camera) == pytest.approx(-math.log2(share))
    assert light_lost_stops(dataclasses.replace(camera, lens_f_number=None)) is None


@pytest.mark.parametrize("name", ["levin", "four_hole", "disc"])
@pytest.mark.parametrize("range_m", [(0.6, 1.5), (0.25, 0.5), (3.0, 9.0)])
def test_settings_keep_blur_and_pupil(name, range_m):
    camera = load_offer(REFERENCES[0]).camera
    mask = Mask.named(name)
    for far_px in (12.0, 16.0):
        found = set_for_range(camera, mask, *range_m, far_px)
        near, far = found.blur_range_px(*range_m)
        assert 1.9 <= near <= 4.1
        assert far <= far_px + 0.1
        assert found.mask_extent_mm <= largest_extent_mm(mask, camera.pupil_mm)


def test_settings_of_unknown_pupils_are_no_wider_than_their_file():
    camera = dataclasses.replace(load_offer(REFERENCES[0]).camera, lens_f_number=None)
    found = set_for_range(camera, camera.mask, 20.0, 60.0, 12.0)
    assert found.mask_extent_mm == camera.mask_extent_mm


def test_a_lens_cannot_be_focused_within_its_focal_length():
    with pytest.raises(InputError, match=r"yaml: focus_distance_m: .*not beyond the focal"):
        trials_for(load_offer(REFERENCES[0]), Wanted(0.01, 0.02))


@pytest.mark.parametrize("range_m", [(1.5, 0.6), (0.0, 1.0), (0.5, math.inf)])
def test_impossible_ranges(range_m):
    with pytest.raises(InputError, match="expected two increasing distances"):
        Wanted(*range_m)


def figures(*values):
    """Figures at 1 to 2 m, 2 to 3 m, ... from errors and fills."""
    return tuple(DistanceFigures(z, z + 1, *each) for z, each in enumerate(values, 1))


GOOD = (0.01, 0.99, 0.9)
WRONG = (0.08, 0.60, 0.9)
SPARSE = (0.01, 0.99, 0.5)


@pytest.mark.parametrize(
    ("values", "range_m"),
    [
        ((GOOD, GOOD, GOOD), (1, 4)),
        ((GOOD, WRONG, GOOD), (1, 2)),  # 1 to 2 m is more than 3 to 4 m
        ((WRONG, GOOD, GOOD), (2, 4)),
        ((GOOD, GOOD, SPARSE), (1, 3)),
        ((SPARSE, WRONG, (math.inf, 0.0, 0.0)), None),
        (((0.05, 1, 0.7), (0.0501, 1, 0.7), (0.05, 1, 0.699)), (1, 2)),
    ],
)
def test_usable_range(values, range_m):
    assert usable_range_m(figures(*values)) == range_m


def outcome(number=0, values=(GOOD, GOOD), wanted=None, **changes):
    offer = load_offer(REFERENCES[number])
    offer = dataclasses.replace(offer, **changes)
    return Outcome(Trial(offer, offer.camera, wanted or Wanted(1, 3)), figures(*values))


def test_cameras_are_ranked_by_view_then_range():
    part = outcome(0, (GOOD, WRONG))
    whole = outcome(1)
    none = outcome(2, (WRONG, WRONG))
    assert ranked([none, part, whole]) == [whole, part, none]
    assert (whole.covered, none.covered, none.range_m) == (1, 0, None)
    # The best of one camera's settings stands for it.
    assert ranked([outcome(1, (GOOD, SPARSE)), whole]) == [whole]
    wide = Wanted(1, 3, view_deg=35.0)
    narrow = next(k for k, path in enumerate(REFERENCES) if load_offer(path).view_deg[0] < 30)
    broad = next(k for k, path in enumerate(REFERENCES) if load_offer(path).view_deg[0] > 50)
    first, second = ranked([outcome(narrow, wanted=wide), outcome(broad, (GOOD, WRONG), wide)])
    assert first.trial.offer.path == REFERENCES[broad]
    assert "field of view" in limits(second)
    assert limits(outcome(1)) == ""


def test_limits_name_noise_and_small_changes_of_blur():
    dark = outcome(0, (WRONG, WRONG), Wanted(1, 3, illuminance_lux=0.01, rate_hz=1000))
    assert "noise of" in limits(dark)
    far = outcome(0, (GOOD, WRONG), Wanted(1, 3))
    camera = dataclasses.replace(far.trial.camera, mask_extent_mm=0.5)
    far = dataclasses.replace(far, trial=dataclasses.replace(far.trial, camera=camera))
    assert "px of blur" in limits(far)


def test_row_is_for_json():
    found = row(outcome(0, (GOOD, (math.inf, 0.0, 0.0))))
    assert found["range_m"] == [1, 2]
    assert found["distances"][1]["error"] is None
    assert found["error"] == 0.01
    bright = row(outcome(0, wanted=Wanted(1, 3, illuminance_lux=1e5)))
    assert bright["exposure_ms"] < 1  # until white fills the pixels
    assert bright["electrons"] == round(load_offer(REFERENCES[0]).sensor.frame_full_well)


def test_relief_lies_between_the_ends_of_the_range():
    scene = relief_scene(3)
    depth_m = scene.depth_m(0.5, 2.0)
    assert depth_m.min() >= 0.5 - 1e-6
    assert depth_m.max() <= 2.0 + 1e-5
    assert 0.01 <= scene.reflectance.min() < scene.reflectance.max() <= 0.95
    assert np.ptp(scene.place) > 0.5
    assert (relief_scene(3).place == scene.place).all()
    assert (relief_scene(4).place != scene.place).any()


def small_offer(**changes):
    offer = load_offer(next(path for path in REFERENCES if path.stem == "cmount_25mm_f1.4"))
    size = {"image_width": 320, "image_height": 240}
    camera = dataclasses.replace(offer.camera, **{**size, **changes})
    return dataclasses.replace(offer, camera=camera)


@pytest.mark.slow
def test_a_camera_measures_no_range_in_the_dark():
    """That it measures one in the light is tested with `design --for`."""
    offer = small_offer()
    (trial, *_) = trials_for(offer, Wanted(1.4, 3.5))
    dark = Wanted(1.4, 3.5, illuminance_lux=0.02).exposure(offer.sensor)
    found = measure_scenes(trial.camera, (1.4, 3.5), dark, [relief_scene(0)], 2)
    assert not any(one.holds for one in found)


@pytest.mark.slow
def test_field_curvature_is_simulated_towards_the_corner():
    """The bank knows the curvature, so that depth is right; places differ, so frames do."""
    plain = small_offer(image_width=640, image_height=480)
    curved = dataclasses.replace(plain.camera, field_curvature=FieldCurvature(2.0, 0.0))
    camera = set_for_range(curved, curved.mask, 1.4, 3.5, 12.0)
    exposure = WANTED.exposure(plain.sensor)
    scenes = [relief_scene(seed) for seed in range(4)]
    found = measure_scenes(camera, (1.4, 3.5), exposure, scenes, 2)
    assert all(one.error < 0.05 for one in found)


@pytest.mark.parametrize("path", REFERENCES, ids=lambda path: path.stem)
def test_the_page_shows_what_the_file_states(path, checkout):
    text = (checkout / "docs" / "data_sheets.md").read_text()
    stated = yaml.safe_load(path.read_text())["reference"]
    line = next(one for one in text.splitlines() if one.startswith(f"| `{path.stem}` |"))
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    camera = load_offer(path).camera
    near_m, far_m = stated["depth_range_m"]
    across, down = stated["field_of_view_deg"]
    assert cells[1:] == [
        stated["name"],
        f"{near_m:g} to {far_m:g} m",
        f"{across:.0f} x {down:.0f}",
        f"{stated['pupil_mm']:.1f} mm",
        f"{camera.mask.name} {camera.mask_extent_mm:g} mm",
        f"{camera.focus_distance_m:.3g} m",
        f"{stated['light_lost_stops']:.1f}",
        stated["price_class"],
    ]
