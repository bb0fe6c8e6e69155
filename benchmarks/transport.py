"""What it costs to carry frames: three processes over DDS, and three nodes of one process.

A driver publishes colour frames, a node that stands for depth answers each with a depth image of at
most 320x240, and a third one waits for both, as deblur_node does. None of them does any work on the
frames, so that all processor time is that of making, carrying and reading messages. With --link
instead: how many frames of a driver reach another process, and when, by the subscriber's
reliability and the Fast DDS profile.
"""

import argparse
import functools
import json
import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from coded_aperture_ros.io.messages import array_from_image
from coded_aperture_ros.ros.deblur_node import StampPairs
from coded_aperture_ros.ros.frame_node import FrameNode
from coded_aperture_ros.ros.messages import image_from_array, stamp_ns
from coded_aperture_ros.ros.topics import LocalTopics, Outputs

PROFILE = Path(__file__).resolve().parent.parent / "config" / "fastdds_shared_memory.xml"
ROLES = ("driver", "depth", "deblur")


class Driver(Node):
    """Publishes the same pixels with new stamps."""

    def __init__(
        self, size: tuple[int, int], rate_hz: float, encoding: str, local: LocalTopics | None
    ) -> None:
        super().__init__("driver")
        self._encoding = encoding
        self._outputs = Outputs(self, {"image_raw": Image}, local)
        self._outputs.open()
        random = np.random.default_rng(0)
        self._pixels = random.integers(0, 256, (*size, 3), dtype=np.uint8)
        self._period_s = 1 / rate_hz
        self.sent = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._stopping.is_set():
            if self._outputs.listened("image_raw"):
                stamp = self.get_clock().now().to_msg()
                header = Header(frame_id="camera", stamp=stamp)
                self._outputs.send(
                    "image_raw", image_from_array(self._pixels, self._encoding, header)
                )
                self.sent += 1
            due_s += self._period_s
            self._stopping.wait(max(0.0, due_s - time.monotonic()))


