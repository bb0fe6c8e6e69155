"""A picture of a found mask and of the spectra that it explains, for people to look at."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.blind.find import BlindMask
from coded_aperture_ros.calibration.tiles import tiled

_TILE_PX, _PER_ROW, _GAP_LIGHT = 192, 5, 0.3


def blind_picture(found: BlindMask) -> NDArray[np.float32]:
    """Draw the mask, then the spectrum of each plane, least blurred first, in [0, 1].

    The left half of a spectrum is measured, the right half what the mask makes of smooth texture;
    the halves of a real spectrum mirror each other.
    """
    tiles = [_mask_tile(found.mask.transmission)]
    tiles += [_halves(*found.spectra[plane]) for plane in np.argsort(found.blur_sizes_px)]
    return tiled(tiles, _PER_ROW, _GAP_LIGHT)


def _mask_tile(transmission: NDArray[np.float32]) -> NDArray[np.float32]:
    rows, columns = transmission.shape
    scale = _TILE_PX / max(rows, columns)
    size = (round(columns * scale), round(rows * scale))
    drawn = np.zeros((_TILE_PX, _TILE_PX), np.float32)
    top, left = (_TILE_PX - size[1]) // 2, (_TILE_PX - size[0]) // 2
    cells = cv2.resize(transmission, size, interpolation=cv2.INTER_NEAREST_EXACT)
    drawn[top : top + size[1], left : left + size[0]] = cells
    return drawn


def _halves(measured: NDArray, explained: NDArray) -> NDArray[np.float32]:
    """Draw two half spectra side by side, zero frequency in the middle."""
    both = np.fft.fftshift(np.stack([measured, explained]), axes=1)[..., :-1]
    # The half with negative horizontal frequencies is the other, turned by 180 degrees.
    turned = np.roll(both[0, ::-1, ::-1], 1, axis=0)
    whole = np.concatenate([turned, both[1]], axis=1)
    low, high = np.nanquantile(whole, (0.02, 0.995))
    light = np.clip((np.nan_to_num(whole, nan=low) - low) / max(high - low, 1e-9), 0, 1)
    size = (_TILE_PX, _TILE_PX)
    return np.asarray(
        cv2.resize(light.astype(np.float32), size, interpolation=cv2.INTER_NEAREST_EXACT)
    )
