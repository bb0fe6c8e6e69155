"""What launch files give to the programs they start, by the real launch and launch_ros.

The files are really launched. In place of the programs stand ones that write down their arguments;
with these, real nodes are then started here, to see which of several values for a parameter holds.
"""

import ast
import os
import re
import sys
from importlib import import_module
from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

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
    "robot_state_publisher": ("robot_state_publisher",),
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
    xacro = prefix / "lib" / "xacro" / "xacro"
    xacro.parent.mkdir()
    xacro.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "import xacro; xacro.main()" "$@"\n')
    xacro.chmod(0o755)
    for folder in ("config", "launch", "urdf"):
        (prefix / "share" / OURS / folder).symlink_to(checkout / folder)
    environment = {
        **os.environ,
        "AMENT_PREFIX_PATH": os.pathsep.join([str(prefix), os.environ["AMENT_PREFIX_PATH"]]),
        "PATH": os.pathsep.join([str(prefix / "lib" / name) for name in ("ros2run", "xacro")])
        + os.pathsep
        + os.environ["PATH"],
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
    given = launched(file, own, "near_m:=0.8", "far_m:=3.0", "camera_name:=front")
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


@pytest.mark.parametrize("camera", ["camera", "/"])
@pytest.mark.parametrize("root", ["", "/robot"])
def test_the_scan_and_the_map_are_the_robots(launched, root, camera):
    names = [f"camera_namespace:={root[1:]}", f"camera_name:={camera}"]
    given = launched("obstacle_avoidance", *names, "rviz:=true")
    depth = f"{root}/{camera}/depth" if camera != "/" else f"{root}/depth"
    published = names_under(given["depth_node"], "any", topics=["depth/image", "depth/points"])
    assert published == [f"{depth}/image", f"{depth}/points"]
    scan = names_under(
        given["depthimage_to_laserscan_node"], "scan", topics=["scan", "depth", "depth_camera_info"]
    )
    assert scan == [f"{root}/scan", f"{depth}/image", f"{depth}/camera_info"]
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
    shown = names_under(given["rviz2"], "rviz", topics=["depth/points", "scan", "costmap/costmap"])
    assert shown == [published[1], scan[0], names[0]]
    assert given["rviz2"][given["rviz2"].index("-f") + 1] == "base_link"


@pytest.mark.parametrize("root", ["", "/robot"])
def test_the_map_is_cleared_up_to_the_bound_if_a_risk_is_given(launched, root):
    given = launched("obstacle_avoidance", f"camera_namespace:={root[1:]}", "free_space.risk:=0.01")
    assert values_of("depth_node", given["depth_node"], "free_space.risk") == (0.01,)
    (cloud,) = names_under(given["depth_node"], "any", topics=["depth/free_points"])
    assert cloud == f"{root}/camera/depth/free_points"
    assert topic_of(given["nav2_costmap_2d"], "free_space") == cloud
    assert topic_of(given["nav2_costmap_2d"], "obstacles") == f"{root}/camera/depth/points"


def test_without_a_risk_there_is_no_bound(launched):
    given = launched("obstacle_avoidance")
    assert values_of("depth_node", given["depth_node"], "free_space.risk") == (0.0,)
    assert topic_of(given["nav2_costmap_2d"], "free_space") == "/camera/depth/points"


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
    given = launched("pipeline", *arguments, "camera_name:=front", f"composed:={composed}")
    assert sorted(given) == (["pipeline"] if composed else sorted(OF_NODE))
    assert set(given) <= {entry.name for entry in distribution(OURS).entry_points}
    for node, names in OF_NODE.items():
        arguments = given["pipeline" if composed else node]
        assert values_of(node, arguments, *names) == tuple(GIVEN[name] for name in names)
        with Started(node, arguments) as started:
            assert started.get_fully_qualified_name() == f"/front/{node}"


@pytest.mark.parametrize(
    ("names", "namespace", "frame"),
    [
        ((), "/camera", "camera_optical_frame"),
        (("camera_name:=front",), "/front", "front_optical_frame"),
        (("camera_name:=front", "frame_id:=lens"), "/front", "lens"),
        (("camera_namespace:=robot",), "/robot/camera", "camera_optical_frame"),
        (("camera_namespace:=robot", "camera_name:=/"), "/robot", "camera_optical_frame"),
        (("camera_name:=/",), "", "camera_optical_frame"),
    ],
)
def test_topics_and_frames_have_the_cameras_name(launched, names, namespace, frame):
    given = launched("pipeline", *names, "rviz:=true")
    topics = ["image_raw", "image_raw/compressed", "camera_info"]
    found = names_under(given["camera_driver_node"], "any", topics=topics)
    assert found == [f"{namespace}/{topic}" for topic in topics]
    with Started("camera_driver_node", given["camera_driver_node"]) as driver:
        assert driver.get_parameter("frame_id").value == frame
        assert driver.get_fully_qualified_name() == f"{namespace}/camera_driver_node"
    assert given["rviz2"][given["rviz2"].index("-f") + 1] == frame
    assert names_under(given["rviz2"], "rviz", topics=["depth/points"]) == [
        f"{namespace}/depth/points"
    ]


def test_two_cameras_have_topics_of_their_own(launched):
    cameras = [f"{name}:={name}.yaml" for name in ("front", "rear")]
    sources = ["front_source:=0", "rear_source:=1"]
    around = "camera_namespace:=robot"
    given = launched("two_cameras", *cameras, *sources, "near_m:=0.8", "far_m:=3.0", around)
    pipelines = (given["pipeline"], given["pipeline 2"])
    found = [names_under(each, "any", topics=["depth/image"]) for each in pipelines]
    assert sorted(found) == [["/robot/front/depth/image"], ["/robot/rear/depth/image"]]


SHOW = """
from launch import LaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.utilities import perform_substitutions
from launch.actions import OpaqueFunction

def show(context):
    source = PythonLaunchDescriptionSource({path!r})
    for argument in source.get_launch_description(context).get_launch_arguments():
        default = argument.default_value
        text = None if default is None else perform_substitutions(context, default)
        print("ARGUMENT", repr((argument.name, text, argument.description)))

def generate_launch_description():
    return LaunchDescription([OpaqueFunction(function=show)])
"""


@pytest.fixture
def shown(launched, checkout, tmp_path):
    """Return a function: arguments of a launch file as `--show-args` lists them."""

    def show(file):
        path = tmp_path / "show.launch.py"
        path.write_text(SHOW.format(path=str(checkout / "launch" / f"{file}.launch.py")))
        launched(path)
        lines = re.findall(r"^ARGUMENT (.*)$", launched.said, re.MULTILINE)
        return {name: rest for name, *rest in map(ast.literal_eval, lines)}

    return show


SOURCES = {"front", "rear", "front_source", "rear_source", "near_m", "far_m"}


@pytest.mark.parametrize(
    ("file", "needed", "some"),
    [
        ("pipeline", set(), {"camera_name", "camera_namespace", "rviz", "params_file", "near_m"}),
        ("obstacle_avoidance", set(), {"camera_name", "camera_namespace", "rviz", "near_m"}),
        ("two_cameras", SOURCES, {"camera_namespace", "rviz", "params_file", "front_frame_id"}),
        ("description", set(), {"camera_name", "camera_namespace", "parent_frame", "cam_pos_x"}),
        ("bag_evaluation", {"bag", "output", "bank", "camera_file"}, {"reference_depth"}),
    ],
)
def test_arguments_have_descriptions_and_defaults_or_are_needed(shown, file, needed, some):
    arguments = shown(file)
    assert {name for name, (default, _) in arguments.items() if default is None} == needed
    assert some <= arguments.keys()
    assert all(len(description) > 5 for _, description in arguments.values())
    assert "no description given" not in {description for _, description in arguments.values()}


def test_defaults_of_arguments_are_those_of_the_nodes(shown):
    arguments = shown("pipeline")
    checked = 0
    for node in OF_NODE:
        with Started(node, ["--ros-args"]) as started:
            for name, (default, _) in arguments.items():
                if started.has_parameter(name) and name not in ("camera_name", "frame_id"):
                    assert default == str(started.get_parameter(name).value), name
                    checked += 1
    assert checked > 12


def test_an_argument_that_is_a_nodes_default_sets_nothing(launched):
    given = launched("pipeline", "source:=simulator", "near_m:=0.0", "use_sim_time:=false")
    assert not [word for words in given.values() for word in words if "params" in word]


@pytest.mark.parametrize("composed", ["false", "true"])
def test_odometry_of_the_robot_can_be_named(launched, composed):
    topics = ["odometry", "imu", "image_raw"]
    own = [f"/camera/{topic}" for topic in topics]
    given = launched("pipeline", f"composed:={composed}")
    name = "pipeline" if composed == "true" else "depth_node"
    assert names_under(given[name], "any", topics=topics) == own
    robots = ["odom_topic:=/odom", "imu_topic:=/imu/data"]
    given = launched("pipeline", *robots, f"composed:={composed}")
    arguments = [given[each] for each in given if each.startswith(name)][-1]
    assert names_under(arguments, "any", topics=topics) == ["/odom", "/imu/data", own[2]]


def test_time_and_log_level_can_be_set(launched):
    given = launched("pipeline", "use_sim_time:=true", "log_level:=warn")
    arguments = given["depth_node"]
    level = arguments.index("--log-level")
    assert arguments[level + 1] == "warn"
    del arguments[level : level + 2]  # it would hold for all tests
    assert values_of("depth_node", arguments, "use_sim_time") == (True,)


@pytest.mark.parametrize("composed", ["false", "true"])
def test_the_model_of_the_camera_is_published_if_it_is_asked_for(launched, composed):
    pytest.importorskip("xacro")
    assert "robot_state_publisher" not in launched("pipeline", f"composed:={composed}")
    names = ["camera_name:=front", "camera_namespace:=robot", f"composed:={composed}"]
    where = ["description:=true", "parent_frame:=mast", "cam_pos_x:=0.2", "rviz:=true"]
    given = launched("pipeline", *names, *where)
    arguments = given["robot_state_publisher"]
    (topic,) = names_under(arguments, "any", topics=["robot_description"])
    assert topic == "/robot/front/robot_description"
    file = arguments[arguments.index("--params-file") + 1]
    (content,) = yaml.safe_load(Path(file).read_text()).values()
    model = ElementTree.fromstring(content["ros__parameters"]["robot_description"])
    links = {link.get("name") for link in model.iter("link")}
    assert links == {"mast", "front_link", "front_optical_frame"}
    (joint,) = model.findall("joint[@name='front_joint']")
    assert joint.find("origin").get("xyz") == "0.2 0.0 0.0"
    assert given["rviz2"][given["rviz2"].index("-f") + 1] == "mast"
