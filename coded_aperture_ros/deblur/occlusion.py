"""Blur with occlusion: which points of the scene each part of the aperture sees."""

from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.operator import OnProcessor, steps_around
from coded_aperture_ros.deblur.psf_basis import PsfBasis

Value = TypeVar("Value", bound=np.generic)

# A surface hides what is behind it if its blur is smaller by this than that of the ray there: less
# is a slant, or an error of the depth.
_IN_FRONT_PX = 0.25
# Rows that a thread works on at once: their weights for one offset stay in the cache.
_BAND_ROWS = 48


class OccludedBlur(OnProcessor):
    """Every pixel collects the light of all rays through the aperture that nothing stops.

    The ray of pixel ``x`` that meets a surface of blur size ``s`` at ``y`` passes, on its way, the
    points ``x + t (y - x)``, ``0 < t < 1``, where it is as far from the surface in focus as blur
    ``t s`` says. It is stopped if a surface there has a smaller blur. So with ``V(x, y)`` = 1
    where nothing does::

        (H_d f)(x) = sum_y h_d(y)(x - y) V(x, y) f(y)  /  sum_y h_d(y)(x - y) V(x, y)

    Surfaces that the pinhole in the middle of the aperture does not see are not in the depth map;
    the denominator leaves their light out. Exact near foregrounds that are sharper than what is
    behind them. It needs memory for as many frames as the largest PSF has pixels.
    """

    def __init__(
        self, basis: PsfBasis, blur_size_px: FloatArray, workers: Workers | None = None
    ) -> None:
        rows, columns = blur_size_px.shape
        self.shape, self.margin_px = (rows, columns), basis.margin_px
        self.scene_shape = (rows + 2 * self.margin_px, columns + 2 * self.margin_px)
        self.workers = workers or Workers()
        self._basis, self._steps = basis, steps_around(basis, blur_size_px, self)
        psfs = np.maximum(basis.psfs(), 0)
        psfs[psfs < 1e-3 * psfs.max(axis=(1, 2), keepdims=True)] = 0
        # The ray that reaches x from x + offset comes from the PSF at -offset.
        taps = np.moveaxis(psfs[:, ::-1, ::-1], 0, -1)
        self._offsets = [(int(down), int(right)) for down, right in np.argwhere(taps.max(axis=-1))]
        self._weights = np.empty((len(self._offsets), rows, columns), np.float32)
        amount = np.abs(basis.table_sizes_px).astype(np.float32)[self._steps]
        amounts, steps = self._around(amount), self._around(self._steps)

        def weigh(index: int, _: int) -> None:
            offset, weight = self._offsets[index], self._weights[index]
            np.take(taps[offset], steps[offset], out=weight)
            weight *= _visible(amounts, offset)

        self.workers.each(weigh, range(len(self._offsets)))
        self._weights /= np.maximum(self._weights.sum(axis=0), np.float32(1e-6))

    def _around(self, scene: NDArray[Value]) -> NDArray[Value]:
        """Return views [down, right] of what is so far from every pixel, less the margin."""
        return sliding_window_view(scene, self.shape, writeable=True)

    def forward(self, scene: FloatArray) -> FloatArray:
        """Blur a scene."""
        frame, around = np.zeros(self.shape, np.float32), self._around(scene)

        def add(top: int, _: int) -> None:
            band = slice(top, top + _BAND_ROWS)
            product = np.empty_like(frame[band])
            for offset, weights in zip(self._offsets, self._weights, strict=True):
                np.multiply(weights[band], around[offset][band], out=product)
                frame[band] += product

        self.workers.each(add, range(0, self.shape[0], _BAND_ROWS))
        return frame

    def adjoint(self, frame: FloatArray) -> FloatArray:
        """Apply the transpose."""
        # Each thread has its own scene: bands of rows overlap by the margin.
        scenes = [np.zeros(self.scene_shape, np.float32) for _ in range(self.workers.threads)]

        def add(top: int, thread: int) -> None:
            band, around = slice(top, top + _BAND_ROWS), self._around(scenes[thread])
            product = np.empty_like(frame[band])
            for offset, weights in zip(self._offsets, self._weights, strict=True):
                np.multiply(weights[band], frame[band], out=product)
                around[offset][band] += product

        self.workers.each(add, range(0, self.shape[0], _BAND_ROWS))
        return np.sum(scenes, axis=0)


def _visible(amounts: FloatArray, place: tuple[int, int]) -> BoolArray:
    """Return for which pixels nothing is in front of the point at a place of their surroundings."""
    centre = len(amounts) // 2
    offset = place[0] - centre, place[1] - centre
    seen = np.ones(amounts[place].shape, bool)
    length = max(abs(offset[0]), abs(offset[1]))
    for step in range(length):
        share = np.float32(step / length)
        down, right = (centre + round(way * step / length) for way in offset)
        seen &= amounts[down, right] >= share * amounts[place] - _IN_FRONT_PX
    return seen
