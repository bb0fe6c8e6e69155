"""Planes whose mask and distances are to be found, and how well they were."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from coded_aperture_benchmarks.thesis.stair import check_frame_options, crops_generator, with_noise
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.metrics.errors import psnr_db
from coded_aperture_ros.optics import Mask, render_psf, render_psf_stack

SMALLEST_PX, LARGEST_PX = 7.0, 30.0
PLANES = 8
_BITS = 8
# Grids of all numbers of cells are compared as pictures of this side.
_SIDE = 132
# Deblurring invents what lies beyond the border.
_BORDER_PX = 32


@dataclasses.dataclass(frozen=True, eq=False)
class BlindPlanes:
    """Pictures of planes in random order.

    Attributes
    ----------
    coded : ndarray, float32 [planes, rows, columns]
        With noise, in 256 steps, as a camera's pictures are.
    sharp : ndarray, float32 [planes, rows, columns]
    blur_sizes_px : ndarray, float64 [planes]
    """

    coded: NDArray[np.float32]
    sharp: NDArray[np.float32]
    blur_sizes_px: NDArray[np.float64]
    mask: Mask


def make_blind_planes(
    mask: Mask,
    textures: Textures,
    sigma: float = 0.001,
    seed: int = 0,
    planes: int = PLANES,
    shape: tuple[int, int] = (384, 384),
) -> BlindPlanes:
    """Blur a crop of its own for every plane, from 7 to 30 px.

    Parameters
    ----------
    sigma : float, optional
        Noise (standard deviation) behind an open aperture; divided by the mask's open fraction.
    seed : int, optional
        The same seed gives the same crops, and the same order, for every mask.
    planes : int, optional
        How many, equally spaced in blur size.
    shape : (int, int), optional
        Rows and columns of the pictures.
    """
    check_frame_options(sigma, min(shape), "plane")
    if planes < 2:
        raise InputError(f"planes: at least 2 are needed, got {planes}")
    random = crops_generator(seed)
    sizes = random.permutation(np.linspace(SMALLEST_PX, LARGEST_PX, planes))
    psfs = [render_psf(mask, size) for size in sizes]
    reach = max(len(psf) for psf in psfs) // 2
    crops = textures.crops(planes, shape[0] + 2 * reach, shape[1] + 2 * reach, random)
    coded = []
    for crop, psf in zip(crops, psfs, strict=True):
        spare = reach - len(psf) // 2
        near = crop[spare : crop.shape[0] - spare, spare : crop.shape[1] - spare]
        coded.append(fftconvolve(near, psf, mode="valid"))
    noisy, _ = with_noise(np.stack(coded), mask, sigma, seed)
    steps = 2**_BITS - 1
    return BlindPlanes(
        coded=np.asarray(np.rint(np.clip(noisy, 0, 1) * steps) / steps, np.float32),
        sharp=crops[:, reach : reach + shape[0], reach : reach + shape[1]].copy(),
        blur_sizes_px=sizes,
        mask=mask,
    )


def mask_correlation(found: Mask, true: Mask) -> float:
    """Correlation of two masks as pictures of one size, the better of both orientations.

    Orientations are as found, and turned by 180 degrees.
    """
    first, second = _picture(found), _picture(true)
    return max(
        float(np.corrcoef(turned.ravel(), second.ravel())[0, 1])
        for turned in (first, first[::-1, ::-1])
    )


def _picture(mask: Mask) -> NDArray[np.float32]:
    """Draw the square that the extent is the side of."""
    rows, columns = mask.transmission.shape
    side = max(rows, columns)
    size = (round(_SIDE * columns / side), round(_SIDE * rows / side))
    cells = cv2.resize(mask.transmission, size, interpolation=cv2.INTER_NEAREST_EXACT)
    drawn = np.zeros((_SIDE, _SIDE), np.float32)
    top, left = (_SIDE - size[1]) // 2, (_SIDE - size[0]) // 2
    drawn[top : top + size[1], left : left + size[0]] = cells
    return drawn


@dataclasses.dataclass(frozen=True)
class DeblurringLoss:
    """What deblurring loses by a mask that was found, dB.

    Attributes
    ----------
    true_db : float
        PSNR with the true PSFs, mean of the planes.
    found_db : float
        With those found, in the better of both orientations.
    largest_loss_db : float
        At the plane where it loses most.
    """

    true_db: float
    found_db: float
    largest_loss_db: float


def deblurring_loss(
    planes: BlindPlanes, found: Mask, blur_sizes_px: NDArray[np.float64], method: str = "fast"
) -> DeblurringLoss:
    """Deblur all planes with the true and with the found PSFs.

    Parameters
    ----------
    blur_sizes_px : ndarray, float64 [planes]
        As found.
    method : str, optional
        See `DeblurConfig`.
    """
    true = _deblurred_db(planes, planes.mask, planes.blur_sizes_px, method)
    either = [_deblurred_db(planes, found, sign * blur_sizes_px, method) for sign in (1, -1)]
    best = max(either, key=lambda db: float(db.mean()))
    return DeblurringLoss(float(true.mean()), float(best.mean()), float((true - best).max()))


def _deblurred_db(
    planes: BlindPlanes, mask: Mask, sizes_px: NDArray[np.float64], method: str
) -> NDArray[np.float64]:
    deblurrer = Deblurrer(render_psf_stack(mask, np.sort(sizes_px)), DeblurConfig(method=method))
    inside = slice(_BORDER_PX, -_BORDER_PX)
    found = []
    for coded, sharp, size in zip(planes.coded, planes.sharp, sizes_px, strict=True):
        blur = np.full(coded.shape, size, np.float32)
        found.append(psnr_db(deblurrer.deblur(coded, blur)[inside, inside], sharp[inside, inside]))
    deblurrer.close()
    return np.array(found)
