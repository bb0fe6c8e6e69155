"""The all-in-focus frame from a coded frame and its depth: where to begin to read."""

from functools import cache

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.core.workers import Workers, thread_count
from coded_aperture_ros.deblur.blend import Blend, unsupported_reason
from coded_aperture_ros.deblur.blur_map import (
    filled_blur_map,
    known_pixels,
    safe_blur_map,
    smoothed_over_surfaces,
)
from coded_aperture_ros.deblur.config import DeblurConfig
from coded_aperture_ros.deblur.fast import ClosedForm, Fast, Inverse
from coded_aperture_ros.deblur.iterative import Iterative, blur_operator
from coded_aperture_ros.deblur.least_squares import solve_least_squares, solve_sparse
from coded_aperture_ros.deblur.operator import frame_within
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
from coded_aperture_ros.optics import PsfStack

# How far edges of the depth of what moves may be off, px.
_EDGE_REACH_PX = 10


class Deblurrer:
    """Makes the frames of a camera all-in-focus.

    Parameters
    ----------
    stack : PsfStack
        PSFs of the blur levels, as a filter bank has them.
    progress : callable, optional
        Wraps the iterations over one frame of `cg` and `sparse`, as ``tqdm.tqdm`` does.
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
        """Compute beforehand what the first frame of `shape` (rows, columns) would wait for."""
        if self._blend is not None:
            self._blend.prepare(shape)
        else:
            self._closed_form.prepare(shape)

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""
        self._video.reset()

    def reconfigure(self, config: DeblurConfig) -> None:
        """Deblur by other settings from the next frame on. Any option may change.

        Another `rank`, `band`, `network` or number of `threads` makes the filters anew: the next
        frame waits unless `prepare` is called. Another `temporal_frames` begins another video.
        """
        old = self.config
        self.config = config
        if config.threads != old.threads:
            self._workers.close()
            self._workers = Workers(thread_count(config.threads))
        made = ("threads", "rank", "band", "network")
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
        """Whether the method can remove blur by motion too."""
        return self._method.removes_motion

    def close(self) -> None:
        """End the threads that the frames were shared among."""
        self._workers.close()

    def deblur(
        self,
        frame: FloatArray,
        blur_size_px: FloatArray,
        noise: float | None = None,
        motion_px: FloatArray | None = None,
    ) -> FloatArray:
        """Return the all-in-focus frame.

        Parameters
        ----------
        frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
            Coded frame in linear light.
        blur_size_px : ndarray, float32 [map rows, map columns]
            Signed blur sizes in pixels of the frame. The map covers the whole frame, may be
            smaller, and is not finite where the depth is unknown.
        noise : float, optional
            Standard deviation of the noise of one channel, with its shot noise. By default what is
            configured, and where that is 0, an estimate; see `channel_noise`.
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
            small for its noise to be estimated, or `fast` or `inverse` is to remove motion.
        """
        check_frame(frame)
        motion = full_resolution_motion(motion_px, frame.shape)
        if motion is not None and not self._method.removes_motion:
            method = self.config.method
            raise InputError(f"motion: method {method} removes no motion, use cg or sparse")
        recorded = frame
        frame, measured, shines = measured_pixels(frame, self.config.saturation)
        blur = self._blur_map(blur_size_px, frame, moves=motion is not None)
        noise = noise or channel_noise(frame, KnownNoise.of(self.config))
        channels, frame_count = self._video.add(opponents(frame), noise)
        known = known_pixels(blur_size_px, frame.shape)
        data = channels, frame_count, measured, shines, blur, known, motion, noise
        problem = Problem(*data, self._progress)
        sharp = self._method.restore(problem, self._video)
        if not (measured | shines).all():
            as_recorded = np.isfinite(recorded) & (recorded >= self.config.saturation)
            as_recorded[shines] = False
            sharp = np.where(as_recorded, recorded, sharp)
        return np.clip(sharp, 0, 1)

    def uncertainty(
        self,
        frame: FloatArray,
        sharp: FloatArray,
        blur_size_px: FloatArray,
        noise: float | None = None,
    ) -> Uncertainty:
        """Return how far each pixel of an all-in-focus frame can be relied on.

        It takes a second of one processor at 640x480, as occlusion is reckoned with. Of frames that
        a video averages the noise is that of one.

        Parameters
        ----------
        frame, blur_size_px, noise
            What `deblur` was given.
        sharp : ndarray, float32, like `frame`
            What it has made of them.

        Raises
        ------
        InputError
            As from `deblur`, or if `sharp` has another shape than `frame`.
        """
        for each in (frame, sharp):
            check_frame(each)
        frame, measured, _ = measured_pixels(frame, self.config.saturation)
        noise = noise or channel_noise(frame, KnownNoise.of(self.config))
        blur = filled_blur_map(blur_size_px, frame)
        operator = blur_operator(self._basis(), blur, self._workers, self.config.occlusion)
        seen = frame_within(operator.adjoint(measured.astype(np.float32))[0], operator)
        known = known_pixels(blur_size_px, frame.shape)
        kind = classify_pixels(blur, known, seen, self.stack.in_pixels)
        return estimate_uncertainty(frame, np.asarray(sharp, np.float32), measured, kind, noise)

    def _blur_map(self, blur_size_px: FloatArray, frame: FloatArray, moves: bool) -> FloatArray:
        """Return the blur sizes to deblur by, as much smaller as the method wants them."""
        blur = filled_blur_map(blur_size_px, frame, self._method.reduction)
        if not self.stack.in_pixels:
            return blur
        if moves:
            return smoothed_over_surfaces(safe_blur_map(blur, _EDGE_REACH_PX, 1))
        return safe_blur_map(blur, self._method.edge_reach_px, self._method.reduction)

    def _new_closed_form(self) -> ClosedForm:
        return ClosedForm(self.stack, self.config.rank, self.config.band, self._workers)

    def _new_blend(self) -> Blend | None:
        method = self.config.method
        band = self.config.band
        closed = method == "inverse" or (method == "fast" and band == "half")
        if closed or unsupported_reason(self.stack):
            return None
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
