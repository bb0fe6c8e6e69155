import struct

import cv2
import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import decode, encode, gamma_from_text, linear_from_pixels
from coded_aperture_ros.io import (
    confidence_picture,
    depth_picture,
    read_depth,
    read_image,
    write_depth,
    write_image,
)
from coded_aperture_ros.io.depth_picture import UNKNOWN_RGB
from coded_aperture_ros.io.picture_file import read_compressed
from coded_aperture_ros.sources import captures, open_files


@pytest.fixture
def colours():
    """A red, a green and a blue pixel, and one of each light in between."""
    return np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [0.25, 0.5, 0.75]]], dtype=np.float32)


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [("a.png", 1e-5), ("a.tif", 0), ("a.tiff", 0), ("a.npy", 0), ("a.bmp", 4.5e-3)],
)
def test_written_picture_is_read_back(tmp_path, colours, name, tolerance):
    for image in (colours, colours[:, :, 1]):
        write_image(tmp_path / name, image)
        read = read_image(tmp_path / name)
        assert read.dtype == np.float32
        assert read.shape in (image.shape, (2, 2, 3))
        compared = read if read.shape == image.shape else read[:, :, 1]
        assert compared == pytest.approx(image, abs=tolerance)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_files_hold_the_colours_in_opencv_order(tmp_path, colours):
    write_image(tmp_path / "a.png", colours)
    assert cv2.imread(str(tmp_path / "a.png"))[0, 0].tolist() == [0, 0, 255]


def test_jpeg_keeps_colours_roughly(tmp_path):
    red = np.full((16, 16, 3), [0.8, 0.1, 0.1], np.float32)
    write_image(tmp_path / "a.jpg", red)
    assert read_image(tmp_path / "a.jpg") == pytest.approx(red, abs=0.02)


@pytest.mark.parametrize(("gamma", "expected"), [(1.0, 0.502), (2.2, 0.2195), ("srgb", 0.2159)])
def test_gamma_applies_to_8_bit_files(tmp_path, gamma, expected):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((2, 2), 128, np.uint8))
    assert read_image(tmp_path / "a.png", gamma) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_numbers_of_either_byte_order_are_read(tmp_path, kind):
    values = np.array([[0, 1, 300], [2, 0, 258]], kind)
    for order in "<>":
        np.save(tmp_path / "a.npy", values.astype(values.dtype.newbyteorder(order)))
        assert read_compressed(tmp_path / "a.npy")[0].dtype == kind
        np.testing.assert_array_equal(read_compressed(tmp_path / "a.npy")[0], values)
        assert read_depth(tmp_path / "a.npy", 0.001)[0, 2] == np.float32(0.3)


def test_gamma_leaves_wider_files_alone(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((2, 2), 32768, np.uint16))
    assert read_image(tmp_path / "a.png", "srgb") == pytest.approx(0.5, abs=1e-4)
    np.save(tmp_path / "a.npy", np.full((2, 2), 0.5))
    assert read_image(tmp_path / "a.npy", 2.2) == pytest.approx(0.5)


@pytest.mark.parametrize("gamma", [1.0, 0.5, 2.2, "srgb"])
def test_decode_undoes_encode(gamma):
    light = np.linspace(0, 1, 101, dtype=np.float32)
    assert decode(encode(light, gamma), gamma) == pytest.approx(light, abs=1e-5)


def test_8_bit_write_with_gamma_is_read_back(tmp_path):
    image = np.linspace(0, 1, 256, dtype=np.float32)[None, :].repeat(2, axis=0)
    write_image(tmp_path / "a.png", image, bits=8, gamma="srgb")
    assert read_image(tmp_path / "a.png", "srgb") == pytest.approx(image, abs=5e-3)


@pytest.mark.parametrize("name", ["a.jpg", "a.bmp"])
def test_pictures_of_8_bits_are_srgb_unless_told(tmp_path, name):
    """As every viewer and every ordinary camera has them; what is written is read back."""
    write_image(tmp_path / name, np.full((8, 8), 0.2159))
    assert cv2.imread(str(tmp_path / name)) == pytest.approx(128, abs=1)
    assert read_image(tmp_path / name) == pytest.approx(0.2159, abs=5e-3)
    write_image(tmp_path / name, np.full((8, 8), 0.5), gamma=1.0)
    assert cv2.imread(str(tmp_path / name)) == pytest.approx(128, abs=1)
    assert read_image(tmp_path / name, gamma=1.0) == pytest.approx(0.5, abs=5e-3)


def test_writing_clips_and_blacks_out_nan(tmp_path):
    write_image(tmp_path / "a.png", np.array([[-1, 2, np.nan, 0.5, np.inf]]))
    assert read_image(tmp_path / "a.png")[0] == pytest.approx([0, 1, 0, 0.5, 1], abs=1e-5)


