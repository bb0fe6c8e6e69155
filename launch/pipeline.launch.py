"""Camera driver, depth and deblurring: three processes, or one with `composed:=true`.

Example::

    ros2 launch coded_aperture_ros pipeline.launch.py camera_file:=/path/to/camera.yaml \
        near_m:=0.8 far_m:=3.0 source:=/dev/video0 namespace:=front
"""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = "coded_aperture_ros"
NODES = ("camera_driver_node", "depth_node", "deblur_node")

# Launch arguments that become parameters of the same name: (name, type, default, description).
PARAMETERS = (
    ("camera_file", str, "", "Camera file (YAML)"),
    ("source", str, "simulator", "simulator, camera index, device, URL, video or folder"),
    ("bank", str, "", "Filter bank (.npz); empty: learn it from the camera file"),
    ("near_m", float, "0.0", "Nearest depth in metres; needed without a bank"),
    ("far_m", float, "0.0", "Farthest depth in metres; needed without a bank"),
)
USED_BY = {
    "camera_driver_node": ("camera_file", "source"),
    "depth_node": ("camera_file", "bank", "near_m", "far_m"),
    "deblur_node": ("camera_file", "bank", "near_m", "far_m"),
}


def generate_launch_description():
    composed = LaunchConfiguration("composed")
    values = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, kind, _, _ in PARAMETERS
    }
    settings = {
        node: PathJoinSubstitution([FindPackageShare(PACKAGE), "config", f"{node}.yaml"])
        for node in NODES
    }
    common = {"package": PACKAGE, "namespace": LaunchConfiguration("namespace"), "output": "screen"}
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, _, default, description in PARAMETERS
            ),
            DeclareLaunchArgument("namespace", default_value="", description="Of all nodes"),
            DeclareLaunchArgument(
                "composed", default_value="false", description="All nodes in one process"
            ),
            *(
                Node(
                    executable=node,
                    parameters=[settings[node], {name: values[name] for name in USED_BY[node]}],
                    condition=UnlessCondition(composed),
                    **common,
                )
                for node in NODES
            ),
            Node(
                # No `name` here: it would rename all three nodes.
                executable="pipeline",
                parameters=[*settings.values(), values],
                condition=IfCondition(composed),
                **common,
            ),
        ]
    )
