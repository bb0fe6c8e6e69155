"""Files of a camera's poses, one a line, as the TUM benchmark has them."""

import os
from pathlib import Path

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.messages import Transforms

_WORLD, _CAMERA, _SECOND_NS = "world", "camera", 1e9
_FORMAT = "expected lines of time in s, x y z in m, and qx qy qz qw"


class PoseFile:
    r"""Poses of a camera's optical frame in a fixed one.

    Parameters
    ----------
    path : str or path
        Text; empty lines, and those that begin with #, are left out.

    Attributes
    ----------
    stamps_ns : ndarray, int64 [n]
        Times in order.

    Raises
    ------
    InputError
        If it cannot be read, or has a line that is no pose, or times that do not grow.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "way.txt")
    ...     _ = path.write_text("0.0 0 0 0 0 0 0 1\n0.1 0.02 0 0 0 0 0 1\n")
    ...     poses = PoseFile(path)
    >>> poses.at(50_000_000)[:3, 3].tolist()
    [0.01, 0.0, 0.0]
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = path
        self._transforms = Transforms(np.inf)
        stamps = []
        for number, line in self._lines():
            try:
                values = np.array(line.split(), np.float64)
            except ValueError:
                values = np.zeros(0)
            length = float(np.linalg.norm(values[4:]))
            if len(values) != 8 or not np.isfinite(values).all() or not 0.9 < length < 1.1:
                raise InputError(f"{path}, line {number}: no pose, {_FORMAT}: {line[:60]}")
            stamps.append(round(values[0] * _SECOND_NS))
            if len(stamps) > 1 and stamps[-1] <= stamps[-2]:
                raise InputError(f"{path}, line {number}: its time is not after the line before")
            self._transforms.keep(_WORLD, _CAMERA, stamps[-1], [*values[1:4]], [*values[4:]])
        if not stamps:
            raise InputError(f"{path}: no poses, {_FORMAT}")
        self.stamps_ns = np.array(stamps, np.int64)

    def at(self, stamp_ns: int) -> DoubleArray:
        """Pose [4, 4] at a time, interpolated; an `InputError` if the file ends before it."""
        first, last = self.stamps_ns[[0, -1]]
        pose = self._transforms.pose(_WORLD, _CAMERA, stamp_ns) if stamp_ns <= last else None
        if pose is None:
            raise InputError(
                f"{self.path}: no pose at {stamp_ns / _SECOND_NS:.3f} s, it has those from "
                f"{first / _SECOND_NS:.3f} to {last / _SECOND_NS:.3f} s"
            )
        return pose

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.stamps_ns)

    def _lines(self) -> list[tuple[int, str]]:
        try:
            lines = Path(self.path).read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot read {self.path}: {error}") from error
        return [
            (n, line)
            for n, line in enumerate(lines, 1)
            if line.strip() and not line.startswith("#")
        ]
