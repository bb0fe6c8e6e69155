"""Gaussian model of a pixel and its neighbours, for every blur level (thesis chapter 5)."""

import dataclasses

import numpy as np
import scipy.fft
import scipy.ndimage
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.likelihood.bank import NaturalImagePrior, power_spectrum
from coded_aperture_ros.likelihood.bank.for_camera import psf_stack_for_camera
from coded_aperture_ros.likelihood.bank.hypotheses import RATIOS
from coded_aperture_ros.likelihood.bank.model import check_level_count
from coded_aperture_ros.likelihood.two_pixel.holes import NeighbourLine, find_holes, neighbour_lines
from coded_aperture_ros.likelihood.two_pixel.likelihood import BLOCK_PX, TwoPixelModel
from coded_aperture_ros.optics import Camera, Mask, PsfStack

# Differences to the right, downward, and along the two diagonals; P = 2 in the thesis.
_DIFFERENCES = (
    np.array([[-1.0, 1.0]]),
    np.array([[-1.0], [1.0]]),
    np.array([[-1.0, 0.0], [0.0, 1.0]]),
    np.array([[0.0, -1.0], [1.0, 0.0]]),
)
# Directions nearer to an axis than this (tangent) are smoothed along the other axis.
_MAX_AXIS_TANGENT = np.tan(np.pi / 8)
# Exponents of the power law of texture: white, as in thesis eq. 5.4, and those of photographs.
_SLOPES = (0.0, 1.6, 2.4, 3.2)
# Smallest period of the texture of the model, px.
_MIN_PERIOD_PX = 256
# Error of the model (shading, slants, covariance of lines with each other) as white noise, relative
# to the texture's contrast (standard deviation). Planes of natural texture, noise 0.0001, windows
# of 64 px, channels not smoothed: 0 gives 1.7 to 2.1 levels, 0.006 gives 0.8 to 1.3.
_MODEL_ERROR = 6e-3
# Share of the noise's own variance that keeps its covariance invertible.
_JITTER = 1e-6
# Number of times that neighbours across a line are averaged. Planes of natural texture, noise
# 0.001, window 96 px: 0.93 levels without and 0.82 with it for two_hole, 0.69 and 0.63 for
# four_hole; 4 times is no better.
_SMOOTHING = 2


@dataclasses.dataclass(frozen=True)
class TwoPixelConfig:
    """Window and derivatives of the two-pixel method.

    Examples
    --------
    >>> TwoPixelConfig(window_px=64).derivatives
    2
    """

    window_px: int = option(
        48,
        "Side of the square that local statistics are taken from; a multiple of 8. Larger is more "
        "accurate on planes, smaller is sharper at edges, none is faster.",
        unit="px",
        within=(16, 256),
    )
    derivatives: int = option(
        2,
        "Derivatives of the frame that are compared: 2 are the horizontal and the vertical one, 4 "
        "the two diagonal ones as well.",
        within=(1, 4),
    )

    def __post_init__(self) -> None:
        check_options(self)


