"""Blur with occlusion: foregrounds hide a part of what is behind them, and only a part."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.blur_map import nearest_of
from coded_aperture_ros.deblur.operator import OnProcessor, frame_within, scene_around
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.deblur.visibility import NOTHING, least_towards, rays
from coded_aperture_ros.imaging import periodic_shape

# Neighbouring pixels that differ by more are an edge, where something may be hidden.
_EDGE_PX = 1.0
# Rows that a thread works on at once.
_BAND_ROWS = 16
_WHOLE = 255  # weights are kept as bytes
_FAINT = 1e-3  # taps of a PSF that are less, of its largest


class OccludedBlur(OnProcessor):
    """Every pixel collects the light of all rays through the aperture that nothing stops.

    The scene has two planes [2, rows, columns]: what the pinhole in the middle of the aperture
    sees, and behind foregrounds, as far as any ray can reach, what goes on there of the surface
    beside them. With ``V(x, y)`` = 1 where nothing is in front (see `rays`)::

        (H_d f)(x) = sum_y h_d(y)(x - y) V(x, y) f(y)  /  sum_y h_d(y)(x - y) V(x, y)

    over the points y of both. It needs a byte per pixel of the frame and of the largest PSF.
    """

    hidden: BoolArray

    def __init__(
        self, basis: PsfBasis, blur_size_px: FloatArray, workers: Workers | None = None
    ) -> None:
        rows, columns = blur_size_px.shape
        self.shape, self.margin_px = (rows, columns), basis.margin_px
        self.scene_shape = periodic_shape(self.shape, 2 * self.margin_px)
        self.workers = workers or Workers()
        self._basis = basis
        front = scene_around(blur_size_px, self)
        self._steps = basis.steps_of(front)
        around = np.ones((3, 3), np.uint8)
        lowest = cv2.erode(front, around)
        edge = cv2.dilate(front, around) - lowest > _EDGE_PX
        self.hidden, self._origin = _continued(front, front - lowest > _EDGE_PX, self.margin_px)
        least = least_towards(front, self.margin_px)
        behind = np.where(self.hidden, front.ravel()[self._origin], np.float32(NOTHING))
        reach = np.ones((2 * self.margin_px + 3,) * 2, np.uint8)
        near_edges = frame_within(cv2.dilate(edge.astype(np.uint8), reach), self) > 0
        psfs = np.maximum(basis.psfs(), 0)
        psfs[psfs < _FAINT * psfs.max(axis=(1, 2), keepdims=True)] = 0
        # The ray that reaches x from x + offset comes from the PSF at -offset.
        taps = np.moveaxis(psfs[:, ::-1, ::-1], 0, -1)
        used = np.argwhere(taps.max(axis=-1))
        taps = np.ascontiguousarray(taps[used[:, 0], used[:, 1]])
        self._offsets = used - self.margin_px
        self._weights = np.empty((len(used), rows, columns), np.uint8)
        self._scale = np.empty(self.shape, np.float32)
        bands = range(0, rows, _BAND_ROWS)
        hidden_steps = basis.steps_of(np.where(self.hidden, behind, 0))
        of_band: dict[int, tuple[IndexArray, ...]] = {}

        def weigh(top: int, _: int) -> None:
            band = slice(top, min(top + _BAND_ROWS, rows))
            weights = np.empty((len(used), band.stop - top, columns), np.float32)
            fixed = (
                taps,
                self._offsets,
                near_edges,
                float(front.min()),
                top,
                self.margin_px,
                weights,
            )
            rays(front, least, behind, hidden_steps, *fixed)
            weights *= near_edges[band]  # farther from edges nothing hidden is seen
            seen = np.flatnonzero(weights)  # a third of the time of `nonzero`
            share = weights.ravel()[seen]
            offset, inside = np.divmod(seen, weights[0].size)
            row, column = np.divmod(inside, columns)
            rays(front, least, front, self._steps, *fixed)
            unit = np.float32(_WHOLE) / np.maximum(weights.max(axis=0), np.float32(1e-9))
            weights *= unit
            share *= unit[row, column]
            np.rint(weights, out=weights)
            self._weights[:, band] = weights
            total = weights.sum(axis=0)
            np.add.at(total, (row, column), share)
            self._scale[band] = 1 / np.maximum(total, np.float32(1))
            down, right = (self._offsets[offset] + self.margin_px).T
            place = (row + top + down) * self.scene_shape[1] + column + right
            pixel = (row + top) * columns + column
            of_band[top] = place.astype(np.int32), pixel.astype(np.int32), share

        self.workers.each(weigh, bands)
        # Of what is behind: where it is, which pixel sees it, and how much of it.
        self._place, self._pixel, self._share = (
            np.concatenate([of_band[top][part] for top in bands]) for part in range(3)
        )

    def around(self, frame: FloatArray) -> FloatArray:
        """Extend a frame to a scene, and continue it behind foregrounds."""
        front = scene_around(frame, self)
        return np.stack([front, np.where(self.hidden, front.ravel()[self._origin], 0)])

    def forward(self, scene: FloatArray) -> FloatArray:
        """Blur a scene."""
        frame = np.empty(self.shape, np.float32)

        def add(top: int, _: int) -> None:
            band = slice(top, top + _BAND_ROWS)
            weights = self._weights[:, band]
            collected(weights, self._offsets, scene[0], top, self.margin_px, frame[band])

        self.workers.each(add, range(0, self.shape[0], _BAND_ROWS))
        light = self._share * scene[1].ravel()[self._place]
        frame += np.bincount(self._pixel, light, frame.size).astype(np.float32).reshape(self.shape)
        frame *= self._scale
        return frame

    def adjoint(self, frame: FloatArray) -> FloatArray:
        """Apply the transpose."""
        frame = frame * self._scale
        # Each thread has its own scene: bands of rows overlap by the margin.
        shape = (2, *self.scene_shape)
        scenes = [np.zeros(shape, np.float32) for _ in range(self.workers.threads)]

        def add(top: int, thread: int) -> None:
            band = slice(top, top + _BAND_ROWS)
            weights = self._weights[:, band]
            spread(weights, self._offsets, frame[band], top, self.margin_px, scenes[thread][0])

        self.workers.each(add, range(0, self.shape[0], _BAND_ROWS))
        scene = scenes[0]
        for other in scenes[1:]:
            scene[0] += other[0]
        light = self._share * frame.ravel()[self._pixel]
        size = scene[1].size
        scene[1] = np.bincount(self._place, light, size).reshape(scene[1].shape)
        return scene


def _continued(
    front: FloatArray, farther: BoolArray, reach_px: int
) -> tuple[BoolArray, IndexArray]:
    """Return where something is hidden behind a foreground, and the pixel that goes on there.

    `farther` are the pixels beside nearer ones.
    """
    if not farther.any():
        return np.zeros(front.shape, bool), np.zeros(front.shape, np.intp)
    origin = np.flatnonzero(farther)[nearest_of(farther)]
    away = cv2.distanceTransform((~farther).astype(np.uint8), cv2.DIST_L2, 5)
    hidden = (front.ravel()[origin] > front + _EDGE_PX) & (away <= reach_px + 1)
    return hidden, origin


def _collect_loop(
    weights: FloatArray,
    offsets: IndexArray,
    scene: FloatArray,
    top: int,
    margin: int,
    frame: FloatArray,
) -> None:
    count, rows, columns = weights.shape
    for y in range(rows):
        total = frame[y]
        total[:] = 0
        for k in range(count):
            # Slices, whose indices are known not to be negative, are added up in vectors.
            weight = weights[k, y]
            first = offsets[k, 1] + margin
            part = scene[offsets[k, 0] + top + y + margin][first : first + columns]
            for x in range(columns):
                total[x] += np.float32(weight[x]) * part[x]


def _collect_plain(
    weights: FloatArray,
    offsets: IndexArray,
    scene: FloatArray,
    top: int,
    margin: int,
    frame: FloatArray,
) -> None:
    _, rows, columns = weights.shape
    frame[:] = 0
    for weight, (down, right) in zip(weights, offsets, strict=True):
        row, first = top + down + margin, right + margin
        frame += weight * scene[row : row + rows, first : first + columns]


def _spread_loop(
    weights: FloatArray,
    offsets: IndexArray,
    frame: FloatArray,
    top: int,
    margin: int,
    scene: FloatArray,
) -> None:
    count, rows, columns = weights.shape
    for y in range(rows):
        light = frame[y]
        for k in range(count):
            weight = weights[k, y]
            first = offsets[k, 1] + margin
            part = scene[offsets[k, 0] + top + y + margin][first : first + columns]
            for x in range(columns):
                part[x] += np.float32(weight[x]) * light[x]


def _spread_plain(
    weights: FloatArray,
    offsets: IndexArray,
    frame: FloatArray,
    top: int,
    margin: int,
    scene: FloatArray,
) -> None:
    _, rows, columns = weights.shape
    for weight, (down, right) in zip(weights, offsets, strict=True):
        row, first = top + down + margin, right + margin
        scene[row : row + rows, first : first + columns] += weight * frame


# The sums over all offsets of a band of rows that begins in row `top` of the frame, and their
# transpose; `weights` are bytes [K, rows, columns].
collected = Compiled(_collect_loop, _collect_plain)
spread = Compiled(_spread_loop, _spread_plain)
