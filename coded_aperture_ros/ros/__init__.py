"""ROS 2 nodes: each converts messages, calls the library and publishes.

Importing any of the modules here needs rclpy, so its environment is prepared first.
"""

from coded_aperture_ros.ros.environment import limit_libraries, prepare_ros_environment

limit_libraries()
prepare_ros_environment()
