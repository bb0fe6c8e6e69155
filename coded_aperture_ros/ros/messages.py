"""Conversions between ROS messages and the library's arrays, without cv_bridge.

Everything here is a pure function of its arguments: no node, no clock, no publisher.
"""

import sys

from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, PointField
from std_msgs.msg import Header

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.io.messages import array_from_compressed, check_pixels, scaled_matrices
from coded_aperture_ros.io.messages import stamp_ns as stamp_ns
from coded_aperture_ros.optics import Camera, Intrinsics


def image_from_array(pixels: NDArray, encoding: str, header: Header) -> Image:
    """Return an image message with a copy of the header.

    The pixels, [row, column] or [row, column, stored channel], are of exactly the dtype and number
    of channels of the encoding; see `check_pixels`.
    """
    check_pixels(pixels, encoding)
    message = Image(header=copied_header(header), encoding=encoding)
    message.height, message.width = pixels.shape[:2]
    message.step = pixels.nbytes // message.height
    message.is_bigendian = int(sys.byteorder == "big")
    # bytes are taken over as one block; a NumPy array would be checked element by element.
    message.data = pixels.tobytes()
    return message


def copied_header(header: Header) -> Header:
    """Return a new header with the same stamp and frame_id."""
    copy = Header(frame_id=header.frame_id)
    copy.stamp.sec = header.stamp.sec
    copy.stamp.nanosec = header.stamp.nanosec
    return copy


def image_from_compressed(message: CompressedImage) -> Image:
    """Return the image that a compressed one (JPEG, PNG and others) holds, with its header.

    Raises `MessageError` as `array_from_compressed` does.
    """
    pixels, encoding = array_from_compressed(message)
    return image_from_array(pixels, encoding, message.header)


def compressed_message(content: tuple[bytes, str], header: Header) -> CompressedImage:
    """Return what `compressed_depth` or `compressed_picture` made as a message."""
    data, kind = content
    return CompressedImage(header=copied_header(header), format=kind, data=data)


def cloud_from_points(points: FloatArray, header: Header) -> PointCloud2:
    """Return points [row, column, 6] as an organised cloud; see `points_of_depth`."""
    names = ("x", "y", "z", "rgb", "confidence", "std_dev")
    cloud = PointCloud2(header=copied_header(header), is_dense=False)
    cloud.height, cloud.width = points.shape[:2]
    cloud.fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate(names)
    ]
    cloud.point_step = 4 * len(names)
    cloud.row_step = cloud.width * cloud.point_step
    cloud.is_bigendian = sys.byteorder == "big"
    cloud.data = points.tobytes()
    return cloud


def camera_info_from_camera(camera: Camera | Intrinsics, header: Header) -> CameraInfo:
    """Return a camera model, or the pinhole model of a camera file, as a message."""
    model = camera.intrinsics if isinstance(camera, Camera) else camera
    info = CameraInfo(header=copied_header(header), distortion_model=model.distortion_model)
    info.width, info.height = model.image_width, model.image_height
    info.d = list(model.distortion_coefficients)
    info.k = list(model.camera_matrix)
    info.r = list(model.rectification_matrix)
    info.p = list(model.projection_matrix)
    return info


def scaled_camera_info(info: CameraInfo, width: int, height: int, header: Header) -> CameraInfo:
    """Return the camera model of its region resized to `width` x `height`.

    Pixel centres have whole coordinates: a scale s moves x to s (x + 1/2) - 1/2. Distortion
    coefficients act on normalised coordinates and stay. Raises `MessageError` of kind
    "camera_info", where the message holds no camera model.
    """
    scaled = CameraInfo(header=copied_header(header), distortion_model=info.distortion_model)
    scaled.k, scaled.p = scaled_matrices(info, width, height)
    scaled.width, scaled.height = width, height
    scaled.d = list(info.d)
    scaled.r = list(info.r)
    return scaled
