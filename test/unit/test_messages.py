"""sensor_msgs/Image and CameraInfo to arrays and back."""

import array

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import MOSAICS, PixelFormat
from coded_aperture_ros.io import messages
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.ros.messages import (
    camera_info_from_camera,
    image_from_array,
    region_camera_info,
    stamp_ns,
)

SIZES = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9)
TYPES = {"mono8": np.uint8, "8UC1": np.uint8, "mono16": np.uint16, "16UC1": np.uint16}
COLOURS = {"rgb8": [0, 1, 2], "bgr8": [2, 1, 0], "rgba8": [0, 1, 2], "bgra8": [2, 1, 0]}


def header(frame_id="camera_optical_frame"):
    made = Header(frame_id=frame_id)
    made.stamp.sec, made.stamp.nanosec = 12, 345_678_901
    return made


def image(encoding="mono8", height=4, width=6, step=None, data=None, bigendian=0):
    message = Image(encoding=encoding, height=height, width=width, is_bigendian=bigendian)
    message.step = width if step is None else step
    message.data = bytes(message.step * height) if data is None else data
    return message


@pytest.mark.parametrize("encoding", TYPES)
@given(data=st.data())
def test_grey_integers_survive_the_round_trip(encoding, data):
    pixels = data.draw(hnp.arrays(TYPES[encoding], SIZES))
    message = image_from_array(pixels, encoding, header())
    np.testing.assert_array_equal(messages.array_from_image(message), pixels)
    frame = messages.frame_from_image(message).light
    assert frame.dtype == np.float32
    np.testing.assert_array_equal(messages.pixels_from_frame(frame, encoding), pixels)


# Above 2 are lamps, but most of a picture is not.
LIGHT = st.floats(width=32, max_value=2) | st.sampled_from([np.nan, -np.inf])


@given(pixels=hnp.arrays(np.float32, SIZES, elements=LIGHT))
def test_floats_survive_the_round_trip_with_nan_and_infinity(pixels):
    message = image_from_array(pixels, "32FC1", header())
    np.testing.assert_array_equal(messages.frame_from_image(message).light, pixels)


@pytest.mark.parametrize("encoding", COLOURS)
@given(data=st.data())
def test_colours_come_out_as_rgb_and_go_back(encoding, data):
    channels = messages.ENCODINGS[encoding].channels
    stored = data.draw(
        hnp.arrays(np.uint8, st.tuples(st.integers(1, 7), st.integers(1, 7), st.just(channels)))
    )
    message = image_from_array(stored, encoding, header())
    rgb = messages.array_from_image(message)
    np.testing.assert_array_equal(rgb, stored[:, :, COLOURS[encoding]])
    again = messages.pixels_from_frame(messages.frame_from_image(message).light, encoding)
    np.testing.assert_array_equal(again[:, :, :3], stored[:, :, :3])


@pytest.mark.parametrize(("encoding", "coloured"), [("mono16", False), ("bayer_gbrg16", True)])
def test_bits_that_a_sensor_does_not_scale(encoding, coloured):
    stored = np.array([[0, 819, 4095], [1638, 2457, 4095]], np.uint16)
    message = image_from_array(stored, encoding, Header())
    of_12_bits, of_10_bits = PixelFormat(bits=12), PixelFormat(bits=10)
    frame = messages.frame_from_image(message, of_12_bits, colour=coloured).picture
    if coloured:
        frame = messages.pixels_from_frame(frame, encoding) / 65535
    np.testing.assert_allclose(frame, stored / 4095, atol=3e-4)
    more = messages.frame_from_image(message, of_10_bits, colour=coloured).picture
    if not coloured:  # clipped, and not what is left over
        np.testing.assert_allclose(more, [[0, 0.8, 1], [1, 1, 1]], atol=2e-3)


@pytest.mark.parametrize(("encoding", "luma"), [("yuv422", 1), ("yuv422_yuy2", 0)])
def test_yuv_comes_out_as_rgb_and_goes_on_as_rgb(encoding, luma):
    """As cameras give it: 16 is black and 235 white, and two pixels share their colour."""
    stored = np.full((2, 4, 2), 128, np.uint8)
    stored[..., luma] = [[16, 235, 16, 235], [81, 81, 145, 145]]
    stored[1, :, 1 - luma] = [90, 240, 54, 34]  # red, then green (BT.601)
    message = image(encoding, 2, 4, 8, stored.tobytes())
    rgb = messages.array_from_image(message)
    expected = [[[0] * 3, [255] * 3] * 2, [[255, 0, 0]] * 2 + [[0, 255, 0]] * 2]
    np.testing.assert_allclose(rgb, expected, atol=2)
    written = messages.output_encoding(encoding)
    assert written == "rgb8"
    again = messages.pixels_from_frame(messages.frame_from_image(message).light, written)
    np.testing.assert_array_equal(again, rgb)
    with pytest.raises(messages.MessageError, match="pixels in pairs"):
        messages.array_from_image(image(encoding, 2, 3, 6, bytes(12)))


@given(pixels=hnp.arrays(np.uint16, SIZES), padding=st.integers(0, 5))
def test_padding_and_byte_order_are_respected(pixels, padding):
    height, width = pixels.shape
    swapped = pixels.astype(">u2").view(np.uint8).reshape(height, 2 * width)
    rows = np.pad(swapped, ((0, 0), (0, padding)), constant_values=77)
    message = image("mono16", height, width, 2 * width + padding, rows.tobytes(), bigendian=1)
    np.testing.assert_array_equal(messages.array_from_image(message), pixels)
    message.is_bigendian = 0
    np.testing.assert_array_equal(messages.array_from_image(message), pixels.byteswap())


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("encoding", image("nv21")),
        ("encoding", image("")),
        ("size", image(height=0)),
        ("size", image(width=0)),
        ("step", image(step=5)),
        ("step", image(step=0)),
        ("step", image("rgb8", step=17)),
        ("data", image(data=bytes(23))),
        ("data", image(data=b"")),
        ("data", image(height=2**31, width=2**30, step=2**30, data=bytes(24))),
    ],
)
def test_a_bad_message_is_a_named_error(kind, message):
    with pytest.raises(messages.MessageError) as caught:
        messages.frame_from_image(message)
    assert caught.value.kind == kind
    assert isinstance(caught.value, InputError)
    assert "\n" not in str(caught.value)


def test_values_are_linear_light():
    message = image(width=3, height=1, data=bytes([0, 51, 255]))
    np.testing.assert_allclose(messages.frame_from_image(message).light[0], [0, 0.2, 1], atol=1e-6)
    np.testing.assert_allclose(
        messages.frame_from_image(message, PixelFormat(2.2)).light[0], [0, 0.2**2.2, 1], atol=1e-6
    )
    wide = image("mono16", 1, 1, 2, np.uint16([32768]).tobytes())
    assert messages.frame_from_image(wide, PixelFormat(2.2)).light[0, 0] == pytest.approx(
        32768 / 65535
    )


def test_gamma_is_undone_on_the_way_back():
    pixels = np.arange(256, dtype=np.uint8).reshape(16, 16)
    frame = messages.frame_from_image(
        image_from_array(pixels, "mono8", header()), PixelFormat(2.2)
    ).light
    np.testing.assert_array_equal(messages.pixels_from_frame(frame, "mono8", 2.2), pixels)


def test_floats_are_clipped_and_unknown_is_black():
    frame = np.float32([[np.nan, -1, 2, np.inf, 0.5]])
    assert messages.pixels_from_frame(frame, "mono8").tolist() == [[0, 0, 255, 255, 128]]


def test_grey_and_colour_convert_into_each_other():
    grey = np.full((2, 3), 0.2, np.float32)
    assert messages.pixels_from_frame(grey, "bgr8").tolist() == [[[51] * 3] * 3] * 2
    red = np.zeros((1, 1, 3), np.float32)
    red[..., 0] = 1
    assert messages.pixels_from_frame(red, "bgr8").tolist() == [[[0, 0, 255]]]
    assert messages.pixels_from_frame(red, "mono8").tolist() == [[round(0.2126 * 255)]]


def test_data_is_assigned_as_a_block():
    """rclpy checks any other sequence element by element: 100 ms instead of 0.2 for 1 MB."""
    message = image_from_array(np.zeros((480, 640), np.float32), "32FC1", header())
    assert isinstance(message.data, array.array)
    assert len(message.data) == 480 * message.step == 480 * 640 * 4


