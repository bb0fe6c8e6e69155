"""Energies of every level by the Gaussian model of a pixel and its neighbours."""

import dataclasses
import math
from functools import partial

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray, PerPatch
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import EngineLikelihood, plausible_ratios, take_logarithm
from coded_aperture_ros.likelihood.bank import DEFAULT_STRIDE_PX
from coded_aperture_ros.likelihood.scoring import MIN_NOISE_SHARE
from coded_aperture_ros.likelihood.two_pixel.holes import Holes, NeighbourLine
from coded_aperture_ros.optics import Camera, PsfStack

# Patches whose hypotheses are compared at a time: large products, but no more than a cache holds.
_PATCHES = 128
# No kernel is wider, px.
_MAX_KERNEL_PX = 16
# Statistics are sums over blocks of pixels of this side, or of its common divisor with the stride.
BLOCK_PX = 8
# Numbers of a window in one independent measurement: its pixels are correlated, and so are the
# lines through them. Chosen so that confidence is right on planes.
_WINDOW_CORRELATION = 4.0
# A square window counts its border as much as its middle, and widens foregrounds by this much more
# than a Hann window. On two planes (blur 10 and 14 or 22 px, noise 0.001) the error within 16 px of
# the edge halves, from 5.2 to 2.6 levels.
_FATTENING = 1.8


@dataclasses.dataclass(frozen=True, eq=False)
class TwoPixelModel:
    """Gaussian model of a mask of equal openings; a `LikelihoodModel`.

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

    References
    ----------
    Martinello 2012, chapter 5.

    Examples
    --------
    >>> from coded_aperture_ros.likelihood.two_pixel import two_pixel_model
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> mask = Mask.named("two_hole")
    >>> model = two_pixel_model(render_psf_stack(mask, [5.0, 7.0]), mask)
    >>> grey = np.random.default_rng(0).random((64, 64), np.float32)
    >>> model.plan((64, 64), stride_px=8).cost(grey, noise=0.01).volume.shape
    (3, 3, 2)
    """

    stack: PsfStack  # the L levels
    holes: Holes
    lines: tuple[NeighbourLine, ...]
    window_px: int  # side of the window of the statistics, px
    derivatives: int  # number P of channels
    # [F, 2]; lags of all lines, one after the other; measured for every channel.
    lags: IndexArray
    # Each [k, k]; of every channel, for every line: smoothed across the line.
    kernels: tuple[tuple[FloatArray, ...], ...]
    contrasts: tuple[float, ...]  # variances of texture, the same under any noise
    ratios: DoubleArray  # [S]; grid of ``a / s^2``, in half decades
    # [S, slopes, L, P * F]; weights of the measured covariances over ``s^2`` in the mean of
    # ``v^T V^-1 v``.
    weights: FloatArray
    # [S, slopes, L]; of ``a / s^2 S_d N^-1 + 1``, per number of the vectors.
    log_determinants: FloatArray
    noise_weights: FloatArray  # [P * F]; as `weights`, without texture
    mask_digest: str  # digest of the mask's pattern
    learned_from: str  # origin of the model, for a person to read
    noise: float = 0.0  # standard deviation, linear light; 0: estimated in each frame
    stride_px: int = DEFAULT_STRIDE_PX  # default distance between the windows, px

    @property
    def fattening(self) -> float:
        """Excess width of foregrounds; see `LikelihoodModel`."""
        return _FATTENING

    def for_view(self, camera: Camera | None) -> "TwoPixelModel":
        """Model itself: its PSFs do not change over the image."""
        return self

    def plan(
        self, shape: tuple[int, ...], stride_px: int, backend: str = "numpy", threads: int = 1
    ) -> EngineLikelihood:
        """Likelihood for frames of one size; always on the processor."""
        engine = TwoPixelEngine(self, shape, stride_px, threads)
        return EngineLikelihood(engine, _WINDOW_CORRELATION)


