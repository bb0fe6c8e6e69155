"""Equations for the motion between two frames by NumPy, where there is no numba."""

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray

# Standard deviation of a found point, px.
POINT_PX = 0.1
# Normalised error from which points count less.
ROBUST = 3.0
LEAST_DEPTH = 1e-3
# Rays [n, 2], inverse depth [n] and its variance [n] of points in the first view.
Points = tuple[DoubleArray, DoubleArray, DoubleArray]
# Focal length and principal point, column and row, px.
Pair = tuple[float, float]


def add_equations_plain(
    points: Points,
    pixels: DoubleArray,
    view: tuple[Pair, Pair],
    matrix: DoubleArray,
    found: tuple[DoubleArray, DoubleArray],
) -> None:
    """Form of `add_equations` for NumPy."""
    (rays, inverse, variance), focal_px, (squares, system) = points, np.array(view[0]), found
    rays = np.column_stack([rays, np.ones(len(inverse))])
    x, y, z = (rays @ matrix[:3, :3].T + inverse[:, None] * matrix[:3, 3]).T
    z = np.maximum(z, LEAST_DEPTH)
    x, y = x / z, y / z
    zero, one = np.zeros_like(x), np.ones_like(x)
    # Of the pixel by the point, times its depth; then by translation and rotation.
    by_point = np.array([[one, zero, -x], [zero, one, -y]]) * focal_px[:, None, None]  # [2, 3, n]
    by_turn = np.array([[-x * y, 1 + x * x, -y], [-1 - y * y, x * y, x]])
    by_motion = np.concatenate([by_point * (inverse / z), by_turn * focal_px[:, None, None]], 1)
    along = np.einsum("ain,i->an", by_point, matrix[:3, 3]) / z
    length = np.hypot(*along)
    across = np.divide(along, length, out=np.stack([one, zero]), where=length > 0)
    axes = np.array([across, [-across[1], across[0]]])  # [2 axes, 2, n]
    deviations = np.sqrt(POINT_PX**2 + np.stack([variance * length**2, zero]))
    axes = axes / deviations[:, None]
    errors = pixels.T - (np.stack([x, y]) * focal_px[:, None] + np.array(view[1])[:, None])
    normalised = (axes * errors).sum(1).T  # [n, 2 axes]
    slopes = (axes[:, :, None] * by_motion).sum(1).transpose(2, 0, 1)  # [n, 2 axes, 6]
    squares[:] = np.square(normalised).sum(axis=1)
    # Outliers count less (Cauchy's weights).
    weights = 1 / np.sqrt(1 + squares / ROBUST**2)
    slopes = np.ascontiguousarray(slopes * weights[:, None, None]).reshape(-1, 6)
    system[:6] = slopes.T @ slopes
    system[6] = slopes.T @ (normalised * weights[:, None]).ravel()
