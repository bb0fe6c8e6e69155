"""What a deblurrer keeps between frames, how its settings change, and how it ends."""

import threading

import numpy as np
import pytest
from deblur_scene import blurred, deblurrer, edges_and_texture, levin_stack

from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer

SHAPE = (96, 128)
BLUR = np.full(SHAPE, 6.0, np.float32)
NOISE = 0.01
CG = {"method": "cg", "iterations": 12}


@pytest.fixture(scope="module")
def frames():
    """A video of a static scene."""
    sharp = edges_and_texture((6, 8), 16)
    return [blurred(sharp, 6.0, NOISE, seed) for seed in range(4)]


def video(deblur, frames):
    for frame in frames:
        result = deblur(frame, BLUR, NOISE)
    return result


@pytest.mark.parametrize("method", [{}, CG])
def test_reset_begins_another_video(frames, method):
    averaging = Deblurrer(levin_stack(), DeblurConfig(temporal_frames=8.0, **method))
    alone = deblurrer(**method).deblur(frames[-1], BLUR, NOISE)
    assert np.abs(video(averaging.deblur, frames) - alone).mean() > 1e-3
    averaging.reset()
    assert np.array_equal(averaging.deblur(frames[-1], BLUR, NOISE), alone)


def test_temporal_frames_can_change(frames):
    config = DeblurConfig(temporal_frames=8.0)
    changing, alone = Deblurrer(levin_stack()), deblurrer().deblur(frames[-1], BLUR, NOISE)
    assert np.array_equal(video(changing.deblur, frames), alone)
    changing.reconfigure(config)
    expected = video(Deblurrer(levin_stack(), config).deblur, frames)
    assert np.array_equal(video(changing.deblur, frames), expected)
    assert np.abs(expected - alone).mean() > 1e-3
    changing.reconfigure(DeblurConfig())
    assert np.array_equal(changing.deblur(frames[-1], BLUR, NOISE), alone)


def test_other_settings_keep_the_video(frames):
    config = DeblurConfig(temporal_frames=8.0)
    changing, same = (Deblurrer(levin_stack(), config) for _ in range(2))
    for each in (changing, same):
        video(each.deblur, frames[:-1])
    changing.reconfigure(DeblurConfig(temporal_frames=8.0, smoothness=3.0))
    changing.reconfigure(config)
    results = [each.deblur(frames[-1], BLUR, NOISE) for each in (changing, same)]
    assert np.array_equal(*results)


@pytest.mark.parametrize(
    "options", [{"method": "inverse"}, {"method": "inverse", "band": "half"}, {"rank": 4}, CG,
                {"method": "sparse", "iterations": 8}, {"smoothness": 9.0}, {"noise": 0.03},
                {"noise_gain": 0.01}]
)  # fmt: skip
def test_every_option_can_change(frames, options):
    """To what a new deblurrer with these options gives, and back."""
    blur = np.where(np.arange(SHAPE[1]) < 64, BLUR, 3).astype(np.float32)
    changing = Deblurrer(levin_stack())
    before = changing.deblur(frames[0], blur)
    changing.reconfigure(DeblurConfig(**options))
    after = changing.deblur(frames[0], blur)
    assert np.array_equal(after, deblurrer(**options).deblur(frames[0], blur))
    assert not np.array_equal(after, before)
    changing.reconfigure(DeblurConfig())
    assert np.array_equal(changing.deblur(frames[0], blur), before)


@pytest.mark.skipif(processors() < 2, reason="one processor")
def test_closing_and_another_number_of_threads_end_the_threads(frames):
    before = set(threading.enumerate())
    threaded = Deblurrer(levin_stack(), DeblurConfig(threads=2))
    expected = threaded.deblur(frames[0], BLUR, NOISE)
    assert len(set(threading.enumerate()) - before) == 1
    threaded.reconfigure(DeblurConfig(threads=1))
    assert set(threading.enumerate()) == before
    assert threaded.deblur(frames[0], BLUR, NOISE) == pytest.approx(expected, abs=1e-5)
    threaded.reconfigure(DeblurConfig(threads=2))
    threaded.deblur(frames[0], BLUR, NOISE)
    assert len(set(threading.enumerate()) - before) == 1
    threaded.close()
    assert set(threading.enumerate()) == before


@pytest.mark.parametrize("colour", [False, True])
def test_noise_is_estimated_as_for_depth_unless_it_is_known(frames, colour):
    """The call's own noise counts first, then the configured one, then the frame's."""
    frame = frames[0]
    if colour:
        random = np.random.default_rng(9)
        frame = np.dstack([frames[1], frame, frames[2]])
        # Green is much noisier than the others: alone it would mislead.
        frame[..., 1] += random.normal(0, 4 * NOISE, SHAPE).astype(np.float32)
    plain, known = deblurrer(), deblurrer(noise=0.05)
    found = plain.deblur(frame, BLUR)
    assert np.array_equal(known.deblur(frame, BLUR), plain.deblur(frame, BLUR, 0.05))
    assert np.array_equal(known.deblur(frame, BLUR, NOISE), plain.deblur(frame, BLUR, NOISE))
    mean_noise = NOISE * np.sqrt((1 + 17 + 1) / 3 if colour else 1)
    closest = min((0.2, 1.0, 4.0), key=lambda factor: np.abs(
        plain.deblur(frame, BLUR, 1.2 * factor * mean_noise) - found).max())  # fmt: skip
    assert closest == 1.0


def test_shot_noise_counts_at_the_brightness_of_the_frame(frames):
    gain = 0.03**2 / float(frames[0].mean())
    with_shot = deblurrer(noise=0.04, noise_gain=gain).deblur(frames[0], BLUR)
    assert np.array_equal(with_shot, deblurrer().deblur(frames[0], BLUR, 0.05))


def test_the_band_is_that_of_closed_forms(frames):
    """What the other methods begin with stays as it is."""
    half, full = (deblurrer(**CG, band=band).deblur(frames[0], BLUR) for band in ("half", "full"))
    assert np.array_equal(half, full)