def test_nan_is_kept_in_float_files(tmp_path):
    write_image(tmp_path / "a.tif", np.array([[np.nan, 0.5]]))
    assert np.isnan(read_image(tmp_path / "a.tif")).tolist() == [[True, False]]


@pytest.mark.parametrize("name", ["a.npy", "a.tif"])
def test_numbers_up_to_255_are_no_linear_light(tmp_path, name):
    values = np.linspace(0, 255, 35, dtype=np.float32).reshape(5, 7)
    (np.save if name.endswith("npy") else write_image)(tmp_path / name, values)
    with pytest.raises(InputError, match="divide by the value of white, such as 255"):
        read_image(tmp_path / name)
    write_image(tmp_path / "lamp.npy", np.array([[0.1, 0.2, 0.3, 50, 90]]))
    assert read_image(tmp_path / "lamp.npy").max() == 90


def test_exif_does_not_turn_the_picture_against_the_mask(tmp_path):
    path = tmp_path / "upright.jpg"
    cv2.imwrite(str(path), np.zeros((24, 40, 3), np.uint8))
    entry = b"\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00"  # orientation: turned by 90 degrees
    exif = b"Exif\0\0MM\x00\x2a\x00\x00\x00\x08\x00\x01" + entry + bytes(4)
    stored = path.read_bytes()
    segment = b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
    path.write_bytes(stored[:2] + segment + stored[2:])
    assert cv2.imread(str(path)).shape == (40, 24, 3)  # OpenCV does, if it is not told otherwise
    assert read_image(path).shape == (24, 40, 3)


def test_alpha_is_dropped(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((3, 4, 4), [0, 0, 255, 128], np.uint8))
    assert read_image(tmp_path / "a.png").tolist() == np.full((3, 4, 3), [1, 0, 0]).tolist()


@pytest.mark.parametrize("text", ["srgb", "SRGB", "2.2"])
def test_gamma_from_text(text):
    assert gamma_from_text(text) in ("srgb", 2.2)


@pytest.mark.parametrize("text", ["-1", "0", "nan", "linear", "99"])
def test_impossible_gamma_is_refused(text):
    with pytest.raises(InputError, match="gamma: expected"):
        gamma_from_text(text)


def _truncated(path):
    image = np.random.default_rng(0).random((40, 40)).astype(np.float32)
    write_image(path, image)
    path.write_bytes(path.read_bytes()[:-500])


@pytest.mark.parametrize(
    ("name", "write", "reason"),
    [
        ("a.png", lambda path: None, "No such file"),
        ("a.png", lambda path: path.mkdir(), "Is a directory"),
        ("a.png", lambda path: path.write_bytes(b""), "empty"),
        ("a.png", lambda path: path.write_bytes(b"hello"), "not a picture"),
        ("a.txt", lambda path: path.write_bytes(b"hello"), "not a picture"),
        ("a.png", _truncated, "truncated"),
        ("a.npy", _truncated, "truncated"),
        ("a.npy", lambda path: np.save(path, np.ones(3)), "expected"),
        ("a.npy", lambda path: np.save(path, np.ones((2, 2, 4))), "expected a picture"),
        ("a.npy", lambda path: np.save(path, np.ones((0, 2))), "expected a picture"),
        ("a.npy", lambda path: np.save(path, np.array([["x"]])), "one numeric array"),
        ("a.npy", lambda path: np.save(path, np.ones((2, 2), np.int64)), "got int64"),
    ],
)
def test_unusable_picture_is_refused_by_name(tmp_path, name, write, reason):
    write(tmp_path / name)
    with pytest.raises(InputError, match=f"{name}: .*{reason}") as error:
        read_image(tmp_path / name)
    assert "\n" not in str(error.value)


def test_unknown_output_format_is_refused_and_nothing_is_left(tmp_path):
    for write in (write_image, write_depth):
        with pytest.raises(InputError, match=r"a\.xyz: unknown"):
            write(tmp_path / "a.xyz", np.ones((2, 2)))
    assert list(tmp_path.iterdir()) == []


def test_depth_round_trips(tmp_path):
    depth = np.array([[1.234, np.nan, 70.0, np.inf, 0.0002, 0, -np.inf]], np.float32)
    write_depth(tmp_path / "d.png", depth)
    expected = [1.234, np.nan, 65.535, np.nan, 0.001, np.nan, np.nan]
    assert read_depth(tmp_path / "d.png")[0] == pytest.approx(expected, nan_ok=True)
    for name in ("d.npy", "d.tif"):
        write_depth(tmp_path / name, depth)
        told = np.where(depth > 0, depth, np.nan)
        assert np.array_equal(read_depth(tmp_path / name), told, equal_nan=True)


