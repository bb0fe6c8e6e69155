"""ROS 2 nodes: each converts messages, calls the library and publishes.

Importing any of the modules here needs rclpy, so its environment is prepared first.
"""

from coded_aperture_ros.ros.environment import (
    limit_pictures,
    limit_threads,
    prepare_ros_environment,
)

limit_threads()
limit_pictures()
prepare_ros_environment()
