"""Camera driver, depth and deblurring: three processes, or one with `composed:=true`.

Example::

    ros2 launch coded_aperture_ros pipeline.launch.py camera_file:=/path/to/camera.yaml \
        near_m:=0.8 far_m:=3.0 source:=/dev/video0 namespace:=front params_file:=robot.yaml

Only given arguments set parameters: those that an including launch file sets with `SetParameter`
stay, and `params_file` wins over both. Name the nodes in it, as in `/**/depth_node:`, because in
ROS a section for all nodes, `/**`, yields to a section of another file that names the node.
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

PACKAGE = "coded_aperture_ros"

# Launch arguments that become parameters of the same name: (name, type, description, nodes).
DRIVER = ("camera_driver_node",)
MODEL_USERS = ("depth_node", "deblur_node")
PARAMETERS = (
    ("camera_file", str, "Camera file (YAML)", (*DRIVER, *MODEL_USERS)),
    ("source", str, "simulator, camera index, device, URL, video or folder", DRIVER),
    ("frame_id", str, "Optical frame of the images", DRIVER),
    ("bank", str, "Filter bank (.npz); empty: learn it from the camera file", MODEL_USERS),
    ("near_m", float, "Nearest depth in metres; needed without a bank", MODEL_USERS),
    ("far_m", float, "Farthest depth in metres; needed without a bank", MODEL_USERS),
    ("free_space.risk", float, "Risk of the free-space bound; 0: no bound", ("depth_node",)),
    (
        "temporal.moving_camera",
        str,
        "What tells how the camera moves: frames, or pose (odometry, tf); empty: nothing",
        ("depth_node",),
    ),
    ("temporal.fixed_frame", str, "Frame of odometry or tf in which it moves", ("depth_node",)),
)
ARGUMENTS = (
    ("namespace", "", "Namespace of all nodes"),
    ("composed", "false", "All nodes in one process"),
    ("settings_file", "", "Parameter file of a launch file that includes this one"),
    ("params_file", "", "Parameter file that wins over everything else"),
)


def nodes(context):
    def value(name):
        return LaunchConfiguration(name).perform(context)

    given = {name: kind(value(name)) for name, kind, _, _ in PARAMETERS if value(name)}
    node_parameters = {
        node: {
            name: given[name] for name, _, _, users in PARAMETERS if name in given and node in users
        }
        for node in (*DRIVER, *MODEL_USERS)
    }
    if IfCondition(LaunchConfiguration("composed")).evaluate(context):
        node_parameters = {"pipeline": given}
    files = [path for name in ("settings_file", "params_file") if (path := value(name))]
    for path in files:
        if not Path(path).is_file():  # launch_ros would only warn
            raise RuntimeError(f"{path} is not a file")
    return [
        Node(  # without `name`, which would rename all three nodes of the pipeline
            package=PACKAGE,
            executable=executable,
            namespace=value("namespace"),
            # The last one wins, so that files come after the arguments.
            parameters=[*([parameters] if parameters else []), *files],
            output="screen",
        )
        for executable, parameters in node_parameters.items()
    ]


def generate_launch_description():
    declared = [(name, "", description) for name, _, description, _ in PARAMETERS]
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in (*declared, *ARGUMENTS)
            ),
            OpaqueFunction(function=nodes),
        ]
    )
