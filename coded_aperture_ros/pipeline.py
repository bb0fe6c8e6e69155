"""A frame goes in; depth, confidence and the all-in-focus picture come out.

This is where a reader begins. The nodes, the commands, recorded bags and Python programs all go
through `FramePipeline`; `docs/architecture.md` walks on from here.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from itertools import repeat
from typing import Any

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.core.stamp_order import StampOrder
from coded_aperture_ros.deblur import DeblurConfig, make_deblurrer
from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator, estimate_video
from coded_aperture_ros.frames import KnownNoise, channel_noise
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.rotation import ExpectedMotion


class LateFrameError(InputError):
    """A frame of a video is older than the one before it."""


@dataclasses.dataclass(frozen=True, eq=False)
class FrameResult:
    """What was made of a frame.

    Attributes
    ----------
    depth : DepthEstimate
        Level, blur size, depth in metres with its standard deviation, confidence and, where the
        method finds it, motion.
    stamp : int or None
        Of the frame.
    """

    depth: DepthEstimate
    stamp: int | None
    _deblur: Callable[[], FloatArray] = dataclasses.field(repr=False)

    @cached_property
    def all_in_focus(self) -> FloatArray:
        """The frame without its blur, float32 in [0, 1], like the frame.

        It is made when first asked for, with the pipeline's settings of that time. With
        `DeblurConfig.temporal_frames` ask for it frame by frame, in order. An `InputError` if the
        pipeline does not deblur, or no depth is known in the whole frame.
        """
        return self._deblur()


class FramePipeline:
    """Turns the coded frames of one camera into depth and all-in-focus pictures.

    Parameters
    ----------
    model : LikelihoodModel
        A filter bank, or what another method knows about the mask; see `new_model`.
    camera : Camera, optional
        Turns blur sizes into metres, and may know its noise.
    deblur : DeblurConfig or None, optional
        None: no all-in-focus pictures.
    progress : callable, optional
        See `Deblurrer`.

    Raises
    ------
    InputError
        If the model is not for the camera.
    """

    def __init__(
        self,
        model: LikelihoodModel,
        camera: Camera | None = None,
        depth: DepthConfig | None = None,
        deblur: DeblurConfig | None = DeblurConfig(),  # noqa: B008  frozen
        progress: Progress = iter,
    ) -> None:
        self.estimator, self._progress = DepthEstimator(model, depth, camera), progress
        self._deblurrer = None if deblur is None else make_deblurrer(model, deblur, progress)
        self._order = StampOrder()

    @property
    def deblurs(self) -> bool:
        """Whether all-in-focus pictures are made."""
        return self._deblurrer is not None

    @property
    def remembers(self) -> bool:
        """Whether what is made of a frame depends on the frames before it."""
        averaged = self._deblurrer is not None and self._deblurrer.config.temporal_frames > 0
        return averaged or self.estimator.config.temporal_frames > 0

    def __call__(
        self,
        frame: FloatArray,
        stamp: int | None = None,
        *,
        size: Shape | None = None,
        prior: ExpectedMotion | None = None,
        coloured: FloatArray | None = None,
        hidden_noise: float = 0.0,
    ) -> FrameResult:
        """Work on one frame.

        Parameters
        ----------
        frame, size, prior, hidden_noise
            See `DepthEstimator.estimate`.
        stamp : int, optional
            Time of the frame, ns. Where time has gone back, another video begins.
        coloured : ndarray, float32 [rows, columns, 3], optional
            What is deblurred in place of a grey frame; see `colour_from_mosaic`.

        Raises
        ------
        LateFrameError
            If the stamp is a little older than the last one, and frames depend on those before.
        InputError
            If the frame has a wrong shape or type, or is smaller than the model's window.
        """
        self._follow(stamp)
        estimate = self.estimator.estimate(frame, size, prior, hidden_noise)
        return self._result(frame if coloured is None else coloured, estimate, stamp)

    def video(
        self,
        frames: Iterable[FloatArray],
        size: Shape | None = None,
        hidden_noise: Iterable[float] = repeat(0.0),
    ) -> Iterator[FrameResult]:
        """Work on a recorded video, each frame in the light of those before and after it.

        Needs `DepthConfig.temporal_frames` above 0. Takes and raises what `estimate_video` does.
        """
        waiting: list[FloatArray] = []

        def kept() -> Iterator[FloatArray]:
            for frame in frames:
                waiting.append(frame)
                yield frame

        for estimate in estimate_video(self.estimator, kept(), size, hidden_noise):
            yield self._result(waiting.pop(0), estimate, None)

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""
        self._order.forget()
        self._forget_video()

    def reconfigure(
        self,
        *,
        model: LikelihoodModel | None = None,
        camera: Camera | None = None,
        depth: DepthConfig | None = None,
        deblur: DeblurConfig | None = None,
    ) -> None:
        """Go on with other settings, from the next frame on; what is not given stays.

        With the same model, camera and settings of depth nothing is planned anew, and the memory of
        the video is kept; so it is of deblurring while the model stays. If the model is not for the
        camera, there is an `InputError`, and everything stays as it was.
        """
        old = self.estimator
        model, depth, camera = model or old.model, depth or old.config, camera or old.camera
        if model is not old.model or depth != old.config or camera != old.camera:
            self.estimator = DepthEstimator(model, depth, camera, like=old)
            old.close()
        deblurrer = self._deblurrer
        config = deblur or (deblurrer.config if deblurrer else None)
        if config is None:
            return
        stack = self.estimator.model.stack
        if deblurrer is not None and deblurrer.stack is stack:
            deblurrer.reconfigure(config)
            return
        self._deblurrer = make_deblurrer(self.estimator.model, config, self._progress)
        if deblurrer is not None:
            deblurrer.close()

    def close(self) -> None:
        """End the threads that the work was shared among."""
        self.estimator.close()
        if self._deblurrer is not None:
            self._deblurrer.close()

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        """Send to another process what the pipeline was made of; threads and memory stay behind."""
        made_of = self.estimator.model, self.estimator.camera, self.estimator.config
        return FramePipeline, (*made_of, self._deblurrer.config if self._deblurrer else None)

    def _follow(self, stamp: int | None) -> None:
        if stamp is None:
            return
        order = self._order.follow(stamp)
        if order == "restart":
            self._forget_video()
        elif order == "late" and self.remembers:
            raise LateFrameError("a frame is older than the one before it")

    def _forget_video(self) -> None:
        self.estimator.reset()
        if self._deblurrer is not None:
            self._deblurrer.reset()

    def _result(self, frame: FloatArray, estimate: DepthEstimate, stamp: int | None) -> FrameResult:
        return FrameResult(estimate, stamp, lambda: self._deblurred(frame, estimate))

    def _deblurred(self, frame: FloatArray, estimate: DepthEstimate) -> FloatArray:
        deblurrer = self._deblurrer
        if deblurrer is None:
            raise InputError("deblurring: the pipeline was made without it")
        motion_px = None
        if estimate.motion is not None and deblurrer.removes_motion:
            motion_px = estimate.motion.vectors_px
        # Not what depth has estimated, which is of the mean of the channels: so the picture is the
        # same as where depth comes from elsewhere.
        noise = channel_noise(frame, KnownNoise.of(deblurrer.config, self.estimator.known_noise))
        return deblurrer.deblur(frame, estimate.blur_size_px, noise, motion_px)
