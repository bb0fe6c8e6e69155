"""Works on the frames of a source in a thread, as long as somebody watches."""

import dataclasses
import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthEstimate
from coded_aperture_ros.frames import PixelFormat
from coded_aperture_ros.likelihood.bank import check_frame_size
from coded_aperture_ros.likelihood.choose import filter_bank
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.sources import Capture, Source
from coded_aperture_viewer.refocus import refocused
from coded_aperture_viewer.settings import LookConfig, Settings

# Depth comes first: after a picture has taken some time, this many times as long without one.
_DEPTH_TO_PICTURES = 10.0
_IDLE_S, _RETRY_S = 0.1, 1.0
_MEASURED = 20


@dataclasses.dataclass(frozen=True, eq=False)
class Shown:
    """A frame and what was made of it.

    Attributes
    ----------
    capture : Capture or None
        As the source gave it.
    frame : ndarray or None
        In linear light.
    estimate : DepthEstimate or None
    sharp, picture : ndarray or None
        All in focus, and as it is looked at. Not every frame has one.
    settings : Settings
    rate_hz, latency_s : float
        Frames per second lately, and how long this one took.
    problem : str
        Why something is missing; empty if nothing is.
    """

    settings: Settings
    capture: Capture | None = None
    frame: FloatArray | None = None
    estimate: DepthEstimate | None = None
    sharp: FloatArray | None = None
    picture: FloatArray | None = None
    rate_hz: float = 0.0
    latency_s: float = 0.0
    problem: str = ""


class Live:
    """Reads frames, estimates depth, and hands over what came of it.

    Parameters
    ----------
    source : Source
    pipeline : FramePipeline
        It is closed in the end.
    settings : Settings
        To begin with.
    stored : PixelFormat
    period_s : float
        Between the frames of a source that is not live and does not say when they were taken.
    show : callable
        Gets every `Shown`, in the thread that works.
    """

    def __init__(
        self,
        source: Source,
        pipeline: FramePipeline,
        settings: Settings,
        stored: PixelFormat,
        period_s: float,
        show: Callable[[Shown], None],
    ) -> None:
        self.settings = settings
        self._source, self._pipeline, self._show = source, pipeline, show
        self._camera = pipeline.estimator.camera  # for frames of the size that it says
        self._stored, self._period_s = stored, period_s
        self._watched, self._stopping = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="frames", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def watch(self, watched: bool) -> None:
        """Say whether anybody watches: only then there is work."""
        if watched:
            self._watched.set()
        else:
            self._watched.clear()

    def stop(self) -> None:
        """End the thread, and let go of the source."""
        self._stopping.set()
        self._watched.set()
        if self._thread.is_alive():
            self._thread.join()
        self._source.close()
        self._pipeline.close()

    def _run(self) -> None:
        capture: Capture | None = None
        done: Settings | None = None
        pictures = _Share(_DEPTH_TO_PICTURES)
        ends: deque[float] = deque(maxlen=_MEASURED)
        while self._watched.wait() and not self._stopping.is_set():
            settings = self.settings
            paused = settings.look.paused and capture is not None
            if paused and settings == done:
                self._stopping.wait(_IDLE_S)
                continue
            begun = time.monotonic()
            try:
                if not paused:
                    capture = self._source.read()
                    if capture is None:
                        raise InputError("there are no more frames")
                shown = self._of(capture, settings, paused, pictures)
            except InputError as error:
                shown = Shown(settings, capture, problem=str(error))
            except Exception as error:  # a driver that fails in its own way: frames may come again
                logging.exception("a frame failed")
                shown = Shown(settings, capture, problem=f"{type(error).__name__}: {error}")
            done, now = settings, time.monotonic()
            ends.append(now)
            rate = (len(ends) - 1) / (now - ends[0]) if len(ends) > 1 else 0.0
            self._show(dataclasses.replace(shown, rate_hz=rate, latency_s=now - begun))
            if shown.frame is None and not paused:
                self._stopping.wait(_RETRY_S)
            elif not (self._source.live or paused):
                self._stopping.wait(self._period_s - (time.monotonic() - begun))

    def _of(
        self, capture: Capture | None, settings: Settings, again: bool, pictures: "_Share"
    ) -> Shown:
        assert capture is not None
        frame = dataclasses.replace(capture.decode(self._stored), stamp_ns=None)
        shown = Shown(settings, capture, frame.picture)
        if again:
            self._pipeline.reset()  # it is not a new frame of the video
        try:
            camera = self._camera_for(frame.light)
            self._pipeline.reconfigure(camera=camera, depth=settings.depth, deblur=settings.deblur)
            estimate = self._pipeline(frame)
            shown = dataclasses.replace(shown, estimate=estimate)
            if settings.look.picture == "none" or not (again or pictures.due):
                return shown
            with pictures:
                sharp = self._pipeline.deblur(frame, estimate)
                looked_at = _looked_at(sharp, estimate, settings.look)
        except InputError as error:
            return dataclasses.replace(shown, problem=str(error))
        return dataclasses.replace(shown, sharp=sharp, picture=looked_at)

    def _camera_for(self, frame: FloatArray) -> Camera | None:
        """Return the camera for frames of this size; an `InputError` if the bank is not."""
        height, width = frame.shape[:2]
        if bank := filter_bank(self._pipeline.estimator.model):
            check_frame_size(bank, width, height)
        return self._camera and self._camera.resized(width, height)


def _looked_at(sharp: FloatArray, estimate: DepthEstimate, look: LookConfig) -> FloatArray:
    if look.picture != "refocused" or estimate.depth_m is None:
        return sharp
    return refocused(sharp, estimate.depth_m, look.focus_m, look.opening_px)


class _Share:
    """Lets something take its share of the time: a context around it measures how long it took."""

    def __init__(self, others: float) -> None:
        self._others = others
        self._begun = self._next = 0.0

    @property
    def due(self) -> bool:
        return time.monotonic() >= self._next

    def __enter__(self) -> None:
        self._begun = time.monotonic()

    def __exit__(self, *_: object) -> None:
        now = time.monotonic()
        self._next = now + self._others * (now - self._begun)