class Depth(FrameNode[Image]):
    """Answers each frame with a depth image."""

    outputs: ClassVar = {"depth/image": Image}

    def __init__(self, local: LocalTopics | None) -> None:
        super().__init__("depth_node", fixed={}, local=local)
        self.listen("image_raw", Image, self.offer)
        self.begin()

    def load(self) -> None:
        """Nothing to load."""

    def unload(self) -> None:
        """Nothing to end."""

    def process(self, item: Image) -> None:
        """Publish a depth image of the usual size."""
        array_from_image(item)
        divisor = -(-item.width // 320)
        depth = np.zeros((item.height // divisor, item.width // divisor), np.float32)
        self.send("depth/image", image_from_array(depth, "32FC1", item.header))
        self.sent(item.header)


class Deblur(FrameNode[tuple[Image, Image]]):
    """Waits for a frame and its depth."""

    outputs: ClassVar = {"deblurred/image": Image}

    def __init__(self, local: LocalTopics | None) -> None:
        super().__init__("deblur_node", fixed={}, local=local)
        self._pairs: StampPairs[Image, Image] = StampPairs(50, lambda: None)
        self.listen("image_raw", Image, self._on_image)
        self.listen("depth/image", Image, self._on_depth)
        self.begin()

    def load(self) -> None:
        """Nothing to load."""

    def unload(self) -> None:
        """Nothing to end."""

    def _on_image(self, message: Image) -> None:
        pair = self._pairs.add_first(stamp_ns(message.header), message)
        if pair is not None:
            self.offer(pair)

    def _on_depth(self, message: Image) -> None:
        pair = self._pairs.add_second(stamp_ns(message.header), message)
        if pair is not None:
            self.offer(pair)

    def process(self, item: tuple[Image, Image]) -> None:
        """Read both messages."""
        for message in item:
            array_from_image(message)
        self.sent(item[0].header)


def run_roles(
    roles: Sequence[str], size: tuple[int, int], rate_hz: float, seconds: float, encoding: str
) -> None:
    """Run nodes for some seconds and print their frames and the processor time meanwhile."""
    rclpy.init(args=["--ros-args", "-p", "lazy:=false"])
    local = LocalTopics() if len(roles) > 1 else None
    makers = {
        "driver": functools.partial(Driver, size, rate_hz, encoding, local),
        "depth": functools.partial(Depth, local),
        "deblur": functools.partial(Deblur, local),
    }
    executor = SingleThreadedExecutor()
    nodes: dict[str, Any] = {role: makers[role]() for role in roles}
    for node in nodes.values():
        executor.add_node(node)
    spinner = threading.Thread(target=executor.spin, daemon=True)
    spinner.start()
    time.sleep(3.0)  # until they have found each other
    before, counts = resource.getrusage(resource.RUSAGE_SELF), frames_of(nodes)
    time.sleep(seconds)
    after = resource.getrusage(resource.RUSAGE_SELF)
    used_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    done = {role: count - counts[role] for role, count in frames_of(nodes).items()}
    time.sleep(1.0)  # the others still measure
    print(json.dumps({"processor_s": used_s, "frames": done}), flush=True)
    os._exit(0)  # what is measured is over; nobody waits for the end of the middleware


def frames_of(nodes: dict[str, Any]) -> dict[str, int]:
    """Return how many frames every node is done with."""
    return {
        role: node.sent if role == "driver" else node.statistics.summary().processed
        for role, node in nodes.items()
    }


def compare(args: argparse.Namespace) -> dict[str, Any]:
    """Run the three nodes in three processes, and in one."""
    settings = [args.size, str(args.rate), str(args.seconds), args.encoding]
    results = {}
    for name, groups in (("processes", [[role] for role in ROLES]), ("pipeline", [ROLES])):
        programs = [
            subprocess.Popen(
                [sys.executable, __file__, "--roles", *group, "--settings", *settings],
                stdout=subprocess.PIPE,
                text=True,
                env=environment(profile=True, domain=61),
            )
            for group in groups
        ]
        answers = [json.loads(program.communicate()[0]) for program in programs]
        frames = {role: count for a in answers for role, count in a["frames"].items()}
        used_s = sum(answer["processor_s"] for answer in answers)
        results[name] = {
            "processor_ms_per_frame": round(1000 * used_s / max(frames["driver"], 1), 2),
            "frames": frames,
        }
    one, three = (results[name]["processor_ms_per_frame"] for name in ("pipeline", "processes"))
    return {**results, "pipeline_over_processes": round(one / three, 3)}


def environment(profile: bool, domain: int) -> dict[str, str]:
    """Return the environment of a program, with or without the package's Fast DDS profile."""
    variables = {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    variables.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    if profile:
        variables["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(PROFILE)
    return variables


def receive(reliable: bool, depth: int, seconds: float) -> None:
    """Subscribe for some seconds and print how many frames came, and how late."""
    rclpy.init()
    node = Node("subscriber")
    reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    late_ms: list[float] = []
    stamps: list[int] = []

    def on_image(message: Image) -> None:
        stamps.append(stamp_ns(message.header))
        late_ms.append((node.get_clock().now().nanoseconds - stamp_ns(message.header)) * 1e-6)

    qos = QoSProfile(depth=depth, reliability=reliability)
    node.create_subscription(Image, "image_raw", on_image, qos)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    end = time.monotonic() + seconds + 2
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    print(json.dumps({"stamps": stamps, "late_ms": late_ms}), flush=True)
    os._exit(0)


def share_received(stamps: Sequence[int], rate_hz: float) -> float:
    """Return how many of the frames from the first to the last one that came have come."""
    if len(stamps) < 2:
        return 0.0
    sent = (stamps[-1] - stamps[0]) * 1e-9 * rate_hz + 1
    return len(stamps) / sent


def measure_link(args: argparse.Namespace) -> list[dict[str, Any]]:
    """Measure a driver and a subscriber in every combination."""
    rows = []
    for profile in (False, True):
        for reliable in (False, True):
            for depth in (1, 2, 5):
                common: dict[str, Any] = {
                    "stdout": subprocess.PIPE,
                    "text": True,
                    "env": environment(profile, 62),
                }
                link = [str(int(reliable)), str(depth), str(args.seconds)]
                subscriber = subprocess.Popen(
                    [sys.executable, __file__, "--receive", *link], **common
                )
                settings = [args.size, str(args.rate), str(args.seconds), args.encoding]
                driver = subprocess.Popen(
                    [sys.executable, __file__, "--roles", "driver", "--settings", *settings],
                    **common,
                )
                got = json.loads(subscriber.communicate()[0])
                sent = json.loads(driver.communicate()[0])["frames"]["driver"]
                late = got["late_ms"] or [float("nan")]
                rows.append(
                    {
                        "profile": PROFILE.name if profile else "default",
                        "subscriber": "reliable" if reliable else "best effort",
                        "depth": depth,
                        "sent_per_s": round(sent / args.seconds, 1),
                        "received_share": round(share_received(got["stamps"], args.rate), 2),
                        "late_ms_p50": round(float(np.percentile(late, 50)), 1),
                        "late_ms_p99": round(float(np.percentile(late, 99)), 1),
                    }
                )
                print(json.dumps(rows[-1]), flush=True)
    return rows


def main() -> int:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", default="1280x720", metavar="WxH", help="default 1280x720")
    parser.add_argument("--rate", type=float, default=30.0, metavar="HZ", help="default 30")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="default 10")
    parser.add_argument("--encoding", choices=("rgb8", "bgr8"), default="rgb8", help="default rgb8")
    parser.add_argument("--link", action="store_true", help="measure frames that arrive instead")
    parser.add_argument("--roles", nargs="+", choices=ROLES, help=argparse.SUPPRESS)
    parser.add_argument("--settings", nargs=4, help=argparse.SUPPRESS)
    parser.add_argument("--receive", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.receive:
        receive(args.receive[0] == "1", int(args.receive[1]), float(args.receive[2]))
    if args.roles:
        width, height = map(int, args.settings[0].split("x"))
        rate_hz, seconds = map(float, args.settings[1:3])
        run_roles(args.roles, (height, width), rate_hz, seconds, args.settings[3])
    if args.link:
        measure_link(args)
    else:
        print(json.dumps(compare(args), indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
