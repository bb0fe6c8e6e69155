"""What readers raise when they meet a file that is damaged."""

import sqlite3
import struct
import sys
from importlib import import_module
from typing import Any

from rosbags.rosbag2 import ReaderError

# What rosbags itself depends on.
_apsw: Any = import_module("apsw")
_zstd: Any = import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")

# A computer that lost its power can leave behind anything for a reader to stumble over.
DAMAGE: tuple[type[BaseException], ...] = (
    *(ReaderError, OSError, sqlite3.Error, _apsw.Error, struct.error, _zstd.ZstdError),
    *(ValueError, TypeError, KeyError, IndexError, EOFError, AssertionError, RuntimeError),
)


def in_a_line(error: BaseException) -> str:
    """Return what an error says, or at least its name."""
    return " ".join(str(error).split()) or type(error).__name__
