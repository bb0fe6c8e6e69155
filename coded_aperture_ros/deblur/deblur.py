"""The all-in-focus frame from a coded frame and its depth, by one of three methods."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.blur_map import (
    calm,
    model_weight,
    sharper_near_edges,
    without_specks,
)
from coded_aperture_ros.deblur.colour import from_opponents, opponents
from coded_aperture_ros.deblur.config import DeblurConfig
from coded_aperture_ros.deblur.fast import InverseFilters, smoothed
from coded_aperture_ros.deblur.fill import filled_blur_map
from coded_aperture_ros.deblur.half_band import HalfBandFilters
from coded_aperture_ros.deblur.moving import MovingBlur, check_motion
from coded_aperture_ros.deblur.occlusion import OccludedBlur
from coded_aperture_ros.deblur.operator import BlurOperator, SpreadingBlur
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.deblur.restore import restore_quadratic, restore_sparse
from coded_aperture_ros.deblur.steady import SteadyFrames
from coded_aperture_ros.imaging import PatchGrid, check_frame, estimate_noise, filled, high_power
from coded_aperture_ros.likelihood import torch_device
from coded_aperture_ros.optics import PsfStack

_NOISE_WINDOW_PX = 32
_LEAST_SIDE_PX = 8
# One bad pixel beyond these bounds would spoil the whole frame through its Fourier transform.
_DARKEST, _BRIGHTEST = -1.0, 2.0
# Colour differences have less texture than brightness, but as much noise: they are deblurred as if
# they had so many times more.
_COLOUR_NOISE = 2.0
# The closed form cannot leave out pixels whose depth is wrong: it keeps farther from edges.
_FAST_REACH = 1.4
# The share of the places in a video that may have more noise than is reckoned with.
_FEW = 0.1
# Residual, in units of the noise, from which a pixel's depth is taken for wrong.
_MISFIT, _MISFIT_OF_EXACT_DEPTH = 2.0, 2.8
# Occlusion is reckoned with, unless told otherwise, where its weights fit into so much memory.
_OCCLUSION_BYTES = 512 * 2**20


class Deblurrer:
    """Makes the frames of a camera all-in-focus.

    Parameters
    ----------
    stack : PsfStack
        PSFs of the blur levels, as a filter bank has them.
    config : DeblurConfig, optional
    """

    def __init__(self, stack: PsfStack, config: DeblurConfig | None = None) -> None:
        self.stack = stack
        self.config = config or DeblurConfig()
        self._workers = Workers(self.config.threads)
        rank = self.config.rank
        filters = HalfBandFilters if self.config.band == "half" else InverseFilters
        self._inverse = filters(stack, rank, self._workers)
        self._of_colour = filters(stack, max(rank // 2, 2), self._workers)
        self._basis: PsfBasis | None = None
        frames = self.config.temporal_frames
        self._steady = SteadyFrames(frames) if frames else None

    def prepare(self, shape: tuple[int, int]) -> None:
        """Compute beforehand what the first frame of `shape` (rows, columns) would wait for."""
        self._inverse.prepare(shape)
        self._of_colour.prepare(shape)

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""
        if self._steady is not None:
            self._steady.reset()

    def close(self) -> None:
        """End the threads that the work was shared among."""
        self._workers.close()

    def deblur(
        self,
        frame: NDArray[np.float32],
        blur_size_px: NDArray[np.float32],
        noise: float | None = None,
        motion_px: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Return the all-in-focus frame.

        Parameters
        ----------
        frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
            Coded frame in linear light.
        blur_size_px : ndarray, float32 [map rows, map columns]
            Signed blur sizes in pixels of the frame. The map covers the whole frame, may be
            smaller, and is not finite where the depth is unknown.
        noise : float, optional
            Standard deviation of the noise of one channel. By default the configured one, and if
            that is 0, an estimate.
        motion_px : ndarray, float32 [map rows, map columns, 2], optional
            Way during the exposure, to the right, and down, in pixels of the frame, of what has
            moved; not finite where it is unknown. The map covers the whole frame. Methods `cg` and
            `sparse` remove it, without occlusion (thesis 7.5).

        Returns
        -------
        ndarray, float32, like `frame`
            In [0, 1].

        Raises
        ------
        InputError
            If the frame or a map has a wrong shape or type, no blur size is known, the frame is too
            small for its noise to be estimated, or `fast` is to remove motion.
        """
        check_frame(frame)
        motion = self._checked_motion(motion_px, frame.shape)
        usable, frame = _usable(frame)
        blur = self._safe_blur(blur_size_px, frame)
        if motion is not None and self.stack.in_pixels and self.config.edge_reach:
            blur = calm(blur)
        noise = noise or self.config.noise or _estimated_noise(frame)
        channels = opponents(frame)
        frames = np.ones((1, 1), np.float32)
        if self._steady is not None:
            channels, frames = self._steady.add(channels, noise)
        if self.config.method == "fast":
            # One noise for the whole frame: that of places with few frames, which would show it.
            few = float(np.quantile(frames, _FEW)) if frames.size > 1 else 1.0
            noise *= float(np.sqrt(self.config.smoothness / few))
            sharp = from_opponents(self._in_closed_form(channels, blur, noise))
            if self.config.band == "full":
                # Of the lower half of the frequencies it gains 0.04 dB.
                sharp = smoothed(sharp)
            return np.clip(sharp, 0, 1)
        usable &= _everywhere(frame < self.config.saturation)
        restored = self._restored(channels, frames, blur, noise, usable, motion)
        return np.clip(from_opponents(restored), 0, 1)

    def _checked_motion(
        self, motion_px: NDArray[np.float32] | None, shape: tuple[int, ...]
    ) -> NDArray[np.float32] | None:
        """Return a map of motion in the size of the frame; None where nothing moves."""
        if motion_px is None:
            return None
        check_motion(motion_px)
        if not np.nan_to_num(motion_px).any():
            return None
        if self.config.method == "fast":
            raise InputError("motion: method fast removes no motion, use cg or sparse")
        motion = np.ascontiguousarray(motion_px, np.float32)
        size = (shape[1], shape[0])
        return np.asarray(cv2.resize(motion, size, interpolation=cv2.INTER_NEAREST_EXACT))

    def _safe_blur(
        self, blur_size_px: NDArray[np.float32], frame: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the blur sizes to deblur by, for the closed form in a smaller map."""
        fast = self.config.method == "fast"
        reduction, reach = (self._inverse.reduction, _FAST_REACH) if fast else (1, 1.0)
        blur = filled_blur_map(blur_size_px, frame, reduction=reduction)
        if self.stack.in_pixels and self.config.edge_reach:
            reach_px = round(reach * self.config.edge_reach / reduction)
            blur = sharper_near_edges(without_specks(blur, reduction), reach_px)
        return blur

    def _restored(
        self,
        channels: list[NDArray[np.float32]],
        frames: NDArray[np.float32],
        blur: NDArray[np.float32],
        noise: float,
        usable: NDArray[np.bool_],
        motion: NDArray[np.float32] | None = None,
    ) -> list[NDArray[np.float32]]:
        """Solve for the whole frame, beginning with the last result or what the closed form gives.

        `frames` says how many frames the channels are the mean of.
        """
        config = self.config
        most = float(np.max(frames))
        noise /= float(np.sqrt(most))
        # Edges that are too sharp are found and lost again more easily than blurred ones.
        small = filled_blur_map(blur, channels[0], reduction=self._inverse.reduction)
        start = self._in_closed_form(channels, small, noise / 3)
        if self._steady is not None:
            start = self._steady.start(start, np.broadcast_to(frames, blur.shape))
        problem = (
            self._operator(blur, motion),
            channels,
            model_weight(blur, noise) * usable * (frames / np.float32(most)),
            start,
            noise,
            config.smoothness,
            config.tolerance,
            config.iterations,
        )
        if config.method == "cg":
            restored, _ = restore_quadratic(*problem)
        else:
            misfit = _MISFIT if config.edge_reach else _MISFIT_OF_EXACT_DEPTH
            restored, _ = restore_sparse(*problem, misfit)
        if self._steady is not None:
            self._steady.keep(restored)
        return restored

    def _in_closed_form(
        self, channels: list[NDArray[np.float32]], blur: NDArray[np.float32], noise: float
    ) -> list[NDArray[np.float32]]:
        places = self._inverse.places(blur)
        brightness, differences = channels[:1], channels[1:]
        if differences:
            differences = self._of_colour.apply(differences, places, _COLOUR_NOISE * noise)
        return self._inverse.apply(brightness, places, noise) + differences

    def _operator(
        self, blur: NDArray[np.float32], motion: NDArray[np.float32] | None
    ) -> BlurOperator:
        if self._basis is None:
            self._basis = PsfBasis.of(self.stack)
        if motion is not None:
            return MovingBlur(self._basis, blur, motion, self._workers)
        device = torch_device(self.config.backend) if self.config.method == "cg" else None
        if device is not None:
            from coded_aperture_ros.deblur.torch_blur import TorchBlur

            return TorchBlur(self._basis, blur, device, self._workers.threads)
        offsets = self._basis.kernels[0].size
        occlusion = self.config.occlusion
        fits = self.stack.in_pixels and 4 * offsets * blur.size <= _OCCLUSION_BYTES
        # Conjugate gradients that stop early gain nothing from it, and take 1.7 times as long.
        sparse = self.config.method == "sparse"
        if occlusion == "yes" or (occlusion == "auto" and sparse and fits):
            return OccludedBlur(self._basis, blur, self._workers)
        return SpreadingBlur(self._basis, blur, self._workers)


def _usable(frame: NDArray[np.float32]) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Return which pixels are numbers that can be, and the frame with the others filled."""
    # A NaN makes both comparisons false.
    usable = (frame > _DARKEST) & (frame < _BRIGHTEST)
    if not usable.all():
        channels = [np.ascontiguousarray(channel) for channel in np.atleast_3d(frame).T]
        masks = np.atleast_3d(usable).T
        frame = np.stack([filled(*pair) for pair in zip(channels, masks, strict=True)]).T.reshape(
            frame.shape
        )
    return _everywhere(usable), np.ascontiguousarray(frame, np.float32)


def _everywhere(condition: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where all channels meet a condition [rows, columns]."""
    if condition.ndim == 2:
        return condition
    # Much faster than a reduction along so short an axis.
    return condition[..., 0] & condition[..., 1] & condition[..., 2]


def _estimated_noise(frame: NDArray[np.float32]) -> float:
    # Sparse windows of one channel tell enough about the noise of a whole frame.
    channel = np.ascontiguousarray(frame if frame.ndim == 2 else frame[..., 1])
    height, width = channel.shape
    if min(height, width) < _LEAST_SIDE_PX:
        raise InputError(
            f"frame of {width}x{height} px is too small to estimate its noise, give the noise"
        )
    window = min(_NOISE_WINDOW_PX, 2 * (min(channel.shape) // 2))
    return estimate_noise(high_power(channel, PatchGrid.covering(channel.shape, window, window)))
