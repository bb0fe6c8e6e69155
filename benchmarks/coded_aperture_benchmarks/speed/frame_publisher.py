"""Program that publishes coded frames at a rate, stamped at the moment of publication.

`python -m coded_aperture_benchmarks.speed.frame_publisher FRAMES CAMERA_FILE RATE_HZ LOG`
"""

import contextlib
import json
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_benchmarks.run import Row

_MODULE = "coded_aperture_benchmarks.speed.frame_publisher"

# Sends the frame of a number, and returns its stamp, ns.
Publish = Callable[[int], int]


def arguments(frames_file: Path, camera_file: Path, rate_hz: float, log_file: Path) -> list[str]:
    """Return the command line of this program, after the Python interpreter.

    Parameters
    ----------
    frames_file : Path
        Array of frames (.npy), uint8 [frames, rows, columns].
    camera_file : Path
        Of their camera model.
    rate_hz : float
    log_file : Path
        JSON that is written at the end: `sent_ns`, the stamps; `late_ms`, by how much each frame
        was late; `left_out`, how many were.
    """
    return ["-m", _MODULE, str(frames_file), str(camera_file), str(rate_hz), str(log_file)]


def publish_until_stopped(publish: Publish, rate_hz: float, stopping: Sequence[int]) -> Row:
    """Publish frames in a loop until `stopping` holds something; return what is logged.

    The deadlines are those of a steady clock and do not depend on each other. Like a camera, the
    publisher leaves a frame out rather than sending two at once to catch up.
    """
    sent_ns: list[int] = []
    late_ms: list[float] = []
    left_out = 0
    period_s = 1.0 / rate_hz
    begun_s, turn = time.monotonic(), 0
    while not stopping:
        due_s = begun_s + turn * period_s
        time.sleep(max(due_s - time.monotonic(), 0.0))
        late_ms.append(1000 * (time.monotonic() - due_s))
        sent_ns.append(publish(len(sent_ns)))
        turn, before = max(turn + 1, int((time.monotonic() - begun_s) / period_s)), turn
        left_out += turn - before - 1
    return {"sent_ns": sent_ns, "late_ms": late_ms, "left_out": left_out}


@contextlib.contextmanager
def publisher(frames_file: Path, camera_file: Path) -> Iterator[Publish]:
    """Run a node that publishes frames and their camera model over DDS."""
    from coded_aperture_benchmarks.speed.node_processes import ros_node

    with ros_node("frame_publisher") as (node, _):
        yield frame_sender(node, frames_file, camera_file)


def frame_sender(node: Any, frames_file: Path, camera_file: Path, local: Any = None) -> Publish:
    """Function of a node that sends frames and their camera model.

    Parameters
    ----------
    node : rclpy.node.Node
    frames_file, camera_file : Path
    local : LocalTopics, optional
        Topics inside the process.
    """
    from rclpy.time import Time
    from sensor_msgs.msg import CameraInfo, Image
    from std_msgs.msg import Header

    from coded_aperture_ros.optics import load_camera
    from coded_aperture_ros.ros.messages import camera_info_from_camera, image_from_array
    from coded_aperture_ros.ros.topics import Outputs

    header = Header(frame_id="camera_optical_frame")
    camera = load_camera(camera_file)
    frames = np.load(frames_file)
    outputs = Outputs(node, {"image_raw": Image, "camera_info": CameraInfo}, local)
    outputs.open()

    def publish(number: int) -> int:
        # Messages inside the process are shared: each is made anew, as the driver does.
        image = image_from_array(frames[number % len(frames)], "mono8", header)
        info = camera_info_from_camera(camera, header)
        now_ns = time.time_ns()
        image.header.stamp = info.header.stamp = Time(nanoseconds=now_ns).to_msg()
        outputs.send("camera_info", info)
        outputs.send("image_raw", image)
        return now_ns

    return publish


def main() -> int:
    """Publish until SIGINT or SIGTERM, then write the log."""
    frames_file, camera_file, log_file = (Path(sys.argv[index]) for index in (1, 2, 4))
    stopping: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: stopping.append(number))
    with publisher(frames_file, camera_file) as publish:
        log = publish_until_stopped(publish, float(sys.argv[3]), stopping)
    log_file.write_text(json.dumps(log))
    return 0


if __name__ == "__main__":
    sys.exit(main())
