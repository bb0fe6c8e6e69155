"""What launch files give to the programs they start, by the real launch and launch_ros.

The files are really launched. In place of the programs stand ones that write down their arguments;
with these, real nodes are then started here, to see which of several values for a parameter holds.
"""

import os
import sys
from importlib import import_module
from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml
from cli_scene import parsed
from waiting import run_program

rclpy = pytest.importorskip("rclpy")
pytestmark = pytest.mark.skipif(
    not (find_spec("launch") and find_spec("launch_ros")),
    reason="launch and launch_ros are not installed: they come with an installed ROS",
)

OURS = "coded_aperture_ros"
RATE = "diagnostics.warn_rate_hz"
PROGRAMS = {
    OURS: ("camera_driver_node", "depth_node", "deblur_node", "pipeline", "coded_aperture"),
    "depthimage_to_laserscan": ("depthimage_to_laserscan_node",),
    "nav2_costmap_2d": ("nav2_costmap_2d",),
    "nav2_lifecycle_manager": ("lifecycle_manager",),
    "rviz2": ("rviz2",),
    "ros2run": ("ros2",),
}
RUNNER = Path(__file__).parents[1] / "support" / "launch_run.py"


@pytest.fixture
def launched(tmp_path, checkout):
    """Return a function that launches a file, and returns the arguments of what it started."""
    prefix, written = tmp_path / "prefix", tmp_path / "written"
    written.mkdir()
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    for package, programs in PROGRAMS.items():
        (index / package).touch()
        folder = prefix / "lib" / package
        for path in (prefix / "share" / package, folder):
            path.mkdir(parents=True)
        for program in programs:
            path = folder / program
            path.write_text(f'#!/bin/sh\nprintf "%s\\0" "$@" > {written}/{program}.$$\n')
            path.chmod(0o755)
    for folder in ("config", "launch"):
        (prefix / "share" / OURS / folder).symlink_to(checkout / folder)
    environment = {
        **os.environ,
        "AMENT_PREFIX_PATH": os.pathsep.join([str(prefix), os.environ["AMENT_PREFIX_PATH"]]),
        "PATH": os.pathsep.join([str(prefix / "lib" / "ros2run"), os.environ["PATH"]]),
        "TMPDIR": str(tmp_path),
        "PYTHONWARNINGS": "ignore",
    }

    def launch(file, *arguments, status=0):
        path = file if isinstance(file, Path) else checkout / "launch" / f"{file}.launch.py"
        command = [sys.executable, str(RUNNER), str(path), *arguments]
        done = run_program(*command, env=environment)
        assert done.returncode == status, done.stderr
        launch.said = done.stdout + done.stderr
        return {
            record.name.rpartition(".")[0] + ("" if count == 1 else f" {count}"): words(record)
            for record, count in numbered(sorted(written.iterdir()))
        }

    return launch


def numbered(records):
    seen = {}
    for record in records:
        name = record.name.rpartition(".")[0]
        seen[name] = seen.get(name, 0) + 1
        yield record, seen[name]


def words(record):
    return record.read_text().split("\0")[:-1]


class Started:
    """One of our nodes, started with recorded arguments; only its parameters matter."""

    def __init__(self, node, arguments):
        name = "".join(part.title() for part in node.split("_"))
        self.type = getattr(import_module(f"{OURS}.ros.{node}"), name)
        self.arguments = [*arguments, "-p", "autostart:=false"]

    def __enter__(self):
        self.context = rclpy.Context()
        rclpy.init(args=self.arguments, context=self.context)
        self.node = self.type(context=self.context)
        return self.node

    def __exit__(self, *_):
        self.node.close()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def values_of(node, arguments, *names):
    with Started(node, arguments) as started:
        return tuple(started.get_parameter(name).value for name in names)


@pytest.fixture
def settings(checkout):
    content = yaml.safe_load((checkout / "config" / "obstacle_avoidance.yaml").read_text())
    return flat(content["/**/depth_node"]["ros__parameters"])


def flat(parameters, prefix=""):
    found = {}
    for name, value in parameters.items():
        found |= (
            flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
        )
    return found


@pytest.mark.parametrize("composed", ["false", "true"])
def test_obstacle_avoidance_applies_its_settings(launched, settings, composed):
    given = launched("obstacle_avoidance", "near_m:=0.8", "far_m:=3.0", f"composed:={composed}")
    arguments = given["pipeline" if composed == "true" else "depth_node"]
    assert values_of("depth_node", arguments, *settings) == tuple(settings.values())
    assert values_of("depth_node", arguments, "near_m", "far_m") == (0.8, 3.0)


