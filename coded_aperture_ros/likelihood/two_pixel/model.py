"""The Gaussian model of a pixel and its neighbours, for every blur level."""

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
# Directions (row, column) that are nearer to an axis than this have the other axis across them.
_NEARLY_AXIS = np.tan(np.pi / 8)
# White texture, as thesis eq. 5.4 has it, and photographs' fall-offs of power with frequency.
_SLOPES = (0.0, 1.6, 2.4, 3.2)
_SMALLEST_PERIOD = 256
# What the model leaves unexplained, shading and slants and the covariance of lines with each other,
# acts like this share of the texture's contrast (standard deviation) in white noise. Planes of
# natural texture, noise 0.0001, windows of 64 px, channels not smoothed: 0 gives 1.7 to 2.1 levels,
# 0.006 gives 0.8 to 1.3.
_MODEL_ERROR = 6e-3
# Share of the noise's own variance that keeps its covariance invertible.
_JITTER = 1e-6
# How often neighbours across a line are averaged. Planes of natural texture, noise 0.001, window
# 96 px: 0.93 levels without and 0.82 with it for two_hole, 0.69 and 0.63 for four_hole; 4 times is
# no better.
_SMOOTHING = 2


@dataclasses.dataclass(frozen=True)
class TwoPixelConfig:
    """Which neighbours and derivatives are compared, and over which window."""

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
    """Return the kernel [k, k], odd k, of a derivative that is smoothed across a direction.

    Smoothing across a line leaves what is on it as it is, but for the noise: the texture that the
    blur has left changes slowly from line to line. To be correlated, as by ``cv2.filter2D``.

    `channel` is 0 to 3: the difference to the right, downward, or along a diagonal. The direction
    [2] is (row, column). Neighbours across it are averaged `smoothing` times, an even number.
    """
    kernel = _DIFFERENCES[channel]
    if direction is not None and smoothing:
        weights = np.ones(1)
        for _ in range(smoothing):
            weights = np.convolve(weights, [0.5, 0.5])
        down, right = (float(part) for part in direction)
        if abs(down) <= _NEARLY_AXIS * abs(right):
            across = weights[:, None]
        elif abs(right) <= _NEARLY_AXIS * abs(down):
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
    """Make the model of a camera's mask for a range of depths on its side of the focal plane.

    The levels, at least 2, are equally spaced in blur size. Raises `InputError` if the mask is not
    of equal openings, the focus lies inside the range, the range ends at infinity, or a blur size
    does not fit the window.
    """
    check_level_count(levels)
    find_holes(camera.mask)  # what is wrong with the mask comes first: no range helps it
    stack = psf_stack_for_camera(camera, near_m, far_m, levels, "the two-pixel method")
    return two_pixel_model(stack, camera.mask, config)


def two_pixel_model(
    stack: PsfStack, mask: Mask, config: TwoPixelConfig | None = None
) -> TwoPixelModel:
    """Make the model of the blur levels.

    The stack has the PSFs of the mask, of at least two levels in order of size, all of one sign;
    the mask has two or more equal openings. Raises `InputError` if the mask has one opening or
    unequal ones, the levels are not in order or lie on both sides of the focal plane, or a PSF is
    larger than the window.
    """
    config = config or TwoPixelConfig()
    holes = find_holes(mask)
    _check(stack, config)
    lines = neighbour_lines(holes, float(np.abs(stack.blur_sizes_px).max()))
    lags = np.concatenate([line.lags for line in lines])
    period = _SMALLEST_PERIOD
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
    for channel, of_channel in enumerate(kernels):
        for line, kernel, end in zip(lines, of_channel, ends, strict=True):
            part = slice(end - len(line.lags), end)
            at_lags = (line.lags[:, 0] % period, line.lags[:, 1] % period)
            passed = np.abs(np.fft.rfft2(kernel, torus)) ** 2
            of_noise = scipy.fft.irfft2(passed, torus)[at_lags]
            whitener = _whitener(of_noise[line.lag_of_pair])
            none = whitener.T @ whitener  # the inverse of the noise's covariance
            noise_weights[channel, part] = _sums_of_lags(none, line) / numbers
            for slope, texture in enumerate(textures):
                for level, transfer in enumerate(transfers):
                    of_texture = scipy.fft.irfft2(texture * transfer * passed, torus)[at_lags]
                    precisions, logs = _precisions(whitener, of_texture[line.lag_of_pair])
                    determinants[:, slope, level] += logs / numbers
                    for ratio, precision in enumerate(precisions):
                        weights[ratio, slope, level, channel, part] = (
                            _sums_of_lags(precision, line) / numbers
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
    """Return the matrix W [n, n] of noise with the covariance N: ``W N W^T = 1``."""
    count = len(noise)
    factor = np.linalg.cholesky(noise + _JITTER * np.trace(noise) / count * np.eye(count))
    return np.linalg.inv(factor)


def _precisions(whitener: DoubleArray, texture: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Invert ``r S + N`` for all ratios r; return also the logarithms of ``det(r S N^-1 + 1)``.

    They are [S, n, n] and [S].
    """
    white = whitener @ texture @ whitener.T
    values, vectors = np.linalg.eigh((white + white.T) / 2)
    spread = RATIOS[:, None] * (np.maximum(values, 0) + _MODEL_ERROR**2) + 1
    back = whitener.T @ vectors
    return (back / spread[:, None, :]) @ back.T, np.log(spread).sum(axis=1)


def _sums_of_lags(precision: DoubleArray, line: NeighbourLine) -> DoubleArray:
    """Add up the pairs of one lag: ``tr(precision C)`` is linear in the covariances at the lags."""
    sums = np.zeros(len(line.lags))
    np.add.at(sums, line.lag_of_pair, precision)
    return sums


def _check(stack: PsfStack, config: TwoPixelConfig) -> None:
    if config.window_px % BLOCK_PX:
        below = config.window_px // BLOCK_PX * BLOCK_PX
        raise InputError(
            f"window_px: expected a multiple of {BLOCK_PX} px, got {config.window_px}: use "
            f"{below} or {below + BLOCK_PX}"
        )
    check_level_count(len(stack))
    sizes = stack.blur_sizes_px
    if not stack.in_pixels:
        raise InputError(
            "psfs: they were measured without their sizes in px, which say where a pixel's "
            "neighbours are: give sizes_px, or use --method bank"
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
