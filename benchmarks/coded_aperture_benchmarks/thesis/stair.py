"""The stair of blur sizes that thesis 6.3.1 measures blur identification on."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import fftconvolve

from coded_aperture_ros.calibration.psf.fine import mask_psf
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.optics import Mask, PsfStack

SMALLEST_BLUR_PX = 7.0
LARGEST_BLUR_PX = 30.0
LEVELS = 39
SIDE_PX = 125
# Noise and crops come from generators of their own: the crops stay when the noise changes.
_CROPS, _NOISE = 0, 1


@dataclasses.dataclass(frozen=True, eq=False)
class Stair:
    """A coded image whose blur grows in steps from top to bottom, and its truth.

    Attributes
    ----------
    coded : ndarray, float32 [levels * side, side]
        With noise.
    sharp : ndarray, float32 [levels * side, side]
        What `coded` would be without blur and noise.
    level : ndarray, float32 [levels * side, side]
        True level: index into the stack.
    stack : PsfStack
        The PSF of every step.
    noise : float
        Standard deviation of the noise that was added.
    """

    coded: NDArray[np.float32]
    sharp: NDArray[np.float32]
    level: NDArray[np.float32]
    stack: PsfStack
    noise: float


def blur_stack(mask: Mask, levels: int = LEVELS) -> PsfStack:
    """Return the PSFs of thesis 6.3.1: `levels` blur sizes, equally spaced from 7 to 30 px."""
    if levels < 2:
        raise InputError(f"levels: at least 2 are needed, got {levels}")
    return area_psf_stack(mask, np.linspace(SMALLEST_BLUR_PX, LARGEST_BLUR_PX, levels))


def area_psf_stack(mask: Mask, blur_sizes_px: ArrayLike) -> PsfStack:
    """Return PSFs as the thesis has them: the mask's transmission, summed over squares of pixels.

    So a picture is constant within each of its pixels, where
    `coded_aperture_ros.optics.render_psf` interpolates it.
    """
    sizes = np.asarray(blur_sizes_px, dtype=np.float64)
    width = area_psf_width(float(np.abs(sizes).max()))
    psfs = np.array([mask_psf(mask, size).at(width) for size in sizes])
    psfs /= psfs.sum(axis=(1, 2), keepdims=True)
    return PsfStack(sizes, psfs.astype(np.float32))


def area_psf_width(blur_size_px: float) -> int:
    """Return the smallest odd number of pixels whose squares cover a centred PSF."""
    return 2 * int(np.ceil(max(abs(blur_size_px) - 1.0, 0.0) / 2.0)) + 1


def noise_behind(mask: Mask, sigma: float) -> float:
    """Return the noise of an image that is as bright as without the mask (thesis eq. 6.29).

    The less light a mask lets through, the more the image, and its noise, is amplified.
    """
    return sigma / mask.open_fraction


def check_frame_options(sigma: float, side_px: int, part: str) -> None:
    """Check the noise, and the side of a part (such as a step) of what is made."""
    if not (sigma >= 0 and np.isfinite(sigma)):
        raise InputError(f"noise: expected 0 or more, got {sigma}")
    if side_px < 1:
        raise InputError(f"side of a {part}: expected at least 1 px, got {side_px}")


def crops_generator(seed: int) -> np.random.Generator:
    """Return the generator of crops, which is not that of noise: see `with_noise`."""
    return np.random.default_rng([seed, _CROPS])


def with_noise(
    coded: NDArray[np.floating], mask: Mask, sigma: float, seed: int
) -> tuple[NDArray[np.float32], float]:
    """Return a frame with noise, float32, and the standard deviation of that; see `noise_behind`.

    Noise has a generator of its own: the crops stay when the noise changes.
    """
    noise = noise_behind(mask, sigma)
    white = np.random.default_rng([seed, _NOISE]).standard_normal(coded.shape, dtype=np.float32)
    return (coded + np.float32(noise) * white).astype(np.float32), noise


def make_stair(
    mask: Mask,
    textures: Textures,
    sigma: float = 0.0,
    seed: int = 0,
    levels: int = LEVELS,
    side_px: int = SIDE_PX,
) -> Stair:
    """Blur a column of crops, each with the PSF of its step (thesis eq. 6.1).

    The sharp image is one continuous column, so that near a step's boundary light comes from both
    crops; it reaches beyond the stair on all sides, so that no border has to be invented.

    Parameters
    ----------
    textures : Textures
        Every step shows another crop.
    sigma : float, optional
        Noise (standard deviation) behind an open aperture; divided by the mask's open fraction.
    seed : int, optional
        The same seed gives the same crops, and the same noise up to its strength, for every mask.
    levels, side_px : int, optional
        Number of steps, and their side.
    """
    check_frame_options(sigma, side_px, "step")
    stack = blur_stack(mask, levels)
    reach = stack.psfs.shape[-1] // 2
    crop_px = side_px + 2 * reach
    crops = textures.crops(levels, crop_px, crop_px, crops_generator(seed))
    steps = crops[:, reach : reach + side_px].reshape(levels * side_px, crop_px)
    sharp = np.concatenate([crops[0, :reach], steps, crops[-1, reach + side_px :]])
    coded = np.concatenate(
        [
            fftconvolve(sharp[step * side_px : step * side_px + crop_px], psf, mode="valid")
            for step, psf in enumerate(stack.psfs)
        ]
    )
    coded, noise = with_noise(coded, mask, sigma, seed)
    level = np.repeat(np.arange(levels, dtype=np.float32), side_px)
    return Stair(
        coded=coded,
        sharp=sharp[reach : reach + levels * side_px, reach : reach + side_px].copy(),
        level=np.broadcast_to(level[:, None], coded.shape),
        stack=stack,
        noise=noise,
    )


@dataclasses.dataclass(frozen=True)
class LevelError:
    """How far estimated levels are from the true ones.

    Attributes
    ----------
    mean : float
        Mean |estimated - true| level over all pixels (thesis tables 6.1 to 6.4).
    mean_confident : float
        The same over the half of the pixels with the highest confidence; NaN without confidence.
    known : float
        Share of the pixels with an estimate. Where there is none, the middle of the levels is
        scored: saying nothing does not pay.
    """

    mean: float
    mean_confident: float
    known: float


def level_error(
    level: NDArray[np.floating],
    true_level: NDArray[np.floating],
    levels: int,
    confidence: NDArray[np.floating] | None = None,
) -> LevelError:
    """Score estimated levels.

    Parameters
    ----------
    level : ndarray of float, shape [rows, columns]
        NaN where unknown.
    true_level : ndarray of float, shape [rows, columns]
    levels : int
        Number of levels that there are.
    confidence : ndarray of float, shape [rows, columns], optional
    """
    for other in (true_level, level if confidence is None else confidence):
        if other.shape != level.shape:
            raise InputError(
                f"expected arrays of one shape, got {list(level.shape)} and {list(other.shape)}"
            )
    error = np.abs(with_middle(level, levels) - true_level)
    confident = float("nan")
    if confidence is not None:
        confident = float(error[confidence >= np.median(confidence)].mean())
    return LevelError(float(error.mean()), confident, float(np.isfinite(level).mean()))


def with_middle(level: NDArray[np.floating], levels: int) -> NDArray[np.float64]:
    """Return estimated levels with the middle of all levels where nothing is known."""
    return np.where(np.isfinite(level), level, (levels - 1) / 2).astype(np.float64)


def spread_per_step(
    level: NDArray[np.floating], levels: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and standard deviation of the estimates on every step (thesis figure 6.4).

    Parameters
    ----------
    level : ndarray of float, shape [levels * side, side]
        Estimated on a stair.

    Returns
    -------
    (ndarray, ndarray), float64 [levels]
    """
    steps = with_middle(level, levels).reshape(levels, -1)
    return steps.mean(axis=1), steps.std(axis=1)
