"""Runs a launch file as `ros2 launch` does: launch_run.py FILE NAME:=VALUE...

`ros2 launch` itself comes with an installed ROS only, launch and launch_ros can be had without.
"""

import sys

from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

from launch import LaunchDescription, LaunchService

file, *given = sys.argv[1:]
arguments = [tuple(argument.split(":=", 1)) for argument in given]
source = PythonLaunchDescriptionSource(file)
service = LaunchService(argv=given)
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments)])
)
sys.exit(service.run())
