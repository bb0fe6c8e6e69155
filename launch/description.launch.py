"""The model of a camera (URDF) and its frames, by robot_state_publisher.

Example::

    ros2 launch coded_aperture_ros description.launch.py camera_name:=front \
        parent_frame:=base_link cam_pos_x:=0.2 cam_pos_z:=0.4 cam_pitch:=0.3

The frames are `<camera_name>_link`, x forward and z up, and `<camera_name>_optical_frame`, z
forward and y down, in which the nodes publish. Leave `base.frame` of camera_driver_node empty then:
a frame has one parent.
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare
from launch_ros.utilities import prefix_namespace

from launch import LaunchDescription

MODEL = ("urdf", "camera.urdf.xacro")
# Launch arguments that are arguments of the model of the same name: (name, default, description).
OF_MODEL = (
    ("camera_name", "camera", "Name of the camera: its namespace, and what its frames begin with"),
    ("parent_frame", "base_link", "Frame that the camera is fixed to"),
    ("cam_pos_x", "0.0", "Position of the camera's link in it, forward, m"),
    ("cam_pos_y", "0.0", "To the left, m"),
    ("cam_pos_z", "0.0", "Upward, m"),
    ("cam_roll", "0.0", "About the axis forward, rad"),
    ("cam_pitch", "0.0", "How far the camera looks down, rad"),
    ("cam_yaw", "0.0", "How far it looks to the left, rad"),
)
ARGUMENTS = (*OF_MODEL, ("camera_namespace", "", "Namespace around that of the camera"))


def publisher(context):
    """Return the node that publishes the model."""
    path = PathJoinSubstitution([FindPackageShare("coded_aperture_ros"), *MODEL])
    command = ["xacro ", path]
    for name, _, _ in OF_MODEL:
        command += [f" {name}:=", LaunchConfiguration(name)]
    camera_name = LaunchConfiguration("camera_name").perform(context)
    around = LaunchConfiguration("camera_namespace").perform(context)
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=prefix_namespace(around, camera_name),
            parameters=[{"robot_description": ParameterValue(Command(command), value_type=str)}],
        )
    ]


def generate_launch_description():
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in ARGUMENTS
            ),
            OpaqueFunction(function=publisher),
        ]
    )