def parameter_file(path, node, **values):
    path.write_text(yaml.safe_dump({node: {"ros__parameters": values}}))
    return f"params_file:={path}"


@pytest.mark.parametrize(
    ("file", "node"),
    [
        *(("pipeline", node) for node in ("/**/depth_node", "/**", "/front/depth_node")),
        *(("obstacle_avoidance", node) for node in ("/**/depth_node", "/front/depth_node")),
    ],
)
def test_a_parameter_file_wins_over_everything(launched, tmp_path, file, node):
    own = parameter_file(tmp_path / "own.yaml", node, near_m=1.1, **{RATE: 2.5})
    given = launched(file, own, "near_m:=0.8", "far_m:=3.0", "namespace:=front")
    got = values_of("depth_node", given["depth_node"], RATE, "near_m", "far_m")
    assert got == (2.5, 1.1, 3.0)


AROUND = """
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import SetParameter
from launch import LaunchDescription

def generate_launch_description():
    return LaunchDescription([
        *(SetParameter(name, value) for name, value in {values}.items()),
        IncludeLaunchDescription(PythonLaunchDescriptionSource({path!r})),
    ])
"""


@pytest.mark.parametrize("composed", ["false", "true"])
def test_what_is_set_around_the_pipeline_holds(launched, checkout, tmp_path, composed):
    values = {"near_m": 0.7, "far_m": 2.5, "lazy": False, RATE: 5.0}
    path = tmp_path / "around.launch.py"
    pipeline = str(checkout / "launch" / "pipeline.launch.py")
    path.write_text(AROUND.format(values=values, path=pipeline))
    given = launched(path, f"composed:={composed}")
    arguments = given["pipeline" if composed == "true" else "depth_node"]
    assert values_of("depth_node", arguments, *values) == tuple(values.values())
    own = parameter_file(tmp_path / "own.yaml", "/**/depth_node", **{RATE: 2.5})
    given = launched(path, f"composed:={composed}", own)
    arguments = [given[name] for name in given if name.startswith(("pipeline", "depth"))][-1]
    assert values_of("depth_node", arguments, RATE, "far_m") == (2.5, 2.5)


def test_a_parameter_file_that_is_none_is_an_error(launched):
    assert launched("pipeline", "params_file:=/nowhere.yaml", status=1) == {}
    assert "/nowhere.yaml is not a file" in launched.said


def test_what_is_said_of_all_nodes_yields_to_what_is_said_of_one(launched, tmp_path):
    """Such is ROS; the documentation says so."""
    own = parameter_file(tmp_path / "own.yaml", "/**", **{RATE: 2.5})
    given = launched("obstacle_avoidance", own, "near_m:=0.8")
    assert values_of("depth_node", given["depth_node"], RATE, "near_m") == (5.0, 0.8)


def names_under(arguments, node, namespace=None, topics=(), services=()):
    """Return the full names that a node gets which is started with these arguments."""
    context = rclpy.Context()
    rclpy.init(args=arguments, context=context)
    # What nav2 itself says in its code about where the node of its map is.
    own = [] if namespace is None else ["--ros-args", "-r", f"__ns:={namespace}"]
    started = rclpy.create_node(node, context=context, cli_args=own)
    found = [started.resolve_topic_name(name) for name in topics]
    found += [started.resolve_service_name(name) for name in services]
    started.destroy_node()
    rclpy.shutdown(context=context)
    return found


@pytest.mark.parametrize("root", ["", "/front"])
def test_the_scan_and_the_map_are_where_the_camera_is(launched, root):
    given = launched("obstacle_avoidance", f"namespace:={root[1:]}", "rviz:=true")
    published = names_under(given["depth_node"], "any", topics=["depth/image", "depth/points"])
    assert published == [f"{root}/depth/image", f"{root}/depth/points"]
    scan = names_under(
        given["depthimage_to_laserscan_node"], "scan", topics=["scan", "depth", "depth_camera_info"]
    )
    assert scan == [f"{root}/scan", f"{root}/depth/image", f"{root}/depth/camera_info"]
    services = ["costmap/change_state", "costmap/get_state", "clear_entirely_costmap"]
    names = names_under(
        given["nav2_costmap_2d"], "costmap", "/costmap", ["costmap", "voxel_grid"], services
    )
    assert names == [f"{root}/costmap/{name}" for name in ("costmap", "voxel_grid", *services)]
    # The manager asks for the state of the map by its name in the manager's own namespace.
    manager = names_under(
        given["lifecycle_manager"], "any", services=["costmap/costmap/change_state"]
    )
    assert manager == [names[2]]
    for source in ("obstacles", "free_space"):
        assert topic_of(given["nav2_costmap_2d"], source) == published[1]
    assert names_under(given["rviz2"], "rviz", topics=["depth/points"]) == published[1:]


