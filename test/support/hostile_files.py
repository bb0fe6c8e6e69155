"""Files that a stranger may send: small ones that stand for more than there is memory or disk."""

import io
import sqlite3
import struct
import zipfile
import zlib
from binascii import crc32

import lz4.frame
import numpy as np
from backports import zstd

MAGIC = b"\x89MCAP0\r\n"
TABLES = (
    "CREATE TABLE {}topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
    "serialization_format TEXT, offered_qos_profiles TEXT)",
    "CREATE TABLE {}messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
    "data BLOB)",
    "INSERT INTO topics VALUES (1, '/image_raw', 'sensor_msgs/msg/Image', 'cdr', '')",
)
# Rows without an end.
COUNTING = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "


def png(width, height, rows=b"", depth=8, colour=0, before=b""):
    """Content of a PNG of a declared size, with few rows or none."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))
    pixels = chunk(b"IDAT", zlib.compress(rows, 9))
    return b"\x89PNG\r\n\x1a\n" + head + before + pixels + chunk(b"IEND", b"")


def jpeg(width, height, kind=0xC0, scans=1):
    """Content of a JPEG whose header declares a size."""
    frame = struct.pack(">BHHB", 8, height, width, 1) + b"\x01\x11\0"
    segments = b"\xff" + bytes([kind]) + struct.pack(">H", len(frame) + 2) + frame
    scan = b"\xff\xda\0\x08\x01\x01\0\0\x3f\0" + bytes(4)
    return b"\xff\xd8" + segments + scan * scans + b"\xff\xd9"


def tiff(tags, data=b"", at=None):
    """Content of a TIFF of tags with one number each, and where its pixels are."""
    entries = sorted({**tags}.items())
    start = 8 + len(data)
    table = struct.pack("<H", len(entries))
    for tag, value in entries:
        table += struct.pack("<HHII", tag, 4, 1, value)
    return b"II*\0" + struct.pack("<I", start) + data + table + struct.pack("<I", at or 0)


def tiff_picture(width, height, **more):
    """Tags of a grey TIFF picture of 8 bits."""
    tags = {256: width, 257: height, 258: 8, 259: 1, 262: 1, 273: 8, 277: 1, 278: height, 279: 4}
    return tags | {int(tag[1:]): value for tag, value in more.items()}


def npy(shape, dtype="<f8", data=b""):
    """Content of an array file whose header declares a shape."""
    header = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {shape!r}}}".encode()
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(header) + 1) + header + b"\n" + data


def npz(compression=zipfile.ZIP_DEFLATED, **members):
    """Content of an archive of members."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", compression) as archive:
        for name, member in members.items():
            archive.writestr(f"{name}.npy", member)
    return content.getvalue()


def array(value):
    """Content of a sound array file."""
    content = io.BytesIO()
    np.save(content, value)
    return content.getvalue()


def record(kind, content):
    """Record of an MCAP file."""
    return struct.pack("<BQ", kind, len(content)) + content


def text(words):
    """Text of an MCAP file."""
    return struct.pack("<I", len(words)) + words.encode()


def mcap(*records):
    """Content of an MCAP file without a summary."""
    return MAGIC + record(1, text("ros2") + text("x")) + b"".join(records)


def chunk(packed, size, compression="zstd", declared=None):
    """Chunk of an MCAP file, with the sizes that it declares."""
    head = struct.pack("<QQQI", 0, 0, size, 0) + text(compression)
    length = len(packed) if declared is None else declared
    return record(6, head + struct.pack("<Q", length) + packed)


def zeros(size, kind=zstd):
    """Compressed zeros; those of zstd do not say how many."""
    if kind is lz4.frame:
        return lz4.frame.compress(bytes(size))
    packer = zstd.ZstdCompressor()
    block = bytes(2**22)
    parts = [packer.compress(block) for _ in range(size // len(block))]
    return b"".join([*parts, packer.flush()])


def sqlite(path, *statements):
    """Write an SQLite file."""
    database = sqlite3.connect(path)
    for statement in statements:
        database.execute(statement)
    database.commit()
    database.close()


def circle(path):
    """SQLite file whose table of messages is a tree of pages that are in each other."""
    sqlite(path, *(each.format("") for each in TABLES))
    database = sqlite3.connect(path)
    rows = ((bytes(500),) for _ in range(2000))
    database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 1, ?)", rows)
    database.commit()
    (root,) = database.execute(
        "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
    ).fetchone()
    (size,) = database.execute("PRAGMA page_size").fetchone()
    database.close()
    data = bytearray(path.read_bytes())
    start = (root - 1) * size
    (cells,) = struct.unpack_from(">H", data, start + 3)
    children = [struct.unpack_from(">H", data, start + 12 + 2 * cell)[0] for cell in range(cells)]
    (leaf,) = struct.unpack_from(">I", data, start + children[0])
    # A copy of the root takes the place of a leaf, so that a branch leads to itself.
    data[(leaf - 1) * size : leaf * size] = data[start : start + size]
    for at in children:
        struct.pack_into(">I", data, (leaf - 1) * size + at, leaf)
        struct.pack_into(">I", data, start + at, leaf)
    path.write_bytes(data)
