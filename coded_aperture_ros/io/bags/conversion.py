"""Between the messages of a bag, as they were sent, and arrays."""

import dataclasses
import sys
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.io.bags.recorded import Topic
from coded_aperture_ros.io.messages import (
    MessageError,
    array_from_compressed,
    array_from_image,
    check_pixels,
    scaled_matrices,
)
from coded_aperture_ros.optics import Intrinsics

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
_NS = 1_000_000_000
# By the type of the pixels and the number of channels.
_ENCODINGS = {("u1", 2): "mono8", ("u2", 2): "mono16", ("u1", 3): "rgb8"}


@cache
def _type_store() -> Any:
    """Return the types of messages; it takes a fifth of a second until all of them were used."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """An image message.

    Attributes
    ----------
    header : std_msgs/Header
        As rosbags has it.
    pixels : ndarray, [row, column] or [row, column, RGB]
        As they are stored.
    encoding : str
        Of `sensor_msgs/Image`, in which results of the same kind can be stored.
    """

    header: Any
    pixels: NDArray
    encoding: str

    @property
    def stamp_ns(self) -> int:
        """When the picture was taken."""
        return stamp_ns_of(self.header)


class Conversion:
    """Reads and makes the few types of messages that a camera's bag has."""

    @property
    def _store(self) -> Any:
        return _type_store()

    def topic(self, name: str, type_name: str) -> Topic:
        """Return a topic of a type of messages that is made here."""
        definition, _ = self._store.generate_msgdef(type_name, ros_version=2)
        return Topic(name, type_name, definition, self._store.hash_rihs01(type_name))

    def picture(self, data: bytes | memoryview, type_name: str) -> Picture:
        """Read a raw or compressed image.

        Raises
        ------
        MessageError
            Of kind "message" if it is not one at all; see also `array_from_image` and
            `array_from_compressed`.
        """
        message = self._read(data, type_name)
        if type_name == IMAGE:
            return Picture(message.header, array_from_image(message), message.encoding)
        pixels = array_from_compressed(message)
        encoding = _ENCODINGS.get((pixels.dtype.str[1:], pixels.ndim))
        if encoding is None:
            raise MessageError(
                "encoding", f"a picture of {pixels.dtype} in colour is not supported"
            )
        return Picture(message.header, pixels, encoding)

    def depth(self, data: bytes | memoryview) -> Picture:
        """Read a depth image; `messages.depth_from_pixels` turns its pixels into metres.

        Raises
        ------
        MessageError
            Of kind "depth" where the encoding is not one of depth; see also `picture`.
        """
        picture = self.picture(data, IMAGE)
        if picture.encoding not in ("32FC1", "16UC1", "mono16"):
            raise MessageError(
                "depth", f"depth has the encoding 32FC1 or 16UC1, not {picture.encoding}"
            )
        return picture

    def camera_info(self, data: bytes | memoryview) -> Any:
        """Read a camera model; `MessageError` of kind "message" if it is none."""
        return self._read(data, CAMERA_INFO)

    def image(self, pixels: NDArray, encoding: str, header: Any) -> memoryview:
        """Make an image message.

        Parameters
        ----------
        pixels : ndarray, [row, column] or [row, column, stored channel]
            As `check_pixels` wants them.
        encoding : str
        header : std_msgs/Header
            As rosbags has it.
        """
        target = check_pixels(pixels, encoding)
        height, width = pixels.shape[:2]
        return self._sent(
            IMAGE,
            header=header,
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=int(sys.byteorder == "big"),
            step=width * target.pixel_bytes,
            data=np.ascontiguousarray(pixels).view(np.uint8).reshape(-1),
        )

    def scaled_camera_info(self, info: Any, size: tuple[int, int], header: Any) -> memoryview:
        """Make the camera model of a view that was resized to (rows, columns).

        Raises
        ------
        MessageError
            See `scaled_matrices`.
        """
        k, p = scaled_matrices(info, size[1], size[0])
        return self._camera_info(info, k, p, size, header)

    def info_of(self, model: Intrinsics) -> Any:
        """Return a camera model as the message that describes it, with an empty header."""
        kinds = self._store.types
        stamp = kinds["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
        header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        return kinds[CAMERA_INFO](
            header=header,
            height=model.image_height,
            width=model.image_width,
            distortion_model=model.distortion_model,
            d=np.array(model.distortion_coefficients, np.float64),
            k=np.array(model.camera_matrix, np.float64),
            r=np.array(model.rectification_matrix, np.float64),
            p=np.array(model.projection_matrix, np.float64),
            binning_x=0,
            binning_y=0,
            roi=self._no_region(),
        )

    def _camera_info(
        self, info: Any, k: list[float], p: list[float], size: tuple[int, int], header: Any
    ) -> memoryview:
        return self._sent(
            CAMERA_INFO,
            header=header,
            height=size[0],
            width=size[1],
            distortion_model=info.distortion_model,
            d=info.d,
            k=np.array(k),
            r=info.r,
            p=np.array(p),
            binning_x=0,
            binning_y=0,
            roi=self._no_region(),
        )

    def _no_region(self) -> Any:
        kind = self._store.types["sensor_msgs/msg/RegionOfInterest"]
        return kind(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)

    def _sent(self, type_name: str, **fields: Any) -> memoryview:
        message = self._store.types[type_name](**fields)
        sent: memoryview = self._store.serialize_cdr(message, type_name)
        return sent

    def _read(self, data: bytes | memoryview, type_name: str) -> Any:
        try:
            return self._store.deserialize_cdr(data, type_name)
        except Exception as error:  # whatever a decoder makes of bytes that are something else
            raise MessageError("message", f"a message is not a {type_name}: {error}") from error


def stamp_ns_of(header: Any) -> int:
    """Return the stamp of a header, as rosbags has it."""
    stamp: int = header.stamp.sec * _NS + header.stamp.nanosec
    return stamp
