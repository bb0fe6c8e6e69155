"""Static transform from a robot's frame to the camera's optical frame."""

import math

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile

from coded_aperture_ros.core.errors import InputError


def optical_transform(
    base_frame: str,
    optical_frame: str,
    position_m: tuple[float, float, float],
    pitch_rad: float = 0.0,
) -> TransformStamped:
    """Transform of a camera that looks forward in the base frame.

    Parameters
    ----------
    base_frame : str
        Axes x forward, y left, z up.
    optical_frame : str
        Axes x right, y down, z forward.
    position_m : (float, float, float)
        Camera position in the base frame.
    pitch_rad : float
        Angle by which the camera looks down.

    Raises
    ------
    InputError
        If both frames have one name.
    """
    from scipy.spatial.transform import Rotation

    if base_frame == optical_frame:
        raise InputError(
            f"base.frame: {base_frame} is frame_id, too: set the robot's frame, or leave it empty"
        )
    transform = TransformStamped(child_frame_id=optical_frame)
    transform.header.frame_id = base_frame
    translation = transform.transform.translation
    rotation = transform.transform.rotation
    translation.x, translation.y, translation.z = (float(value) for value in position_m)
    # From the axes of a body to those of a camera: yaw and roll of -90 degrees (REP 103).
    turned = Rotation.from_euler("YZX", (pitch_rad, -math.pi / 2, -math.pi / 2))
    rotation.x, rotation.y, rotation.z, rotation.w = map(float, turned.as_quat())
    return transform


def broadcast_static(node: Node, transform: TransformStamped) -> Publisher | None:
    """Publisher of a transform on /tf_static, latched for late subscribers: who calls destroys it.

    Without tf2_msgs it warns instead, and there is none.
    """
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        node.get_logger().warning(
            "static transform not published: tf2_msgs is not installed, "
            "sudo apt install ros-jazzy-tf2-msgs"
        )
        return None
    qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    transform.header.stamp = node.get_clock().now().to_msg()
    publisher: Publisher = node.create_publisher(TFMessage, "/tf_static", qos)
    publisher.publish(TFMessage(transforms=[transform]))
    return publisher
