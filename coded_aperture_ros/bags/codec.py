"""Messages of a bag, as they were sent (CDR), to arrays and back."""

import dataclasses
import sys
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bags.contents import Topic
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.points import POINT_FIELDS
from coded_aperture_ros.frames.pictures import quantisation_sigma
from coded_aperture_ros.io.messages import (
    MessageError,
    array_from_compressed,
    array_from_image,
    check_pixels,
    depth_pixels,
    has_matrices,
    mosaic_encoding,
    output_encoding,
    parse_encoding,
    region_matrices,
    stamp_ns,
)
from coded_aperture_ros.optics import Intrinsics

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
POINTS = "sensor_msgs/msg/PointCloud2"
POINT_FIELD = "sensor_msgs/msg/PointField"


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """Image message.

    Attributes
    ----------
    header : message
    pixels : ndarray [rows, columns] or [rows, columns, RGB]
        As stored.
    encoding : str
        For images that are made of these pixels.
    mosaic : str
        Order of the colour filters, where each pixel has one.
    lost : float
        Noise that compression has hidden; see `quantisation_sigma`.
    """

    header: Any
    pixels: NDArray
    encoding: str
    mosaic: str = ""
    compression_loss: float = 0.0

    @property
    def stamp_ns(self) -> int:
        """Time of the exposure, ns."""
        return stamp_ns(self.header)


def read_picture(data: bytes | memoryview, type_name: str, mosaic: str = "") -> Picture:
    """Picture of a raw or compressed image message.

    Parameters
    ----------
    data : bytes
    type_name : str
    mosaic : str
        Order of the colour filters of grey images whose message names none.

    Raises
    ------
    MessageError
        Of kind "message" if it is no such message; of other kinds if its image cannot be used.
    """
    message = read_message(data, type_name)
    if type_name == IMAGE:
        pixels, encoding, lost = array_from_image(message), message.encoding, 0.0
    else:
        pixels, encoding = array_from_compressed(message)  # first: it refuses what is cut off
        lost = quantisation_sigma(bytes(message.data))
    encoding = mosaic_encoding(encoding, mosaic)
    found = parse_encoding(encoding).mosaic
    return Picture(message.header, pixels, output_encoding(encoding), found, lost)


def read_depth_image(data: bytes | memoryview) -> Picture:
    """Picture for `depth_from_pixels`; a `MessageError` of kind "depth" if it is no depth image."""
    message = read_message(data, IMAGE)
    return Picture(message.header, depth_pixels(message), message.encoding)


def read_camera_info(data: bytes | memoryview) -> Any:
    """Camera model; a `MessageError` of kind "message" if it is none."""
    return read_message(data, CAMERA_INFO)


def image_data(pixels: NDArray, encoding: str, header: Any) -> memoryview:
    """Serialised image message of pixels; see `check_pixels` for their type and shape."""
    check_pixels(pixels, encoding)
    height, width = pixels.shape[:2]
    message = _store().types[IMAGE](
        header=header,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=int(sys.byteorder == "big"),
        step=pixels.nbytes // height,
        data=np.ascontiguousarray(pixels).view(np.uint8).reshape(-1),
    )
    return _store().serialize_cdr(message, IMAGE)


def cloud_data(points: FloatArray, header: Any) -> memoryview:
    """Serialised organised cloud of points, float32 [rows, columns, 6]; see `points_of_depth`."""
    types = _store().types
    field = types[POINT_FIELD]
    fields = [
        field(name=name, offset=4 * index, datatype=field.FLOAT32, count=1)
        for index, name in enumerate(POINT_FIELDS)
    ]
    rows, columns = points.shape[:2]
    message = types[POINTS](
        header=header,
        height=rows,
        width=columns,
        fields=fields,
        is_bigendian=sys.byteorder == "big",
        point_step=points.strides[1],
        row_step=points.strides[0],
        data=points.view(np.uint8).reshape(-1),
        is_dense=False,
    )
    return _store().serialize_cdr(message, POINTS)


def camera_info_data(info: Any, size: tuple[int, int], header: Any) -> memoryview:
    """Serialised camera model of a view resized to (rows, columns); see `region_matrices`."""
    k, p = region_matrices(info, size[1], size[0])
    resized = dataclasses.replace(
        info,
        header=header,
        height=size[0],
        width=size[1],
        k=np.array(k),
        p=np.array(p),
        binning_x=0,
        binning_y=0,
        roi=_whole_view(),
    )
    return _store().serialize_cdr(resized, CAMERA_INFO)


def camera_info_copy(info: Any, header: Any) -> memoryview:
    """Serialised camera model as a bag has it, with another header."""
    copy = camera_info_message(Intrinsics.pinhole(1.0, int(info.width), int(info.height)))
    same = {name: getattr(info, name) for name in ("roi", "binning_x", "binning_y")}
    same["k"] = np.array(info.k, np.float64)
    if has_matrices(info):
        same |= {name: getattr(info, name) for name in ("distortion_model", "d", "r", "p")}
    copy = dataclasses.replace(copy, header=header, **same)
    return _store().serialize_cdr(copy, CAMERA_INFO)


def camera_info_message(model: Intrinsics) -> Any:
    """Message that describes a camera model, with an empty header."""
    kinds = _store().types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    return kinds[CAMERA_INFO](
        header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
        height=model.image_height,
        width=model.image_width,
        distortion_model=model.distortion_model,
        d=np.array(model.distortion_coefficients, np.float64),
        k=np.array(model.camera_matrix, np.float64),
        r=np.array(model.rectification_matrix, np.float64),
        p=np.array(model.projection_matrix, np.float64),
        binning_x=0,
        binning_y=0,
        roi=_whole_view(),
    )


def new_topic(name: str, type_name: str) -> Topic:
    """Topic of a type of messages that this module knows."""
    definition, _ = _store().generate_msgdef(type_name, ros_version=2)
    return Topic(name, type_name, definition, _store().hash_rihs01(type_name))


@cache
def _store() -> Any:
    """Types of messages; until each of them was used once, it takes 0.2 s."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def _whole_view() -> Any:
    kind = _store().types["sensor_msgs/msg/RegionOfInterest"]
    return kind(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)


def read_message(data: bytes | memoryview, type_name: str) -> Any:
    """Message of a type that rosbags knows; a `MessageError` if it is none."""
    try:
        return _store().deserialize_cdr(data, type_name)
    except Exception as error:  # whatever a decoder makes of bytes that are something else
        raise MessageError("message", f"a message is not a {type_name}: {error}") from error
