"""Conversions between ROS messages and arrays, without cv_bridge.

All are pure functions of their arguments: no node, no clock, no publisher.
"""

import sys
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, PointField
from std_msgs.msg import Header

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.depth.moving import Place
from coded_aperture_ros.depth.points import POINT_FIELDS
from coded_aperture_ros.io.messages import (
    array_from_compressed,
    check_pixels,
    has_matrices,
    region_matrices,
)
from coded_aperture_ros.io.messages import stamp_ns as stamp_ns
from coded_aperture_ros.optics import Camera, Intrinsics


def image_from_array(pixels: NDArray, encoding: str, header: Header) -> Image:
    """Image message of pixels, with a copy of the header.

    Parameters
    ----------
    pixels : ndarray [rows, columns] or [rows, columns, stored channels]
        Of the dtype and number of channels of the encoding; see `check_pixels`.
    encoding : str
    header : Header
    """
    check_pixels(pixels, encoding)
    message = Image(header=copied_header(header), encoding=encoding)
    message.height, message.width = pixels.shape[:2]
    message.step = pixels.nbytes // message.height
    message.is_bigendian = int(sys.byteorder == "big")
    # rclpy takes bytes as one block, but checks an array element by element.
    message.data = pixels.tobytes()
    return message


def copied_header(header: Header) -> Header:
    """New header with the same stamp and frame_id."""
    copy = Header(frame_id=header.frame_id)
    copy.stamp.sec = header.stamp.sec
    copy.stamp.nanosec = header.stamp.nanosec
    return copy


def image_from_compressed(message: CompressedImage) -> Image:
    """Image message decoded from a compressed one (JPEG, PNG and others), with its header.

    Raises
    ------
    MessageError
        As `array_from_compressed` does.
    """
    pixels, encoding = array_from_compressed(message)
    return image_from_array(pixels, encoding, message.header)


def compressed_message(content: tuple[bytes, str], header: Header) -> CompressedImage:
    """Message of the data and format that `compressed_depth` or `compressed_picture` returned."""
    data, kind = content
    return CompressedImage(header=copied_header(header), format=kind, data=data)


def cloud_from_points(points: FloatArray, header: Header) -> PointCloud2:
    """Organised cloud of points, float32 [rows, columns, 6]; see `points_of_depth`."""
    cloud = PointCloud2(header=copied_header(header), is_dense=False)
    cloud.height, cloud.width = points.shape[:2]
    cloud.fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate(POINT_FIELDS)
    ]
    cloud.point_step = 4 * len(POINT_FIELDS)
    cloud.row_step = cloud.width * cloud.point_step
    cloud.is_bigendian = sys.byteorder == "big"
    cloud.data = points.tobytes()
    return cloud


def camera_info_from_camera(camera: Camera | Intrinsics, header: Header) -> CameraInfo:
    """Message of a camera model, or of the pinhole model of a camera file."""
    model = camera.intrinsics if isinstance(camera, Camera) else camera
    info = CameraInfo(header=copied_header(header), distortion_model=model.distortion_model)
    info.width = model.image_width
    info.height = model.image_height
    info.d = list(model.distortion_coefficients)
    info.k = list(model.camera_matrix)
    info.r = list(model.rectification_matrix)
    info.p = list(model.projection_matrix)
    return info


def camera_info_from_recorded(recorded: Any, header: Header) -> CameraInfo:
    """Message with the values of one that was recorded, and another header."""
    info = CameraInfo(header=copied_header(header))
    info.width = int(recorded.width)
    info.height = int(recorded.height)
    info.binning_x = int(recorded.binning_x)
    info.binning_y = int(recorded.binning_y)
    roi = recorded.roi
    info.roi.x_offset = int(roi.x_offset)
    info.roi.y_offset = int(roi.y_offset)
    info.roi.width = int(roi.width)
    info.roi.height = int(roi.height)
    info.roi.do_rectify = bool(roi.do_rectify)
    if has_matrices(recorded):
        info.distortion_model = recorded.distortion_model
        info.d = list(map(float, recorded.d))
        info.k = list(map(float, recorded.k))
        info.r = list(map(float, recorded.r))
        info.p = list(map(float, recorded.p))
    return info


def region_camera_info(info: CameraInfo, width: int, height: int, header: Header) -> CameraInfo:
    """Camera model of the region of interest, resized to `width` x `height` pixels.

    Pixel centres have whole coordinates: a scale s moves x to s (x + 1/2) - 1/2. Distortion
    coefficients act on normalised coordinates and stay.

    Raises
    ------
    MessageError
        Of kind "camera_info", if the message holds no camera model.
    """
    scaled = CameraInfo(header=copied_header(header), distortion_model=info.distortion_model)
    scaled.k, scaled.p = region_matrices(info, width, height)
    scaled.width = width
    scaled.height = height
    scaled.d = list(info.d)
    scaled.r = list(info.r)
    return scaled


def odometry_from_place(place: Place, header: Header, seconds: float) -> Odometry:
    """Odometry of a camera.

    Parameters
    ----------
    place : Place
    header : Header
        Of the frame. The pose is in the frame of its name and ``_start``: the camera at first.
    seconds : float
        Time since the last frame; 0 or less: the twist is 0, with no covariance.
    """
    message = Odometry(child_frame_id=header.frame_id)
    message.header.stamp = header.stamp
    message.header.frame_id = f"{header.frame_id}_start"
    pose = message.pose.pose
    pose.position.x, pose.position.y, pose.position.z = map(float, place.pose[:3, 3])
    turn = quaternion(place.pose[:3, :3])
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = turn
    # About the axes of the first frame, as the message has it.
    turned = np.kron(np.eye(2), place.pose[:3, :3])
    message.pose.covariance = (turned @ place.covariance @ turned.T).ravel()
    if seconds > 0:
        rates = [float(rate) for rate in place.moved / seconds]
        twist = message.twist.twist
        twist.linear.x, twist.linear.y, twist.linear.z = rates[:3]
        twist.angular.x, twist.angular.y, twist.angular.z = rates[3:]
        message.twist.covariance = (place.moved_covariance / seconds**2).ravel()
    return message


def quaternion(turn: DoubleArray) -> tuple[float, float, float, float]:
    """Unit quaternion x, y, z, w of a rotation matrix [3, 3].

    Examples
    --------
    >>> quaternion(np.eye(3))
    (0.0, 0.0, 0.0, 1.0)
    """
    from scipy.spatial.transform import Rotation  # it is wanted by few

    x, y, z, w = map(float, Rotation.from_matrix(turn).as_quat())
    return x, y, z, w
