"""Launch files and parameter files name only what exists.

The packages launch and launch_ros come with an installed ROS only. Elsewhere a recorder stands in
for them: it shows what a launch file asks for, which is what these tests are about.
"""

import dataclasses
import runpy
import sys
from importlib import import_module
from importlib.metadata import distribution
from types import ModuleType, SimpleNamespace

import pytest
import yaml

from coded_aperture_ros.cli.main import make_parser
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


class _Recorder:
    """Takes any arguments and keeps them."""

    def __init__(self, *values, **options):
        self.values, self.options = values, options


_ACTIONS = ("DeclareLaunchArgument", "Node", "ExecuteProcess", "IncludeLaunchDescription")


@pytest.fixture
def launch_file(checkout, monkeypatch):
    """Return a function that says what a launch file asks for."""
    recorded = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "ExecuteProcess", "IncludeLaunchDescription"],
        "launch.conditions": ["IfCondition", "UnlessCondition"],
        "launch.launch_description_sources": ["PythonLaunchDescriptionSource"],
        "launch.substitutions": [
            "EqualsSubstitution",
            "LaunchConfiguration",
            "NotEqualsSubstitution",
            "PathJoinSubstitution",
        ],
        "launch_ros": [],
        "launch_ros.actions": ["Node", "SetParametersFromFile"],
        "launch_ros.parameter_descriptions": ["ParameterValue"],
        "launch_ros.substitutions": ["FindPackageShare"],
    }
    for module, names in recorded.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, type(name, (_Recorder,), {}))
        monkeypatch.setitem(sys.modules, module, stand_in)

    def run(name):
        launch_file = runpy.run_path(str(checkout / "launch" / f"{name}.launch.py"))
        (actions,) = launch_file["generate_launch_description"]().values
        kinds = {kind: [a for a in actions if type(a).__name__ == kind] for kind in _ACTIONS}
        return SimpleNamespace(
            arguments={action.values[0] for action in kinds["DeclareLaunchArgument"]},
            nodes=[action.options for action in kinds["Node"]],
            programs=[action.options["cmd"] for action in kinds["ExecuteProcess"]],
            included=kinds["IncludeLaunchDescription"],
        )

    return run


@pytest.fixture
def launched(launch_file):
    return launch_file("pipeline")


def test_launched_programs_exist(launched):
    programs = {entry.name for entry in distribution("coded_aperture_ros").entry_points}
    started = [node["executable"] for node in launched.nodes]
    assert sorted(started) == sorted([*NODES, "pipeline"])
    assert set(started) <= programs
    assert {node["package"] for node in launched.nodes} == {"coded_aperture_ros"}


def test_either_three_processes_or_one(launched):
    conditions = {n["executable"]: type(n["condition"]).__name__ for n in launched.nodes}
    assert conditions.pop("pipeline") == "IfCondition"
    assert set(conditions.values()) == {"UnlessCondition"}
    assert {node["condition"].values[0].values for node in launched.nodes} == {("composed",)}
    assert all("name" not in node for node in launched.nodes)


def test_launched_parameter_files_exist(launched, checkout):
    for node in launched.nodes:
        files = [p.values[0][-1] for p in node["parameters"] if not isinstance(p, dict)]
        expected = list(NODES) if node["executable"] == "pipeline" else [node["executable"]]
        assert files == [f"{name}.yaml" for name in expected]
        assert all((checkout / "config" / name).is_file() for name in files)


def test_launched_parameters_exist_and_have_the_right_type(launched, configs_of):
    for node in launched.nodes:
        if node["executable"] == "pipeline":
            continue
        (given,) = (p for p in node["parameters"] if isinstance(p, dict))
        assert given
        known = {
            name: field for c in configs_of(node["executable"])
            for name, (field, _) in options_of(c).items()
        }  # fmt: skip
        for name, value in given.items():
            assert value.options["value_type"] is type(known[name].default)
            assert value.values[0].values == (name,)


def test_the_one_process_gets_every_parameter(launched):
    given = {
        node["executable"]: set().union(*(p for p in node["parameters"] if isinstance(p, dict)))
        for node in launched.nodes
    }
    together = given.pop("pipeline")
    assert together == set().union(*given.values())
    assert together <= launched.arguments


def test_obstacle_avoidance_connects_consumers_to_what_is_published(launch_file, checkout):
    launched = launch_file("obstacle_avoidance")
    nodes = {node["executable"]: node for node in launched.nodes}
    assert {"depthimage_to_laserscan_node", "nav2_costmap_2d", "lifecycle_manager"} <= set(nodes)
    from coded_aperture_ros.ros.depth_node import DepthNode

    remapped = dict(nodes["depthimage_to_laserscan_node"]["remappings"])
    assert set(remapped) == {"depth", "depth_camera_info"}
    assert set(remapped.values()) <= set(DepthNode.outputs)
    (included,) = launched.included
    path = included.values[0].values[0].values[0]
    assert (checkout / path[-2] / path[-1]).is_file()
    assert launched.arguments == {"rviz"}


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


def test_bag_evaluation_calls_the_program_with_its_own_options(launch_file):
    launched = launch_file("bag_evaluation")
    assert launched.arguments == {"bag", "output", "bank", "camera_file", "reference_depth"}
    for program in launched.programs:
        words = [word if isinstance(word, str) else word.values[0] for word in program]
        assert words[:5] == ["ros2", "run", "coded_aperture_ros", "coded_aperture", "bag"]
        make_parser().parse_args(words[4:])  # exits where an option does not exist


def test_two_cameras_do_not_share_names(launch_file, checkout):
    launched = launch_file("two_cameras")
    given = [dict(action.options["launch_arguments"]) for action in launched.included]
    assert [arguments["namespace"] for arguments in given] == ["front", "rear"]
    known = launch_file("pipeline").arguments
    assert all(set(arguments) <= known for arguments in given)


def test_the_picture_of_rviz_shows_published_topics(checkout):
    from coded_aperture_ros.ros.deblur_node import DeblurNode
    from coded_aperture_ros.ros.depth_node import DepthNode

    content = yaml.safe_load((checkout / "config" / "coded_aperture.rviz").read_text())
    displays = content["Visualization Manager"]["Displays"]
    topics = {display["Topic"]["Value"] for display in displays if "Topic" in display}
    others = {"image_raw", "costmap/costmap", "scan"}
    assert topics - others <= {*DepthNode.outputs, *DeblurNode.outputs}
    assert "depth/points" in topics
