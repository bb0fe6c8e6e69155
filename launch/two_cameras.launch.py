"""Two coded-aperture cameras on one robot, each with a name and a process of its own.

Example::

    ros2 launch coded_aperture_ros two_cameras.launch.py \
        front:=front.yaml front_source:=/dev/video0 rear:=rear.yaml rear_source:=/dev/video2 \
        near_m:=0.8 far_m:=3.0

Topics of the front camera are in the namespace front, as in /front/depth/image, and its images in
the frame front_optical_frame; those of the rear camera in rear and rear_optical_frame. In
`params_file`, /front/depth_node and /rear/depth_node tell them apart.
"""

from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

CAMERAS = ("front", "rear")
SHARED = (
    ("near_m", None, "Nearest depth in metres"),
    ("far_m", None, "Farthest depth in metres"),
    ("camera_namespace", "", "Namespace around both cameras, such as the robot's"),
    ("params_file", "", "Parameter file that wins over everything else"),
    ("rviz", "false", "Start RViz, once for each camera"),
)


def generate_launch_description():
    pipeline = PathJoinSubstitution(
        [FindPackageShare("coded_aperture_ros"), "launch", "pipeline.launch.py"]
    )
    arguments = [
        *((camera, None, f"Camera file (YAML) of the {camera} camera") for camera in CAMERAS),
        *((f"{camera}_source", None, f"Source of the {camera} camera") for camera in CAMERAS),
        *(
            (
                f"{camera}_frame_id",
                f"{camera}_optical_frame",
                f"Optical frame of the {camera} camera",
            )
            for camera in CAMERAS
        ),
        *SHARED,
    ]
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in arguments
            ),
            *(
                # A group, so that the arguments of the first camera do not reach the second one.
                GroupAction(
                    [
                        IncludeLaunchDescription(
                            PythonLaunchDescriptionSource(pipeline),
                            launch_arguments={
                                "camera_name": camera,
                                "camera_file": LaunchConfiguration(camera),
                                "source": LaunchConfiguration(f"{camera}_source"),
                                "frame_id": LaunchConfiguration(f"{camera}_frame_id"),
                                **{name: LaunchConfiguration(name) for name, _, _ in SHARED},
                                "composed": "true",
                            }.items(),
                        )
                    ]
                )
                for camera in CAMERAS
            ),
        ]
    )
