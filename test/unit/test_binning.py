"""Other binnings of a camera's sensor: geometry, what is written, what is left out."""

import dataclasses
import json

import numpy as np
import pytest
import yaml

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.binning import binned_entries, with_binning, with_binnings
from coded_aperture_ros.design.choice import (
    Outcome,
    Trial,
    Wanted,
    load_offer,
    ranked,
    reference_files,
    row,
    trials_for,
)
from coded_aperture_ros.design.relief import DistanceFigures, relief_scene
from coded_aperture_ros.optics.camera_file import camera_entries, camera_from_mapping

REFERENCES = {path.stem: path for path in reference_files()}
HQ = REFERENCES["hq_16mm_f1.4"]


def camera_file(folder, name="mine.yaml", without=(), **changes):
    entries = {**yaml.safe_load(HQ.read_text()), **changes}
    path = folder / name
    path.write_text(yaml.safe_dump({k: v for k, v in entries.items() if k not in without}))
    return path


@pytest.mark.parametrize("stem", REFERENCES)
@pytest.mark.parametrize("binning", [1, 2, 3, 5, 8])
def test_same_part_of_the_sensor(stem, binning):
    """Same field of view and mask; light and noise of a pixel as of its area."""
    offer = load_offer(REFERENCES[stem])
    found = with_binning(offer, binning)
    ratio = offer.sensor.binning / binning
    assert found.camera.image_width == int(offer.camera.image_width * ratio)
    assert found.camera.image_height == int(offer.camera.image_height * ratio)
    assert found.camera.image_width * binning <= offer.sensor.width
    assert found.camera.image_height * binning <= offer.sensor.height
    assert found.camera.focal_length_px == pytest.approx(offer.camera.focal_length_px * ratio)
    assert found.view_deg == pytest.approx(offer.view_deg, abs=0.15)
    assert found.camera.mask_extent_mm == offer.camera.mask_extent_mm
    assert found.pixels == pytest.approx(ratio**2, rel=0.02)
    full_well = offer.sensor.full_well
    assert found.sensor.frame_full_well == full_well * binning**2
    # What is lit less than full: electrons go with the area of a pixel.
    exposure = [Wanted(1, 2, illuminance_lux=1).exposure(one.sensor) for one in (offer, found)]
    before, after = (
        one.electrons(each.camera) for one, each in zip(exposure, (offer, found), strict=True)
    )
    assert before / after == pytest.approx(ratio**2, rel=1e-6)


@pytest.mark.parametrize("binning", [1, 2, 3, 4, 5])
def test_entries_are_those_of_a_camera_file(binning):
    entries = binned_entries(camera_entries(HQ), binning)
    camera = camera_from_mapping(json.loads(json.dumps(entries)))
    assert entries["sensor"]["binning"] == binning
    assert entries["pixel_pitch_um"] == pytest.approx(1.55 * binning)
    assert (camera.image_width, camera.image_height) == (4056 // binning, 3040 // binning)


def test_a_part_of_the_sensor_stays_that_part(tmp_path):
    offer = load_offer(camera_file(tmp_path, image_width=321, image_height=241))
    found = with_binning(offer, 3).camera
    assert (found.image_width, found.image_height) == (428, 321)


def test_a_focal_length_in_pixels_is_that_of_the_frame(tmp_path):
    lens = "focal_length_mm", "pixel_pitch_um", "lens_f_number"
    path = camera_file(tmp_path, without=lens, focal_length_px=2500.0)
    found = with_binning(load_offer(path), 2)
    assert found.camera.focal_length_px == 5000.0


def test_cameras_without_a_sensor_stay_alone(tmp_path):
    offer = load_offer(camera_file(tmp_path, without=("sensor",)))
    assert with_binnings(offer, (1, 2)) == ([offer], [])
    assert row(Outcome(Trial(offer, offer.camera, Wanted(1, 2)), ()))["binning"] is None


def test_repeated_binnings_and_that_of_the_file_are_one():
    offer = load_offer(HQ)
    found, warnings = with_binnings(offer, (4, 2, 2, 4))
    assert [one.binning for one in found] == [4, 2]
    assert [one.file_name for one in found] == ["hq_16mm_f1.4.yaml", "hq_16mm_f1.4_binning2.yaml"]
    assert len({one.name for one in found}) == 2
    assert warnings == []


def test_frames_of_a_few_pixels_are_left_out():
    found, (warning,) = with_binnings(load_offer(HQ), (64,))
    assert len(found) == 1
    assert "with a binning of 64: frames of 63x47: expected at least 60 px" in warning
    with pytest.raises(InputError, match="expected at least 60 px"):
        with_binning(load_offer(HQ), 64)


def test_what_was_measured_with_a_binning_is_not_used_with_another(tmp_path):
    offer = load_offer(camera_file(tmp_path, noise=0.01, noise_gain=0.001))
    found, (warning,) = with_binnings(offer, (2,))
    assert [one.camera.noise_gain for one in found] == [0.001, 0.0]
    assert "noise, noise_gain: measured with a binning of 4" in warning
    assert binned_entries(camera_entries(offer.path), 4)["noise"] == 0.01


def test_every_binning_is_a_row_of_its_own():
    offer = load_offer(HQ)
    fine = with_binning(offer, 2)
    good = DistanceFigures(1, 2, 0.01, 0.99, 0.9)
    wrong = dataclasses.replace(good, error=0.08)
    wanted = Wanted(1, 2)
    outcomes = [
        Outcome(Trial(one, one.camera, wanted), (figures,))
        for one, figures in ((offer, wrong), (fine, good), (fine, wrong))
    ]
    first, second = (row(one) for one in ranked(outcomes))
    assert (first["binning"], first["pixels"], first["range_m"]) == (2, 4.0, [1, 2])
    assert (first["image_width"], first["image_height"]) == (2028, 1520)
    assert (second["binning"], second["pixels"], second["range_m"]) == (4, 1.0, None)


def test_the_same_masks_are_tried_with_more_pixels():
    """Half a mask instead would have twice the diffraction in pixels of half the size."""
    offer = load_offer(HQ)
    wanted = Wanted(0.35, 1.0)  # where the blur limits the mask, not the pupil
    before, after = (
        [one.camera for one in trials_for(each, wanted)] for each in (offer, with_binning(offer, 2))
    )
    assert len(before) == len(after) == 2
    for coarse, fine in zip(before, after, strict=True):
        assert coarse.mask_extent_mm < 0.9 * offer.camera.mask_extent_mm
        assert 1.0 <= fine.mask_extent_mm / coarse.mask_extent_mm < 1.25
        assert fine.blur_range_px(0.35, 1.0)[1] <= 2.05 * coarse.blur_range_px(0.35, 1.0)[1]
    coarser = trials_for(with_binning(offer, 8), wanted)
    assert max(one.camera.blur_range_px(0.35, 1.0)[1] for one in coarser) <= 16.1


@pytest.mark.parametrize("seed", [0, 3])
def test_magnified_scenes_are_the_same_places(seed):
    place = relief_scene(seed, (160, 120), 0.5).pixel_place
    magnified = relief_scene(seed, (320, 240), 1.0).pixel_place[::2, ::2]
    assert np.mean(np.abs(place - magnified) < 0.02) > 0.95
