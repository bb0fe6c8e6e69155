"""Pictures in all layouts of their formats: read as stored, or refused by name."""

import io
import struct
import zlib

import cv2
import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import PixelFormat, decode_picture
from coded_aperture_ros.io import read_depth, read_image
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.sources import captures, open_files

tifffile = pytest.importorskip("tifffile")

RANDOM = np.random.default_rng(0)
LIGHT = RANDOM.random((50, 70, 3))
TURNED = [(274, "H", 1, 6, True)]


def stored(dtype):
    """Pixels of a type, and their values from 0 to 1."""
    white = 1 if np.dtype(dtype).kind == "f" else np.iinfo(dtype).max
    return (LIGHT * white).astype(dtype), white


def tiff(pixels, **options):
    file = io.BytesIO()
    tifffile.imwrite(file, pixels, **options)
    return file.getvalue()


def assert_read(data, expected, white):
    found = decode_picture(data)
    assert found.white == white
    np.testing.assert_array_equal(found.pixels, expected)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize(
    "layout",
    [
        {},
        {"byteorder": ">"},
        {"bigtiff": True, "byteorder": ">"},
        {"compression": "zlib"},
        {"compression": "zlib", "predictor": True},
        {"tile": (64, 64)},
        {"tile": (16, 32), "compression": "zlib"},
        {"rowsperstrip": 7},
    ],
    ids=str,
)
def test_layouts_of_tiff_are_read_as_stored(dtype, layout):
    if dtype == "float32" and "predictor" in layout:
        pytest.skip("tifffile writes it with imagecodecs only")
    pixels, white = stored(dtype)
    grey = np.ascontiguousarray(pixels[..., 1])
    planes = np.ascontiguousarray(np.moveaxis(pixels, -1, 0))
    turned = {**layout, "extratags": TURNED}
    assert_read(tiff(grey, photometric="minisblack", **turned), grey, white)
    assert_read(tiff(pixels, photometric="rgb", **turned), pixels, white)
    separate = tiff(planes, photometric="rgb", planarconfig="separate", **turned)
    assert_read(separate, pixels, white)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_orientation_of_tiff_is_ignored(orientation, dtype):
    pixels, white = stored(dtype)
    tags = [(274, "H", 1, orientation, True)]
    assert_read(tiff(pixels, photometric="rgb", extratags=tags), pixels, white)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_white_is_zero(dtype):
    pixels, white = stored(dtype)
    grey = pixels[..., 1].copy()
    assert_read(tiff(white - grey, photometric="miniswhite"), grey, white)
    open_cells = LIGHT[..., 0] < 0.5
    assert_read(tiff(~open_cells, photometric="miniswhite"), 255 * open_cells, 255)


