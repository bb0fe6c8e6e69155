"""What changes over minutes: the test of the mask, averages, and since when something has moved."""

import dataclasses

import numpy as np
import pytest

from coded_aperture_ros.calibration.service.mask import turned
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.drift import DriftWatch, is_same_view, turn_deg, view_of
from coded_aperture_ros.depth.quality.mask_test import PARTS, TURNS_DEG, MaskLook, MaskTest, covered
from coded_aperture_ros.frames import Frame
from coded_aperture_ros.likelihood.bank import learn_bank
from coded_aperture_ros.optics import Mask, render_psf, render_psf_stack
from coded_aperture_ros.simulation.layered import random_scene

SIZES_PX = np.arange(2.0, 18.0, 0.55)
NOISE = 0.002
SCENES = 6


@pytest.fixture(scope="module")
def levin():
    return Mask.named("levin")


@pytest.fixture(scope="module")
def stack(levin):
    return render_psf_stack(levin, SIZES_PX)


@pytest.fixture(scope="module")
def mask_test(stack):
    return MaskTest(stack)


@pytest.fixture(scope="module")
def scenes(levin):
    return [
        random_scene(1_000_100 + seed, levin, shape=(256, 256), blur_range_px=(4.0, 14.0))
        for seed in range(SCENES)
    ]


def recorded(light, seed=0):
    random = np.random.default_rng(seed)
    return (light + NOISE * random.standard_normal(light.shape)).astype(np.float32)


def mean_gains(mask_test, scenes, mask):
    looks = [mask_test.look(recorded(scene.coded(mask)), NOISE) for scene in scenes]
    return np.mean([look.gains for look in looks if look is not None], axis=0)


@pytest.mark.parametrize("degrees", [0.0, 6.0, -9.0])
def test_frames_tell_how_far_a_mask_is_turned(mask_test, scenes, levin, degrees):
    found = turn_deg(mean_gains(mask_test, scenes, turned(levin, degrees)))
    assert found == pytest.approx(degrees, abs=2.5)


def test_frames_tell_which_part_of_a_mask_is_covered(mask_test, scenes, levin):
    cells = np.kron(levin.transmission, np.ones((PARTS, PARTS), np.float32))
    third = len(cells) // PARTS
    cells[:third, third : 2 * third] = 0
    gains = mean_gains(mask_test, scenes, Mask("dirty", cells))
    clean = mean_gains(mask_test, scenes, None)
    # Power spectra do not tell a part from the one on the other side, if the mask is about
    # the same there.
    name = mask_test.names[int(np.argmax(gains[2:])) + 2]
    assert name in ("covered 1 2", "covered 3 2")
    assert gains[2:].max() > 0.1 > clean.max()


def test_a_covered_part_has_no_light():
    psf = render_psf(Mask("open", [[1.0]]), 9.0)
    found = covered(psf, 9.0, 0, 2)
    middle = len(psf) // 2
    assert found.sum() == pytest.approx(1)
    assert found[middle - 3, middle + 3] == 0 < found[middle - 3, middle - 3]
    dot = np.zeros((9, 9), np.float32)
    dot[4, 4] = 1
    assert covered(dot, 1.0, 1, 1) == pytest.approx(dot)


def test_frames_without_texture_say_nothing(mask_test):
    assert mask_test.look(np.full((128, 128), 0.5, np.float32), NOISE) is None
    assert mask_test.look(np.zeros((20, 20), np.float32), NOISE) is None


@pytest.mark.parametrize(
    ("gains", "angle"),
    [
        ([-3, -2, -1, -1, -2, -3], 0),
        ([-3, -2, -1, 1, -2, -3], 4 - 0.5),
        ([-3, 1, 0, -1, -2, -3], -8 + 4 * 3 / 10),
        ([-3, -2, -1, 0, 1, 2], 12),
    ],
)
def test_the_angle_is_where_the_parabola_is_highest(gains, angle):
    assert turn_deg(np.array(gains, float)) == pytest.approx(angle, abs=0.5)


def look(angle=0.0, part=None, residual=0.0):
    off = np.array(TURNS_DEG) - angle
    gains = np.concatenate([0.02 * (angle**2 - off**2), np.full(PARTS**2, -1.0)])
    if part is not None:
        gains[len(TURNS_DEG) + part] = 1.0
    return MaskLook(gains, residual)


VIEWS = [view_of(np.random.default_rng(number).random((64, 64), np.float32)) for number in range(8)]


def minutes_of(watch, looks, first_s=0.0, health=0.9, minutes=4, views=VIEWS):
    """Add frames of some minutes, one a second; return when the next one begins."""
    for second in range(60 * minutes + 1):
        watch.add(first_s + second, health, looks, views[second % len(views)])
    return first_s + 60 * minutes + 1


@pytest.fixture
def watch(stack):
    return DriftWatch(stack)


