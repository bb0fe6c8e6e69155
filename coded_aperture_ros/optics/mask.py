"""Aperture masks: patterns with names, and masks from picture or array files."""

import dataclasses
import difflib
import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.array_file import read_array
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.input_file import read_bytes
from coded_aperture_ros.frames import decode_picture

# Largest side in cells: finer than any lens shows, and a picture of a mask may be a large scan.
_MAX_CELLS = 4096
# Of a file: all cells as 64-bit floats.
_LARGEST_BYTES = 2**27 + 2**16
_LEVIN = """
00110101100 00000100000 11000000011 01001110010 10000100001 10011111001
10000100001 01001110010 11000000011 00000100000 00110101100
"""
_VEERARAGHAVAN = "0100001 0011001 0000001 1011000 0111000 0110101 1001101"
_ZHOU = """
00011101100 00011100110 11111101111 11111100111 11111000111 11111000011
11111000011 10001000000 00001000000 01111111110 00011111100
"""
# Found by searching for the smallest predicted errors of depth and deblurring, see docs/masks.md.
_FOUR_WIDE = """
11110001111 10010001111 10110001101 11110001011 00000000000 00000000000
00000000000 11110000111 11110000011 11110001001 11110001111
"""
# Found likewise, with the side of the focal plane as a third criterion.
_THREE_WIDE = "0000111 0000111 0000111 0000000 1110111 1110111 1110111"
_MURA_PRIME = 13
# The holes are 4/17 of the extent wide; half cells are needed to centre one of them.
_HOLE_GRID = 34
_HOLE_SIDE = 8
# Curved outlines are stored as coverage on a grid fine enough that a cell stays below half a
# pixel up to blur sizes of 48 px.
_CURVE_GRID = 96
_CURVE_SUPERSAMPLING = 16


@dataclasses.dataclass(frozen=True, eq=False)
class Mask:
    """Pattern of an aperture.

    Parameters
    ----------
    name : str
        One of `MASK_NAMES`, or the name of the file that the mask came from.
    transmission : array_like of float, shape [n, m]
        Fraction of the light that each square cell lets through, 0 to 1; row 0 is the top. The
        longer side of the grid spans the mask's extent. Kept as float32, read-only.

    Raises
    ------
    InputError
        If the grid is not two-dimensional, a value is outside 0 to 1, or no cell is open.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> mask = Mask.named("levin")
    >>> mask.transmission.shape, round(mask.open_fraction, 3)
    ((11, 11), 0.355)
    >>> Mask.from_rows(["#.", "##"]).open_fraction
    0.75
    """

    name: str
    transmission: FloatArray

    def __post_init__(self) -> None:
        grid = np.array(self.transmission, dtype=np.float32)
        if grid.ndim != 2 or grid.size == 0:
            raise InputError(
                f"mask {self.name}: expected a grid of rows and columns, got shape {grid.shape}"
            )
        if not (np.isfinite(grid).all() and grid.min() >= 0.0 and grid.max() <= 1.0):
            raise InputError(f"mask {self.name}: transmissions must lie between 0 and 1")
        if not grid.any():
            raise InputError(f"mask {self.name}: no cell is open, so no light passes")
        grid.setflags(write=False)
        object.__setattr__(self, "transmission", grid)

    @property
    def open_fraction(self) -> float:
        """Open area over the area of the square that bounds the mask's grid, 0 to 1."""
        return float(self.transmission.sum(dtype=np.float64)) / max(self.transmission.shape) ** 2

    @property
    def asymmetry(self) -> float:
        """Difference between the mask and itself turned by 180 degrees, 0 (equal) to 1 (disjoint).

        Share of the open area that is closed in the turned mask. At 0 the blur is the same before
        and behind the focal plane, and the side cannot be told.
        """
        grid = self.transmission.astype(np.float64)
        return float(np.abs(grid - grid[::-1, ::-1]).sum() / (2 * grid.sum()))

    @property
    def digest(self) -> str:
        """Hash of the pattern (SHA-256, hexadecimal), equal for equal masks."""
        shape = "x".join(str(length) for length in self.transmission.shape)
        return hashlib.sha256(shape.encode() + self.transmission.tobytes()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mask) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    @staticmethod
    def named(name: str) -> "Mask":
        """Mask of a name in `MASK_NAMES`; raises `InputError` for another name."""
        if name not in _BUILDERS:
            close = difflib.get_close_matches(str(name), MASK_NAMES, 1)
            hint = f"did you mean {close[0]}? " if close else ""
            raise InputError(f"unknown mask {name!r}: {hint}use one of {', '.join(MASK_NAMES)}")
        return Mask(name, _BUILDERS[name]())

    @staticmethod
    def from_rows(rows: ArrayLike, name: str = "rows") -> "Mask":
        """Mask from strings, top row first; `1` and `#` are open, all else is closed."""
        lines = [str(row) for row in np.atleast_1d(np.asarray(rows))]
        if len({len(line) for line in lines}) != 1:
            raise InputError(f"mask {name}: all rows must have the same length")
        return Mask(name, np.array([[cell in "1#" for cell in line] for line in lines]))

    @staticmethod
    def from_file(path: str | os.PathLike[str]) -> "Mask":
        """Mask from a picture (white is open) or from a two-dimensional `.npy` array.

        Raises
        ------
        InputError
            If the file is missing, neither of them, or has values outside 0 to 1.
        """
        path = Path(path)
        data = read_bytes(path, f"mask {path}", _LARGEST_BYTES)
        if path.suffix.lower() == ".npy":
            return Mask(path.name, _array_of(path, data))
        with naming(f"cannot read mask {path}"):
            stored = decode_picture(data)
        picture: Any = stored.pixels
        if picture.ndim == 3:
            picture = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        if max(picture.shape) > _MAX_CELLS:
            raise InputError(
                f"cannot read mask {path}: {picture.shape[1]}x{picture.shape[0]} cells, "
                f"at most {_MAX_CELLS} a side: make the picture smaller"
            )
        if picture.dtype.kind == "u":
            picture = picture / np.float32(stored.white)
        return Mask(path.name, picture)