class TwoPixelEngine:
    """Energies of every window of frames of one size; an `Engine`.

    The covariance of a channel at a lag is the mean, over a window, of the products of pixels at
    that distance; a product lies halfway between its two pixels. Products are added up in
    blocks first, once for all windows, and a window's blocks by running sums: the time depends on
    the size of the frame and the number of lags, not on that of the window.
    """

    name = "numpy"

    def __init__(
        self, model: TwoPixelModel, shape: tuple[int, ...], stride_px: int, threads: int = 1
    ) -> None:
        self._model = model
        self.grid = grid = PatchGrid.covering(shape, model.window_px, stride_px)
        self._workers = Workers(threads)
        # Windows that overlap share their blocks.
        self._block = block = math.gcd(BLOCK_PX, stride_px)
        self._across = model.window_px // block
        self._blocks = tuple(
            ((count - 1) * stride_px + model.window_px) // block
            for count in (grid.rows, grid.columns)
        )
        # Beyond the frame there is nothing: products with that are zero, and do not count.
        self._margin = int(np.abs(model.lags).max()) // 2 + _MAX_KERNEL_PX
        rows, columns = (count * block for count in self._blocks)
        # Pixels at the frame's border, which a kernel covers in part, do not count.
        self._reach = max(len(kernel) // 2 for kernels in model.kernels for kernel in kernels)
        self._valid = rows - 2 * self._reach, columns - 2 * self._reach
        padded = rows + 2 * self._margin, columns + 2 * self._margin
        lines = len(model.lines)
        self._channels = np.zeros((model.derivatives, lines, *padded), np.float32)
        self._line_of_lag = np.repeat(np.arange(lines), [len(line.lags) for line in model.lines])
        patches = grid.rows * grid.columns
        lags = len(model.lags)
        self._covariances = np.empty((model.derivatives * lags + 1, patches), np.float32)
        self._covariances[-1] = 1  # for the constant of the hypotheses
        self._shares = [self._inverse_counts(lag) for lag in model.lags]
        gains = np.exp(model.log_determinants)[..., None]
        least_noise = np.full_like(gains, MIN_NOISE_SHARE)
        self._hypotheses = np.concatenate([model.weights, least_noise], axis=-1) * gains
        self._energies = np.empty((len(model.stack), patches), np.float32)
        compared = len(model.contrasts) * model.weights.shape[1] * len(model.stack)
        # Buffers of each thread.
        self._columns = np.empty((threads, self._blocks[0], columns), np.float32)
        self._excess = np.empty((threads, compared * _PATCHES), np.float32)

    def project(self, grey: FloatArray) -> None:
        """Take a frame [rows, columns]: measure its local covariances."""
        grid, margin, (rows, columns) = self.grid, self._margin, self._valid
        covered = grey[grid.top :, grid.left :]
        covered = covered[: rows + 2 * self._reach, : columns + 2 * self._reach]

        def filter_frame(number: int, thread: int) -> None:
            channel, line = divmod(number, len(self._model.lines))
            passed = cv2.filter2D(covered, -1, self._model.kernels[channel][line])
            valid = passed[self._reach : self._reach + rows, self._reach : self._reach + columns]
            padded = self._channels[channel, line]
            padded[margin : margin + rows, margin : margin + columns] = valid

        self._workers.each(filter_frame, range(self._channels.shape[0] * self._channels.shape[1]))
        # One product of the frame with itself for each lag and channel; the last row is constant.
        self._workers.each(self._measure, range(len(self._covariances) - 1))

    def energies(self, noise: PerPatch) -> FloatArray:
        """Energies of the last projected frame [rows, columns, L]."""
        grid = self.grid
        model = self._model
        compared = plausible_ratios(model.ratios, model.contrasts, float(np.median(noise)))
        hypotheses = self._hypotheses[compared].reshape(-1, self._hypotheses.shape[-1])
        precision = np.empty((grid.rows, grid.columns), np.float32)
        precision[:] = 1 / np.square(noise)
        starts = range(0, precision.size, _PATCHES)
        self._workers.each(partial(self._compare, hypotheses, precision.ravel()), starts)
        return np.moveaxis(self._energies.reshape(-1, grid.rows, grid.columns), 0, -1)

    def close(self) -> None:
        """Stop the engine's threads."""
        self._workers.close()

    def _measure(self, number: int, thread: int) -> None:
        """Measure the covariances of one channel at one lag, in all windows."""
        channel, index = divmod(number, len(self._model.lags))
        padded, lag = self._channels[channel, self._line_of_lag[index]], self._model.lags[index]
        blocks, block = self._blocks, self._block
        rows, columns = (count * block for count in blocks)
        # The first row and column that count lie `reach` into the first block.
        corner = self._margin - self._reach
        top, left = corner - _half_shift(lag[0]), corner - _half_shift(lag[1])
        ends = top + lag[0], left + lag[1]
        first = padded[top : top + rows, left : left + columns]
        second = padded[ends[0] : ends[0] + rows, ends[1] : ends[1] + columns]
        shape = blocks[0], block, columns
        sums = self._columns[thread]
        # The products are added up as they are formed: they never leave the cache.
        np.einsum("brc,brc->bc", first.reshape(shape), second.reshape(shape), out=sums)
        means = cv2.resize(sums, blocks[::-1], interpolation=cv2.INTER_AREA)
        windows = cv2.boxFilter(
            means,
            -1,
            (self._across, self._across),
            anchor=(0, 0),
            normalize=False,
            borderType=cv2.BORDER_CONSTANT,
        )
        step, grid = self.grid.stride_px // block, self.grid
        windows = windows[
            : (grid.rows - 1) * step + 1 : step, : (grid.columns - 1) * step + 1 : step
        ]
        down, across = self._shares[index]
        out = self._covariances[number].reshape(grid.rows, grid.columns)
        np.multiply(windows, down, out=out)
        out *= across

    def _compare(
        self, hypotheses: FloatArray, precision: FloatArray, start: int, thread: int
    ) -> None:
        """Compute the energies of a group of windows; see `TwoPixelModel`."""
        group = slice(start, min(start + _PATCHES, len(precision)))
        measured = self._covariances[:, group].copy()
        measured[:-1] *= precision[group]
        count = measured.shape[1]
        excess = self._excess[thread, : len(hypotheses) * count].reshape(len(hypotheses), count)
        np.matmul(hypotheses, measured, out=excess)
        energies = self._energies[:, group]
        np.minimum.reduce(excess.reshape(-1, len(energies), count), axis=0, out=energies)
        textureless = self._model.noise_weights @ measured[:-1] + MIN_NOISE_SHARE
        take_logarithm(energies, textureless, self._model.window_px**2)

    def _inverse_counts(self, lag: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Factors by row and by column that turn the sums of windows into means."""
        grid = self.grid
        down, across = (
            self._counts(int(shift), axis, count)
            for axis, (shift, count) in enumerate(zip(lag, (grid.rows, grid.columns), strict=True))
        )
        # Resizing has divided by the width of a block.
        scale = np.float32(self._block)
        return (1 / down)[:, None].astype(np.float32), (scale / across).astype(np.float32)

    def _counts(self, shift: int, axis: int, windows: int) -> DoubleArray:
        """Number of products of each window along an axis, for a shift between their pixels, px."""
        length, valid = self._blocks[axis] * self._block, self._valid[axis]
        first = np.arange(length) - _half_shift(shift) - self._reach
        inside = (first >= 0) & (first < valid) & (first + shift >= 0) & (first + shift < valid)
        total = np.concatenate([[0], np.cumsum(inside)])
        starts = np.arange(windows) * self.grid.stride_px
        return np.maximum(total[starts + self._model.window_px] - total[starts], 1).astype(float)


def _half_shift(shift: int) -> int:
    """Whole pixels from the first of two pixels to the middle between them."""
    return int(shift) // 2 if shift >= 0 else -(int(-shift) // 2)
