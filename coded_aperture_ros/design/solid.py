"""Solids that a 3-D printer builds up from its bed: triangulation and STL files.

Every solid stands on the plane z = 0, and its height is a function of (x, y): nothing hangs over.
"""

import dataclasses
import math

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, IndexArray

# Corners of a circle; divisible by four, so that the width is the diameter.
CIRCLE_CORNERS = 360
# Of a binary STL file: a header, the number of triangles, and each with its normal.
_HEADER_BYTES = 80
_TRIANGLE = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")], align=False
)


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """Closed surface of triangles."""

    vertices: DoubleArray  # [n, 3], mm
    faces: IndexArray  # [m, 3], anticlockwise as seen from outside


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """Heights over the triangles of a plane; triangles share their corners' indices."""

    points: DoubleArray  # [n, 2], mm
    triangles: IndexArray  # [m, 3], anticlockwise
    heights: DoubleArray  # [m], mm; 0 is open


def circle(diameter_mm: float, notch_mm: float = 0.0) -> DoubleArray:
    """Corners [n, 2] of a circle, anticlockwise from the right, with a notch at the top.

    The notch is as deep as half of its width.
    """
    corners = np.arange(CIRCLE_CORNERS)
    angles = 2 * math.pi * corners / CIRCLE_CORNERS
    beside_mm = np.abs(angles - math.pi / 2) * diameter_mm / 2
    radii = diameter_mm / 2 - np.maximum(notch_mm - beside_mm, 0)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)


def triangles_between(inner: DoubleArray, outer: DoubleArray) -> IndexArray:
    """Triangles [n, 3] that fill the ring between two loops around the origin.

    Parameters
    ----------
    inner, outer : ndarray [n, 2], [m, 2]
        Corners of the loops, anticlockwise, the inner one convex. Corners of the outer one have the
        indices that follow those of the inner one.

    Returns
    -------
    ndarray, int [n + m, 3]
        Indices of corners, anticlockwise.

    Examples
    --------
    >>> square = np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    >>> len(triangles_between(square, circle(4.0)))
    364
    """
    order = [_by_angle(loop) for loop in (inner, outer)]
    counts = [len(inner), len(outer)]
    done = [0, 0]
    triangles = []
    while done != counts:
        here = [order[k][0][done[k] % counts[k]] + k * counts[0] for k in (0, 1)]
        # Whichever loop's next corner comes first in angle.
        after = [order[k][1][done[k] + 1] if done[k] < counts[k] else np.inf for k in (0, 1)]
        loop = 0 if after[0] <= after[1] else 1
        done[loop] += 1
        corner = order[loop][0][done[loop] % counts[loop]] + loop * counts[0]
        triangles.append((here[0], here[1], corner))
    return np.array(triangles, dtype=np.intp)


def _by_angle(loop: DoubleArray) -> tuple[IndexArray, DoubleArray]:
    """Indices of a loop's corners by angle, and the angles, with the first one after a turn."""
    angles = np.arctan2(loop[:, 1], loop[:, 0]) % (2 * math.pi)
    order = np.argsort(angles)
    return order, np.append(angles[order], angles[order[0]] + 2 * math.pi)


def solid(plan: Plan) -> Mesh:
    """Solid that stands on z = 0 and is as high as the plan says.

    Examples
    --------
    >>> triangle = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    >>> wedge = solid(Plan(triangle, np.array([[0, 1, 2]]), np.array([2.0])))
    >>> wedge.vertices.shape, wedge.faces.shape
    ((6, 3), (8, 3))
    """
    levels, tops = np.unique(np.append(plan.heights, 0.0), return_inverse=True)
    tops = tops[:-1]
    count = len(plan.points)
    built = tops > 0
    above = plan.triangles[built] + count * tops[built, None]
    below = plan.triangles[built][:, ::-1]
    starts, ends, high, low = _steps(plan.triangles, tops, count)
    faces = [above, below]
    # A wall is cut at every level between its ends, as the walls beside it are.
    for level in range(len(levels) - 1):
        here = (low <= level) & (level < high)
        a, b = starts[here] + count * level, ends[here] + count * level
        faces += [np.stack([a, b, b + count], axis=1), np.stack([a, b + count, a + count], axis=1)]
    used, numbered = np.unique(np.concatenate(faces), return_inverse=True)
    vertices = np.column_stack([plan.points[used % count], levels[used // count]])
    return Mesh(vertices, numbered.reshape(-1, 3).astype(np.intp))


def _steps(
    triangles: IndexArray, tops: IndexArray, count: int
) -> tuple[IndexArray, IndexArray, IndexArray, IndexArray]:
    """Edges [n] where a triangle is higher than its neighbour: start, end, both levels.

    Seen from the higher one they run anticlockwise.
    """
    starts = triangles.ravel()
    ends = np.roll(triangles, -1, axis=1).ravel()
    high = np.repeat(tops, 3)
    key = starts * count + ends
    order = np.argsort(key)
    reverse = ends * count + starts
    at = np.minimum(np.searchsorted(key[order], reverse), len(key) - 1)
    has_neighbour = key[order][at] == reverse
    low = np.where(has_neighbour, high[order][at], 0)
    step = high > low
    return starts[step], ends[step], high[step], low[step]


def stl(mesh: Mesh, title: str) -> bytes:
    """Bytes of a binary STL file, in mm; `title` goes into its header."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    triangles = np.zeros(len(corners), _TRIANGLE)
    triangles["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    triangles["corners"] = corners
    # A header that began with "solid" would be taken for a text file.
    header = f"mm; {title}".encode("ascii", "replace")[:_HEADER_BYTES].ljust(_HEADER_BYTES)
    return header + np.uint32(len(corners)).astype("<u4").tobytes() + triangles.tobytes()
