"""Conversions between ROS messages and the library's arrays, without cv_bridge.

Everything here is a pure function of its arguments: no node, no clock, no publisher.
"""

import sys
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, PointField
from std_msgs.msg import Header

from coded_aperture_ros.errors import InputError
from coded_aperture_ros.images import decode_picture, linear_from_pixels, pixels_from_linear
from coded_aperture_ros.optics import Camera, Intrinsics

# Weights of linear red, green and blue in luminance (ITU-R BT.709).
_LUMINANCE = np.array([[0.2126, 0.7152, 0.0722]], np.float32)
# Relative error of a depth computed from a blur size in single precision, generously.
_DEPTH_ROUNDING = 1e-4


class MessageError(InputError):
    """A message that cannot be used; `kind` names the fault in one word, for counting."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


@dataclass(frozen=True)
class Encoding:
    """How one `sensor_msgs/Image` encoding stores a pixel."""

    dtype: str
    channels: int
    to_rgb: int | None = None  # OpenCV's colour conversions; None where there is nothing to do
    from_rgb: int | None = None

    @property
    def pixel_bytes(self) -> int:
        """Return the bytes of one pixel."""
        return np.dtype(self.dtype).itemsize * self.channels


ENCODINGS = {
    "mono8": Encoding("u1", 1),
    "8UC1": Encoding("u1", 1),
    "mono16": Encoding("u2", 1),
    "16UC1": Encoding("u2", 1),
    "32FC1": Encoding("f4", 1),
    "rgb8": Encoding("u1", 3),
    "bgr8": Encoding("u1", 3, cv2.COLOR_BGR2RGB, cv2.COLOR_RGB2BGR),
    "rgba8": Encoding("u1", 4, cv2.COLOR_RGBA2RGB, cv2.COLOR_RGB2RGBA),
    "bgra8": Encoding("u1", 4, cv2.COLOR_BGRA2RGB, cv2.COLOR_RGB2BGRA),
}


def encoding_of(name: str) -> Encoding:
    """Return the `Encoding` called `name`; a `MessageError` of kind "encoding" if unsupported."""
    try:
        return ENCODINGS[name]
    except KeyError:
        raise MessageError(
            "encoding", f"image encoding {name!r} is not supported, use {', '.join(ENCODINGS)}"
        ) from None


def array_from_image(message: Image) -> NDArray:
    """Return the pixels of an image message as they are stored, in native byte order.

    Parameters
    ----------
    message : sensor_msgs.msg.Image
        In one of `ENCODINGS`. Rows may be padded (`step`) and bytes swapped (`is_bigendian`).

    Returns
    -------
    array, [row, column] or [row, column, RGB]
        dtype as stored. Channels are in the order red, green, blue; alpha is left out. It may be
        a view of the message's data: do not write to it.

    Raises
    ------
    MessageError
        Of kind "encoding", "size", "step" or "data".
    """
    encoding = encoding_of(message.encoding)
    height, width, step = message.height, message.width, message.step
    if height == 0 or width == 0:
        raise MessageError("size", f"the image is empty ({width}x{height})")
    row_bytes = width * encoding.pixel_bytes
    if step < row_bytes:
        raise MessageError(
            "step", f"step is {step} bytes, {width} pixels of {message.encoding} need {row_bytes}"
        )
    if len(message.data) < step * height:
        raise MessageError(
            "data", f"image data has {len(message.data)} bytes, {height} rows need {step * height}"
        )
    rows = np.frombuffer(message.data, np.uint8, step * height).reshape(height, step)
    pixels = np.ascontiguousarray(rows[:, :row_bytes]).view(encoding.dtype)
    swapped = bool(message.is_bigendian) != (sys.byteorder == "big")
    if swapped and pixels.dtype.itemsize > 1:
        pixels = pixels.byteswap()
    if encoding.channels == 1:
        return pixels
    pixels = pixels.reshape(height, width, encoding.channels)
    return pixels if encoding.to_rgb is None else cv2.cvtColor(pixels, encoding.to_rgb)


def image_from_compressed(message: CompressedImage) -> Image:
    """Return the image that a compressed one (JPEG, PNG and others) holds, with its header.

    Raises
    ------
    MessageError
        Of kind "data", where it cannot be decompressed.
    """
    pixels = decode_picture(message.data)
    encodings = {(np.uint8, 2): "mono8", (np.uint16, 2): "mono16", (np.uint8, 3): "bgr8"}
    encoding = None if pixels is None else encodings.get((pixels.dtype.type, pixels.ndim))
    if pixels is None or encoding is None or pixels.shape[2:] not in ((), (3,)):
        raise MessageError(
            "data", f"compressed image of format {message.format[:40]!r} cannot be decompressed"
        )
    return image_from_array(pixels, encoding, message.header)


def frame_from_image(message: Image, gamma: float = 1.0) -> NDArray[np.float32]:
    """Return an image message as the frame that the library works on.

    Parameters
    ----------
    message : sensor_msgs.msg.Image
        See `array_from_image`.
    gamma : float
        Exponent that turns 8-bit values into linear light; 1 for a linear sensor. 16-bit and
        float images are linear by definition.

    Returns
    -------
    float32, [row, column] or [row, column, RGB]
        Linear light; integers are scaled to [0, 1], floats are taken as they are.
    """
    pixels = array_from_image(message)
    if pixels.dtype == np.float32:
        return pixels
    if pixels.dtype == np.uint8 and gamma == 1.0:
        return pixels * np.float32(1 / 255)  # several times faster than a table
    return linear_from_pixels(pixels, gamma)


def luminance(frame: NDArray) -> NDArray:
    """Return the luminance of a linear frame of any type; a grey frame as it is."""
    if frame.ndim == 2:
        return frame
    return cv2.transform(frame, _LUMINANCE)


def pixels_from_frame(frame: NDArray, encoding: str, gamma: float = 1.0) -> NDArray:
    """Return a frame as the pixels of an encoding: the inverse of `frame_from_image`.

    Parameters
    ----------
    frame : float32, [row, column] or [row, column, RGB]
        Linear light. Integer encodings clip it to [0, 1]; unknown (NaN) pixels become 0.
        Integers of the encoding's own type are kept as they are.
    encoding : str
        One of `ENCODINGS`; grey encodings of a colour frame hold its luminance.
    gamma : float
        As in `frame_from_image`.

    Returns
    -------
    array, [row, column] or [row, column, stored channel]
    """
    target = encoding_of(encoding)
    if target.channels == 1:
        frame = luminance(frame)
    elif frame.ndim == 2:
        frame = cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_GRAY2RGB)
    if frame.dtype == target.dtype:
        pixels = frame
    elif target.dtype == "f4":
        pixels = linear_from_pixels(frame, gamma)
    else:
        linear = linear_from_pixels(frame, gamma)
        pixels = pixels_from_linear(linear, 8 * np.dtype(target.dtype).itemsize, gamma)
    return pixels if target.from_rgb is None else cv2.cvtColor(pixels, target.from_rgb)


def image_from_array(pixels: NDArray, encoding: str, header: Header) -> Image:
    """Return an image message that holds `pixels`, stored as `encoding` says.

    Parameters
    ----------
    pixels : array, [row, column] or [row, column, stored channel]
        Of exactly the encoding's dtype and number of channels.
    encoding : str
        One of `ENCODINGS`.
    header : std_msgs.msg.Header
        Copied, so that messages never share one.
    """
    target = encoding_of(encoding)
    shape = (*pixels.shape[:2], *((target.channels,) if target.channels > 1 else ()))
    if pixels.dtype != np.dtype(target.dtype) or pixels.shape != shape or pixels.ndim < 2:
        raise MessageError(
            "encoding",
            f"{encoding} needs {np.dtype(target.dtype)} with {target.channels} channel(s), "
            f"got {pixels.dtype} {pixels.shape}",
        )
    message = Image(header=copied_header(header), encoding=encoding)
    message.height, message.width = pixels.shape[:2]
    message.step = message.width * target.pixel_bytes
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


def stamp_ns(header: Header) -> int:
    """Return the stamp of a header in nanoseconds."""
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def limit_depth(
    depth_m: NDArray[np.float32], near_m: float = 0.0, far_m: float = np.inf
) -> NDArray[np.float32]:
    """Mark known depths outside the range the way REP 117 asks for.

    Returns
    -------
    float32, [row, column]
        Metres; -Inf where nearer than `near_m`, +Inf where farther than `far_m`, NaN where the
        depth is unknown: what is unknown is never called far.
    """
    depth_m = depth_m.astype(np.float32, copy=True)
    # The outermost levels of a bank are the ends of the range but for rounding.
    depth_m[depth_m < near_m * (1 - _DEPTH_ROUNDING)] = -np.inf
    depth_m[depth_m > far_m * (1 + _DEPTH_ROUNDING)] = np.inf
    return depth_m


def millimetres_from_depth(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return depth in whole millimetres, as REP 118 stores it in 16UC1.

    0 stands for everything without a distance: unknown, too near, beyond the range. A distance
    too long for 16 bits saturates at 65535 instead of wrapping, and one below half a millimetre
    becomes 1, because 0 is taken.
    """
    known = np.isfinite(depth_m) & (depth_m > 0)
    # Clipped in metres first: the largest float32 would overflow when multiplied.
    millimetres = np.rint(np.clip(np.where(known, depth_m, 0.0), 0.0, 66.0) * 1000.0)
    return np.where(known, np.clip(millimetres, 1, 65535), 0).astype(np.uint16)


