"""Thin structures of a scene: pieces of nearer surfaces that are only some pixels wide.

A piece's width is that of the largest disc that fits into it: the morphological closing of the map
of blur sizes (near is small) with a disc takes away whatever is narrower than the disc.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array, csgraph

from coded_aperture_benchmarks.metrics.edges import occluding_contour
from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.metrics.edges import EDGE_JUMP_PX

# Each includes its lower bound, the last its upper bound too.
WIDTHS_PX = ((2, 4), (4, 8), (8, 20))
_FOUND_SHARE = 0.5
# The share of a piece's outline that has something farther beside it: a ridge has nothing.
_OCCLUDING_SHARE = 0.5
_FARTHER_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))


def thin_pieces(
    blur_size_px: NDArray[np.floating],
    widths_px: tuple[tuple[int, int], ...] = WIDTHS_PX,
    elongation: float = 2.0,
) -> dict[tuple[int, int], IndexArray]:
    """Find the connected pieces of nearer surfaces by their width.

    Parameters
    ----------
    blur_size_px : ndarray of float, shape [h, w]
        True signed blur size, which grows with depth; NaN where unknown. With the sign turned
        round, the pieces are gaps between nearer surfaces.
    widths_px : tuple of (int, int)
        Ranges of widths in increasing order, without gaps.
    elongation : float
        Least area of a piece in squares of its width. Corners of large surfaces have less than 2.

    Returns
    -------
    dict of (int, int) to ndarray of int, shape [h, w]
        For every range of widths each pixel's piece, counted from 1; 0 in none. What is unknown
        is taken for the continuation of the nearer surface beside it.
    """
    known = np.isfinite(blur_size_px)
    pieces = {widths: np.zeros(known.shape, np.intp) for widths in widths_px}
    if not known.any():
        return pieces
    lowest = float(np.min(blur_size_px[known]))
    size = np.where(known, blur_size_px, lowest - 1000.0).astype(np.float32)
    contour = occluding_contour(np.where(known, blur_size_px, np.nan))
    free = known
    last = widths_px[-1]
    # What is narrower than all ranges must not count as the narrowest.
    for low, high in ((1, widths_px[0][0]), *widths_px):
        # A rod of the last width, drawn at a slant, is up to a pixel wider.
        diameter = high + 2 * ((low, high) == last)
        # Where narrow wires meet is no wide piece: a step for each half of their width.
        thin = _without_joints(_narrower(size, diameter) & free, size, low // 2)
        labels = _long(_connected(thin, size), contour, elongation, low)
        free = free & (labels == 0)
        if (low, high) in pieces:
            pieces[low, high] = labels
    return pieces


def pieces_found(labels: IndexArray, right: BoolArray) -> BoolArray:
    """Return for every piece whether at least half of its pixels are right.

    Parameters
    ----------
    labels : ndarray of int, shape [h, w]
        As from `thin_pieces`.
    right : ndarray of bool, shape [h, w]
    """
    pixels = np.bincount(labels.ravel())[1:]
    good = np.bincount(labels.ravel(), right.ravel(), minlength=pixels.size + 1)[1:]
    return np.asarray(good >= _FOUND_SHARE * pixels)


def _narrower(size: FloatArray, diameter: int) -> BoolArray:
    """Return the pixels of nearer surfaces that no disc around them fits into."""
    reach = 2 * diameter
    padded = cv2.copyMakeBorder(size, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    from_middle = np.arange(diameter) - (diameter - 1) / 2
    disc = np.hypot(*np.meshgrid(from_middle, from_middle)) <= diameter / 2
    kernel, first = disc.astype(np.uint8), diameter // 2
    # The second step looks the other way: a disc of even diameter has no middle pixel.
    second = diameter - 1 - first
    filled = cv2.dilate(padded, kernel, anchor=(first, first))
    closed = cv2.erode(filled, kernel, anchor=(second, second))
    thin = closed[reach:-reach, reach:-reach] - size > EDGE_JUMP_PX
    return _without_joints(thin, size, diameter // 2)


def _without_joints(thin: BoolArray, size: FloatArray, steps: int) -> BoolArray:
    """Leave out what is within some steps, on the same surface, of what is not thin.

    A disc does not reach into the corners of a large surface.
    """
    thin = thin.copy()
    beside = [np.abs(np.diff(size, axis=axis)) <= EDGE_JUMP_PX for axis in (0, 1)]
    for _ in range(steps):
        for pixels, same in ((thin, beside[0]), (thin.T, beside[1].T)):
            pixels[1:] &= pixels[:-1] | ~same
            pixels[:-1] &= pixels[1:] | ~same
    return thin


def _connected(pixels: BoolArray, size: FloatArray) -> IndexArray:
    """Label connected pixels, eight neighbours each, that no jump parts."""
    index = np.full(pixels.shape, -1)
    count = int(np.count_nonzero(pixels))
    index[pixels] = np.arange(count)
    pairs = []
    rows, columns = pixels.shape
    for down, right in _FARTHER_NEIGHBOURS:
        here = np.s_[: rows - down, max(0, -right) : columns - max(0, right)]
        there = np.s_[down:, max(0, right) : columns - max(0, -right)]
        joined = pixels[here] & pixels[there]
        joined &= np.abs(size[here] - size[there]) <= EDGE_JUMP_PX
        pairs.append((index[here][joined], index[there][joined]))
    one, other = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    graph = coo_array((np.ones(one.size, bool), (one, other)), shape=(count, count))
    labels = np.zeros(pixels.shape, np.intp)
    labels[pixels] = csgraph.connected_components(graph, directed=False)[1] + 1
    return labels


def _long(labels: IndexArray, contour: BoolArray, elongation: float, least: int) -> IndexArray:
    """Keep the pieces that are long for their width and lie in front of what is around them."""
    count = int(labels.max())
    if not count:
        return labels
    every = np.arange(1, count + 1)
    area = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    outline = (labels > 0) & (
        (ndimage.maximum_filter(labels, 3) != labels)
        | (ndimage.minimum_filter(labels, 3) != labels)
    )
    # Every piece by itself: the pixels where it meets another one are its outline as well.
    depth = ndimage.distance_transform_edt((labels > 0) & ~outline) + 1.0
    width = np.maximum(2 * ndimage.maximum(depth, labels, every) - 0.5, least)
    around = np.bincount(labels[outline], minlength=count + 1)[1:]
    occluding = np.bincount(labels[outline & contour], minlength=count + 1)[1:]
    keep = (area >= elongation * width**2) & (occluding >= _OCCLUDING_SHARE * around)
    new = np.concatenate([[0], np.cumsum(keep) * keep])
    return np.asarray(new[labels], np.intp)