def test_depth_units(tmp_path):
    cv2.imwrite(str(tmp_path / "d.png"), np.array([[0, 10000]], np.uint16))
    assert read_depth(tmp_path / "d.png", 1e-4)[0] == pytest.approx([np.nan, 1.0], nan_ok=True)
    np.save(tmp_path / "d.npy", np.array([[0.0, -1.0, 2.0, -np.inf]]))
    expected = [np.nan, np.nan, 2.0, np.nan]
    assert read_depth(tmp_path / "d.npy")[0] == pytest.approx(expected, nan_ok=True)


def test_depth_that_is_not_one_is_refused(tmp_path):
    write_image(tmp_path / "rgb.png", np.ones((2, 2, 3)))
    with pytest.raises(InputError, match=r"rgb\.png: expected a depth map"):
        read_depth(tmp_path / "rgb.png")
    write_image(tmp_path / "d.png", np.ones((2, 2)), bits=8)
    with pytest.raises(InputError, match="8-bit depth has no usual unit"):
        read_depth(tmp_path / "d.png")
    with pytest.raises(InputError, match="metres per unit"):
        read_depth(tmp_path / "d.png", -1.0)


def test_folder_is_read_in_order_of_names(tmp_path):
    for value, name in [(0.3, "c.png"), (0.1, "a.npy"), (0.2, "b.tif")]:
        write_image(tmp_path / name, np.full((2, 2), value))
    (tmp_path / "planes.json").write_text("{}")
    source = open_files(str(tmp_path))
    assert source.length == 3
    for _ in range(2):
        read = list(captures(source))
        assert [capture.name for capture in read] == ["a", "b", "c"]
        values = [float(linear_from_pixels(capture.frame)[0, 0]) for capture in read]
        assert values == pytest.approx([0.1, 0.2, 0.3], abs=1e-4)


def test_single_file_is_a_source_of_one_frame(tmp_path):
    write_image(tmp_path / "a.png", np.ones((2, 3)))
    source = open_files(str(tmp_path / "a.png"))
    assert source.length == 1
    assert [(capture.name, capture.frame.shape) for capture in captures(source)] == [("a", (2, 3))]


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """A video of three frames with more and more red."""
    path = tmp_path_factory.mktemp("video") / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    for level in (50, 100, 200):
        writer.write(np.full((48, 64, 3), [10, 20, level], np.uint8))
    writer.release()
    return path


def test_video_frames_come_in_order_and_in_rgb(clip):
    source = open_files(str(clip))
    assert source.length == 3
    read = list(captures(source))
    assert [capture.name for capture in read] == [f"clip_00000{index}" for index in range(3)]
    for capture, level in zip(read, (50, 100, 200), strict=True):
        frame = linear_from_pixels(capture.frame)
        assert frame.shape == (48, 64, 3)
        assert frame[20, 20] == pytest.approx(np.array([level, 20, 10]) / 255, abs=0.02)


def test_a_video_that_asks_to_be_turned_is_read_as_it_was_taken(tmp_path):
    path = tmp_path / "phone.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 10, (64, 48))
    writer.write(np.full((48, 64, 3), 100, np.uint8))
    writer.release()
    data = path.read_bytes()
    unturned = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    place = data.index(unturned, data.index(b"tkhd"))
    turned = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, 48 << 16, 0, 1 << 30)
    path.write_bytes(data[:place] + turned + data[place + len(turned) :])
    assert cv2.VideoCapture(str(path)).read()[1].shape[:2] == (64, 48)  # as players do
    assert [capture.frame.shape[:2] for capture in captures(open_files(str(path)))] == [(48, 64)]


def test_files_are_read_over_and_over_or_once(clip, tmp_path):
    for value, name in [(0.25, "a.npy"), (0.5, "b.npy")]:
        write_image(tmp_path / name, np.full((2, 2), value))
    for path, length in ((clip, 3), (tmp_path, 2)):
        once, forever = open_files(str(path)), open_files(str(path), loop=True)
        names = [capture.name for capture in captures(once)]
        assert len(names) == length
        assert [forever.read().name for _ in range(2 * length)] == 2 * names
        forever.close()
        assert forever.read().name == names[0]


def test_a_picture_that_cannot_be_read_does_not_hide_those_after_it(tmp_path):
    for name in ("a.png", "c.png"):
        write_image(tmp_path / name, np.ones((2, 2)))
    (tmp_path / "b.png").write_bytes(b"hello")
    source = open_files(str(tmp_path))
    assert source.read().name == "a"
    with pytest.raises(InputError, match=r"b\.png"):
        source.read()
    assert source.read().name == "c"
    assert source.read() is None


