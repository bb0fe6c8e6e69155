"""Recorded bags of ROS 2: read whole or cut off, worked on, and written again. No ROS in here.

Needs rosbags, and matplotlib for reports; both come with the extra `eval`.
"""

from coded_aperture_ros.io.bags.reading import Bag, is_bag
from coded_aperture_ros.io.bags.recorded import Recorded
from coded_aperture_ros.io.bags.writing import bag_output, check_bag_output
