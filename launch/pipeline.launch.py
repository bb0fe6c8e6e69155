"""Camera driver, depth and deblurring: three processes, or one with `composed:=true`.

Example::

    ros2 launch coded_aperture_ros pipeline.launch.py camera_file:=/path/to/camera.yaml \
        near_m:=0.8 far_m:=3.0 source:=/dev/video0 camera_name:=front params_file:=robot.yaml

Nodes and topics are in the namespace `camera_name`, as in `/front/depth/image`, inside
`camera_namespace`, if that is given; `camera_name:=/` leaves the name out. The arguments that are
parameters of nodes have the nodes' defaults, and set nothing then: what an including launch file
sets with `SetParameter` stays. `params_file` wins over both. Name the nodes in it, as in
`/**/depth_node:`, because in ROS a section for all nodes, `/**`, yields to a section of another
file that names the node.
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare
from launch_ros.utilities import make_namespace_absolute, prefix_namespace

from launch import LaunchDescription

PACKAGE = "coded_aperture_ros"
SHARE = FindPackageShare(PACKAGE)
DRIVER = ("camera_driver_node",)
DEPTH = ("depth_node",)
MODEL_USERS = (*DEPTH, "deblur_node")
EVERY_NODE = (*DRIVER, *MODEL_USERS)
# Launch arguments that are parameters of the same name: (name, default, description, nodes).
PARAMETERS = (
    ("camera_file", "", "Camera file (YAML)", EVERY_NODE),
    ("source", "simulator", "simulator, camera index, device, URL, video or folder", DRIVER),
    ("camera_info_url", "", "Calibration, file:// or package://; empty: as found", DRIVER),
    ("frame_id", "", "Optical frame of the images; empty: <camera_name>_optical_frame", DRIVER),
    ("bank", "", "Filter bank (.npz); empty: learn it from the camera file", MODEL_USERS),
    ("near_m", 0.0, "Nearest depth, m; needed without a bank", MODEL_USERS),
    ("far_m", 0.0, "Farthest depth, m; needed without a bank", MODEL_USERS),
    ("free_space.risk", 0.0, "Risk of the free-space bound; 0: no bound", DEPTH),
    (
        "temporal.moving_camera",
        "",
        "What tells how the camera moves: frames, gyro, or pose (odometry, tf); empty: nothing",
        DEPTH,
    ),
    ("temporal.fixed_frame", "odom", "Frame of odometry or tf in which it moves", DEPTH),
    ("use_sim_time", False, "Take the time from /clock", EVERY_NODE),
)
# The frame that the driver names by default is that of this name.
CAMERA_NAME = "camera"
# Launch arguments for topics of the robot, which lie outside the camera's namespace: our names.
OF_ROBOT = {"odom_topic": "odometry", "imu_topic": "imu"}
ARGUMENTS = (
    ("camera_name", CAMERA_NAME, "Namespace of the camera's nodes, begins its frames; /: none"),
    ("camera_namespace", "", "Namespace around it, such as the robot's"),
    ("odom_topic", "odometry", "Topic of the robot's odometry, for temporal.moving_camera:=pose"),
    ("imu_topic", "imu", "Topic of a gyroscope, for method: motion or moving_camera: gyro"),
    ("composed", "false", "All nodes in one process"),
    ("settings_file", "", "Parameter file of a launch file that includes this one"),
    ("params_file", "", "Parameter file that wins over everything else"),
    ("log_level", "info", "debug, info, warn, error or fatal"),
    ("description", "false", "Publish a model of the camera (URDF) and its frames"),
    ("parent_frame", "base_link", "With description: frame that the camera is fixed to"),
    ("rviz", "false", "Start RViz"),
    ("rviz_frame", "", "Fixed frame of RViz; empty: parent_frame, or else frame_id"),
)


def given_parameters(value):
    """Parameters whose argument is not the default, and the optical frame of the name."""
    given = {}
    for name, default, _, _ in PARAMETERS:
        text = value(name)
        if text != str(default) and not (default is False and text.lower() == "false"):
            kind = type(default)
            given[name] = text.lower() == "true" if kind is bool else kind(text)
    camera_name = value("camera_name").strip("/")
    if camera_name not in ("", CAMERA_NAME):
        given.setdefault("frame_id", f"{camera_name}_optical_frame")
    return given


def remappings(value):
    """Pairs of our name and the robot's name of a topic."""
    return [(ours, value(name)) for name, ours in OF_ROBOT.items() if value(name) != ours]


def checked_files(value):
    """Parameter files, the last one wins."""
    files = [path for name in ("settings_file", "params_file") if (path := value(name))]
    for path in files:
        if not Path(path).is_file():  # launch_ros would only warn
            raise RuntimeError(f"{path} is not a file")
    return files


def rviz(value, namespace, outer, frame):
    """RViz, with names of the camera; what belongs to the robot is in the namespace around it."""
    root = (make_namespace_absolute(outer) or "").rstrip("/")
    robots = ("scan", "costmap/costmap")
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=namespace,
        arguments=[
            "-d",
            PathJoinSubstitution([SHARE, "config", "coded_aperture.rviz"]),
            "-f",
            value("rviz_frame") or frame,
        ],
        remappings=[(name, f"{root}/{name}") for name in robots],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )


def nodes(context):
    def value(name):
        return LaunchConfiguration(name).perform(context)

    given = given_parameters(value)
    node_parameters = {
        node: {
            name: given[name] for name, _, _, users in PARAMETERS if name in given and node in users
        }
        for node in EVERY_NODE
    }
    if IfCondition(LaunchConfiguration("composed")).evaluate(context):
        node_parameters = {"pipeline": given}
    files = checked_files(value)
    namespace = prefix_namespace(value("camera_namespace"), value("camera_name").strip("/"))
    outer = prefix_namespace(
        context.launch_configurations.get("ros_namespace"), value("camera_namespace")
    )
    frame = given.get("frame_id", f"{CAMERA_NAME}_optical_frame")
    if IfCondition(LaunchConfiguration("description")).evaluate(context):
        frame = value("parent_frame")
    log_level = value("log_level")
    return [
        *(
            Node(  # without `name`, which would rename all three nodes of the pipeline
                package=PACKAGE,
                executable=executable,
                namespace=namespace,
                # The last one wins, so that files come after the arguments.
                parameters=[*([parameters] if parameters else []), *files],
                remappings=remappings(value),
                ros_arguments=[] if log_level == "info" else ["--log-level", log_level],
                output="screen",
            )
            for executable, parameters in node_parameters.items()
        ),
        rviz(value, namespace, outer, frame),
    ]


def generate_launch_description():
    declared = [(name, str(default), description) for name, default, description, _ in PARAMETERS]
    description = PathJoinSubstitution([SHARE, "launch", "description.launch.py"])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in (*declared, *ARGUMENTS)
            ),
            OpaqueFunction(function=nodes),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(description),
                condition=IfCondition(LaunchConfiguration("description")),
            ),
        ]
    )
