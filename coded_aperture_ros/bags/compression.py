"""Decompression of what is in bags: a few bytes may stand for more than there is memory or disk."""

import zlib
from collections.abc import Callable
from importlib import import_module
from typing import Any

from coded_aperture_ros.bags.damage import zstd

# What rosbags itself depends on, as `zstd`.
_lz4: Any = import_module("lz4.frame")
# A message, or a chunk of messages, unpacked. Recorders make chunks of a megabyte.
LARGEST_UNPACKED_BYTES = 2**28
# All that a file holds, unpacked: so many bytes, and so many for each of its own. Frames without
# any light come to a few hundred, bombs to 20,000.
_UNPACKED_BYTES = 2**28
_LARGEST_RATIO = 1000
_NEW_DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": zstd.ZstdDecompressor,
    "lz4": _lz4.LZ4FrameDecompressor,
}


def most_unpacked(size: int) -> int:
    """Number of bytes that a compressed file of so many bytes may unpack to."""
    return _UNPACKED_BYTES + _LARGEST_RATIO * size


def unpacked(data: bytes | memoryview, kind: str, most: int = LARGEST_UNPACKED_BYTES) -> bytes:
    """Decompressed data of one frame or several.

    Parameters
    ----------
    data : bytes
    kind : str
        ``zstd`` or ``lz4``.
    most : int
        Bytes that may come.

    Raises
    ------
    ValueError
        If there would be more, or the data are cut off; other errors of `DAMAGE` if damaged.

    Examples
    --------
    >>> unpacked(zstd.compress(bytes(10**6)), "zstd", 1000)
    Traceback (most recent call last):
    ...
    ValueError: it unpacks to more than 1000 bytes
    """
    parts: list[bytes] = []
    left = most + 1
    while data:
        decompressor = _NEW_DECOMPRESSORS[kind]()
        while not decompressor.eof:
            part = decompressor.decompress(data, max_length=left)
            data = b""
            left -= len(part)
            parts.append(part)
            if left <= 0:
                raise ValueError(f"it unpacks to more than {most} bytes")
            if not part and not decompressor.eof:
                raise ValueError("compressed data are cut off")
        data = decompressor.unused_data or b""
    return parts[0] if len(parts) == 1 else b"".join(parts)


def unpacked_chunk(data: memoryview, kind: str, size: int, checksum: int) -> bytes | memoryview:
    """Content of a chunk of an MCAP file; a `ValueError` if it is not what its header says."""
    if size > LARGEST_UNPACKED_BYTES:
        raise ValueError(f"a chunk of {size} bytes, expected at most {LARGEST_UNPACKED_BYTES}")
    if kind and kind not in _NEW_DECOMPRESSORS:
        raise ValueError("a compression that is not supported")
    content = unpacked(data, kind, size) if kind else data
    if len(content) != size:
        raise ValueError(f"a chunk of {len(content)} bytes, its header says {size}")
    if checksum and zlib.crc32(content) != checksum:
        raise ValueError("the checksum of a chunk is wrong")
    return content