def cloud_from_points(points: NDArray[np.float32], header: Header) -> PointCloud2:
    """Return an organised cloud with the fields x, y, z and confidence.

    Parameters
    ----------
    points : float32, [row, column, 4]
        See `points_of_depth`.
    header : std_msgs.msg.Header
        Copied.
    """
    names = ("x", "y", "z", "confidence")
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


def camera_info_from_camera(camera: Camera, header: Header) -> CameraInfo:
    """Return the pinhole model of a camera file; see `Camera.intrinsics`."""
    return camera_info_from_intrinsics(camera.intrinsics, header)


def camera_info_from_intrinsics(model: Intrinsics, header: Header) -> CameraInfo:
    """Return a camera model as a message."""
    info = CameraInfo(header=copied_header(header), distortion_model=model.distortion_model)
    info.width, info.height = model.image_width, model.image_height
    info.d = list(model.distortion_coefficients)
    info.k = list(model.camera_matrix)
    info.r = list(model.rectification_matrix)
    info.p = list(model.projection_matrix)
    return info


def scaled_camera_info(info: CameraInfo, width: int, height: int, header: Header) -> CameraInfo:
    """Return the camera model of the same view resized to `width` x `height`.

    Pixel centres have whole coordinates: a scale s moves x to s (x + 1/2) - 1/2. Distortion
    coefficients act on normalised coordinates and stay.

    Raises
    ------
    MessageError
        Of kind "camera_info", where the message holds no camera model.
    """
    if info.width == 0 or info.height == 0 or info.k[0] <= 0 or info.k[4] <= 0:
        raise MessageError("camera_info", "camera_info holds no camera model (size or K is 0)")
    x, y = width / info.width, height / info.height
    scaled = CameraInfo(header=copied_header(header), distortion_model=info.distortion_model)
    scaled.width, scaled.height = width, height
    scaled.d = list(info.d)
    scaled.r = list(info.r)
    k, p = [float(value) for value in info.k], [float(value) for value in info.p]
    scaled.k = [
        *(k[0] * x, k[1] * x, _moved_centre(k[2], x)),
        *(k[3] * y, k[4] * y, _moved_centre(k[5], y)),
        *k[6:],
    ]
    if p[0] > 0:
        scaled.p = [
            *(p[0] * x, p[1] * x, _moved_centre(p[2], x), p[3] * x),
            *(p[4] * y, p[5] * y, _moved_centre(p[6], y), p[7] * y),
            *p[8:],
        ]
    else:  # P left empty by an uncalibrated driver
        scaled.p = [*scaled.k[:3], 0.0, *scaled.k[3:6], 0.0, 0.0, 0.0, 1.0, 0.0]
    return scaled


def _moved_centre(centre: float, scale: float) -> float:
    return scale * (centre + 0.5) - 0.5
