"""Pictures of PSFs, and of a found mask with its spectra, for display."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.blind.find import BlindMask
from coded_aperture_ros.core.arrays import FloatArray

_GAP_PX = 6
_TILE_PX = 192
_TILES_PER_ROW = 5
_TILE_GAP_LIGHT = 0.3
_WIDTH_PX = 120
_PER_ROW = 8
_GAP_LIGHT = 0.25


def _tiled(tiles: Sequence[NDArray[np.floating]], per_row: int, gap_light: float) -> FloatArray:
    """Square tiles of one size [k, k] in rows, with gaps between and around them."""
    side = len(tiles[0])
    step = side + _GAP_PX
    columns = min(per_row, len(tiles))
    shape = -(-len(tiles) // columns) * step + _GAP_PX, columns * step + _GAP_PX
    drawn = np.full(shape, gap_light, np.float32)
    for number, tile in enumerate(tiles):
        top, left = (_GAP_PX + step * place for place in divmod(number, columns))
        drawn[top : top + side, left : left + side] = tile
    return drawn


def enlarged(cells: NDArray[np.floating], side_px: int) -> FloatArray:
    """Cells as whole squares of equal size, at most `side_px` wide in all if they fit."""
    factor = max(1, side_px // max(cells.shape))
    return np.kron(cells, np.ones((factor, factor), np.float32)).astype(np.float32)


def blind_picture(found: BlindMask) -> FloatArray:
    """Picture in [0, 1] of the mask, then of the spectrum of each plane, least blurred first.

    The left half of a spectrum is measured, the right half is the mask's for smooth texture; the
    halves of a real spectrum mirror each other.
    """
    tiles = [_mask_tile(found.mask.transmission)]
    tiles += [_halves(*found.spectra[plane]) for plane in np.argsort(found.blur_sizes_px)]
    return _tiled(tiles, _TILES_PER_ROW, _TILE_GAP_LIGHT)


def _mask_tile(transmission: FloatArray) -> FloatArray:
    rows, columns = transmission.shape
    scale = _TILE_PX / max(rows, columns)
    size = (round(columns * scale), round(rows * scale))
    cells = cv2.resize(transmission, size, interpolation=cv2.INTER_NEAREST_EXACT)
    rests = [_TILE_PX - length for length in cells.shape]
    return np.pad(cells, [(rest // 2, rest - rest // 2) for rest in rests])


def _halves(measured: NDArray, explained: NDArray) -> FloatArray:
    """Two half spectra side by side, zero frequency in the middle."""
    both = np.fft.fftshift(np.stack([measured, explained]), axes=1)[..., :-1]
    # The half with negative horizontal frequencies is the other, turned by 180 degrees.
    turned = np.roll(both[0, ::-1, ::-1], 1, axis=0)
    whole = np.concatenate([turned, both[1]], axis=1)
    low, high = np.nanquantile(whole, (0.02, 0.995))
    light = np.clip((np.nan_to_num(whole, nan=low) - low) / max(high - low, 1e-9), 0, 1)
    size = (_TILE_PX, _TILE_PX)
    return cv2.resize(light.astype(np.float32), size, interpolation=cv2.INTER_NEAREST_EXACT)


def psf_picture(psfs: Sequence[NDArray[np.floating]]) -> FloatArray:
    """Picture in [0, 1] of PSFs in rows of eight, at one scale, each up to its own maximum."""
    width = max(len(psf) for psf in psfs)
    padded = [np.pad(np.maximum(psf, 0), (width - len(psf)) // 2) for psf in psfs]
    tiles = [enlarged(psf / max(float(psf.max()), 1e-12), _WIDTH_PX) for psf in padded]
    return _tiled(tiles, _PER_ROW, _GAP_LIGHT)
