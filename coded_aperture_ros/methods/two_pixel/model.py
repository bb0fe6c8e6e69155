"""The Gaussian model of a pixel and its neighbours, for every blur level."""

import dataclasses

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.bank import DEFAULT_STRIDE_PX, NaturalImagePrior, power_spectrum
from coded_aperture_ros.bank.learning import RATIOS, check_levels, psf_stack_for_camera
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.methods.two_pixel.config import SimpleConfig
from coded_aperture_ros.methods.two_pixel.derivatives import channel_kernel, passed_power
from coded_aperture_ros.methods.two_pixel.holes import Holes, find_holes
from coded_aperture_ros.methods.two_pixel.lines import NeighbourLine, neighbour_lines
from coded_aperture_ros.optics import Camera, Mask, PsfStack

# White texture, as thesis eq. 5.4 has it, and photographs' fall-offs of power with frequency.
_SLOPES = (0.0, 1.6, 2.4, 3.2)
# Statistics are sums over blocks of pixels of this side, or of its common divisor with the stride.
BLOCK_PX = 8
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
# The pixels of a window repeat each other, and so do the lines through them: by how much the
# likelihood overstates the evidence. Chosen so that confidence is right on planes.
_EVIDENCE_REPETITION = 4.0


@dataclasses.dataclass(frozen=True, eq=False)
class NeighbourModel:
    """What depth estimation needs to know of a simple mask; stands in for a `FilterBank`.

    A pixel ``p`` of a high-pass channel and its neighbours on a line are a Gaussian vector ``v`` of
    n numbers (thesis eq. 5.9 to 5.11). Its covariance at level ``d`` is ``a S_d + s^2 N``: ``S_d``
    is the autocovariance of unit-contrast texture seen through the channel and the level's PSF, at
    the lags between the pixels, and ``N`` that of white noise seen through the channel. The vector
    holds the neighbours ``N_p`` (eq. 5.18) of all levels, so that the levels explain the same
    numbers. Twice the negative logarithm of its likelihood is, averaged over a window, ::

        E_d = min over a, slope of  sum  [ tr( (a S_d + s^2 N)^-1 C ) + log det(a S_d + s^2 N) ]

    summed over channels and lines, where ``C`` is the *measured* covariance: linear in what the
    window shows at the lags. By the chain rule this is eq. 5.14 with the conditional mean and
    variance of eq. 5.15 and 5.16, one pixel of the line after the other. As in `FilterBank`, only
    ``a / s^2`` enters the weights, and the best noise of a hypothesis is found in closed form.

    Attributes
    ----------
    stack : PsfStack
        The L levels.
    holes : Holes
    lines : tuple of NeighbourLine
    window_px : int
        Side of the window of the statistics.
    derivatives : int
        Number P of channels.
    lags : ndarray, intp [F, 2]
        The lags of all lines, one after the other; measured for every channel.
    kernels : tuple of tuples of ndarray, float32 [k, k]
        That of every channel, for every line: smoothed across the line.
    contrasts : int
        How many of the ratios are tried for one noise.
    ratios : ndarray, float64 [S]
        Grid of ``a / s^2``, in half decades.
    weights : ndarray, float32 [S, slopes, L, P * F]
        What multiplies the measured covariances over ``s^2``, for the mean of ``v^T V^-1 v``.
    log_determinants : ndarray, float32 [S, slopes, L]
        Of ``a / s^2 S_d N^-1 + 1``, per number of the vectors.
    noise_weights : ndarray, float32 [P * F]
        As `weights`, without texture.
    mask_digest : str
        Digest of the mask's pattern.
    learned_from : str
        What the model is of, for a person to read.
    noise : float
        0: the noise of a frame is estimated, unless it is given.
    stride_px : int
        Distance between the windows, unless another is asked for.
    """

    stack: PsfStack
    holes: Holes
    lines: tuple[NeighbourLine, ...]
    window_px: int
    derivatives: int
    lags: NDArray[np.intp]
    kernels: tuple[tuple[NDArray[np.float32], ...], ...]
    contrasts: int
    ratios: NDArray[np.float64]
    weights: NDArray[np.float32]
    log_determinants: NDArray[np.float32]
    noise_weights: NDArray[np.float32]
    mask_digest: str
    learned_from: str
    noise: float = 0.0
    stride_px: int = DEFAULT_STRIDE_PX
    pattern: None = None

    @property
    def blur_sizes_px(self) -> NDArray[np.float64]:
        """Signed blur size of every level [L], px."""
        return self.stack.blur_sizes_px

    @property
    def levels(self) -> int:
        """Number L of levels."""
        return len(self.stack.blur_sizes_px)

    @property
    def evidence_repetition(self) -> float:
        """How many numbers of a window tell one thing; see `FilterBank.evidence_repetition`."""
        return _EVIDENCE_REPETITION

    def plausible_ratios(self, noise: float) -> slice:
        """Return which ratios belong to textures' contrasts under a noise of this deviation."""
        wanted = min(NaturalImagePrior().contrasts) / noise**2
        first = int(np.argmin(np.abs(np.log(self.ratios / wanted))))
        first = min(first, len(self.ratios) - self.contrasts)
        return slice(first, first + self.contrasts)


