"""Errors that damaged files of bags raise."""

import sqlite3
import struct
import sys
from importlib import import_module
from typing import Any

from rosbags.rosbag2 import ReaderError

from coded_aperture_ros.core.text import shortened

# What rosbags itself depends on.
zstd: Any = import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")

# What reading raises for files that a computer left behind when it lost its power.
DAMAGE: tuple[type[BaseException], ...] = (
    ReaderError,
    OSError,
    sqlite3.Error,
    struct.error,
    zstd.ZstdError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    EOFError,
    AssertionError,
    RuntimeError,
    # Numbers that nobody wrote, such as lengths.
    MemoryError,
    OverflowError,
)


# Characters of what a library says of a file.
_LONGEST_MESSAGE = 200


def one_line(error: BaseException) -> str:
    """Message of an error in one line, or else its name."""
    return shortened(str(error), _LONGEST_MESSAGE) or type(error).__name__
