"""Blur with occlusion: foregrounds hide a part of what is behind them."""

import dataclasses
from functools import cached_property

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.blur_map import nearest_index
from coded_aperture_ros.deblur.operator import BlurOperator, crop_to_frame, extend_to_scene
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.deblur.visibility import NO_SURFACE, quadrant_minimum, trace_visibility

# Neighbouring pixels that differ by more are an edge, where something may be hidden.
_EDGE_PX = 1.0
# Rows that a thread works on at once.
_BAND_ROWS = 16
_MAX_WEIGHT = 255  # weights are kept as bytes
_MIN_TAP_SHARE = 1e-3  # taps of a PSF that are less, of its largest


class OccludedBlur(BlurOperator):
    """Blur where each pixel collects the light of all unobstructed rays through the aperture.

    The scene has two planes [2, rows, columns]: the view of a pinhole in the middle of the
    aperture, and behind foregrounds, as far as any ray can reach, the continuation of the surface
    beside them. With ``V(x, y)`` = 1 where nothing is in front (see `trace_visibility`)::

        (H_d f)(x) = sum_y h_d(y)(x - y) V(x, y) f(y)  /  sum_y h_d(y)(x - y) V(x, y)

    over the points y of both. It needs a byte per pixel of the frame and of the largest PSF.
    """

    hidden: BoolArray

    def __init__(
        self, basis: PsfBasis, blur_size_px: FloatArray, workers: Workers | None = None
    ) -> None:
        super().__init__(basis, blur_size_px.shape, basis.margin_px, workers)
        rows, columns = self.shape
        surfaces = _Surfaces.from_front(extend_to_scene(blur_size_px, self), self.margin_px)
        self.hidden = surfaces.hidden
        self._origin = surfaces.origin
        self._steps = basis.table_steps(surfaces.front)
        self._offsets, taps = _taps(basis)
        # Where each of them lies in the scene for the frame's first pixel.
        self._first = self._offsets + self.margin_px
        self._weights = np.empty((len(taps), rows, columns), np.uint8)
        self._scale = np.empty(self.shape, np.float32)
        light = _Light(self, surfaces, taps, basis.table_steps(surfaces.behind))
        bands = range(0, rows, _BAND_ROWS)
        band_entries: dict[int, tuple[IndexArray, ...]] = {}

        def weigh(top: int, _: int) -> None:
            band = slice(top, min(top + _BAND_ROWS, rows))
            hidden_weights = light.hidden_weights(band)
            weights = light.front_weights(band)
            # As bytes, of the largest weight of each pixel.
            unit = np.float32(_MAX_WEIGHT) / np.maximum(weights.max(axis=0), np.float32(1e-9))
            weights *= unit
            np.rint(weights, out=weights)
            self._weights[:, band] = weights
            total = weights.sum(axis=0)
            place, pixel, share = hidden_weights
            share = share * unit.ravel()[pixel]
            np.add.at(total.ravel(), pixel, share)
            self._scale[band] = 1 / np.maximum(total, np.float32(1))
            band_entries[top] = place, pixel + top * columns, share

        self.workers.each(weigh, bands)
        # Of what is behind: where it is, which pixel sees it, and how much of it.
        self._place, self._pixel, self._share = (
            np.concatenate([band_entries[top][part] for top in bands]) for part in range(3)
        )

    def extend(self, frame: FloatArray) -> FloatArray:
        """Scene from a frame, continued beyond its borders and behind foregrounds."""
        front = extend_to_scene(frame, self)
        return np.stack([front, np.where(self.hidden, front.ravel()[self._origin], 0)])

    def forward(self, scene: FloatArray) -> FloatArray:
        """Frame of a scene."""
        frame = np.empty(self.shape, np.float32)

        def add(top: int, _: int) -> None:
            band = slice(top, top + _BAND_ROWS)
            collect(self._weights[:, band], self._first, scene[0, top:], frame[band])

        self.workers.each(add, range(0, self.shape[0], _BAND_ROWS))
        light = self._share * scene[1].ravel()[self._place]
        frame += np.bincount(self._pixel, light, frame.size).astype(np.float32).reshape(self.shape)
        frame *= self._scale
        return frame

    def adjoint(self, frame: FloatArray) -> FloatArray:
        """Transpose of `forward` applied to a frame."""
        frame = frame * self._scale
        # Each thread has its own scene: bands of rows overlap by the margin.
        shape = (2, *self.scene_shape)
        scenes = [np.zeros(shape, np.float32) for _ in range(self.workers.threads)]

        def add(top: int, thread: int) -> None:
            band = slice(top, top + _BAND_ROWS)
            spread(self._weights[:, band], self._first, frame[band], scenes[thread][0, top:])

        self.workers.each(add, range(0, self.shape[0], _BAND_ROWS), sums=True)
        scene = scenes[0]
        for other in scenes[1:]:
            scene[0] += other[0]
        light = self._share * frame.ravel()[self._pixel]
        size = scene[1].size
        scene[1] = np.bincount(self._place, light, size).reshape(scene[1].shape)
        return scene


