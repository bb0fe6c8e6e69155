"""Noise of a sensor from still frames."""

import numpy as np
import pytest
from cameras import THESIS
from cli_scene import call, everything, refused, wrong_usage

from coded_aperture_ros.calibration.noise import noise_from_frames
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames.noise import KnownNoise
from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import camera_from_mapping


def scene(seed=0, size=(300, 400), low=0.01, high=0.9):
    """Random squares of every brightness: many pixels at each, and many steep steps."""
    random = np.random.default_rng(seed)
    squares = random.random((size[0] // 8 + 1, size[1] // 8 + 1))
    return low + (high - low) * np.kron(squares, np.ones((8, 8)))[: size[0], : size[1]]


def frames_of(light, noise, gain, count=2, seed=1, bits=16, flicker=0.0):
    random = np.random.default_rng(seed)
    steps = 2**bits - 1
    frames = []
    for number in range(count):
        lit = light * (1 + flicker * number)
        frame = lit + np.sqrt(noise**2 + gain * lit) * random.standard_normal(light.shape)
        frames.append(np.round(np.clip(frame, 0, 1) * steps) / steps)
    return frames


@pytest.mark.parametrize(
    ("noise", "gain"), [(0.002, 0.0), (0.003, 1e-4), (0.005, 1e-3), (0.001, 2e-4)]
)
@pytest.mark.parametrize("colour", [False, True])
def test_noise_and_gain(noise, gain, colour):
    light = scene()
    if colour:
        light = np.stack([light, 0.7 * light, 0.5 * light], axis=-1)
    found = noise_from_frames(frames_of(light, noise, gain))
    # The line's height is known to a share of the variance where there is least light.
    assert found.noise**2 == pytest.approx(noise**2, abs=0.1 * (noise**2 + gain * found.darkest))
    assert found.noise_gain == pytest.approx(gain, rel=0.05, abs=3e-7)
    assert found.gain_is_known


def test_more_frames_and_flickering_light():
    found = noise_from_frames(frames_of(scene(), 0.003, 1e-4, count=5, flicker=0.01))
    assert found.noise == pytest.approx(0.003, rel=0.05)
    assert found.noise_gain == pytest.approx(1e-4, rel=0.1)


def test_quantisation_to_8_bits_counts_as_noise():
    found = noise_from_frames(frames_of(scene(), 0.003, 0.0, bits=8))
    assert found.noise == pytest.approx(np.hypot(0.003, 1 / 255 / np.sqrt(12)), rel=0.05)


def test_sparks_and_saturated_pixels_do_not_matter():
    frames = frames_of(scene(high=1.3), 0.003, 1e-4)
    frames[1][::17, ::13] = 0.5
    found = noise_from_frames(frames)
    assert found.noise == pytest.approx(0.003, rel=0.15)
    assert found.noise_gain == pytest.approx(1e-4, rel=0.1)
    assert found.brightest <= 0.95


def test_flat_frames_tell_the_noise_at_their_brightness():
    found = noise_from_frames(frames_of(np.full((200, 200), 0.4), 0.002, 1e-4))
    assert not found.gain_is_known
    assert found.noise_gain == 0
    assert found.noise == pytest.approx(np.sqrt(0.002**2 + 0.4e-4), rel=0.03)


def test_shot_noise_that_hides_the_dark_is_told():
    assert noise_from_frames(frames_of(scene(low=0.2), 0.0005, 4e-4)).dark_is_extrapolated
    assert not noise_from_frames(frames_of(scene(), 0.003, 1e-4)).dark_is_extrapolated


@pytest.mark.parametrize(
    ("frames", "phrase"),
    [
        ([scene()], "two or more"),
        ([scene(), scene()], "the frames are equal"),
        ([scene(), scene()[:-1]], r"frame 2 has the shape \[299, 400\]"),
        (frames_of(1 + 0 * scene(), 0.0, 0.0), "neither black nor saturated"),
        ([frames_of(scene(), 0.002, 0)[0], np.roll(scene(), 1, axis=1)], "something moved"),
        (frames_of(scene(), 0.002, 0)[:1] + frames_of(scene()[::-1], 0.002, 0)[1:], "% off"),
    ],
)
def test_frames_that_cannot_be_used(frames, phrase):
    with pytest.raises(InputError, match=phrase):
        noise_from_frames(frames)


def test_noise_of_the_camera_file_is_a_default():
    camera = camera_from_mapping({**THESIS, "noise": 0.002, "noise_gain": 1e-4})
    assert KnownNoise.from_sources(DepthConfig(noise=0.01), camera) == KnownNoise(0.01, 1e-4)
    assert KnownNoise.from_sources(DepthConfig(), camera).noise == 0.002
    assert KnownNoise.from_sources(DepthConfig(), None) == KnownNoise()


# ---- the command ----


def files_of(folder, frames):
    paths = [folder / f"frame{number}.png" for number in range(len(frames))]
    for path, frame in zip(paths, frames, strict=True):
        write_image(path, frame)
    return paths


def test_command(tmp_path, capsys):
    import json

    import yaml

    paths = files_of(tmp_path, frames_of(scene(), 0.003, 1e-4, count=3))
    before = everything(tmp_path)
    result = call(capsys, "calibrate", "noise", *paths, "--json")
    assert (result.status, result.err) == (0, "")
    found = json.loads(result.out)
    assert found["noise"] == pytest.approx(0.003, rel=0.05)
    assert (found["frames"], found["warnings"]) == (3, [])
    # What is printed can go into a camera file as it stands.
    lines = yaml.safe_load(call(capsys, "calibrate", "noise", *paths).out)
    assert lines.keys() == {"noise", "noise_gain"}
    assert camera_from_mapping({**THESIS, **lines}).noise == pytest.approx(found["noise"], abs=1e-6)
    assert everything(tmp_path) == before


def test_command_warns_of_flat_frames(tmp_path, capsys, caplog):
    paths = files_of(tmp_path, frames_of(np.full((200, 200), 0.4), 0.002, 1e-4))
    assert call(capsys, "calibrate", "noise", *paths).status == 0
    (warning,) = caplog.messages
    assert "photograph something with dark and bright parts" in warning


def test_command_names_the_file(tmp_path, capsys):
    paths = files_of(tmp_path, [scene(), scene()[:-9]])
    refused(call(capsys, "calibrate", "noise", *paths), paths[1], paths[0], "[291, 400]")
    (tmp_path / "same.png").write_bytes(paths[0].read_bytes())
    refused(call(capsys, "calibrate", "noise", paths[0], tmp_path / "same.png"), "are equal")
    nowhere = call(capsys, "calibrate", "noise", tmp_path / "nowhere")
    wrong_usage(nowhere, "calibrate noise", "two or more", "nowhere has not so many")
    wrong_usage(call(capsys, "calibrate", "noise", paths[0]), "calibrate noise", "two or more")
