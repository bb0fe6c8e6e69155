"""Depth for obstacle avoidance: a voxel map of nav2, a laser scan, and RViz if it is asked for.

Beside this package it needs nav2_costmap_2d, nav2_lifecycle_manager and depthimage_to_laserscan,
and a robot that publishes the transforms odom -> base_link -> the camera's optical frame.
Example::

    ros2 launch coded_aperture_ros obstacle_avoidance.launch.py \
        camera_file:=/path/to/camera.yaml near_m:=0.8 far_m:=3.0 source:=/dev/video0
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node, SetParametersFromFile
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

SHARE = FindPackageShare("coded_aperture_ros")


def generate_launch_description():
    settings = PathJoinSubstitution([SHARE, "config", "obstacle_avoidance.yaml"])
    picture = PathJoinSubstitution([SHARE, "config", "coded_aperture.rviz"])
    pipeline = PathJoinSubstitution([SHARE, "launch", "pipeline.launch.py"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("rviz", default_value="false", description="Show everything"),
            SetParametersFromFile(settings),
            IncludeLaunchDescription(PythonLaunchDescriptionSource(pipeline)),
            Node(
                package="depthimage_to_laserscan",
                executable="depthimage_to_laserscan_node",
                parameters=[settings],
                remappings=[
                    ("depth", "depth/image"),
                    ("depth_camera_info", "depth/camera_info"),
                ],
            ),
            Node(
                package="nav2_costmap_2d",
                executable="nav2_costmap_2d",
                parameters=[settings],
            ),
            Node(
                package="nav2_lifecycle_manager",
                executable="lifecycle_manager",
                name="lifecycle_manager_costmap",
                parameters=[settings],
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", picture],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )
