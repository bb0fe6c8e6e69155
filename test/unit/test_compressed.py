"""Pictures and depth as image_transport's plugins compress and decode them."""

import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from coded_aperture_ros.io.messages import (
    ENCODINGS,
    MessageError,
    array_from_compressed,
    compressed_depth,
    compressed_picture,
    pixels_from_frame,
)


def decoded_runs(data, count):
    """RVL as its paper's decoder reads it: one number after the other."""
    words = np.frombuffer(data, "<u4")
    nibbles = iter(((words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32)) & 15).ravel())

    def number():
        value, shift = 0, 0
        while True:
            nibble = int(next(nibbles))
            value |= (nibble & 7) << shift
            shift += 3
            if not nibble & 8:
                return value

    values, previous = [], 0
    while len(values) < count:
        values += [0] * number()
        for _ in range(number()):
            folded = number()
            previous += (folded >> 1) ^ -(folded & 1)
            values.append(previous)
    return np.array(values)


def decoded(data, kind):
    """What compressed_depth_image_transport makes of a message."""
    encoding, transport = kind.split("; ")
    inverse_depth, scale, offset = struct.unpack("<i2f", data[:12])
    assert inverse_depth == 0
    if transport == "compressedDepth png":
        values = cv2.imdecode(np.frombuffer(data[12:], np.uint8), cv2.IMREAD_UNCHANGED)
    else:
        assert transport == "compressedDepth rvl"
        columns, rows = struct.unpack("<2I", data[12:20])
        values = decoded_runs(data[20:], rows * columns).reshape(rows, columns)
    if encoding == "16UC1":
        return values
    with np.errstate(divide="ignore"):
        depth = np.float32(scale) / (values.astype(np.float32) - np.float32(offset))
    return np.where(values > 0, depth, np.nan)


def depth_m(near=0.5, far=20.0):
    random = np.random.default_rng(0)
    values = np.exp(random.uniform(np.log(near), np.log(far), (40, 56))).astype(np.float32)
    values[random.random(values.shape) < 0.3] = np.nan
    values[:3], values[3], values[-2:] = np.inf, -np.inf, np.nan
    return values


@pytest.mark.parametrize("kind", ["png", "rvl"])
@pytest.mark.parametrize("near", [0.05, 0.5])
def test_metres_come_back_to_a_ten_thousandth_of_their_inverse(kind, near):
    given = depth_m(near)
    found = decoded(*compressed_depth(given, kind))
    known = np.isfinite(given)
    step = 1 / min(10_100, 65_534 * np.nanmin(given[known]))
    assert np.abs(1 / found[known] - 1 / given[known]).max() < 0.51 * step
    # Beyond the range stays so; what is too near is unknown, like what is unknown.
    assert np.isposinf(found[:3]).all()
    assert np.isnan(found[np.isnan(given) | np.isneginf(given)]).all()


@pytest.mark.parametrize("kind", ["png", "rvl"])
@pytest.mark.parametrize("empty", ["begins", "ends", "all", "none"])
def test_millimetres_come_back_exactly(kind, empty):
    given = np.random.default_rng(1).integers(1, 65536, (16, 20)).astype(np.uint16)
    given[4:9, 3:15] = 0
    rows = {"begins": np.s_[:2], "ends": np.s_[-2:], "all": np.s_[:], "none": np.s_[:0]}[empty]
    given[rows] = 0
    np.testing.assert_array_equal(decoded(*compressed_depth(given, kind)), given)


def test_runs_are_written_as_the_original_codec_writes_them():
    # Of 0 0 5 6 4 0 300 by the code that the paper gives: numbers 2 3 10 2 3 1 1 592.
    data, _ = compressed_depth(np.array([[0, 0, 5, 6, 4, 0, 300]], np.uint16), "rvl")
    nibbles = [2, 3, 10, 1, 2, 3, 1, 1, 8, 10, 9, 1, 0, 0, 0, 0]
    words = [
        sum(nibble << 28 - 4 * i for i, nibble in enumerate(nibbles[k : k + 8])) for k in (0, 8)
    ]
    assert data[20:] == struct.pack("<2I", *words)


@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
def test_a_frame_without_depth_is_unknown_everywhere(dtype):
    nothing = np.full((4, 6), np.nan if dtype == np.float32 else 0).astype(dtype)
    found = decoded(*compressed_depth(nothing))
    assert (np.isnan(found) if dtype == np.float32 else found == 0).all()


@pytest.mark.parametrize(
    ("encoding", "kind"),
    [
        ("mono8", "mono8; jpeg compressed "),
        ("rgb8", "rgb8; jpeg compressed bgr8"),
        ("bgr8", "bgr8; jpeg compressed bgr8"),
        ("rgba8", "rgba8; jpeg compressed bgr8"),
        ("mono16", "mono16; png compressed mono16"),
        ("rgb16", "rgb16; png compressed bgr16"),
    ],
)
def test_pictures_are_readable_whatever_their_encoding(encoding, kind):
    frame = np.zeros((48, 64, 3), np.float32)
    frame[..., 0], frame[..., 1], frame[..., 2] = 0.8, 0.4, np.linspace(0, 0.3, 64)
    data, found = compressed_picture(pixels_from_frame(frame, encoding), encoding)
    assert found == kind
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    expected = pixels_from_frame(frame, encoding.replace("rgba", "rgb").replace("rgb", "bgr"))
    assert picture.dtype == expected.dtype
    assert np.abs(picture.astype(float) - expected).mean() < 3


@pytest.mark.parametrize(
    ("encoding", "kind", "form"),
    [
        ("mono8", "png", "mono8; png compressed "),
        ("rgb8", "png", "rgb8; png compressed bgr8"),
        ("rgb16", "jpeg", "rgb16; png compressed bgr16"),
        ("bayer_rggb8", "jpeg", "bayer_rggb8; png compressed "),
        ("bayer_gbrg16", "png", "bayer_gbrg16; png compressed "),
    ],
)
def test_png_keeps_every_pixel(encoding, kind, form):
    entry = ENCODINGS[encoding]
    shape = (12, 16, 3) if entry.channels == 3 else (12, 16)
    pixels = np.random.default_rng(0).integers(0, 256, shape).astype(entry.dtype)
    data, found = compressed_picture(pixels, encoding, kind)
    assert found == form
    decoded, name = array_from_compressed(SimpleNamespace(data=data, format=found))
    assert name == encoding
    np.testing.assert_array_equal(decoded, pixels)


@pytest.mark.parametrize(("encoding", "shape"), [("32FC1", (4, 4)), ("yuv422", (4, 4, 2))])
def test_what_has_no_compressed_form_is_refused(encoding, shape):
    pixels = np.zeros(shape, ENCODINGS[encoding].dtype)
    with pytest.raises(MessageError, match=f"{encoding} cannot be compressed"):
        compressed_picture(pixels, encoding)
