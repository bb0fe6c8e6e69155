"""Blur with occlusion: which points of the scene each part of the aperture sees."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

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

    Parameters are those of `SpreadingBlur`.
    """

    def __init__(
        self, basis: PsfBasis, blur_size_px: NDArray[np.float32], workers: Workers | None = None
    ) -> None:
        rows, columns = blur_size_px.shape
        self.shape, self.margin_px = (rows, columns), basis.margin_px
        self.scene_shape = (rows + 2 * self.margin_px, columns + 2 * self.margin_px)
        self.workers = workers or Workers()
        self._basis, self._steps = basis, steps_around(basis, blur_size_px, self)
        amount = np.abs(basis.table_sizes_px).astype(np.float32)[self._steps]
        psfs = np.maximum(basis.psfs(), 0)
        psfs[psfs < 1e-3 * psfs.max(axis=(1, 2), keepdims=True)] = 0
        open_at = np.argwhere(psfs.max(axis=0) > 0) - self.margin_px
        self._offsets = offsets = [(int(down), int(right)) for down, right in open_at]
        # The ray that reaches x from x + offset comes from the PSF at -offset.
        taps = [psfs[:, self.margin_px - down, self.margin_px - right] for down, right in offsets]
        self._weights = np.empty((len(offsets), rows, columns), np.float32)

        def weigh(index: int, _: int) -> None:
            seen = _visible(amount, self.margin_px, self.shape, offsets[index])
            there = _shifted(self._steps, self.margin_px, self.shape, offsets[index])
            np.take(taps[index], there, out=self._weights[index])
            self._weights[index] *= seen

        self.workers.each(weigh, range(len(offsets)))
        self._weights /= np.maximum(self._weights.sum(axis=0), np.float32(1e-6))

    def forward(self, scene: NDArray[np.float32]) -> NDArray[np.float32]:
        """Blur a scene."""
        frame = np.zeros(self.shape, np.float32)

        def add(top: int, _: int) -> None:
            band = slice(top, top + _BAND_ROWS)
            product = np.empty_like(frame[band])
            for offset, weights in zip(self._offsets, self._weights, strict=True):
                there = _shifted(scene, self.margin_px, self.shape, offset)[band]
                np.multiply(weights[band], there, out=product)
                frame[band] += product

        self.workers.each(add, range(0, self.shape[0], _BAND_ROWS))
        return frame

    def adjoint(self, frame: NDArray[np.float32]) -> NDArray[np.float32]:
        """Apply the transpose."""
        # Each thread has its own scene: bands of rows overlap by the margin.
        scenes = [np.zeros(self.scene_shape, np.float32) for _ in range(self.workers.threads)]

        def add(top: int, thread: int) -> None:
            band = slice(top, top + _BAND_ROWS)
            product = np.empty_like(frame[band])
            for offset, weights in zip(self._offsets, self._weights, strict=True):
                np.multiply(weights[band], frame[band], out=product)
                _shifted(scenes[thread], self.margin_px, self.shape, offset)[band] += product

        self.workers.each(add, range(0, self.shape[0], _BAND_ROWS))
        return np.sum(scenes, axis=0)

    def ranges(self, count: int) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Divide the scene among ranges of blur sizes."""
        return self._basis.ranges(self._steps, count)


def _visible(
    amount: NDArray[np.float32], margin: int, shape: tuple[int, int], offset: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return for which pixels nothing is in front of the point `offset` of them."""
    there = _shifted(amount, margin, shape, offset)
    seen = np.ones(shape, bool)
    length = int(np.max(np.abs(offset)))
    for step in range(length):
        share = np.float32(step / length)
        between = (round(offset[0] * step / length), round(offset[1] * step / length))
        seen &= _shifted(amount, margin, shape, between) >= share * there - _IN_FRONT_PX
    return seen


def _shifted(
    scene: NDArray[Value], margin: int, shape: tuple[int, int], offset: tuple[int, int]
) -> NDArray[Value]:
    """Return what lies `offset` (down, right) of every pixel of the frame."""
    top, left = margin + offset[0], margin + offset[1]
    return scene[top : top + shape[0], left : left + shape[1]]
