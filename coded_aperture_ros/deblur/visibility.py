"""Visibility of the points of a scene through the aperture, past surfaces in front of them."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.core.compiled import Compiled

# A surface stops a ray to a point that is at least so much farther, px of blur size; less is a
# slant, or an error of the depth.
_IN_FRONT_PX = 0.5
# Neighbouring pixels of a surface differ by up to this: what they leave open is no gap.
_CLOSED_PX = 0.25
# Points that are less blurred are met by next to one ray: nothing is between.
_SHARP_PX = 0.3
NO_SURFACE = -1e9
_Scene = tuple[FloatArray, FloatArray, FloatArray, IndexArray, BoolArray]
_Place = tuple[float, int, int]


def quadrant_minimum(front: FloatArray, reach_px: int) -> FloatArray:
    """Smallest size within reach in each of the four quadrants [4, rows, columns].

    They are above left, above right, below left and below right.

    Where it is not below the size of a point of `front`, nothing is in front of that point.
    """
    square = np.ones((reach_px + 1,) * 2, np.uint8)
    corners = ((reach_px, reach_px), (0, reach_px), (reach_px, 0), (0, 0))
    return np.stack([cv2.erode(front, square, anchor=corner) for corner in corners])


def _loop(
    scene: _Scene, taps: FloatArray, offsets: IndexArray, place: _Place, weights: FloatArray
) -> None:
    (front, least, sizes, steps, edges), (nearest, top, margin) = scene, place
    count, rows, columns = weights.shape
    height, width = front.shape
    for k in range(count):
        down = offsets[k, 0]
        right = offsets[k, 1]
        length = max(abs(down), abs(right))
        one_pixel = 1 / max(length, 1)
        towards = 2 * (down > 0) + (right > 0)
        for y in range(rows):
            py = top + y + margin
            first_x = margin + right
            sizes_here = sizes[py + down][first_x : first_x + columns]
            steps_here = steps[py + down][first_x : first_x + columns]
            least_here = least[towards, py][margin : margin + columns]
            edges_here = edges[top + y]
            weights_here = weights[k, y]
            tap = taps[k]
            for x in range(columns):
                size = sizes_here[x]
                weights_here[x] = tap[steps_here[x]] if size > NO_SURFACE else 0
                if not edges_here[x] or weights_here[x] == 0:
                    continue
                if length == 0:
                    if front[py, x + margin] < size - _IN_FRONT_PX:
                        weights_here[x] = 0
                    continue
                if abs(size) < _SHARP_PX:
                    continue
                begin = int(np.floor(nearest / size * length))
                first = begin - 1
                last = length
                if begin > length:
                    first = length + 1
                    last = begin + 1
                elif begin >= 0 and least_here[x] >= size - _IN_FRONT_PX:
                    continue
                per_pixel = size * one_pixel
                half = abs(per_pixel) / 2 + _CLOSED_PX
                for i in range(first, last + 1):
                    yy = py + int(np.rint(down * (i * one_pixel)))
                    xx = x + margin + int(np.rint(right * (i * one_pixel)))
                    there = front[min(max(yy, 0), height - 1), min(max(xx, 0), width - 1)]
                    if there < size - _IN_FRONT_PX and abs(there - i * per_pixel) < half:
                        weights_here[x] = 0
                        break


def _plain(
    scene: _Scene, taps: FloatArray, offsets: IndexArray, place: _Place, weights: FloatArray
) -> None:
    # What is least saves the loop work.
    (front, _, sizes, steps, edges), (nearest, top, margin) = scene, place
    count, rows, columns = weights.shape
    height, width = front.shape
    py, px = np.mgrid[top + margin : top + margin + rows, margin : margin + columns]
    near_edges = edges[top : top + rows]
    for k in range(count):
        down, right = offsets[k]
        length = max(abs(down), abs(right))
        size = sizes[py + down, px + right]
        weight = np.where(size > NO_SURFACE, taps[k, steps[py + down, px + right]], 0)
        if length == 0:
            weight[near_edges & (front[py, px] < size - _IN_FRONT_PX)] = 0
            weights[k] = weight
            continue
        followed = (weight > 0) & near_edges & (np.abs(size) >= _SHARP_PX)
        begin = np.floor(nearest / np.where(followed, size, 1) * length)
        first = np.where(begin <= length, begin - 1, length + 1)
        last = np.where(begin <= length, length, begin + 1)
        if followed.any():
            per_pixel = size / length
            half = np.abs(per_pixel) / 2 + _CLOSED_PX
            for i in range(int(first[followed].min()), int(last[followed].max()) + 1):
                yy = np.clip(py + int(np.rint(down * (i / length))), 0, height - 1)
                xx = np.clip(px + int(np.rint(right * (i / length))), 0, width - 1)
                there = front[yy, xx]
                stopped = followed & (first <= i) & (i <= last) & (there < size - _IN_FRONT_PX)
                weight[stopped & (np.abs(there - i * per_pixel) < half)] = 0
        weights[k] = weight


# Writes the light that reaches each pixel of some rows from points at each offset [K, rows,
# columns]. The ray of pixel x that meets a point of blur size s at y is, where its distance from
# the surface in focus has blur size t, at ``x + t / s (y - x)``. A surface whose size there is t
# stops it.
#
# Of the scene, `front` has the size that every pixel shows, with a margin around the frame,
# `least` the `quadrant_minimum`, `sizes` those of the points, `NO_SURFACE` where there are none,
# `steps` the columns of `taps` [K, steps] for them, the light at each of the `offsets` [K, 2], and
# `edges` the pixels where rays are followed, from size `nearest` on [frame rows, columns]. The
# place has this size, the first row and the margin.
trace_visibility = Compiled(_loop, _plain)
