"""Two coded-aperture cameras on one robot, each in a namespace and a process of its own.

Example::

    ros2 launch coded_aperture_ros two_cameras.launch.py \
        front:=front.yaml front_source:=/dev/video0 rear:=rear.yaml rear_source:=/dev/video2 \
        near_m:=0.8 far_m:=3.0
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

CAMERAS = ("front", "rear")


def generate_launch_description():
    pipeline = PathJoinSubstitution(
        [FindPackageShare("coded_aperture_ros"), "launch", "pipeline.launch.py"]
    )
    arguments = [
        *((camera, f"Camera file (YAML) of the {camera} camera") for camera in CAMERAS),
        *((f"{camera}_source", f"Source of the {camera} camera") for camera in CAMERAS),
        ("near_m", "Nearest depth in metres"),
        ("far_m", "Farthest depth in metres"),
    ]
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, description=what) for name, what in arguments),
            *(
                IncludeLaunchDescription(
                    PythonLaunchDescriptionSource(pipeline),
                    launch_arguments={
                        "namespace": camera,
                        "camera_file": LaunchConfiguration(camera),
                        "source": LaunchConfiguration(f"{camera}_source"),
                        "near_m": LaunchConfiguration("near_m"),
                        "far_m": LaunchConfiguration("far_m"),
                        "composed": "true",
                    }.items(),
                )
                for camera in CAMERAS
            ),
        ]
    )