def channel_kernel(
    channel: int, direction: NDArray[np.floating] | None = None, smoothing: int = 0
) -> FloatArray:
    """Kernel of a derivative that is smoothed across a direction, float32 [k, k], odd k.

    Blurred texture changes slowly from line to line, so smoothing across a line mostly lowers the
    noise. The kernel is for correlation, as by ``cv2.filter2D``.

    Parameters
    ----------
    channel : int
        0 to 3: difference to the right, downward, or along a diagonal.
    direction : ndarray [2], optional
        Row and column.
    smoothing : int
        How often neighbours across the direction are averaged, an even number.

    References
    ----------
    Martinello 2012, eq. 5.2.
    """
    kernel = _DIFFERENCES[channel]
    if direction is not None and smoothing:
        weights = np.ones(1)
        for _ in range(smoothing):
            weights = np.convolve(weights, [0.5, 0.5])
        down, right = (float(part) for part in direction)
        if abs(down) <= _MAX_AXIS_TANGENT * abs(right):
            across = weights[:, None]
        elif abs(right) <= _MAX_AXIS_TANGENT * abs(down):
            across = weights[None, :]
        else:
            across = np.diag(weights)
            if down * right > 0:
                across = across[:, ::-1]
        wider = np.pad(kernel, [(side // 2, side // 2) for side in across.shape])
        kernel = scipy.ndimage.convolve(wider, across, mode="constant")
    side = max(kernel.shape) // 2 * 2 + 1
    odd = np.zeros((side, side), np.float32)
    odd[: kernel.shape[0], : kernel.shape[1]] = kernel
    return odd


def two_pixel_model_for_camera(
    camera: Camera, near_m: float, far_m: float, levels: int, config: TwoPixelConfig | None = None
) -> TwoPixelModel:
    """Two-pixel model of a camera's mask for a depth range.

    Parameters
    ----------
    camera : Camera
        With a mask of two to eight equal openings.
    near_m, far_m : float
        Depth range on the camera's side of the focal plane, m.
    levels : int
        Number of levels, equally spaced in blur size; at least 2.
    config : TwoPixelConfig, optional

    Raises
    ------
    InputError
        If the mask does not have equal openings, the focus lies inside the range, the range ends at
        infinity, or a blur size does not fit the window.

    References
    ----------
    Martinello 2012, chapter 5.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Camera, Mask
    >>> camera = Camera(640.0, 1.0, 160, 120, Mask.named("two_hole"), 46.0)
    >>> len(two_pixel_model_for_camera(camera, 1.2, 2.4, 5).stack)
    5
    """
    check_level_count(levels)
    find_holes(camera.mask)  # its errors come before those of the range, which no mask depends on
    stack = psf_stack_for_camera(camera, near_m, far_m, levels, "the two-pixel method")
    return two_pixel_model(stack, camera.mask, config)


def two_pixel_model(
    stack: PsfStack, mask: Mask, config: TwoPixelConfig | None = None
) -> TwoPixelModel:
    """Two-pixel model of the blur levels of a mask.

    Parameters
    ----------
    stack : PsfStack
        PSFs of the mask, of at least two levels in order of size, all of one sign.
    mask : Mask
        With two to eight equal openings.
    config : TwoPixelConfig, optional

    Raises
    ------
    InputError
        If the mask has one opening or unequal ones, the levels are not in order or lie on both
        sides of the focal plane, or a PSF is larger than the window.

    References
    ----------
    Martinello 2012, eq. 5.9 to 5.16.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> mask = Mask.named("two_hole")
    >>> two_pixel_model(render_psf_stack(mask, [5.0, 7.0]), mask).lags.shape
    (8, 2)
    """
    config = config or TwoPixelConfig()
    holes = find_holes(mask)
    _check_stack(stack, config)
    lines = neighbour_lines(holes, float(np.abs(stack.blur_sizes_px).max()))
    lags = np.concatenate([line.lags for line in lines])
    period = _MIN_PERIOD_PX
    while period < 4 * max(stack.psfs.shape[-1], config.window_px):
        period *= 2
    torus = (period, period)
    transfers = [np.abs(scipy.fft.rfft2(psf.astype(np.float64), torus)) ** 2 for psf in stack.psfs]
    # A power law without a slope is white.
    textures = [power_spectrum(slope, torus) for slope in _SLOPES]
    numbers = config.derivatives * sum(len(line.positions) for line in lines)
    shape = len(RATIOS), len(_SLOPES), len(stack)
    weights = np.empty((*shape, config.derivatives, len(lags)))
    noise_weights = np.empty((config.derivatives, len(lags)))
    determinants = np.zeros(shape)
    kernels = tuple(
        tuple(channel_kernel(channel, line.direction, _SMOOTHING) for line in lines)
        for channel in range(config.derivatives)
    )
    ends = np.cumsum([len(line.lags) for line in lines])
    for channel, channel_kernels in enumerate(kernels):
        for line, kernel, end in zip(lines, channel_kernels, ends, strict=True):
            part = slice(end - len(line.lags), end)
            at_lags = (line.lags[:, 0] % period, line.lags[:, 1] % period)
            passed = np.abs(np.fft.rfft2(kernel, torus)) ** 2
            noise_covariances = scipy.fft.irfft2(passed, torus)[at_lags]
            whitener = _whitener(noise_covariances[line.pair_lags])
            noise_precision = whitener.T @ whitener
            noise_weights[channel, part] = _sum_by_lag(noise_precision, line) / numbers
            for slope, texture in enumerate(textures):
                for level, transfer in enumerate(transfers):
                    spectrum = texture * transfer * passed
                    covariances = scipy.fft.irfft2(spectrum, torus)[at_lags]
                    precisions, logs = _precisions(whitener, covariances[line.pair_lags])
                    determinants[:, slope, level] += logs / numbers
                    for ratio, precision in enumerate(precisions):
                        weights[ratio, slope, level, channel, part] = (
                            _sum_by_lag(precision, line) / numbers
                        )
    return TwoPixelModel(
        stack=stack,
        holes=holes,
        lines=tuple(lines),
        window_px=config.window_px,
        derivatives=config.derivatives,
        lags=lags,
        kernels=kernels,
        contrasts=tuple(NaturalImagePrior().contrasts),
        ratios=RATIOS,
        weights=weights.reshape(*shape, -1).astype(np.float32),
        log_determinants=determinants.astype(np.float32),
        noise_weights=noise_weights.ravel().astype(np.float32),
        mask_digest=mask.digest,
        learned_from=f"mask {mask.name}, {holes.count} equal openings",
    )


def _whitener(noise: DoubleArray) -> DoubleArray:
    """Matrix W [n, n] that whitens noise of the covariance N [n, n]: ``W N W^T = 1``."""
    count = len(noise)
    factor = np.linalg.cholesky(noise + _JITTER * np.trace(noise) / count * np.eye(count))
    return np.linalg.inv(factor)


def _precisions(whitener: DoubleArray, texture: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Inverses of ``r S + N`` for all ratios r, and logarithms of ``det(r S N^-1 + 1)``.

    They are [S, n, n] and [S]; the whitener of N and the texture's S are [n, n].
    """
    white = whitener @ texture @ whitener.T
    values, vectors = np.linalg.eigh((white + white.T) / 2)
    spread = RATIOS[:, None] * (np.maximum(values, 0) + _MODEL_ERROR**2) + 1
    back = whitener.T @ vectors
    return (back / spread[:, None, :]) @ back.T, np.log(spread).sum(axis=1)


def _sum_by_lag(precision: DoubleArray, line: NeighbourLine) -> DoubleArray:
    """Weights of the covariances at the lags [m] in ``tr(precision C)``."""
    sums = np.zeros(len(line.lags))
    np.add.at(sums, line.pair_lags, precision)
    return sums


def _check_stack(stack: PsfStack, config: TwoPixelConfig) -> None:
    """Raise `InputError` if the levels or their PSFs do not suit the method."""
    if config.window_px % BLOCK_PX:
        below = config.window_px // BLOCK_PX * BLOCK_PX
        raise InputError(
            f"window_px: expected a multiple of {BLOCK_PX} px, got {config.window_px}: use "
            f"{below} or {below + BLOCK_PX}"
        )
    check_level_count(len(stack))
    sizes = stack.blur_sizes_px
    if stack.nominal or not stack.in_pixels:
        raise InputError(
            "psfs: they were measured without their sizes in px, on which the neighbours of a "
            "pixel depend: give sizes_px, or use --method bank"
        )
    if sizes.min() < 0 < sizes.max():
        raise InputError(
            f"blur sizes {sizes.min():g} to {sizes.max():g} px: the focus lies inside the range, "
            "and neighbours are at the same places on both sides of the focal plane, as for any "
            "symmetric mask: narrow the range to one side, or move the focus"
        )
    steps = np.diff(sizes)
    if not ((steps > 0).all() or (steps < 0).all()):
        raise InputError("blur sizes: the levels have to be in order, each larger than the last")
    if stack.psfs.shape[-1] > config.window_px:
        raise InputError(
            f"window_px: a PSF is {stack.psfs.shape[-1]} px wide, more than the window of "
            f"{config.window_px} px: use a larger window, or a range with less blur"
        )