def test_wrong_pixels_are_refused():
    for pixels in (np.zeros((2, 2), np.float64), np.zeros((2, 2, 3), np.uint8), np.zeros(4, "u1")):
        with pytest.raises(messages.MessageError, match="mono8 needs uint8"):
            image_from_array(pixels, "mono8", header())


def test_headers_are_copied_not_shared():
    original = header()
    message = image_from_array(np.zeros((1, 1), np.uint8), "mono8", original)
    original.frame_id, original.stamp.sec = "moved", 99
    assert message.header == header()
    assert stamp_ns(message.header) == 12_345_678_901


def test_millimetres_saturate_and_never_wrap():
    depth = np.float32([[np.nan, 0, -1, 1.2344, 65.535, 65.536, 131.072, 3e38, 1e-5]])
    expected = [[0, 0, 0, 1234, 65535, 65535, 65535, 65535, 1]]
    assert messages.millimetres_from_depth(depth).tolist() == expected


def test_millimetres_of_infinities_are_unknown():
    """A point cloud made of 16UC1 must not have points where that of 32FC1 has none."""
    assert messages.millimetres_from_depth(np.float32([[np.inf, -np.inf]])).tolist() == [[0, 0]]


@given(depth=hnp.arrays(np.float32, SIZES, elements=st.floats(2**-10, 65.5, width=32)))
def test_millimetres_are_right_to_half_a_millimetre(depth):
    error = messages.millimetres_from_depth(depth) * 1e-3 - depth.astype(np.float64)
    # Half a millimetre, and what single precision rounds in thousands of them.
    assert (np.abs(error) <= 0.0005 + np.spacing(1000 * depth) / 1000).all()


def test_depth_outside_the_range_is_marked():
    depth = np.float32([[0.5, 1, 2, 3, 4, np.nan, np.inf]])
    marked = messages.limit_depth(depth, 1.0, 3.0)
    np.testing.assert_array_equal(marked, np.float32([[-np.inf, 1, 2, 3, np.inf, np.nan, np.inf]]))
    assert depth[0, 0] == 0.5  # the argument is left alone


def test_rounding_does_not_put_the_end_of_the_range_out_of_range():
    ends = np.float32([[1.3, 4.0]])
    for rounded in (np.nextafter(ends, np.float32(0)), np.nextafter(ends, np.float32(9))):
        assert np.isfinite(messages.limit_depth(rounded, 1.3, 4.0)).all()


def camera(width=640, height=480):
    return Camera(800.0, 0.9, width, height, Mask.named("levin"), 5.0)


def project(info, point):
    x, y, w = np.reshape(info.p, (3, 4)) @ [*point, 1.0]
    return x / w, y / w


def test_camera_info_of_a_camera_file():
    info = camera_info_from_camera(camera(), header())
    assert (info.width, info.height, info.distortion_model) == (640, 480, "plumb_bob")
    assert list(info.d) == [0.0] * 5
    assert list(info.k) == [800, 0, 319.5, 0, 800, 239.5, 0, 0, 1]
    assert list(info.p) == [800, 0, 319.5, 0, 0, 800, 239.5, 0, 0, 0, 1, 0]
    assert list(info.r) == [1, 0, 0, 0, 1, 0, 0, 0, 1]
    assert info.header == header()


