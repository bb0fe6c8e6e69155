"""Parameter files, and the picture for RViz, name only what exists."""

import dataclasses
from importlib import import_module

import pytest
import yaml

from coded_aperture_ros.core.options import options_of

rclpy = pytest.importorskip("rclpy")

NODES = {
    "camera_driver_node": "CameraDriverNode",
    "depth_node": "DepthNode",
    "deblur_node": "DeblurNode",
}
# rclpy's own, which every node has.
COMMON = {"use_sim_time"}


class _DeclaredError(Exception):
    """Carries the configurations that a node makes its parameters from."""


@pytest.fixture
def configs_of(monkeypatch):
    """Return the configurations from which a node, really started, declares its parameters."""

    def declared(self, node, *configs, **_):
        raise _DeclaredError(configs)

    def start(name):
        parameters = import_module("coded_aperture_ros.ros.parameters")
        monkeypatch.setattr(parameters.NodeParameters, "__init__", declared)
        module = import_module(f"coded_aperture_ros.ros.{name}")
        context = rclpy.Context()
        rclpy.init(context=context)
        try:
            with pytest.raises(_DeclaredError) as caught:
                getattr(module, NODES[name])(context=context)
        finally:
            rclpy.shutdown(context=context)
        return caught.value.args[0]

    return start


def names_in(configs):
    return {name for config in configs for name in options_of(config)} | COMMON


@pytest.mark.parametrize("node", NODES)
def test_parameter_file_holds_valid_values_of_real_parameters(checkout, configs_of, node):
    content = yaml.safe_load((checkout / "config" / f"{node}.yaml").read_text())
    assert list(content) == [f"/**/{node}"]
    values = content[f"/**/{node}"]["ros__parameters"]
    configs = configs_of(node)
    assert set(values) <= names_in(configs)
    for config in configs:
        mine = {name: value for name, value in values.items() if name in options_of(config)}
        dataclasses.replace(config, **mine)  # raises InputError for a value that is refused
        for name, value in mine.items():  # ROS parameters do not turn 15 into 15.0
            assert type(value) is type(getattr(config, name)), name


@pytest.mark.parametrize(
    ("file", "node"), [*((node, node) for node in NODES), ("obstacle_avoidance", "depth_node")]
)
def test_ros_reads_parameter_files_as_they_are_meant(checkout, tmp_path, file, node):
    """Its YAML parser takes some texts for numbers that PyYAML does not, such as nan."""
    module = import_module(f"coded_aperture_ros.ros.{node}")
    context = rclpy.Context()
    rclpy.init(context=context)
    path = str(checkout / "config" / f"{file}.yaml")
    arguments = ["--ros-args", "--params-file", path, "-p", "autostart:=false"]
    try:
        started = getattr(module, NODES[node])(context=context, cli_args=arguments)
        content = yaml.safe_load((checkout / "config" / f"{file}.yaml").read_text())
        for name, value in content[f"/**/{node}"]["ros__parameters"].items():
            assert started.get_parameter(name).value == value
        started.destroy_node()
    finally:
        rclpy.shutdown(context=context)


def test_obstacle_avoidance_settings_agree_with_each_other(checkout, configs_of):
    content = yaml.safe_load((checkout / "config" / "obstacle_avoidance.yaml").read_text())
    values = {name: part["ros__parameters"] for name, part in content.items()}
    ours, configs = values["/**/depth_node"], configs_of("depth_node")
    assert set(ours) <= names_in(configs)
    for config in configs:
        dataclasses.replace(config, **{n: v for n, v in ours.items() if n in options_of(config)})
    layer = values["/**/costmap/costmap"]["voxel_layer"]
    marking, clearing = (layer[source] for source in layer["observation_sources"].split())
    assert {marking["topic"], clearing["topic"]} == {"depth/points"}
    assert marking["marking"]
    assert clearing["clearing"]
    # What is beyond the range clears as far as the layer looks, and marks nothing.
    assert marking["obstacle_max_range"] < clearing["raytrace_max_range"] < ours["points_far_m"]
    scan = values["/**/depthimage_to_laserscan"]
    assert scan["range_max"] < 10
    assert "optical" not in scan["output_frame"]


def test_the_picture_of_rviz_shows_published_topics(checkout):
    from coded_aperture_ros.ros.deblur_node import DeblurNode
    from coded_aperture_ros.ros.depth_node import DepthNode

    content = yaml.safe_load((checkout / "config" / "coded_aperture.rviz").read_text())
    displays = content["Visualization Manager"]["Displays"]
    topics = {display["Topic"]["Value"] for display in displays if "Topic" in display}
    others = {"image_raw", "costmap/costmap", "scan"}
    assert topics - others <= {*DepthNode.outputs, *DeblurNode.outputs}
    assert "depth/points" in topics
