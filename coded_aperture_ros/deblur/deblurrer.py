"""Deblurrer: the all-in-focus frame from a coded frame and its depth. Begin to read here."""

from functools import cache

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.blas import one_blas_thread
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.core.workers import Workers, thread_count
from coded_aperture_ros.deblur.blend import Blend, unsupported_reason
from coded_aperture_ros.deblur.blur_map import (
    filled_blur_map,
    known_pixels,
    safe_blur_map,
    smooth_within_surfaces,
)
from coded_aperture_ros.deblur.config import DeblurConfig
from coded_aperture_ros.deblur.fast import ClosedForm, Fast, Inverse
from coded_aperture_ros.deblur.iterative import Iterative, blur_operator
from coded_aperture_ros.deblur.least_squares import solve_least_squares, solve_sparse
from coded_aperture_ros.deblur.operator import crop_to_frame
from coded_aperture_ros.deblur.problem import (
    Method,
    Problem,
    VideoState,
    full_resolution_motion,
    measured_pixels,
    opponents,
)
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.deblur.uncertainty import Uncertainty, classify_pixels, estimate_uncertainty
from coded_aperture_ros.frames import KnownNoise, channel_noise, check_frame
from coded_aperture_ros.likelihood import torch_device
from coded_aperture_ros.optics import PsfStack

# How far edges of the depth of what moves may be off, px.
_EDGE_REACH_PX = 10


