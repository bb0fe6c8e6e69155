"""The transform from a robot's frame to the camera's optical frame."""

import math

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from coded_aperture_ros.core.errors import InputError


def optical_transform(
    base_frame: str,
    optical_frame: str,
    position_m: tuple[float, float, float],
    pitch_rad: float = 0.0,
) -> TransformStamped:
    """Return the transform of a camera that looks forward from `base_frame`.

    Their axes: x forward, y left, z up, and x right, y down, z forward. The camera is at
    `position_m` in the base frame, and looks down by `pitch_rad`. `InputError` if both are one.
    """
    from scipy.spatial.transform import Rotation

    if base_frame == optical_frame:
        raise InputError(f"base.frame: is {base_frame}, as frame_id: give the robot's frame, or ''")
    transform = TransformStamped(child_frame_id=optical_frame)
    transform.header.frame_id = base_frame
    translation, rotation = transform.transform.translation, transform.transform.rotation
    translation.x, translation.y, translation.z = (float(value) for value in position_m)
    # From a body's axes to optical ones: yaw and roll of -90 degrees (REP 103).
    turned = Rotation.from_euler("YZX", (pitch_rad, -math.pi / 2, -math.pi / 2))
    rotation.x, rotation.y, rotation.z, rotation.w = map(float, turned.as_quat())
    return transform


def broadcast_static(node: Node, transform: TransformStamped) -> None:
    """Publish a transform on /tf_static once, for late joiners too.

    Where tf2_msgs is not installed there is a warning instead.
    """
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        node.get_logger().warning(
            "no static transform published: tf2_msgs is not installed (apt: ros-jazzy-tf2-msgs)"
        )
        return
    qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    transform.header.stamp = node.get_clock().now().to_msg()
    node.create_publisher(TFMessage, "/tf_static", qos).publish(TFMessage(transforms=[transform]))
