"""Killed at any moment, a program leaves a whole result, and the next run removes what was left.

KILLS=100 kills the programs so many times in all.
"""

import json
import math
import os
import subprocess
import sys

import killed_program
import killed_writers
import pytest
import yaml
from bag_scene import camera_info, image, write_bag
from small_camera import CAMERA, coded_wall

from coded_aperture_ros.bags.codec import CAMERA_INFO, IMAGE
from coded_aperture_ros.io.picture_file import write_image
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank, save_bank
from coded_aperture_ros.optics import load_camera, render_psf_stack

KINDS = "bag", "learn", "depth", "record"
KILLS = math.ceil(int(os.environ.get("KILLS", "16")) / len(KINDS))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kills")
    file = folder / "camera.yaml"
    file.write_text(yaml.safe_dump(CAMERA))
    camera = load_camera(file)
    sizes = camera.blur_size_px([1.3, 1.6, 2.0, 2.6, 4.0])
    stack = render_psf_stack(camera.mask, sorted(sizes))
    save_bank(learn_bank(stack, LearnConfig(window_px=16)), folder / "bank.npz")
    wall = coded_wall(camera)
    write_image(folder / "frame.png", wall)
    pixels = (wall * 255).astype("uint8")
    rows, columns = pixels.shape
    messages = [
        message
        for index in range(4)
        for message in (
            ("/camera/camera_info", CAMERA_INFO, index, camera_info(index, columns, rows, 400.0)),
            ("/camera/image_raw", IMAGE, index, image(pixels, "mono8", index)),
        )
    ]
    write_bag(folder / "recording", messages)
    return folder


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", KINDS)
def test_a_kill_leaves_a_whole_result(inputs, tmp_path, kind):
    if kind == "record":
        pytest.importorskip("aiohttp", reason="the viewer needs aiohttp")
    out = tmp_path / "out"
    bank = "--bank", inputs / "bank.npz"
    camera = "--camera", inputs / "camera.yaml"
    # Workers for the frames take seconds to start.
    frames = "0" if KILLS > 10 else "2"
    of_bag = "--temporal-frames", frames, "--overwrite", "-o", out
    words = {
        "bag": [inputs / "recording", *bank, *camera, *of_bag],
        "learn": ["--depth-range", "1.3", "4", *camera, "-o", f"{out}.npz"],
        "depth": [inputs / "frame.png", *bank, *camera, "-o", f"{out}.npy"],
        "record": [],
    }[kind]
    done = subprocess.run(
        [sys.executable, killed_program.__file__, tmp_path, kind, str(KILLS), "1", *words],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    print(result)
    assert result["faults"] == []
    assert result["killed"] == KILLS
    assert result["namings"] > 0


@pytest.mark.parametrize("kind", killed_writers.WRITERS)
def test_a_kill_before_any_step_of_writing_leaves_old_or_new(tmp_path, kind):
    done = subprocess.run(
        [sys.executable, killed_writers.__file__, tmp_path, kind], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["faults"] == []
    assert result["steps"] > 10