@pytest.mark.parametrize("alpha", ["unassalpha", "assocalpha", "unspecified"])
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_alpha_does_not_change_colours(alpha, dtype, planar):
    pixels, white = stored(dtype)
    four = np.dstack([pixels, pixels[..., 0]])
    four = np.moveaxis(four, -1, 0).copy() if planar == "separate" else four
    data = tiff(four, photometric="rgb", extrasamples=[alpha], planarconfig=planar)
    assert_read(data, pixels, white)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda grey: tiff(np.stack([grey] * 3), photometric="minisblack"), "3 pages"),
        (lambda grey: tiff(np.stack([grey] * 3), imagej=True), "3 pages"),
        (lambda grey: tiff(np.stack([grey] * 4), volumetric=True, photometric=1), "4 pages"),
        (lambda grey: tiff(np.dstack([grey] * 4), photometric="separated"), "interpretation 5"),
        (lambda grey: tiff(grey, photometric="cfa"), "interpretation 32803"),
        (lambda grey: tiff(grey.astype(np.float16)), "floats of 16 bits"),
        (lambda grey: tiff(np.dstack([grey] * 2), planarconfig="contig", photometric=1), "alpha"),
        (lambda grey: tiff(grey)[:-500], "truncated"),
        (lambda grey: tiff(grey)[:100], "truncated"),
        (lambda grey: tiff(grey, compression="zlib")[:-500], "truncated"),
        (lambda grey: tiff(grey, subfiletype=1), "preview"),
    ],
)
def test_tiff_that_is_not_one_picture_is_refused(tmp_path, make, reason):
    grey = stored("uint16")[0][..., 1].copy()
    (tmp_path / "a.tif").write_bytes(make(grey))
    for read in (read_image, read_depth, Mask.from_file):
        with pytest.raises(InputError, match=rf"a\.tif: .*{reason}") as error:
            read(tmp_path / "a.tif")
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_damaged_compressed_tiff_is_refused(dtype):
    data = bytearray(tiff(stored(dtype)[0][..., 1].copy(), compression="zlib"))
    data[len(data) // 2 : len(data) // 2 + 20] = bytes(20)
    with pytest.raises(InputError, match="damaged"):
        decode_picture(bytes(data))


def test_tiff_with_a_smaller_version_behind_it_is_one_picture():
    grey = stored("uint16")[0][..., 1].copy()
    file = io.BytesIO()
    with tifffile.TiffWriter(file) as writer:
        writer.write(grey)
        writer.write(grey[::2, ::2].copy(), subfiletype=1)
    assert_read(file.getvalue(), grey, 65535)


def test_every_reader_takes_the_rows_and_columns_of_the_file(tmp_path):
    grey = stored("uint16")[0][..., 1].copy()
    path = tmp_path / "turned.tif"
    path.write_bytes(tiff(grey, extratags=TURNED))
    np.testing.assert_allclose(read_image(path), grey / 65535, atol=1e-6)
    np.testing.assert_allclose(read_depth(path), grey / 1000, rtol=1e-6)
    np.testing.assert_allclose(Mask.from_file(path).transmission, grey / 65535, atol=1e-6)
    (capture,) = captures(open_files(str(path)))
    np.testing.assert_array_equal(capture.frame, grey)


def netpbm(kind, pixels, white):
    """A file of one of the formats that `kind` names."""
    rows, columns = pixels.shape[:2]
    if kind in ("P2", "P3"):
        text = " ".join(map(str, pixels.ravel()))
        return f"{kind}\n# by hand\n{columns} {rows} # and more\n{white}\n{text}\n".encode()
    body = pixels.astype(np.uint8 if white < 256 else ">u2").tobytes()
    if kind == "P7":
        channels = 1 if pixels.ndim == 2 else pixels.shape[2]
        head = f"P7\n# c\nWIDTH {columns}\nHEIGHT {rows}\nDEPTH {channels}\nMAXVAL {white}\n"
        return f"{head}TUPLTYPE X\nENDHDR\n".encode() + body
    return f"{kind}\n# a comment\n{columns} {rows}\n{white}\n".encode() + body


@pytest.mark.parametrize("white", [1, 15, 100, 255, 256, 1023, 4095, 16383, 65535])
@pytest.mark.parametrize("kind", ["P2", "P3", "P5", "P6", "P7"])
def test_netpbm_has_a_white_of_its_own(tmp_path, kind, white):
    pixels = np.rint(LIGHT * white).astype(int)
    pixels = pixels[..., 1] if kind in ("P2", "P5") else pixels
    path = tmp_path / "a.pnm"
    path.write_bytes(netpbm(kind, pixels, white))
    # To a half of the step of 8 bits.
    np.testing.assert_allclose(
        read_image(path, 1.0), pixels / white, atol=2e-3 if white < 255 else 1e-6
    )
    # The option for sensors whose numbers are not scaled does not apply to a file that says so.
    (capture,) = captures(open_files(str(path)))
    light = capture.decode(PixelFormat(bits=12 if white == 4095 else 16)).light
    np.testing.assert_allclose(light, read_image(path, 1.0))


def test_depth_in_netpbm_and_pfm_keeps_its_numbers(tmp_path):
    pixels = np.rint(4000 * LIGHT[..., 1]).astype(int) + 1
    (tmp_path / "d.pgm").write_bytes(netpbm("P5", pixels, 4095))
    np.testing.assert_allclose(read_depth(tmp_path / "d.pgm"), pixels / 1000, rtol=1e-6)
    metres = (pixels / 1000).astype("<f4")
    (tmp_path / "d.pfm").write_bytes(b"Pf\n70 50\n-1.0\n" + metres[::-1].tobytes())
    np.testing.assert_array_equal(read_depth(tmp_path / "d.pfm"), metres)
    (tmp_path / "d.pfm").write_bytes(b"Pf\n70 50\n1.0\n" + metres[::-1].astype(">f4").tobytes())
    np.testing.assert_array_equal(read_depth(tmp_path / "d.pfm"), metres)


def test_bits_of_netpbm_are_black_where_they_are_1(tmp_path):
    cells = LIGHT[..., 0] < 0.5  # light
    packed = np.packbits(~cells, axis=1).tobytes()
    (tmp_path / "a.pbm").write_bytes(b"P4\n70 50\n" + packed)
    np.testing.assert_array_equal(read_image(tmp_path / "a.pbm"), cells)
    text = "".join("01"[not cell] for cell in cells.ravel())
    (tmp_path / "a.pbm").write_bytes(f"P1\n70 50\n{text}".encode())
    np.testing.assert_array_equal(Mask.from_file(tmp_path / "a.pbm").transmission, cells)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"P5\n4 4\n255\nabc", "ends before"),
        (b"P5\n4 4\n1023\n" + bytes(20), "ends before"),
        (b"P2\n2 2\n255\n1 2 3", "ends before"),
        (b"P4\n9 2\nabc", "ends before"),
        (b"Pf\n4 4\n-1\nabc", "ends before"),
        (b"P5\n2 1\n1023\n\xff\xff\0\0", "above the largest"),
        (b"P5\n2 1\n99999\n" + bytes(20), "largest value 99999"),
        (b"P5\n0 1\n255\n", "size"),
        (b"P5\n2", "header is damaged"),
        (b"P7\nWIDTH 2\nHEIGHT 2\n", "header is damaged"),
        (b"P7\nWIDTH 2\nHEIGHT 2\nDEPTH 7\nMAXVAL 1\nENDHDR\n", "7 channels"),
        (b"P7\nWIDTH 2\nDEPTH 1\nMAXVAL 1\nENDHDR\n", "HEIGHT"),
    ],
)
def test_damaged_netpbm_is_refused(tmp_path, data, reason):
    (tmp_path / "a.pgm").write_bytes(data)
    with pytest.raises(InputError, match=rf"a\.pgm: .*{reason}"):
        read_image(tmp_path / "a.pgm")