@pytest.mark.parametrize("root", ["", "/front"])
def test_the_map_is_cleared_up_to_the_bound_if_a_risk_is_given(launched, root):
    given = launched("obstacle_avoidance", f"namespace:={root[1:]}", "free_space.risk:=0.01")
    assert values_of("depth_node", given["depth_node"], "free_space.risk") == (0.01,)
    (cloud,) = names_under(given["depth_node"], "any", topics=["depth/free_points"])
    assert topic_of(given["nav2_costmap_2d"], "free_space") == cloud == f"{root}/depth/free_points"
    assert topic_of(given["nav2_costmap_2d"], "obstacles") == f"{root}/depth/points"


def test_without_a_risk_there_is_no_bound(launched):
    given = launched("obstacle_avoidance")
    assert values_of("depth_node", given["depth_node"], "free_space.risk") == (0.0,)
    assert topic_of(given["nav2_costmap_2d"], "free_space") == "/depth/points"


def topic_of(arguments, source):
    """Return where the map, a node that we do not have, looks for a source; by the real rcl."""
    context = rclpy.Context()
    rclpy.init(args=arguments, context=context)
    started = rclpy.create_node(
        "costmap",
        context=context,
        cli_args=["--ros-args", "-r", "__ns:=/costmap"],
        automatically_declare_parameters_from_overrides=True,
    )
    topic = started.get_parameter(f"voxel_layer.{source}.topic").value
    started.destroy_node()
    rclpy.shutdown(context=context)
    return topic


def test_two_cameras_have_frames_and_parameters_of_their_own(launched, tmp_path):
    (tmp_path / "own.yaml").write_text(
        yaml.safe_dump(
            {
                f"/{camera}/depth_node": {"ros__parameters": {RATE: rate}}
                for camera, rate in (("front", 3.0), ("rear", 4.0))
            }
        )
    )
    cameras = [f"{name}:={name}.yaml" for name in ("front", "rear")]
    sources = ["front_source:=0", "rear_source:=1"]
    own = f"params_file:={tmp_path / 'own.yaml'}"
    given = launched("two_cameras", *cameras, *sources, "near_m:=0.8", "far_m:=3.0", own)
    found = set()
    for arguments in (given["pipeline"], given["pipeline 2"]):
        names = "camera_file", "source", "frame_id"
        driver = values_of("camera_driver_node", arguments, *names)
        depth = values_of("depth_node", arguments, "camera_file", "near_m", RATE)
        found.add((*driver, *depth))
    assert found == {
        ("front.yaml", "0", "front_optical_frame", "front.yaml", 0.8, 3.0),
        ("rear.yaml", "1", "rear_optical_frame", "rear.yaml", 0.8, 4.0),
    }


@pytest.mark.parametrize("compared", [(), ("reference_depth:=/stereo/depth",)])
def test_bag_evaluation_calls_the_program_with_its_own_options(launched, compared):
    needed = ["bag:=a.mcap", "output:=b", "bank:=c.npz", "camera_file:=d.yaml"]
    given = launched("bag_evaluation", *needed, *compared)
    assert list(given) == ["ros2"]
    assert given["ros2"][:4] == ["run", OURS, "coded_aperture", "bag"]
    options = parsed(*given["ros2"][3:])  # raises an error where one does not exist
    assert options.reference_depth == ("/stereo/depth" if compared else None)


GIVEN = {
    "camera_file": "camera.yaml",
    "source": "/dev/video0",
    "frame_id": "front_optical_frame",
    "bank": "bank.npz",
    "near_m": 0.8,
    "far_m": 3.0,
}
OF_NODE = {
    "camera_driver_node": ("camera_file", "source", "frame_id"),
    "depth_node": ("camera_file", "bank", "near_m", "far_m"),
    "deblur_node": ("camera_file", "bank", "near_m", "far_m"),
}


@pytest.mark.parametrize("composed", [False, True])
def test_three_processes_or_one_get_what_is_given(launched, composed):
    arguments = [f"{name}:={value}" for name, value in GIVEN.items()]
    given = launched("pipeline", *arguments, "namespace:=front", f"composed:={composed}")
    assert sorted(given) == (["pipeline"] if composed else sorted(OF_NODE))
    assert set(given) <= {entry.name for entry in distribution(OURS).entry_points}
    for node, names in OF_NODE.items():
        arguments = given["pipeline" if composed else node]
        assert values_of(node, arguments, *names) == tuple(GIVEN[name] for name in names)
        with Started(node, arguments) as started:
            assert started.get_fully_qualified_name() == f"/front/{node}"