@given(st.integers(1, 800), st.integers(1, 800), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_a_decimated_camera_sees_a_point_at_the_same_place(width, height, x, y):
    """Pixel i covers [i - 1/2, i + 1/2]: relative to the image's edges nothing may move."""
    full = camera_info_from_camera(camera(), header())
    small = region_camera_info(full, width, height, header())
    for centre, length, small_centre, small_length in zip(
        project(full, (x, y, 1)), (640, 480), project(small, (x, y, 1)), (width, height),
        strict=True,
    ):  # fmt: skip
        assert (small_centre + 0.5) / small_length == pytest.approx((centre + 0.5) / length)
    assert small.k[0] == pytest.approx(small.p[0]) and small.k[2] == pytest.approx(small.p[2])


def test_scaling_keeps_distortion_rotation_and_baseline():
    info = camera_info_from_camera(camera(), header())
    info.d = [0.1, -0.2, 0.001, 0.002, 0.03]
    info.p[3] = -80.0
    half = region_camera_info(info, 320, 240, header("other"))
    assert list(half.d) == [0.1, -0.2, 0.001, 0.002, 0.03]
    assert half.p[3] == -40.0
    assert half.k[2] == pytest.approx(159.5) and half.k[5] == pytest.approx(119.5)
    assert half.header.frame_id == "other"


def test_a_missing_projection_matrix_is_filled_in():
    info = camera_info_from_camera(camera(), header())
    info.p = [0.0] * 12
    half = region_camera_info(info, 320, 240, header())
    assert list(half.p) == [400, 0, 159.5, 0, 0, 400, 119.5, 0, 0, 0, 1, 0]


def test_an_uncalibrated_camera_is_a_named_error():
    with pytest.raises(messages.MessageError) as caught:
        region_camera_info(CameraInfo(width=640, height=480), 320, 240, header())
    assert caught.value.kind == "camera_info"


def compressed_message(pixels, suffix, kind):
    data = cv2.imencode(suffix, pixels)[1].tobytes()
    return CompressedImage(header=header(), format=kind, data=data)


@pytest.mark.parametrize("order", MOSAICS)
@pytest.mark.parametrize(
    ("kind", "suffix", "dtype"),
    [
        ("bayer_{}8; png compressed ", ".png", np.uint8),
        ("bayer_{}8; jpeg compressed ", ".jpg", np.uint8),
        ("bayer_{}16; png compressed ", ".png", np.uint16),
        ("bayer_{}16; jpeg compressed ", ".jpg", np.uint8),
        ("bayer_{}8;png compressed", ".png", np.uint8),
        ("bayer_{}8", ".png", np.uint8),
        ("bayer_{}16; tiff compressed ", ".png", np.uint16),
    ],
)
def test_compressed_mosaics_are_mosaics(order, kind, suffix, dtype):
    smooth = np.linspace(20, 200, 24).astype(dtype) + np.zeros((16, 1), dtype)
    pixels, encoding = messages.array_from_compressed(
        compressed_message(smooth, suffix, kind.format(order))
    )
    assert encoding == f"bayer_{order}{8 * np.dtype(dtype).itemsize}"
    np.testing.assert_allclose(pixels, smooth, atol=4 if suffix == ".jpg" else 0)
    assert image_from_array(pixels, encoding, header()).encoding == encoding


@pytest.mark.parametrize(
    ("shape", "dtype", "kind", "encoding"),
    [
        ((16, 24), np.uint8, "mono8; png compressed ", "mono8"),
        ((16, 24), np.uint16, "mono16; png compressed ", "mono16"),
        ((16, 24, 3), np.uint8, "rgb8; png compressed bgr8", "rgb8"),
        ((16, 24, 3), np.uint16, "rgb16; png compressed bgr16", "rgb16"),
        # A driver that made colours of its mosaic first.
        ((16, 24, 3), np.uint8, "bayer_rggb8; png compressed bgr8", "rgb8"),
        ((16, 24), np.uint8, "png", "mono8"),
    ],
)
def test_other_compressed_pictures_are_no_mosaics(shape, dtype, kind, encoding):
    pixels = np.arange(np.prod(shape)).reshape(shape).astype(dtype)
    found, name = messages.array_from_compressed(compressed_message(pixels, ".png", kind))
    assert name == encoding
    np.testing.assert_array_equal(found, pixels if pixels.ndim == 2 else pixels[..., ::-1])


def test_floats_up_to_255_are_refused_with_what_to_do():
    pixels = np.linspace(0, 255, 48, dtype=np.float32).reshape(6, 8)
    with pytest.raises(InputError, match="divide by the value of white, such as 255"):
        messages.frame_from_image(image_from_array(pixels, "32FC1", header()))


def test_a_damaged_picture_is_a_fault_of_data():
    pytest.importorskip("numba")
    message = compressed_message(np.arange(9600, dtype=np.uint8).reshape(80, 120), ".jpg", "jpeg")
    message.data = bytes(message.data)[:-200] + b"\xff\xd9"
    with pytest.raises(messages.MessageError, match="damaged") as error:
        messages.array_from_compressed(message)
    assert error.value.kind == "data"
