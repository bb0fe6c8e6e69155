"""Point clouds on disk (PLY), as Open3D, PCL, CloudCompare and MeshLab read them."""

import os

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.files import atomic_output

_FIELDS = [
    *((name, "<f4") for name in ("x", "y", "z")),
    *((name, "u1") for name in ("red", "green", "blue")),
    *((name, "<f4") for name in ("confidence", "std_dev")),
]


def write_points(path: str | os.PathLike[str], points: FloatArray) -> None:
    """Write the known ones of the points of `points_of_depth` to a binary PLY file."""
    known = points[np.isfinite(points[..., 2])]
    rows = np.empty(len(known), _FIELDS)
    packed = np.ascontiguousarray(known[:, 3]).view(np.uint32)
    for index, name in ((0, "x"), (1, "y"), (2, "z"), (4, "confidence"), (5, "std_dev")):
        rows[name] = known[:, index]
    for name, shift in (("red", 16), ("green", 8), ("blue", 0)):
        rows[name] = packed >> shift & 255
    types = {"<f4": "float", "u1": "uchar"}
    properties = [f"property {types[kind]} {name}" for name, kind in _FIELDS]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *properties]
    with atomic_output(path) as temporary:
        text = "\n".join([*header, "end_header", ""])
        temporary.write_bytes(text.encode() + rows.tobytes())
