"""Thread that processes the frames of a source, while a page is open."""

import dataclasses
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthEstimate
from coded_aperture_ros.frames import Frame, PixelFormat
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.likelihood.bank import check_frame_size
from coded_aperture_ros.likelihood.choose import filter_bank
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.sources import Capture, Source
from coded_aperture_viewer.refocus import refocused
from coded_aperture_viewer.settings import LookConfig, Settings

# Depth has priority: after a picture has taken some time, none is made for so many times as long.
_DEPTH_TO_PICTURES = 10.0
# Time between two checks of the settings while paused.
_IDLE_S = 0.1
# Pause after a frame that could not be read.
_RETRY_S = 1.0
# Frames over which the rate is measured.
_RATE_FRAMES = 20

# Settings to process a frame with, and what pages display of its all-in-focus picture.
_Wanted = tuple[Settings, frozenset[LookConfig]]


@dataclasses.dataclass(frozen=True, eq=False)
class Shown:
    """Frame and its results.

    Attributes
    ----------
    capture : Capture or None
        From the source.
    frame : ndarray or None
        Linear light, float32 [rows, columns(, 3)].
    estimate : DepthEstimate or None
    sharp : ndarray or None
        All-in-focus picture, of the shape of `frame`; not every frame has one.
    pictures : {LookConfig: ndarray}
        What pages display of it, by `LookConfig.made_from`.
    settings : Settings
        Of which the look is of no page.
    rate_hz, latency_s : float
        Frames per second over the last ones, and how long this one took.
    problem : str
        Why a result is missing; empty if none is.
    """

    settings: Settings
    capture: Capture | None = None
    frame: FloatArray | None = None
    estimate: DepthEstimate | None = None
    sharp: FloatArray | None = None
    pictures: Mapping[LookConfig, FloatArray] = dataclasses.field(default_factory=dict)
    rate_hz: float = 0.0
    latency_s: float = 0.0
    problem: str = ""


