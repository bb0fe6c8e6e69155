"""PSF on cells finer than the pixels, from dots at different positions on the pixels.

A dot a third of a pixel off shows the same PSF, cut into pixels elsewhere. Light on a fine grid,
moved and integrated over pixels, has to give all dots at once: least squares with non-negative
light. Without that constraint, a grid that is wrong by a bit on each pixel would give as good a
PSF.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coded_aperture_ros.calibration.mask.cells import square_cells
from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, IndexArray
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.optics.pixels import cell_shares
from coded_aperture_ros.optics.psf import interpolated_shares

_ITERATIONS = 60
_MIN_LIGHT_SHARE = 0.04
# A point where there is no blur.
_POINT_PX = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class FinePsf:
    """Light on square cells around an origin."""

    light: DoubleArray  # [n, n]; sum 1; the origin is the middle
    cell_px: float  # width of a cell in px

    def at(self, width: int, centre: ArrayLike = (0.0, 0.0), scale: float = 1.0) -> DoubleArray:
        """What pixels [width, width] record of a point, its origin at `centre` from their middle.

        `centre` is down and right in px, `width` odd; the PSF is `scale` times as wide as measured.
        """
        return self._rendered(cell_shares, width, centre, scale)

    def interpolated(
        self, width: int, centre: ArrayLike = (0.0, 0.0), scale: float = 1.0
    ) -> DoubleArray:
        """PSF of pictures that are interpolated between pixels, as `render_psf`; like `at`."""
        return self._rendered(interpolated_shares, width, centre, scale)

    def _rendered(
        self, shares: Callable[..., DoubleArray], width: int, centre: ArrayLike, scale: float
    ) -> DoubleArray:
        rows, columns = (
            shares(width, len(self.light), self.cell_px * scale, offset)
            for offset in np.asarray(centre, np.float64)
        )
        return np.asarray(rows @ self.light @ columns.T)


def mask_psf(mask: Mask, blur_size_px: float) -> FinePsf:
    """PSF of a mask of a blur size: its cells, turned by 180 degrees if that is negative."""
    cells = square_cells(mask)
    if blur_size_px < 0:
        cells = cells[::-1, ::-1]
    return FinePsf(cells / cells.sum(), max(abs(blur_size_px), _POINT_PX) / len(cells))


def fit_fine(
    windows: DoubleArray, offsets: DoubleArray, strengths: DoubleArray, ridge: float, start: FinePsf
) -> FinePsf:
    """Light on fine cells fitted to pictures of dots, by projected gradients (FISTA with restarts).

    `windows`, float64 [N, k, k], are the pictures without background, `offsets` [N, 2] the
    positions of the dots from the middle of the windows in px, and `strengths` [N] the light of
    each. `ridge` is the variance of a pixel's noise, for light whose cells have the mean square of
    `start`, which also defines the cells.
    """
    width = windows.shape[-1]
    cells = len(start.light)
    rows, columns = (cell_shares(width, cells, start.cell_px, offsets[:, axis]) for axis in (0, 1))
    rows = rows * strengths[:, None, None]
    damping = ridge / max(float((start.light**2).mean()), 1e-30)

    # All dots' rows below each other: large products instead of many small ones.
    every = rows.reshape(-1, cells)

    def back(windows: DoubleArray) -> DoubleArray:
        return every.T @ (windows @ columns).reshape(-1, cells)

    def normal(light: DoubleArray) -> DoubleArray:
        seen = (every @ light).reshape(rows.shape) @ columns.transpose(0, 2, 1)
        return back(seen) + damping * light

    wanted = back(windows)
    # Nothing in the matrix is negative: no eigenvalue is larger than its largest sum of a row.
    largest = float(normal(np.ones_like(start.light)).max())
    light = ahead = start.light
    momentum = 1.0
    for _ in range(_ITERATIONS):
        before = light
        light = np.maximum(ahead - (normal(ahead) - wanted) / largest, 0)
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        if ((ahead - light) * (light - before)).sum() > 0:
            following = 1.0  # past the minimum: restart the momentum
        ahead = light + (momentum - 1) / following * (light - before)
        momentum = following
    return FinePsf(light / max(light.sum(), 1e-30), start.cell_px)


def centroids(pictures: NDArray[np.floating]) -> DoubleArray:
    """First moments of light (down, right) about the middle [..., 2], not divided by the light.

    Pictures are [..., k, k], with odd k.
    """
    steps = centred_steps(pictures.shape[-1])
    return np.stack([pictures.sum(axis=-1) @ steps, pictures.sum(axis=-2) @ steps], axis=-1)


def centred_steps(width: int) -> IndexArray:
    """Signed distance of each pixel from the middle one along a side [width]."""
    return np.arange(width) - width // 2


def border_mask(width: int) -> BoolArray:
    """Mask of the outermost pixels [width, width]."""
    return ring_numbers(width) == width // 2


def ring_numbers(width: int) -> IndexArray:
    """Number of the square ring around the middle that each pixel is on [width, width]."""
    steps = np.abs(centred_steps(width))
    return np.maximum(steps[:, None], steps)


def light_extent(light: NDArray[np.floating]) -> int:
    """Width in px of what is not faint, about the middle of a picture."""
    return (
        2 * int(ring_numbers(len(light))[light > _MIN_LIGHT_SHARE * light.max()].max(initial=0)) + 1
    )