def neighbour_model_for_camera(
    camera: Camera,
    near_m: float,
    far_m: float,
    levels: int,
    config: SimpleConfig | None = None,
) -> NeighbourModel:
    """Make the model of a camera's mask for a range of depths.

    Parameters
    ----------
    camera : Camera
    near_m, far_m : float
        On the camera's side of the focal plane.
    levels : int
        Equally spaced in blur size; at least 2.
    config : SimpleConfig, optional

    Raises
    ------
    InputError
        If the mask is not of equal openings, the focus lies inside the range, the range ends at
        infinity, or a blur size does not fit the window.
    """
    check_levels(levels)
    find_holes(camera.mask)  # what is wrong with the mask is told first: no range helps it
    stack = psf_stack_for_camera(camera, near_m, far_m, levels, "the method for simple masks")
    return neighbour_model(stack, camera.mask, config)


def neighbour_model(
    stack: PsfStack, mask: Mask, config: SimpleConfig | None = None
) -> NeighbourModel:
    """Make the model of a simple mask's blur levels.

    Parameters
    ----------
    stack : PsfStack
        The PSFs of the mask, of at least two levels in order of size, all of one sign.
    mask : Mask
        Of two or more equal openings.
    config : SimpleConfig, optional

    Returns
    -------
    NeighbourModel

    Raises
    ------
    InputError
        If the mask has one opening or unequal ones, the levels are not in order or lie on both
        sides of the focal plane, or a PSF is larger than the window.
    """
    config = config or SimpleConfig()
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
            passed = passed_power(kernel, period)
            of_noise = scipy.fft.irfft2(passed, torus)[at_lags]
            whitener = _Whitener(of_noise[line.lag_of_pair])
            none = whitener.precision_of_noise()
            noise_weights[channel, part] = _sums_of_lags(none, line) / numbers
            for slope, texture in enumerate(textures):
                for level, transfer in enumerate(transfers):
                    of_texture = scipy.fft.irfft2(texture * transfer * passed, torus)[at_lags]
                    precisions, logs = whitener.precisions(of_texture[line.lag_of_pair])
                    determinants[:, slope, level] += logs / numbers
                    for ratio, precision in enumerate(precisions):
                        weights[ratio, slope, level, channel, part] = (
                            _sums_of_lags(precision, line) / numbers
                        )
    return NeighbourModel(
        stack=stack,
        holes=holes,
        lines=tuple(lines),
        window_px=config.window_px,
        derivatives=config.derivatives,
        lags=lags,
        kernels=kernels,
        contrasts=len(NaturalImagePrior().contrasts),
        ratios=RATIOS,
        weights=weights.reshape(*shape, -1).astype(np.float32),
        log_determinants=determinants.astype(np.float32),
        noise_weights=noise_weights.ravel().astype(np.float32),
        mask_digest=mask.digest,
        learned_from=f"mask {mask.name}, {holes.count} equal openings",
    )


class _Whitener:
    """Inverts ``r S + N`` for a noise covariance N and all ratios r at once."""

    def __init__(self, noise: NDArray[np.float64]) -> None:
        count = len(noise)
        factor = np.linalg.cholesky(noise + _JITTER * np.trace(noise) / count * np.eye(count))
        self._inverse = np.linalg.inv(factor)

    def precision_of_noise(self) -> NDArray[np.float64]:
        """Return the inverse of N."""
        return np.asarray(self._inverse.T @ self._inverse)

    def precisions(
        self, texture: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the inverses [S, n, n], and the logarithms of ``det(r S N^-1 + 1)`` [S]."""
        white = self._inverse @ texture @ self._inverse.T
        values, vectors = np.linalg.eigh((white + white.T) / 2)
        spread = RATIOS[:, None] * (np.maximum(values, 0) + _MODEL_ERROR**2) + 1
        back = self._inverse.T @ vectors
        return (back / spread[:, None, :]) @ back.T, np.log(spread).sum(axis=1)


def _sums_of_lags(precision: NDArray[np.float64], line: NeighbourLine) -> NDArray[np.float64]:
    """Add up the pairs of one lag: ``tr(precision C)`` is linear in the covariances at the lags."""
    sums = np.zeros(len(line.lags))
    np.add.at(sums, line.lag_of_pair, precision)
    return sums


def _check(stack: PsfStack, config: SimpleConfig) -> None:
    if config.window_px % BLOCK_PX:
        below = config.window_px // BLOCK_PX * BLOCK_PX
        raise InputError(
            f"window_px: expected a multiple of {BLOCK_PX} px, got {config.window_px}: use "
            f"{below} or {below + BLOCK_PX}"
        )
    check_levels(len(stack))
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
