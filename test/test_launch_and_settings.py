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

from coded_aperture_ros.configuration import options_of

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
        parameters = import_module("coded_aperture_ros.nodes.parameters")
        monkeypatch.setattr(parameters.NodeParameters, "__init__", declared)
        module = import_module(f"coded_aperture_ros.nodes.{name}")
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


class _Recorder:
    """Takes any arguments and keeps them."""

    def __init__(self, *values, **options):
        self.values, self.options = values, options


@pytest.fixture
def launched(checkout, monkeypatch):
    """Return what the launch file asks for: its arguments, and its nodes."""
    recorded = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.conditions": ["IfCondition", "UnlessCondition"],
        "launch.substitutions": ["LaunchConfiguration", "PathJoinSubstitution"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
        "launch_ros.parameter_descriptions": ["ParameterValue"],
        "launch_ros.substitutions": ["FindPackageShare"],
    }
    for module, names in recorded.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, type(name, (_Recorder,), {}))
        monkeypatch.setitem(sys.modules, module, stand_in)
    launch_file = runpy.run_path(str(checkout / "launch" / "pipeline.launch.py"))
    (actions,) = launch_file["generate_launch_description"]().values
    return SimpleNamespace(
        arguments={a.values[0] for a in actions if type(a).__name__ == "DeclareLaunchArgument"},
        nodes=[action.options for action in actions if type(action).__name__ == "Node"],
    )


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
