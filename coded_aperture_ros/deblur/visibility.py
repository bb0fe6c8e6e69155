"""Which points of a scene each part of the aperture sees, past what is in front of them."""

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
NOTHING = -1e9


def _loop(
    front: FloatArray,
    sizes: FloatArray,
    steps: IndexArray,
    taps: FloatArray,
    offsets: IndexArray,
    edges: BoolArray,
    nearest: float,
    top: int,
    margin: int,
    weights: FloatArray,
) -> None:
    count, rows, columns = weights.shape
    height, width = front.shape
    for k in range(count):
        down, right = offsets[k, 0], offsets[k, 1]
        length = max(abs(down), abs(right))
        for y in range(rows):
            for x in range(columns):
                py, px = top + y + margin, x + margin
                size = sizes[py + down, px + right]
                weight = taps[k, steps[py + down, px + right]] if size > NOTHING else 0.0
                if weight > 0 and edges[top + y, x]:
                    if length == 0:
                        if front[py, px] < size - _IN_FRONT_PX:
                            weight = 0.0
                    elif abs(size) >= _SHARP_PX:
                        begin = int(np.floor(nearest / size * length))
                        first = min(begin, 0) if begin <= length else length + 1
                        last = length if begin <= length else begin + 1
                        for i in range(first, last + 1):
                            yy = min(max(py + int(np.rint(down * i / length)), 0), height - 1)
                            xx = min(max(px + int(np.rint(right * i / length)), 0), width - 1)
                            there = front[yy, xx]
                            one, other = (i - 0.5) * size / length, (i + 0.5) * size / length
                            if (
                                there < size - _IN_FRONT_PX
                                and there > min(one, other) - _CLOSED_PX
                                and there < max(one, other) + _CLOSED_PX
                            ):
                                weight = 0.0
                                break
                weights[k, y, x] = weight


def _plain(
    front: FloatArray,
    sizes: FloatArray,
    steps: IndexArray,
    taps: FloatArray,
    offsets: IndexArray,
    edges: BoolArray,
    nearest: float,
    top: int,
    margin: int,
    weights: FloatArray,
) -> None:
    count, rows, columns = weights.shape
    height, width = front.shape
    py, px = np.mgrid[top + margin : top + margin + rows, margin : margin + columns]
    near_edges = edges[top : top + rows]
    for k in range(count):
        down, right = offsets[k]
        length = max(abs(down), abs(right))
        size = sizes[py + down, px + right]
        weight = np.where(size > NOTHING, taps[k, steps[py + down, px + right]], 0)
        if length == 0:
            weight[near_edges & (front[py, px] < size - _IN_FRONT_PX)] = 0
            weights[k] = weight
            continue
        begins = (weight > 0) & near_edges & (np.abs(size) >= _SHARP_PX)
        begin = np.floor(nearest / np.where(begins, size, 1) * length)
        first = np.where(begin <= length, np.minimum(begin, 0), length + 1)
        last = np.where(begin <= length, length, begin + 1)
        if begins.any():
            for i in range(int(first[begins].min()), int(last[begins].max()) + 1):
                yy = np.clip(py + int(np.rint(down * i / length)), 0, height - 1)
                xx = np.clip(px + int(np.rint(right * i / length)), 0, width - 1)
                there = front[yy, xx]
                one, other = (i - 0.5) * size / length, (i + 0.5) * size / length
                stopped = begins & (first <= i) & (i <= last) & (there < size - _IN_FRONT_PX)
                stopped &= there > np.minimum(one, other) - _CLOSED_PX
                stopped &= there < np.maximum(one, other) + _CLOSED_PX
                weight[stopped] = 0
        weights[k] = weight


# Writes how much light reaches each pixel of some rows from the points so far from it [K, rows,
# columns]. The ray of pixel x that meets a point of blur size s at y is, where it is as far from
# the surface in focus as blur size t says, at ``x + t / s (y - x)``. A surface stops it whose
# size there is t.
#
# `front` has the size that every pixel of the scene shows, which is a margin larger than the frame
# on all sides, `sizes` those of the points, `NOTHING` where there are none, and `steps` the columns
# of `taps` [K, steps] for them: the light at each of the `offsets` [K, 2]. Rays are followed from
# size `nearest` on at the pixels with `edges` around [frame rows, columns]. The first row is `top`.
rays = Compiled(_loop, _plain)
