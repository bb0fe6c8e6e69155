#!/usr/bin/env python3
"""Write docs/topics.md: topics, services and parameters of the nodes, and the layers of depth.

    python scripts/generate_topics.py

The nodes are made, and say themselves what they have; a test compares the file with what this
program would write. Needs rclpy.
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import rclpy
from generate_layers import layer_table
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from coded_aperture_ros.core.share import share_directory
from coded_aperture_ros.depth import layer_specs
from coded_aperture_ros.depth.core_maps import CORE_MAPS
from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.deblur_node import DeblurNode
from coded_aperture_ros.ros.depth_node import DepthNode

PAGE = Path(__file__).resolve().parent.parent / "docs" / "topics.md"
_HEAD = """# Topics, parameters, layers

Three nodes turn frames into depth and all-in-focus pictures. This page has their topics, services
and parameters, and the maps that come beside depth. *Generated from the nodes themselves by
`scripts/generate_topics.py`.*

![Frames go from camera_driver_node to depth_node and deblur_node](images/nodes.svg)

- All names are relative: a namespace or a remapping moves them. [On a robot](robot.md) shows how
  nodes are started.
- Every result has the stamp and the frame of the picture that it came from. In 32FC1, NaN is
  unknown, +Inf beyond `far_m`, -Inf nearer than `near_m`; in 16UC1 all of these are 0.
- `qos_overrides` parameters change the QoS of every topic. With `image_transport:=compressed`
  frames come from `image_raw/compressed`.
"""
_PARAMETERS = """
## Parameters

Set a parameter at the start with `-p NAME:=VALUE`, and while the node runs with
`ros2 param set /NODE NAME VALUE`, where the table says "yes". A value that is not allowed is
refused with the reason, and the old one stays.
"""
_LAYERS = """
## Layers: what is known of every pixel beside its depth

`coded_aperture depth` with the output `x.npy` writes each as the file below, `depth_node` and
`coded_aperture bag` publish it as the topic, and `coded_aperture view` offers it as a map. In
Python it is `estimate.layers[name]`. Each stage in `coded_aperture_ros/depth/stages` names its own.

