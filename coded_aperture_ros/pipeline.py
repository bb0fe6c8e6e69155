"""A frame goes in; depth, confidence and the all-in-focus picture come out.

This is where a reader begins. The nodes, the commands, recorded bags and Python programs all go
through `FramePipeline`; `docs/architecture.md` walks on from here.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.deblur import AnyDeblurrer, DeblurConfig, Uncertainty, make_deblurrer
from coded_aperture_ros.deblur.levels import RenderedLevels
from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator, estimate_video
from coded_aperture_ros.depth.levels import check_camera
from coded_aperture_ros.depth.range_check import checked_blur_sizes_px
from coded_aperture_ros.frames import Frame, KnownNoise, View, channel_noise
from coded_aperture_ros.frames.frame import LateFrameError, StampOrder
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.optics import Camera

# PSFs alone are enough for deblurring by depth from elsewhere.
AnyModel = LikelihoodModel | RenderedLevels


class FramePipeline:
    """Turns the coded frames of one camera into depth and all-in-focus pictures.

    Parameters
    ----------
    model : LikelihoodModel or RenderedLevels
        A filter bank, or what another method knows about the mask; see `new_model`. PSFs alone
        are enough for deblurring by depth from elsewhere.
    camera : Camera, optional
        Of the whole view. It turns blur sizes into metres, and may know its noise.
    depth : DepthConfig, optional
    deblur : DeblurConfig or None, optional
        None: no all-in-focus pictures.
    progress : callable, optional
        See `Deblurrer`.

    Raises
    ------
    InputError
        If the model is not for the camera.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(2, 9, 15)))
    >>> frame = Frame(np.random.default_rng(0).random((96, 128), np.float32))
    >>> everywhere = DepthConfig(confidence_threshold=0.0, check_fit=False)
    >>> pipeline = FramePipeline(bank, depth=everywhere)
    >>> estimate = pipeline(frame)
    >>> pipeline.deblur(frame, estimate).shape
    (96, 128)
    """

    def __init__(
        self,
        model: AnyModel,
        camera: Camera | None = None,
        depth: DepthConfig | None = None,
        deblur: DeblurConfig | None = DeblurConfig(),  # noqa: B008  frozen
        progress: Progress = iter,
    ) -> None:
        self.model = model
        self.camera = camera
        self.depth_config = depth or DepthConfig()
        self._view: View | None = None  # of the last frame
        self._estimator = _new_estimator(model, self.depth_config, camera)
        self._progress = progress
        self._deblurrer = None if deblur is None else self._new_deblurrer(deblur)
        self._order = StampOrder()

    @property
    def estimator(self) -> DepthEstimator:
        """Estimator of depth, for the view of the last frame.

        Raises
        ------
        InputError
            If the model has PSFs only.
        """
        if self._estimator is None:
            raise InputError("depth: PSFs alone give no depth, the pipeline needs a filter bank")
        return self._estimator

    @property
    def deblurs(self) -> bool:
        """Whether all-in-focus pictures are made."""
        return self._deblurrer is not None

    @property
    def remembers(self) -> bool:
        """Whether what is made of a frame depends on the frames before it."""
        averaged = self._deblurrer is not None and self._deblurrer.config.temporal_frames > 0
        return averaged or self.depth_config.temporal_frames > 0

    def __call__(self, frame: Frame | FloatArray, size: Shape | None = None) -> DepthEstimate:
        """Depth and everything else that the stages find of one frame.

        Where the stamp has gone back, another video begins.

        Parameters
        ----------
        frame : Frame or ndarray, float32 [rows, columns] or [rows, columns, 3]
        size : (int, int), optional
            Rows and columns of the maps; the frame's by default.

        Raises
        ------
        LateFrameError
            If the stamp is a little older than the last one, and frames depend on those before.
        InputError
            If the frame has a wrong shape or type, is smaller than the model's window, or shows
            what cannot be a region of the camera's view.
        """
        frame = Frame.of(frame)
        self._follow(frame.stamp_ns)
        self._show(frame)
        return self.estimator.estimate(frame, size)

    def video(
        self, frames: Iterable[Frame | FloatArray], size: Shape | None = None
    ) -> Iterator[tuple[Frame, DepthEstimate]]:
        """Each frame of a recorded video, with its depth by those before and after it.

        Needs `DepthConfig.temporal_frames` above 0. Another video begins. Raises what
        `estimate_video` does.
        """
        self.reset()
        waiting: deque[Frame] = deque()
        following = map(Frame.of, frames)
        first = next(following, None)
        if first is None:
            return
        self._show(first)

        def kept() -> Iterator[Frame]:
            for frame in chain([first], following):
                waiting.append(frame)
                yield frame

        for estimate in estimate_video(self.estimator, kept(), size):
            yield waiting.popleft(), estimate

    def deblur(
        self,
        frame: Frame | FloatArray,
        depth: DepthEstimate | FloatArray | None = None,
        motion_px: FloatArray | None = None,
    ) -> FloatArray:
        """All-in-focus picture of a frame.

        With `DeblurConfig.temporal_frames` call it frame by frame, in order.

        Parameters
        ----------
        frame : Frame or ndarray, float32 [rows, columns] or [rows, columns, 3]
        depth : DepthEstimate or ndarray, float32 [map rows, map columns], optional
            What `pipeline(frame)` has found, or metres from elsewhere: NaN where unknown; by
            default it is estimated.
        motion_px : ndarray, float32 [map rows, map columns, 2], optional
            Motion during the exposure, right and down; by default what the estimate has. Methods
            that cannot remove it leave it out.

        Returns
        -------
        ndarray, float32, like `frame.picture`
            In [0, 1].

        Raises
        ------
        InputError
            If the pipeline was made without deblurring, no depth is known in the whole frame, or a
            depth map does not have the proportions of the frame or is not in metres.
        """
        frame = Frame.of(frame)
        deblurrer = self._deblurrer
        if deblurrer is None:
            raise InputError("deblurring: the pipeline was made without it")
        if depth is None:
            depth = self(frame)
        if isinstance(depth, DepthEstimate):
            motion_px = depth.values("motion") if motion_px is None else motion_px
        else:
            self._follow(frame.stamp_ns)
        blur_size_px = self.blur_size_px(frame, depth)
        if not deblurrer.removes_motion:
            motion_px = None
        return deblurrer.deblur(frame.picture, blur_size_px, self._noise(frame), motion_px)

    def blur_size_px(self, frame: Frame, depth: DepthEstimate | FloatArray) -> FloatArray:
        """Signed blur sizes that a frame is deblurred by, px [map rows, map columns].

        Parameters
        ----------
        frame, depth
            See `deblur`.

        Raises
        ------
        InputError
            If no depth is known in the whole frame, or what blur it has, or hardly any depth is
            within the range of the model.
        """
        if isinstance(depth, DepthEstimate):
            return depth.blur_size_px
        self._show(frame)
        return checked_blur_sizes_px(self.model, self._view_camera, depth)

    def uncertainty(
        self, frame: Frame, sharp: FloatArray, depth: DepthEstimate | FloatArray
    ) -> Uncertainty:
        """How far each pixel of an all-in-focus picture can be relied on.

        Parameters
        ----------
        frame, depth
            What `deblur` was given.
        sharp : ndarray, float32, like `frame.picture`
            What it has made of them.

        Raises
        ------
        InputError
            As from `deblur`.
        """
        if self._deblurrer is None:
            raise InputError("deblurring: the pipeline was made without it")
        blur_size_px = self.blur_size_px(frame, depth)
        return self._deblurrer.uncertainty(frame.picture, sharp, blur_size_px, self._noise(frame))

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""
        self._order.forget()
        self._forget_video()

    def reconfigure(
        self,
        *,
        model: AnyModel | None = None,
        camera: Camera | None = None,
        depth: DepthConfig | None = None,
        deblur: DeblurConfig | None = None,
    ) -> None:
        """Go on with other settings, from the next frame on; what is not given stays.

        With the same model, camera and settings of depth nothing is planned anew, and the memory of
        the video is kept; so it is of deblurring while the model stays. If the model is not for the
        camera, there is an `InputError`, and everything stays as it was.
        """
        config = deblur or (self._deblurrer.config if self._deblurrer else None)
        self._change(
            model or self.model, camera or self.camera, depth or self.depth_config, self._view
        )
        if config is None:
            return
        if self._deblurrer is None:
            self._deblurrer = self._new_deblurrer(config)
        else:
            self._deblurrer.reconfigure(config)

    def fit(
        self,
        camera: Camera | None,
        frame: Frame,
        new_model: Callable[[Camera], AnyModel] | None = None,
    ) -> None:
        """Go on with a camera of the whole view, scaled to that of a frame; None: stay as it is.

        `new_model` makes the model of a camera, where it is no bank from a file.
        """
        if camera is None:
            return
        resized = camera.resized(*frame.whole_size)
        if resized != self.camera:
            model = None if new_model is None else new_model(resized)
            self.reconfigure(model=model, camera=resized)

    def warm_up(self, shape: Shape) -> None:
        """Do beforehand what the first frame would wait for: plan, and compile loops.

        On a new machine compiling takes seconds. Another video begins.

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the frames.
        """
        frame = Frame(np.random.default_rng(0).uniform(0.2, 0.8, (*shape, 3)).astype(np.float32))
        if self._estimator is not None:
            self._estimator.estimate(frame)
        if self._deblurrer is not None:
            sizes_px = self.model.stack.blur_sizes_px
            everywhere = np.full(shape, sizes_px[len(sizes_px) // 2], np.float32)
            self._deblurrer.deblur(frame.picture, everywhere, self._noise(frame), None)
        self.reset()

    def close(self) -> None:
        """End the threads that the work was shared among."""
        if self._estimator is not None:
            self._estimator.close()
        if self._deblurrer is not None:
            self._deblurrer.close()

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        """Send to another process what the pipeline was made of; threads and memory stay behind."""
        deblur = self._deblurrer.config if self._deblurrer else None
        return FramePipeline, (self.model, self.camera, self.depth_config, deblur)

    @property
    def _view_camera(self) -> Camera | None:
        """Camera of what the last frame showed."""
        return _cut(self.camera, self._view)

    def _show(self, frame: Frame) -> None:
        """Make model and camera those of the region of the view that a frame shows."""
        if frame.view != self._view:
            self._change(self.model, self.camera, self.depth_config, frame.view)

    def _change(
        self, model: AnyModel, camera: Camera | None, depth: DepthConfig, view: View | None
    ) -> None:
        """Make anew what model, camera, view or settings of depth have made false."""
        shown = _cut(camera, view)
        old, estimator = self._estimator, self._estimator
        if (
            old is None
            or old.source_model is not model
            or (depth, shown) != (old.config, old.camera)
        ):
            estimator = _new_estimator(model, depth, shown)
        other_psfs = model is not self.model or (
            shown != self._view_camera and model.for_view(shown) is not model
        )
        self.model = model
        self.camera = camera
        self.depth_config = depth
        self._view = view
        self._estimator = estimator
        if old is not None and old is not estimator:
            old.close()
        if other_psfs and self._deblurrer is not None:
            self._deblurrer.close()
            self._deblurrer = self._new_deblurrer(self._deblurrer.config)

    def _new_deblurrer(self, config: DeblurConfig) -> AnyDeblurrer:
        model = self.model.for_view(self._view_camera)
        return make_deblurrer(model, config, self._progress)

    def _noise(self, frame: Frame) -> float:
        """Noise of one channel for deblurring, by the rule for all: `KnownNoise.from_sources`.

        Not what depth has estimated, the noise of the mean of the channels: depth from elsewhere
        gives the same picture.
        """
        deblur = None if self._deblurrer is None else self._deblurrer.config
        known = KnownNoise.from_sources(deblur, self.depth_config, self.camera, self.model)
        return channel_noise(frame.picture, known)

    def _follow(self, stamp_ns: int | None) -> None:
        """Begin another video where time has gone back."""
        if stamp_ns is None:
            return
        order = self._order.follow(stamp_ns)
        if order == "restart":
            self._forget_video()
        elif order == "late" and self.remembers:
            raise LateFrameError("a frame is older than the one before it")

    def _forget_video(self) -> None:
        if self._estimator is not None:
            self._estimator.reset()
        if self._deblurrer is not None:
            self._deblurrer.reset()


def _cut(camera: Camera | None, view: View | None) -> Camera | None:
    """Camera of a region of the whole view."""
    return camera if camera is None or view is None else camera.for_view(view)


def _new_estimator(
    model: AnyModel, config: DepthConfig, camera: Camera | None
) -> DepthEstimator | None:
    """Estimator of a model; None for PSFs alone. An `InputError` if it is not for the camera."""
    if isinstance(model, RenderedLevels):
        if camera is not None:
            check_camera(model, camera)
        return None
    return DepthEstimator(model, config, camera)