def png(kind, bits, rows, extra=b""):
    """A PNG of a colour type, of rows of bytes."""

    def chunk(name, content):
        check = zlib.crc32(name + content)
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", check)

    height, width = rows[0], rows[1]
    head = struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0)
    lines = b"".join(b"\0" + row for row in rows[2])
    data = chunk(b"IHDR", head) + extra + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + data, chunk


def test_kinds_of_png_are_read_as_stored():
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    palette = RANDOM.integers(0, 256, (256, 3), dtype=np.uint8)
    _, chunk = png(0, 8, (3, 4, [row.tobytes() for row in grey]))
    lookup = chunk(b"PLTE", palette.tobytes())
    see_through = lookup + chunk(b"tRNS", bytes(range(256)))
    for extra in (lookup, see_through):
        data, _ = png(3, 8, (3, 4, [row.tobytes() for row in grey]), extra)
        assert_read(data, palette[grey], 255)
    for dtype, bits in (("u1", 8), (">u2", 16)):
        white = 2**bits - 1
        with_alpha = np.dstack([grey, grey[::-1]]).astype(dtype)
        data, _ = png(4, bits, (3, 4, [row.tobytes() for row in with_alpha]))
        found = decode_picture(data)
        assert found.white == white
        assert (found.pixels == grey[..., None]).all()
        colours = np.dstack([grey, grey + 5, grey + 9, grey[::-1]]).astype(dtype)
        data, _ = png(6, bits, (3, 4, [row.tobytes() for row in colours]))
        assert_read(data, colours[..., :3], white)
    four_bits = np.array([[0x01, 0x2F], [0x3F, 0xF0]], np.uint8)
    data, _ = png(0, 4, (2, 4, [row.tobytes() for row in four_bits]))
    assert_read(data, np.array([[0, 17, 34, 255], [51, 255, 255, 0]]), 255)


@pytest.mark.parametrize(
    ("place", "value"),
    [(0, 0), (4, 0), (8, 0x03000000), (8, 0x10030000), (8, 0x08010000), (8, 0x04020000),
     (8, 0x08000100), (8, 0x08000001), (9, 0x00000002)],
    ids=["width", "height", "bits", "16 bits of a palette", "colour", "4 bits of RGB",
         "compression", "filter", "interlacing"],
)  # fmt: skip
def test_png_whose_header_is_none_is_refused(capfd, place, value):
    """By us: libpng would print lines of its own."""
    data = bytearray(png(0, 8, (1, 1, [b"\7"]))[0])
    struct.pack_into(">I", data, 16 + place, value)
    struct.pack_into(">I", data, 29, zlib.crc32(data[12:29]))
    with pytest.raises(InputError, match="header of the PNG"):
        decode_picture(bytes(data))
    assert capfd.readouterr().err == ""


def test_png_whose_data_are_damaged_is_refused():
    data = bytearray(cv2.imencode(".png", (255 * LIGHT).astype(np.uint8))[1].tobytes())
    data[len(data) // 2] ^= 1
    with pytest.raises(InputError, match="checksum"):
        decode_picture(bytes(data))


def test_animations_are_refused():
    rows = (1, 1, [b"\7"])
    _, chunk = png(0, 8, rows)
    data, _ = png(0, 8, rows, chunk(b"acTL", struct.pack(">II", 2, 0)))
    with pytest.raises(InputError, match="several frames"):
        decode_picture(data)
    for data in (b"GIF89a" + bytes(40), b"RIFF\0\0\0\0WEBPVP8X" + bytes(14) + b"ANIM" + bytes(20)):
        with pytest.raises(InputError, match="animation"):
            decode_picture(data)


def test_no_directory_of_tiff_is_too_damaged():
    """Refused or read, whatever its tags say."""
    random = np.random.default_rng(5)
    small = stored("uint16")[0][:12, :16]
    planes = np.moveaxis(small, -1, 0).copy()
    kinds = [
        tiff(small, photometric="rgb"),
        tiff(planes, photometric="rgb", planarconfig="separate"),
        tiff(small[..., 0].copy(), compression="zlib", bigtiff=True),
    ]
    refused = 0
    for _ in range(1500):
        data = bytearray(kinds[random.integers(3)])
        for at in random.integers(4, 260, 3):
            data[at] = random.choice([0, 1, 2, 3, 255, random.integers(256)])
        try:
            assert decode_picture(bytes(data)).pixels.size
        except InputError as error:
            refused += 1
            assert "\n" not in str(error)
    assert 300 < refused < 1450