def test_what_stays_as_it_is_does_not_drift(watch):
    minutes_of(watch, look(angle=1.0), minutes=8)
    assert watch.drift is None
    figures = watch.figures()
    assert figures["health_10s"] == figures["health_10min"] == pytest.approx(0.9)
    assert figures["mask_turned_10min_deg"] == pytest.approx(1.0)
    assert figures["residual_10s"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("changed", "health", "words"),
    [
        (look(angle=8.0), 0.9, "turned by 8 degrees clockwise"),
        (look(angle=-7.0), 0.9, "turned by 7 degrees counter-clockwise"),
        (look(part=1), 0.9, "row 1, column 2"),
        (look(), 0.4, "0.40 in place of 0.90"),
    ],
)
def test_a_change_that_lasts_is_told_with_its_time(watch, changed, health, words):
    change_s = minutes_of(watch, look())
    assert watch.drift is None
    minutes_of(watch, changed, change_s, health, minutes=9)
    assert words in watch.drift.text
    assert change_s <= watch.drift.since_s <= change_s + 300


def test_a_change_that_goes_is_not_told_any_more(watch):
    then_s = minutes_of(watch, look(angle=6.0), minutes=5)
    assert watch.drift is not None
    minutes_of(watch, look(), then_s, minutes=5)
    assert watch.drift is None


def test_frames_without_a_health_are_compared_all_the_same(watch):
    then_s = minutes_of(watch, look(), health=np.nan)
    minutes_of(watch, look(angle=8.0), then_s, np.nan, minutes=8)
    assert "turned by 8 degrees" in watch.drift.text


@pytest.mark.parametrize(("count", "told"), [(4, False), (5, True)])
@pytest.mark.parametrize("changed", [look(angle=8.0), look(part=1)])
def test_few_views_say_nothing_of_the_mask(watch, changed, count, told):
    minutes_of(watch, changed, minutes=6, views=VIEWS[:count])
    assert (watch.drift is not None) == told


def test_views_of_long_ago_do_not_count(watch):
    then_s = minutes_of(watch, look(), minutes=3)
    minutes_of(watch, look(angle=8.0), then_s, minutes=7, views=VIEWS[:2])
    assert watch.drift is None


def test_health_is_watched_in_few_views_too(watch):
    then_s = minutes_of(watch, look(), views=VIEWS[:1])
    minutes_of(watch, look(), then_s, health=0.3, minutes=6, views=VIEWS[:1])
    assert "0.30 in place of 0.90" in watch.drift.text


@pytest.mark.parametrize(("right", "down"), [(0, 0), (80, 0), (-60, 40)])
def test_what_a_camera_pans_over_is_the_same_view(levin, right, down):
    whole = random_scene(1_000_200, levin, shape=(480, 640), blur_range_px=(4.0, 14.0)).coded()
    other = random_scene(1_000_201, levin, shape=(480, 640), blur_range_px=(4.0, 14.0)).coded()
    here, there, other = (
        view_of(light[top : top + 320, left : left + 400])
        for light, top, left in (
            (whole, 80, 120),
            (whole, 80 + down, 120 + right),
            (other, 80, 120),
        )
    )
    assert is_same_view(here, there)
    assert not is_same_view(here, other)


def test_minutes_with_few_frames_do_not_count(watch):
    for second in range(0, 1200, 10):
        watch.add(float(second), 0.9, look(angle=6.0), VIEWS[0])
    assert watch.drift is None


def test_the_short_average_follows_sooner(watch):
    now_s = minutes_of(watch, look())
    for second in range(30):
        watch.add(now_s + second, 0.3, look(), VIEWS[0])
    figures = watch.figures()
    assert figures["health_10s"] < 0.4 < 0.8 < figures["health_10min"]


def test_health_that_is_not_known_is_left_out(watch):
    watch.add(0.0, np.nan, look(), VIEWS[0])
    assert "health_10s" not in watch.figures() and "residual_10s" in watch.figures()
    watch.add(1.0, 0.8, look(), VIEWS[0])
    watch.add(2.0, np.nan, look(), VIEWS[0])
    assert watch.figures()["health_10s"] == pytest.approx(0.8)


@pytest.mark.parametrize("middle_only", [False, True])
def test_frames_are_seen_once_a_second_at_most(stack, scenes, middle_only):
    watch = DriftWatch(stack, middle_only)
    estimator = DepthEstimator(learn_bank(stack), DepthConfig())
    light = recorded(scenes[0].coded())
    frame = Frame.of(np.stack([light] * 3, axis=-1))
    estimate = estimator.estimate(frame)
    assert watch.due(5.0)
    watch.see(5.0, frame, estimate, 0.995)
    assert not watch.due(5.5) and watch.due(6.0)
    assert watch.figures()["health_10s"] == pytest.approx(estimate.health.value)
    before = watch.figures()
    watch.see(6.0, frame, dataclasses.replace(estimate, health=None), 0.995)
    assert watch.figures() == before  # it is the same scene
    blank = dataclasses.replace(frame, light=np.full_like(frame.light, 0.5))
    watch.see(7.0, blank, estimate, 0.995)
    estimator.close()