@dataclasses.dataclass(frozen=True, eq=False)
class _Surfaces:
    """Signed blur sizes of a scene [rows, columns]: in front, and behind."""

    front: FloatArray
    behind: FloatArray  # NO_SURFACE where nothing is hidden
    hidden: BoolArray
    origin: IndexArray  # which pixel of the front goes on there
    near_edges: BoolArray  # where something may stand in the way

    @classmethod
    def from_front(cls, front: FloatArray, reach_px: int) -> "_Surfaces":
        around = np.ones((3, 3), np.uint8)
        least = cv2.erode(front, around)
        farther = front - least > _EDGE_PX  # beside something nearer
        if farther.any():
            origin = np.flatnonzero(farther)[nearest_index(farther)]
            away = cv2.distanceTransform((~farther).astype(np.uint8), cv2.DIST_L2, 5)
            hidden = (front.ravel()[origin] > front + _EDGE_PX) & (away <= reach_px + 1)
        else:
            origin = np.zeros(front.shape, np.intp)
            hidden = np.zeros(front.shape, bool)
        behind = np.where(hidden, front.ravel()[origin], np.float32(NO_SURFACE))
        edge = (cv2.dilate(front, around) - least > _EDGE_PX).astype(np.uint8)
        near_edges = cv2.dilate(edge, np.ones((2 * reach_px + 3,) * 2, np.uint8)) > 0
        return cls(front, behind, hidden, origin, near_edges)


@dataclasses.dataclass(frozen=True, eq=False)
class _Light:
    """Light that reaches the pixels of bands of rows; see `trace_visibility`."""

    operator: OccludedBlur
    surfaces: _Surfaces
    taps: FloatArray
    steps_behind: IndexArray

    @cached_property
    def _least(self) -> FloatArray:
        return quadrant_minimum(self.surfaces.front, self.operator.margin_px)

    @cached_property
    def _near_edges(self) -> BoolArray:
        return np.ascontiguousarray(crop_to_frame(self.surfaces.near_edges, self.operator))

    def front_weights(self, band: slice) -> FloatArray:
        """Weights of what is in front [K, rows, columns]."""
        return self._weights(self.surfaces.front, self.operator._steps, band)

    def hidden_weights(self, band: slice) -> tuple[IndexArray, IndexArray, FloatArray]:
        """Position of visible hidden points, the band's pixel that sees each, and its weight."""
        weights = self._weights(self.surfaces.behind, self.steps_behind, band)
        weights *= self._near_edges[band]  # farther from edges nothing hidden is seen
        seen = np.flatnonzero(weights)  # a third of the time of `nonzero`
        offset, pixel = np.divmod(seen, weights[0].size)
        row, column = np.divmod(pixel, weights.shape[2])
        down, right = self.operator._first[offset].T
        place = (row + band.start + down) * self.operator.scene_shape[1] + column + right
        return place.astype(np.int32), pixel.astype(np.int32), weights.ravel()[seen]

    def _weights(self, sizes: FloatArray, steps: IndexArray, band: slice) -> FloatArray:
        front = self.surfaces.front
        offsets = self.operator._offsets
        shape = len(self.taps), band.stop - band.start, self.operator.shape[1]
        weights = np.empty(shape, np.float32)
        scene = front, self._least, sizes, steps, self._near_edges
        place = float(front.min()), band.start, self.operator.margin_px
        trace_visibility(scene, self.taps, offsets, place, weights)
        return weights


def _taps(basis: PsfBasis) -> tuple[IndexArray, FloatArray]:
    """Offsets [K, 2] from a pixel to points, and the light from there [K, steps]."""
    psfs = np.maximum(basis.psfs(), 0)
    psfs[psfs < _MIN_TAP_SHARE * psfs.max(axis=(1, 2), keepdims=True)] = 0
    # The ray that reaches x from x + offset comes from the PSF at -offset.
    taps = np.moveaxis(psfs[:, ::-1, ::-1], 0, -1)
    used = np.argwhere(taps.max(axis=-1))
    return used - basis.margin_px, np.ascontiguousarray(taps[used[:, 0], used[:, 1]])


def _collect_loop(
    weights: FloatArray, first: IndexArray, scene: FloatArray, frame: FloatArray
) -> None:
    count, rows, columns = weights.shape
    for y in range(rows):
        total = frame[y]
        total[:] = 0
        for k in range(count):
            # Slices, whose indices are known not to be negative, are added up in vectors.
            weight = weights[k, y]
            column = first[k, 1]
            part = scene[first[k, 0] + y][column : column + columns]
            for x in range(columns):
                total[x] += np.float32(weight[x]) * part[x]


def _collect_plain(
    weights: FloatArray, first: IndexArray, scene: FloatArray, frame: FloatArray
) -> None:
    _, rows, columns = weights.shape
    frame[:] = 0
    for weight, (row, column) in zip(weights, first, strict=True):
        frame += weight * scene[row : row + rows, column : column + columns]


def _spread_loop(
    weights: FloatArray, first: IndexArray, frame: FloatArray, scene: FloatArray
) -> None:
    count, rows, columns = weights.shape
    for y in range(rows):
        light = frame[y]
        for k in range(count):
            weight = weights[k, y]
            column = first[k, 1]
            part = scene[first[k, 0] + y][column : column + columns]
            for x in range(columns):
                part[x] += np.float32(weight[x]) * light[x]


def _spread_plain(
    weights: FloatArray, first: IndexArray, frame: FloatArray, scene: FloatArray
) -> None:
    _, rows, columns = weights.shape
    for weight, (row, column) in zip(weights, first, strict=True):
        scene[row : row + rows, column : column + columns] += weight * frame


# The sums over all offsets of a band of rows of the frame, and their transpose. `weights` are bytes
# [K, rows, columns], `first` where the band's first pixel has each offset [K, 2] in the scene,
# which begins with the band's row.
collect = Compiled(_collect_loop, _collect_plain)
spread = Compiled(_spread_loop, _spread_plain)
