"""Parameter files, and the picture for RViz, name only what exists."""

import json
import re
from importlib import import_module

import pytest
import yaml

rclpy = pytest.importorskip("rclpy")

NODES = {
    "camera_driver_node": "CameraDriverNode",
    "depth_node": "DepthNode",
    "deblur_node": "DeblurNode",
}
FILES = [*((node, node) for node in NODES), ("obstacle_avoidance", "depth_node")]


@pytest.fixture
def started():
    """Return a function that starts a node, to look at its parameters."""
    made = []

    def start(name, *arguments):
        context = rclpy.Context()
        rclpy.init(context=context)
        module = import_module(f"coded_aperture_ros.ros.{name}")
        arguments = ["--ros-args", *arguments, "-p", "autostart:=false"]
        made.append((getattr(module, NODES[name])(context=context, cli_args=arguments), context))
        return made[-1][0]

    yield start
    for node, context in made:
        node.close()
        node.destroy_node()
        rclpy.shutdown(context=context)


def parameters_in(checkout, file, node):
    """Return the parameters of a node in a file, nested ones with their full names."""

    def flat(values, prefix=""):
        for name, value in values.items():
            if isinstance(value, dict):
                yield from flat(value, f"{prefix}{name}.")
            else:
                yield prefix + name, value

    content = yaml.safe_load((checkout / "config" / f"{file}.yaml").read_text())
    return dict(flat(content[f"/**/{node}"]["ros__parameters"]))


@pytest.mark.parametrize(("file", "node"), FILES)
def test_ros_reads_parameter_files_as_they_are_meant(checkout, started, file, node):
    """Its YAML parser takes some texts for numbers that PyYAML does not, such as nan."""
    path = str(checkout / "config" / f"{file}.yaml")
    given = parameters_in(checkout, file, node)
    node = started(node, "--params-file", path)
    for name, value in given.items():
        assert node.get_parameter(name).value == value
        assert type(node.get_parameter(name).value) is type(value), name


@pytest.mark.parametrize("node", NODES)
def test_parameter_files_say_the_defaults(checkout, started, node):
    """Launch files leave the defaults to the nodes."""
    content = yaml.safe_load((checkout / "config" / f"{node}.yaml").read_text())
    assert list(content) == [f"/**/{node}"]
    given, node = parameters_in(checkout, node, node), started(node)
    assert given == {name: node.get_parameter(name).value for name in given}


def test_obstacle_avoidance_settings_agree_with_each_other(checkout):
    content = yaml.safe_load((checkout / "config" / "obstacle_avoidance.yaml").read_text())
    values = {name: part["ros__parameters"] for name, part in content.items()}
    layer = values["/**/costmap/costmap"]["voxel_layer"]
    marking, clearing = (layer[source] for source in layer["observation_sources"].split())
    assert {marking["topic"], clearing["topic"]} == {"depth/points"}
    assert marking["marking"]
    assert clearing["clearing"]
    # What is beyond the range clears as far as the layer looks, and marks nothing.
    far_m = values["/**/depth_node"]["output"]["points_far_m"]
    assert marking["obstacle_max_range"] < clearing["raytrace_max_range"] < far_m
    scan = values["/**/depthimage_to_laserscan"]
    assert scan["range_max"] < 10
    assert "optical" not in scan["output_frame"]


def test_the_picture_of_rviz_shows_published_topics(checkout):
    from coded_aperture_ros.ros.deblur_node import OUTPUT_TYPES
    from coded_aperture_ros.ros.depth_node import output_types

    content = yaml.safe_load((checkout / "config" / "coded_aperture.rviz").read_text())
    displays = content["Visualization Manager"]["Displays"]
    topics = {display["Topic"]["Value"] for display in displays if "Topic" in display}
    others = {"image_raw", "costmap/costmap", "scan"}
    assert topics - others <= {*output_types(), *OUTPUT_TYPES}
    assert "depth/points" in topics


def test_the_layout_of_foxglove_shows_published_topics(checkout):
    from coded_aperture_ros.ros.deblur_node import OUTPUT_TYPES
    from coded_aperture_ros.ros.depth_node import output_types

    content = json.loads((checkout / "config" / "foxglove_layout.json").read_text())
    panels = content["configById"]
    topics, kinds = set(), set()
    for name, panel in panels.items():
        kinds.add(name.partition("!")[0])
        topics |= panel.get("topics", {}).keys()
        topics |= {panel["imageMode"][key] for key in panel.get("imageMode", ()) if "Topic" in key}
        topics |= {path["value"].partition(".")[0] for path in panel.get("paths", ())}
        topics |= {panel["topicToRender"]} if "topicToRender" in panel else set()
    assert kinds == {"Image", "3D", "Plot", "DiagnosticSummary"}
    shown = {"image_raw", "depth/image", "depth/confidence", "deblurred/image", "depth/points"}
    driver = {"image_raw", "camera_info"}
    relative = {topic.removeprefix("/camera/").removeprefix("/") for topic in topics}
    assert {topic for topic in topics if not topic.startswith("/camera/")} == {"/diagnostics"}
    assert shown <= relative
    assert relative - driver - {"diagnostics"} <= {*output_types(), *OUTPUT_TYPES}
    # Every panel has its place, and no place is empty.
    text = json.dumps(content["layout"])
    assert sorted(re.findall(r'"(?:first|second)": "(.+?)"', text)) == sorted(panels)