def _array_of(path: Path, data: bytes) -> FloatArray:
    try:
        return np.asarray(read_array(data), dtype=np.float32)
    except (ValueError, TypeError) as error:
        raise InputError(f"cannot read mask {path}: not a numeric .npy array") from error


def _grid(rows: str) -> FloatArray:
    return np.array([[float(cell) for cell in row] for row in rows.split()], dtype=np.float32)


def _square_holes(corners: list[tuple[int, int]]) -> FloatArray:
    grid = np.zeros((_HOLE_GRID, _HOLE_GRID), dtype=np.float32)
    for row, column in corners:
        grid[row : row + _HOLE_SIDE, column : column + _HOLE_SIDE] = 1.0
    return grid


def _ring(inner_radius: float) -> FloatArray:
    """Coverage of a ring with outer radius 1, on a square grid that just holds it."""
    fine = _CURVE_GRID * _CURVE_SUPERSAMPLING
    x = (np.arange(fine) + 0.5) / fine * 2.0 - 1.0
    squared_radius = x[:, None] ** 2 + x[None, :] ** 2
    inside = (squared_radius <= 1.0) & (squared_radius >= inner_radius**2)
    blocks = inside.reshape(_CURVE_GRID, _CURVE_SUPERSAMPLING, _CURVE_GRID, _CURVE_SUPERSAMPLING)
    return blocks.mean(axis=(1, 3), dtype=np.float32)


def _mura() -> FloatArray:
    """Modified uniformly redundant array, by the quadratic-residue rule."""
    p = _MURA_PRIME
    residues = {i * i % p for i in range(1, p)}
    sign = np.array([1 if i in residues else -1 for i in range(p)])
    grid = (np.outer(sign, sign) == 1).astype(np.float32)
    grid[:, 0] = 1.0
    grid[0, :] = 0.0
    return grid


# First cells of a hole in the middle and at the end of the grid.
_MIDDLE = (_HOLE_GRID - _HOLE_SIDE) // 2
_END = _HOLE_GRID - _HOLE_SIDE
_BUILDERS: dict[str, Callable[[], FloatArray]] = {
    "levin": lambda: _grid(_LEVIN),
    "two_hole": lambda: _square_holes([(_MIDDLE, 0), (_MIDDLE, _END)]),
    "three_hole": lambda: _square_holes([(0, _MIDDLE), (_END, 0), (_END, _END)]),
    "four_hole": lambda: _square_holes([(0, 0), (0, _END), (_END, 0), (_END, _END)]),
    "annulus": lambda: _ring(0.75),
    "veeraraghavan": lambda: _grid(_VEERARAGHAVAN),
    "zhou": lambda: _grid(_ZHOU),
    "mura": _mura,
    "disc": lambda: _ring(0.0),
    "four_wide": lambda: _grid(_FOUR_WIDE),
    "three_wide": lambda: _grid(_THREE_WIDE),
}
MASK_NAMES = tuple(_BUILDERS)


def load_mask(name: str) -> Mask:
    """Mask of a name of `MASK_NAMES`, or else of a file; an `InputError` if neither.

    Examples
    --------
    >>> load_mask("zhou").transmission.shape
    (11, 11)
    """
    if name not in MASK_NAMES and Path(name).exists():
        return Mask.from_file(name)
    try:
        return Mask.named(name)
    except InputError as error:
        raise InputError(f"{error}, or a file") from error