class Live:
    """Thread that reads frames, estimates depth and makes pictures.

    Parameters
    ----------
    source : Source
        It is closed at the end.
    pipeline : FramePipeline
        It is closed at the end.
    settings : Settings
        First settings.
    pixel_format : PixelFormat
        Of the frames.
    period_s : float
        Between the frames of a source that is not live.
    show : callable
        Called with every `Shown`, in this thread.
    """

    def __init__(
        self,
        source: Source,
        pipeline: FramePipeline,
        settings: Settings,
        pixel_format: PixelFormat,
        period_s: float,
        show: Callable[[Shown], None],
    ) -> None:
        self._wanted: _Wanted = settings, frozenset()
        self._source = source
        self._pipeline = pipeline
        self._show = show
        self._camera = pipeline.estimator.camera  # of the size in its file
        self._pixel_format = pixel_format
        self._period_s = period_s
        self._watched = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="frames", daemon=True)

    @property
    def model(self) -> LikelihoodModel:
        """What the depth is estimated with."""
        return self._pipeline.estimator.source_model

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def want(self, settings: Settings, looks: Collection[LookConfig]) -> None:
        """Set how the next frames are processed, and which pictures pages display."""
        self._wanted = settings, frozenset(look.made_from for look in looks)

    def watch(self, watched: bool) -> None:
        """Set whether frames are needed, by a page or a recording; else the thread waits."""
        if watched:
            self._watched.set()
        else:
            self._watched.clear()

    def stop(self, within_s: float | None = None) -> None:
        """End the thread, and close source and pipeline.

        Parameters
        ----------
        within_s : float, optional
            A frame that takes longer, as of a camera that does not answer, is left to the end of
            the program, with source and pipeline.
        """
        self._stopping.set()
        self._watched.set()
        if self._thread.is_alive():
            self._thread.join(within_s)
        if self._thread.is_alive():
            logging.warning("the last frame was not finished: the viewer ends without it")
            return
        self._source.close()
        self._pipeline.close()

    def _run(self) -> None:
        capture: Capture | None = None
        shown_for: _Wanted | None = None
        pictures = _TimeShare(_DEPTH_TO_PICTURES)
        ends_s: deque[float] = deque(maxlen=_RATE_FRAMES)
        while self._watched.wait() and not self._stopping.is_set():
            wanted = self._wanted
            settings, _ = wanted
            paused = settings.run.paused and capture is not None
            if paused and wanted == shown_for:
                self._stopping.wait(_IDLE_S)
                continue
            begin_s = time.monotonic()
            try:
                if not paused:
                    capture = self._source.read()
                    if capture is None:
                        raise InputError("end of the source: no more frames")
                shown = self._process(capture, wanted, paused, pictures)
            except InputError as error:
                shown = Shown(settings, capture, problem=str(error))
            except Exception as error:  # of a camera's driver, for example: the next may succeed
                logging.exception("frame skipped after an internal error")
                shown = Shown(settings, capture, problem=f"{type(error).__name__}: {error}")
            shown_for = wanted
            end_s = time.monotonic()
            ends_s.append(end_s)
            rate_hz = (len(ends_s) - 1) / (end_s - ends_s[0]) if len(ends_s) > 1 else 0.0
            self._show(dataclasses.replace(shown, rate_hz=rate_hz, latency_s=end_s - begin_s))
            if shown.frame is None and not paused:
                self._stopping.wait(_RETRY_S)
            elif not (self._source.live or paused):
                self._stopping.wait(self._period_s - (time.monotonic() - begin_s))

    def _process(
        self, capture: Capture | None, wanted: _Wanted, again: bool, pictures: "_TimeShare"
    ) -> Shown:
        """Results of a frame; `again` if it is the same frame with other settings."""
        assert capture is not None
        settings, looks = wanted
        looks = frozenset(look for look in looks if look.picture != "none")
        frame = capture.decode(self._pixel_format, self._camera)
        frame = dataclasses.replace(frame, stamp_ns=None)
        shown = Shown(settings, capture, frame.picture)
        if again:
            self._pipeline.reset()  # it is not a new frame of the video
        try:
            camera = self._camera_for(frame)
            self._pipeline.reconfigure(camera=camera, depth=settings.depth, deblur=settings.deblur)
            estimate = self._pipeline(frame)
            shown = dataclasses.replace(shown, estimate=estimate)
            if not looks or not (again or pictures.due):
                return shown
            with pictures:
                sharp = self._pipeline.deblur(frame, estimate)
                made = {look: _displayed_picture(sharp, estimate, look) for look in looks}
        except InputError as error:
            return dataclasses.replace(shown, problem=str(error))
        return dataclasses.replace(shown, sharp=sharp, pictures=made)

    def _camera_for(self, frame: Frame) -> Camera | None:
        """Camera of a frame's whole view; an `InputError` if the bank is for another."""
        if bank := filter_bank(self._pipeline.estimator.model):
            check_frame_size(bank, *frame.whole_size)
        return self._camera and self._camera.resized(*frame.whole_size)


def _displayed_picture(sharp: FloatArray, estimate: DepthEstimate, look: LookConfig) -> FloatArray:
    """All-in-focus picture, refocused if a page asks for it."""
    if look.picture != "refocused" or estimate.depth_m is None:
        return sharp
    return refocused(sharp, estimate.depth_m, look.focus_m, look.opening_px)


class _TimeShare:
    """Limits optional work to a share of the time; a context around the work measures it.

    Parameters
    ----------
    others : float
        After the work it is not due for so many times as long as it took.
    """

    def __init__(self, others: float) -> None:
        self._others = others
        self._begin_s = 0.0
        self._due_s = 0.0

    @property
    def due(self) -> bool:
        return time.monotonic() >= self._due_s

    def __enter__(self) -> None:
        self._begin_s = time.monotonic()

    def __exit__(self, *_: object) -> None:
        now = time.monotonic()
        self._due_s = now + self._others * (now - self._begin_s)