"""
# What topics are that no layer describes.
_MEANING = {
    "image_raw": "Coded frames.",
    "image_raw/compressed": "The same, compressed.",
    "camera_info": "Camera model of the frames.",
    "ground_truth/camera_info": "Camera model of the true pictures.",
    "ground_truth/depth": "True depth of simulated frames, m.",
    "ground_truth/image": "All-in-focus picture of simulated frames.",
    "/clock": "Stamps of the frames as the time.",
    "/tf_static": "Where the camera is on the robot.",
    "/tf": "Poses of the robot.",
    "/diagnostics": "Rate, latency, faults, and whether frames fit the bank.",
    "imu": "Angular velocity from a gyroscope, with `temporal.moving_camera:=gyro`, too.",
    "odometry": "Pose of the robot.",
    "rgbd/image": "Pictures to be coded, in linear light.",
    "rgbd/depth": "Depth of these pictures, m.",
    "depth/image": "Depth, m.",
    "depth/camera_info": "Camera model of the depth image.",
    "depth/odometry": "Pose and speed of the camera, as frames give them.",
    "deblurred/image": "All-in-focus picture.",
    "deblurred/image/compressed": "The same, compressed.",
    "deblurred/camera_info": "Camera model of the picture.",
    "set_camera_info": "Sets the calibration, as `cameracalibrator` does.",
}
# Each node, and the parameters besides the least with which it has further topics.
_NODES: dict[str, tuple[Any, tuple[dict[str, Any], ...]]] = {
    "camera_driver_node": (
        CameraDriverNode,
        (
            {"source": "simulator"},
            {"source": "rgbd"},
            {"publish_clock": True},
            {"base.frame": "base_link"},
        ),
    ),
    "depth_node": (DepthNode, ({"method": "motion"}, {"temporal.moving_camera": "pose"})),
    "deblur_node": (DeblurNode, ()),
}
# What nodes have besides where tf2_msgs is installed, by the parameter that asks for it.
_OF_TF = {
    "base.frame": [
        ("out", "/tf_static", "tf2_msgs/TFMessage", "reliable, depth 1, transient local")
    ],
    "temporal.moving_camera": [
        ("in", "/tf", "tf2_msgs/TFMessage", "best effort, depth 100"),
        ("in", "/tf_static", "tf2_msgs/TFMessage", "reliable, depth 100, transient local"),
    ],
}
_CAMERA = str(share_directory() / "config" / "demo_camera.yaml")
_LAYER_OF = {topic: spec for spec in layer_specs() for topic in (spec.topic, spec.points_topic)}


def page() -> str:
    """Text of docs/topics.md."""
    rclpy.init(args=["--ros-args", "--disable-rosout-logs", "--log-level", "error"])
    try:
        parts = [_HEAD]
        for name, (node_class, further) in _NODES.items():
            parts += [f"\n## Topics of {name}\n\n", _topics(node_class, further)]
        parts.append(_PARAMETERS)
        for name, (node_class, _) in _NODES.items():
            parts += [f"\n### Parameters of {name}\n\n", _parameters(node_class)]
        parts += [_LAYERS, layer_table()]
    finally:
        rclpy.shutdown()
    return "".join(parts)


def _topics(node_class: Any, further: tuple[dict[str, Any], ...]) -> str:
    """Table of the topics and services that a node has, with the parameters that it needs."""
    least: dict[str, Any] = {"camera_file": _CAMERA, "lazy": False}
    if node_class is CameraDriverNode:
        with tempfile.NamedTemporaryFile(suffix=".png") as picture:
            _write_picture(picture.name)
            rows = _endpoints(node_class, {**least, "source": picture.name})
    else:
        least |= {"near_m": 0.63, "far_m": 1.53, "learn.level_count": 8}
        rows = _endpoints(node_class, least)
    conditions = dict.fromkeys(rows, "")
    for added in further:
        ((key, value),) = added.items()
        for row in [*_endpoints(node_class, least | added), *_OF_TF.get(key, ())]:
            conditions.setdefault(row, f"with `{key}:={str(value).lower()}`")
    lines = ["| | topic | type | QoS | what it is |", "|---|---|---|---|---|"]
    lines += [
        f"| {kind} | `{topic}` | {type_name} | {qos} | {_meaning(topic, condition)} |"
        for (kind, topic, type_name, qos), condition in sorted(
            conditions.items(), key=lambda row: (row[1], row[0])
        )
    ]
    return "\n".join(lines) + "\n"


def _write_picture(path: str) -> None:
    import cv2
    import numpy as np

    cv2.imwrite(path, np.full((480, 640), 128, np.uint8))


def _endpoints(node_class: Any, parameters: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    """What a node subscribes, publishes and serves: kind, name, type and QoS of each."""
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    node = node_class(parameter_overrides=overrides)
    try:
        found = [
            ("in", one.topic_name, _type_name(one.msg_type), _qos(one))
            for one in node.subscriptions
        ]
        found += [
            ("out", one.topic_name, _type_name(one.msg_type), _qos(one)) for one in node.publishers
        ]
        found += [
            ("service", one.srv_name, _type_name(one.srv_type), "")
            for one in node.services
            if f"{node.get_name()}/" not in one.srv_name
        ]
    finally:
        node.close()
        node.destroy_node()
    ours = [(kind, _relative(name), *rest) for kind, name, *rest in found]
    own = [row for row in ours if row[1] not in ("/rosout", "/parameter_events")]
    return sorted({row for row in own if "transition_event" not in row[1]})


def _relative(name: str) -> str:
    absolute = ("/clock", "/tf", "/tf_static", "/diagnostics", "/rosout", "/parameter_events")
    return name if name in absolute else name.removeprefix("/")


def _type_name(kind: Any) -> str:
    return f"{kind.__module__.partition('.')[0]}/{kind.__name__}"


def _qos(endpoint: Any) -> str:
    """Reliability, depth, and durability where it is not volatile."""
    profile = endpoint.qos_profile
    reliable = profile.reliability == ReliabilityPolicy.RELIABLE
    words = ["reliable" if reliable else "best effort", f"depth {profile.depth}"]
    if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        words.append("transient local")
    return ", ".join(words)


def _meaning(topic: str, condition: str) -> str:
    """What a topic is, for a cell of the table, and under which condition there is one."""
    spec = _LAYER_OF.get(topic)
    if spec is not None:
        return f"Layer **{spec.name}**, see below."
    if topic in _MEANING:
        meaning = _MEANING[topic]
    else:
        meaning = _core_meaning(topic)
    return f"{meaning[:-1]}; {condition}." if condition else meaning


def _core_meaning(topic: str) -> str:
    """What a map is that every estimate has."""
    for spec in CORE_MAPS:
        if topic == spec.topic:
            return f"{spec.description.rstrip('.')} ({spec.encoding})."
        if topic == spec.points_topic:
            return "Points: x, y, z, rgb, confidence, std_dev."
        if topic == f"{spec.topic}/compressedDepth":
            return f"`{spec.topic}`, compressed."
    raise KeyError(f"{topic}: say in _MEANING what it is")


def _parameters(node_class: Any) -> str:
    """Table of the parameters of a node."""
    node = node_class(parameter_overrides=[Parameter("autostart", value=False)])
    try:
        names = [
            name
            for name in node._parameters
            if not name.startswith(("qos_overrides", "use_sim_time", "start_type_description"))
        ]
        lines = [
            "| parameter | type | default | allowed | while running | meaning |",
            "|---|---|---|---|---|---|",
        ]
        for name in names:
            value = True if name == "autostart" else node.get_parameter(name).value
            lines.append(_parameter_line(name, value, node.describe_parameter(name)))
    finally:
        node.close()
        node.destroy_node()
    return "\n".join(lines) + "\n"


def _parameter_line(name: str, value: Any, descriptor: ParameterDescriptor) -> str:
    shown = str(value).lower() if isinstance(value, bool) else str(value)
    kind = {"bool": "switch", "int": "integer", "float": "number", "str": "text"}
    cells = (
        f"`{name}`",
        kind[type(value).__name__],
        f"`{shown}`" if shown else "",
        _allowed(descriptor),
        "no" if descriptor.read_only else "yes",
        descriptor.description.replace("|", "\\|"),
    )
    return f"| {' | '.join(cells)} |"


def _allowed(descriptor: ParameterDescriptor) -> str:
    """Allowed values, in words; empty if all are."""
    if descriptor.additional_constraints:
        return descriptor.additional_constraints.removeprefix("one of ")
    for bounds in (*descriptor.floating_point_range, *descriptor.integer_range):
        least = None if bounds.from_value < -1e300 else bounds.from_value
        most = None if bounds.to_value >= 2**62 else bounds.to_value
        if least is None:
            return f"at most {most:g}"
        return f"at least {least:g}" if most is None else f"{least:g} to {most:g}"
    return ""


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    main()