def test_unusable_files_are_refused(tmp_path, capfd):
    with pytest.raises(InputError, match="no pictures in this folder"):
        open_files(str(tmp_path))
    with pytest.raises(InputError, match="nowhere: no such file or folder"):
        open_files(str(tmp_path / "nowhere"))
    (tmp_path / "bad.mp4").write_bytes(b"hello")
    with pytest.raises(InputError, match=r"bad\.mp4: not a video"):
        open_files(str(tmp_path / "bad.mp4"))


def test_depth_picture_colours_near_red_far_blue_unknown_grey():
    depth = np.tile(np.linspace(1.0, 3.0, 200, dtype=np.float32), (50, 1))
    depth[:10] = np.nan
    depth[10:20] = np.inf
    picture = depth_picture(depth)
    assert picture.dtype == np.uint8
    assert picture.shape[1:] == (200, 3)
    assert picture.shape[0] > 50
    unknown = picture[:10].reshape(-1, 3)
    assert (np.ptp(unknown, axis=1) == 0).all()  # grey, which no depth is
    assert {tuple(colour) for colour in unknown.tolist()} > {UNKNOWN_RGB}
    assert (np.ptp(picture[10:50].astype(int), axis=2) > 20).all()
    near, far = picture[30, 5].astype(int), picture[30, 194].astype(int)
    assert near[0] > near[2]
    assert far[2] > far[0]
    assert (picture[15] == picture[30, 199]).all()
    # The bar below shows the same colours in the same order, above dark labels.
    strip = picture[50:].astype(int)
    assert strip[8, 20, 0] > strip[8, 20, 2]
    assert strip[8, 180, 2] > strip[8, 180, 0]
    assert (strip[20:] < 128).all(axis=2).sum() > 30


@pytest.mark.parametrize(
    "depth",
    [np.full((5, 300), np.nan), np.full((5, 300), 2.0), np.full((5, 8), 2.0), np.zeros((5, 300))],
)
def test_depth_picture_of_degenerate_maps(depth):
    assert depth_picture(depth).shape == (45, depth.shape[1], 3)


def test_depth_picture_with_a_fixed_range():
    depth = np.full((4, 100), 2.0)
    assert (depth_picture(depth, 1, 3)[0, 0] == depth_picture(depth + 8, 9, 11)[0, 0]).all()
    with pytest.raises(InputError, match="expected"):
        depth_picture(np.zeros((2, 2, 3)))


def test_confidence_picture():
    picture = confidence_picture(np.array([[0, 0.5, 1, np.nan, 2]]))
    assert (picture[0] == np.array([0, 128, 255, 0, 255])[:, None]).all()
    wide = confidence_picture(np.full((5, 300), 0.5))
    bar = wide[13, :, 0].astype(int)
    assert bar[20] < 40
    assert bar[280] > 215
    assert (np.diff(bar[15:285]) >= 0).all()


def test_integer_pixels_span_their_type():
    assert linear_from_pixels(np.array([0, 255], np.uint8)).tolist() == [0, 1]
    assert linear_from_pixels(np.array([0, 65535], np.uint16)) == pytest.approx([0, 1])


@pytest.mark.parametrize("quality", [95, 75, 50])
def test_a_picture_says_what_jpeg_has_lost(tmp_path, quality):
    picture = np.random.default_rng(0).integers(0, 255, (64, 96, 3)).astype(np.uint8)
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    path = tmp_path / "p.jpg"
    path.write_bytes(data.tobytes())
    pixels, lost = read_compressed(path)
    np.testing.assert_array_equal(linear_from_pixels(pixels), read_image(path, 1.0))
    # The median of the standard's luminance table is 56.5, at quality 50.
    median = 56.5 * (2 - quality / 50)
    assert lost == pytest.approx(0.35 * median / 255 / np.sqrt(12), rel=0.1)
    cv2.imwrite(str(tmp_path / "p.png"), picture)
    assert read_compressed(tmp_path / "p.png")[1] == 0


def test_cut_jpeg_pictures_are_refused_or_read(tmp_path):
    """At whatever byte they end."""
    picture = np.random.default_rng(0).integers(0, 255, (24, 24), np.uint8)
    data = cv2.imencode(".jpg", picture)[1].tobytes()
    path = tmp_path / "cut.jpg"
    for length in range(1, len(data), 7):
        path.write_bytes(data[:length])
        try:
            assert read_compressed(path)[0].shape == picture.shape
        except InputError as error:
            assert "cut.jpg" in str(error)
