"""The nodes as programs: start, signals, exit status, what they print."""

import re
import signal
import subprocess
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from ros_helpers import start_node
from sensor_msgs.msg import Image
from small_camera import CAMERA, FAR_M, HEIGHT, NEAR_M, WIDTH, coded_wall
from waiting import output_of, scaled, wait_until

from coded_aperture_ros.optics import load_camera

MODEL = {
    "near_m": NEAR_M,
    "far_m": FAR_M,
    "learn.level_count": 8,
    "learn.window_px": 32,
    "learn.rank": 48,
}


# What a node would warn of; the pipeline has all.
NOT_OF = {
    "camera_driver_node": [*MODEL],
    "depth_node": ["source", "rate_hz"],
    "deblur_node": ["source", "rate_hz", "learn.window_px", "learn.rank"],
}


@pytest.fixture(scope="module")
def parameters(tmp_path_factory):
    folder = tmp_path_factory.mktemp("camera")
    (folder / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
    (folder / "pictures").mkdir()
    frame = coded_wall(load_camera(folder / "camera.yaml"))
    cv2.imwrite(str(folder / "pictures" / "0.png"), np.rint(255 * frame).astype(np.uint8))
    return {
        "camera_file": str(folder / "camera.yaml"),
        "source": str(folder / "pictures"),
        "rate_hz": 30.0,
        "lazy": False,
        **MODEL,
    }


@pytest.fixture
def start(parameters):
    """Return a function that starts a node as a program; what it leaves running is killed."""
    started = []

    def start(node, *arguments, **changes):
        own = {name: parameters[name] for name in parameters if name not in NOT_OF.get(node, ())}
        process = start_node(
            node,
            {**own, **changes},
            *arguments,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def end(process, number):
    process.send_signal(number)
    out, err = output_of(process)
    return process.returncode, out + err


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_pipeline_runs_and_ends_cleanly_in_full_swing(ros, start, number):
    deblurred = ros.subscribe("deblurred/image", Image)
    process = start("pipeline")
    assert wait_until(lambda: len(deblurred) > 3), process.poll()
    status, said = end(process, number)
    assert status == 0, said
    assert "Traceback" not in said and "RCLError" not in said


@pytest.mark.parametrize(
    ("node", "topic"), [("camera_driver_node", "image_raw"), ("depth_node", "depth/image")]
)
def test_a_node_ends_cleanly_in_full_swing(ros, start, node, topic):
    received = ros.subscribe(topic, Image)
    images = ros.publisher("image_raw", Image)
    process = start(node)
    frame = Image(encoding="mono8", width=WIDTH, height=HEIGHT, step=WIDTH)
    frame.data = bytes(WIDTH * HEIGHT)

    def publish_until_received():
        if node != "camera_driver_node":
            images.publish(frame)
        return received

    assert wait_until(publish_until_received)
    status, said = end(process, signal.SIGTERM)
    assert (status, "Traceback" in said) == (0, False), said


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_impatience_does_not_make_the_end_a_crash(ros, start, number):
    received = ros.subscribe("depth/image", Image)
    process = start("pipeline")
    assert wait_until(lambda: received)
    while process.poll() is None:
        process.send_signal(number)
        time.sleep(0.005)
    _, err = output_of(process)
    assert process.returncode == 0, err
    assert "Traceback" not in err


def test_a_signal_while_learning_ends_at_once(start):
    process = start(
        "depth_node", **{"learn.level_count": 400, "learn.window_px": 128, "learn.rank": 512}
    )
    assert wait_until(lambda: process.stderr.readline())  # it says that it is learning
    time.sleep(0.2)
    began = time.monotonic()
    status, said = end(process, signal.SIGINT)
    assert (status, "Traceback" in said) == (0, False), said
    assert time.monotonic() - began < scaled(5)


@pytest.mark.parametrize("node", ["depth_node", "deblur_node", "pipeline"])
def test_a_bank_that_does_not_load_ends_the_node_with_one_line(start, tmp_path, node):
    (tmp_path / "bank.npz").write_bytes(b"PK\x03\x04 truncated")
    process = start(node, bank=str(tmp_path / "bank.npz"))
    out, err = output_of(process)
    assert (process.returncode, out) == (1, "")
    # In `pipeline` the driver has said where its frames go.
    errors = [line for line in err.splitlines() if not line.startswith("[INFO]")]
    assert len(errors) == 1, err
    assert node in errors[0] and "bank.npz" in errors[0]


def test_a_wrong_parameter_ends_the_node_with_one_line(start):
    process = start("depth_node", **{"compute.stride_px": -1})
    out, err = output_of(process)
    assert (process.returncode, out) == (1, "")
    assert len(err.splitlines()) == 1 and "compute.stride_px" in err, err


def test_a_wrong_qos_override_ends_the_node_with_one_line(start):
    name = "qos_overrides./image_raw.subscription.reliability"
    process = start("depth_node", **{name: "certain"})
    out, err = output_of(process)
    assert (process.returncode, out) == (1, "")
    errors = [line for line in err.splitlines() if not line.startswith(("[INFO]", "[WARN]"))]
    assert len(errors) == 1 and "certain" in errors[0], err


def test_wrong_ros_arguments_end_the_node_with_one_line(start):
    process = start("depth_node", "-r", "not a remapping")
    _, err = output_of(process)
    assert process.returncode == 1
    assert "Traceback" not in err


def catches(pid, number):
    """Return whether a process has said what to do at a signal."""
    status = Path(f"/proc/{pid}/status").read_text()
    mask = int(re.search(r"^SigCgt:\s*(\w+)", status, re.M)[1], 16)
    return bool(mask >> (number - 1) & 1)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("node", ["camera_driver_node", "depth_node", "pipeline"])
def test_a_signal_before_anything_is_imported_is_no_crash(start, node, number):
    process = start(node)
    while not catches(process.pid, signal.SIGTERM):  # Python itself takes SIGINT, and this not
        assert process.poll() is None
    mapped = Path(f"/proc/{process.pid}/maps").read_text()
    status, said = end(process, number)
    assert (status, said) == (0, "")
    assert "numpy" not in mapped and "rclpy" not in mapped


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("delay_s", [0.1, 0.25, 0.5, 0.8, 1.2, 1.8])
def test_a_signal_during_the_start_is_no_crash(start, delay_s, number):
    process = start("depth_node")
    while not catches(process.pid, signal.SIGTERM):
        assert process.poll() is None
    time.sleep(delay_s)
    status, said = end(process, number)
    assert status == 0, said
    assert "Traceback" not in said