class Deblurrer:
    """All-in-focus frames of a camera with one PSF for each blur size.

    Parameters
    ----------
    stack : PsfStack
        PSFs of the blur levels, as in a filter bank.
    config : DeblurConfig, optional
    progress : callable, optional
        Wraps the iterations over one frame of `cg` and `sparse`, as ``tqdm.tqdm`` does.

    References
    ----------
    Martinello 2012, chapter 6.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros import Deblurrer
    >>> from coded_aperture_ros.deblur import DeblurConfig
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> stack = render_psf_stack(Mask.named("levin"), np.linspace(1, 9, 9))
    >>> deblurrer = Deblurrer(stack, DeblurConfig(method="inverse"))
    >>> coded = np.random.default_rng(0).random((64, 96), np.float32)
    >>> blur_size_px = np.full((64, 96), 5, np.float32)
    >>> deblurrer.deblur(coded, blur_size_px, noise=0.002).shape
    (64, 96)
    """

    def __init__(
        self, stack: PsfStack, config: DeblurConfig | None = None, progress: Progress = iter
    ) -> None:
        self.stack = stack
        self.config = config or DeblurConfig()
        self._progress = progress
        self._basis = cache(lambda: PsfBasis.from_stack(stack))
        self._workers = Workers(thread_count(self.config.threads))
        self._closed_form = self._new_closed_form()
        self._blend = self._new_blend()
        self._method = self._new_method()
        self._video = VideoState(self.config.temporal_frames)

    def prepare(self, shape: Shape) -> None:
        """Make the filters for frames of `shape` (rows, columns) before the first one."""
        if self._blend is not None:
            self._blend.prepare(shape)
        else:
            self._closed_form.prepare(shape)

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""
        self._video.reset()

    def reconfigure(self, config: DeblurConfig) -> None:
        """Use other settings from the next frame on. Any option may change.

        Another `rank`, `band`, `network`, `backend` or number of `threads` makes new filters: the
        next frame waits unless `prepare` is called. Another `temporal_frames` begins another video.
        """
        old = self.config
        self.config = config
        if config.threads != old.threads:
            self._workers.close()
            self._workers = Workers(thread_count(config.threads))
        made = ("threads", "rank", "band", "network", "backend")
        if any(getattr(config, name) != getattr(old, name) for name in made):
            self._closed_form = self._new_closed_form()
            self._blend = None
        if config.temporal_frames != old.temporal_frames:
            self._video = VideoState(config.temporal_frames)
        # Its filters take time to make: kept for when another method asks for them.
        self._blend = self._blend or self._new_blend()
        self._method = self._new_method()

    @property
    def removes_motion(self) -> bool:
        """Whether the method can remove motion blur too."""
        return self._method.removes_motion

    def close(self) -> None:
        """End the worker threads."""
        self._workers.close()

    @one_blas_thread
    def deblur(
        self,
        frame: FloatArray,
        blur_size_px: FloatArray,
        noise: float | None = None,
        motion_px: FloatArray | None = None,
    ) -> FloatArray:
        """All-in-focus frame, float32, shape of `frame`, in [0, 1].

        Parameters
        ----------
        frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
            Coded frame, linear light.
        blur_size_px : ndarray, float32 [map rows, map columns]
            Signed blur sizes in pixels of the frame; not finite where the depth is unknown. The map
            covers the whole frame, and may be smaller.
        noise : float, optional
            Standard deviation of the noise of one channel, with its shot noise. By default that of
            the configuration, and if that is 0, an estimate; see `channel_noise`. A `FramePipeline`
            always gives it, as it knows the noise of camera and bank, too.
        motion_px : ndarray, float32 [map rows, map columns, 2], optional
            Motion during the exposure, right and down, in pixels of the frame; not finite where
            unknown. The map covers the whole frame. Methods `cg` and `sparse` remove it, without
            occlusion (thesis 7.5).

        Raises
        ------
        InputError
            If the frame or a map has a wrong shape or type, no blur size is known, the frame is too
            small to estimate its noise, or `fast` or `inverse` is to remove motion.
        """
        check_frame(frame)
        motion = full_resolution_motion(motion_px, frame.shape)
        if motion is not None and not self._method.removes_motion:
            method = self.config.method
            raise InputError(f"motion: method {method} removes no motion, use cg or sparse")
        recorded = frame
        frame, measured, clipped = measured_pixels(frame, self.config.saturation)
        blur = self._blur_map(blur_size_px, frame, moves=motion is not None)
        noise = noise or self._noise_by_config(frame)
        channels, frame_count = self._video.add(opponents(frame), noise)
        known = known_pixels(blur_size_px, frame.shape)
        data = channels, frame_count, measured, clipped, blur, known, motion, noise
        problem = Problem(*data, self._progress)
        sharp = self._method.restore(problem, self._video)
        if not (measured | clipped).all():
            as_recorded = np.isfinite(recorded) & (recorded >= self.config.saturation)
            as_recorded[clipped] = False
            sharp = np.where(as_recorded, recorded, sharp)
        return np.clip(sharp, 0, 1)

    def uncertainty(
        self,
        frame: FloatArray,
        sharp: FloatArray,
        blur_size_px: FloatArray,
        noise: float | None = None,
    ) -> Uncertainty:
        """Standard deviation of each pixel of an all-in-focus frame, and how it came about.

        It takes a second of one processor at 640x480, as it models occlusion. For frames that a
        video averages, it uses the noise of one.

        Parameters
        ----------
        frame, blur_size_px, noise
            The arguments of `deblur`.
        sharp : ndarray, float32, like `frame`
            Its result.

        Returns
        -------
        Uncertainty

        Raises
        ------
        InputError
            As `deblur`, or if `sharp` has another shape than `frame`.
        """
        for each in (frame, sharp):
            check_frame(each)
        frame, measured, _ = measured_pixels(frame, self.config.saturation)
        noise = noise or self._noise_by_config(frame)
        blur = filled_blur_map(blur_size_px, frame)
        operator = blur_operator(self._basis(), blur, self._workers, self.config.occlusion)
        seen = crop_to_frame(operator.adjoint(measured.astype(np.float32))[0], operator)
        known = known_pixels(blur_size_px, frame.shape)
        kind = classify_pixels(blur, known, seen, self.stack.in_pixels)
        return estimate_uncertainty(frame, np.asarray(sharp, np.float32), measured, kind, noise)

    def _noise_by_config(self, frame: FloatArray) -> float:
        """Noise of one channel where the caller gives none: as configured, else estimated.

        The rule for depth and deblurring alike is that of `FramePipeline`.
        """
        return channel_noise(frame, KnownNoise(self.config.noise, self.config.noise_gain))

    def _blur_map(self, blur_size_px: FloatArray, frame: FloatArray, moves: bool) -> FloatArray:
        """Blur sizes for the method [rows / reduction, columns / reduction], px of the frame."""
        blur = filled_blur_map(blur_size_px, frame, self._method.reduction)
        if not self.stack.in_pixels:
            return blur
        if moves:
            return smooth_within_surfaces(safe_blur_map(blur, _EDGE_REACH_PX, 1))
        return safe_blur_map(blur, self._method.edge_reach_px, self._method.reduction)

    def _new_closed_form(self) -> ClosedForm:
        return ClosedForm(self.stack, self.config.rank, self.config.band, self._workers)

    def _new_blend(self) -> Blend | None:
        method = self.config.method
        band = self.config.band
        closed = method == "inverse" or (method == "fast" and band == "half")
        if closed or unsupported_reason(self.stack):
            return None
        device = torch_device(self.config.backend)
        if device is not None:
            from coded_aperture_ros.deblur.blend.on_device.blend import DeviceBlend

            return DeviceBlend(self.stack, self.config.rank, self._workers, device)
        return Blend(self.stack, self.config.rank, self._workers, self.config.network)

    def _new_method(self) -> Method:
        if self.config.method in ("fast", "inverse"):
            blends = self.config.method == "fast" and self.config.band == "full"
            if blends and self._blend is not None:
                return Fast(self.config, self._blend)
            return Inverse(self.config, self._closed_form)
        minimise = {"cg": solve_least_squares, "sparse": solve_sparse}[self.config.method]
        filters = self._closed_form, self._blend, self._basis
        return Iterative(minimise, self.config, *filters, self._workers)
