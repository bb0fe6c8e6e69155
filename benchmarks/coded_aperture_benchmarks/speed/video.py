"""Frame after frame through the depth estimation, with the time of every stage."""

import dataclasses
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.speed.machine import opencv_threads
from coded_aperture_benchmarks.speed.memory import Memory, forget_peak, memory_mib
from coded_aperture_benchmarks.speed.setting import MASK, Setting, Size, published_size
from coded_aperture_ros.depth import DepthEstimator
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.metrics.times import Times
from coded_aperture_ros.optics import Camera, Mask

# Blurred by 32 px at infinity, so that every level of 7 to 30 px has a depth.
_FOCAL_LENGTH_PX, _FOCUS_M, _EXTENT_MM = 800.0, 1.0, 40.0
# Frames that are not measured: the first is planned for, the second begins the video.
_WARM_UP = 2


class VideoRun:
    """Estimates the depth of a video that goes there and back, and keeps the times.

    Parameters
    ----------
    frames : sequence of ndarray, float32 [rows, columns]
    changes
        Of the `DepthConfig`.

    Attributes
    ----------
    totals : list of float
        Of every frame that was measured, s.
    stages : dict of str to list of float
        The same for every stage.
    memory : Memory or None
        Once frames were measured.
    """

    def __init__(
        self,
        bank: FilterBank,
        frames: Sequence[NDArray[np.float32]],
        setting: Setting,
        **changes: Any,
    ) -> None:
        self.shape: Size = (frames[0].shape[0], frames[0].shape[1])
        self.map_size = published_size(self.shape, setting.full_size)
        self._frames = [*frames, *frames[-2:0:-1]]  # no jump at the end
        self._next = 0
        self._threads = setting.threads
        height, width = self.shape
        camera = Camera(_FOCAL_LENGTH_PX, _FOCUS_M, width, height, Mask.named(MASK), _EXTENT_MM)
        config = dataclasses.replace(setting.depth_config, **changes)
        self._estimator = DepthEstimator(bank, config, camera)
        self.totals: list[float] = []
        self.stages: dict[str, list[float]] = {}
        self.memory: Memory | None = None
        self._planned = (float("nan"), float("nan"))

    def measure(self, count: int) -> None:
        """Measure some more frames."""
        with opencv_threads(self._threads):
            if not self.totals:
                self._warm_up()
            for _ in range(count):
                total, stages = self._estimate()
                self.totals.append(total)
                for stage, seconds in stages.items():
                    self.stages.setdefault(stage, []).append(seconds)
        before, planned = self._planned
        now = memory_mib("VmRSS")
        self.memory = Memory(memory_mib("VmHWM"), planned - before, now - planned)

    def times(self) -> Times:
        """Return the times of whole frames."""
        return Times.from_seconds(self.totals)

    def stage_times(self, *stages: str) -> Times:
        """Return the times of some stages together."""
        return Times.from_seconds(np.sum([self.stages[stage] for stage in stages], axis=0).tolist())

    def close(self) -> None:
        """End the threads, and let go of the frames."""
        self._estimator.close()
        self._frames = []

    def _estimate(self) -> tuple[float, Mapping[str, float]]:
        frame = self._frames[self._next]
        self._next = (self._next + 1) % len(self._frames)
        start = time.perf_counter()
        estimate = self._estimator.estimate(frame, self.map_size)
        return time.perf_counter() - start, estimate.seconds

    def _warm_up(self) -> None:
        forget_peak()
        before = memory_mib("VmRSS")
        self._estimate()
        self._planned = before, memory_mib("VmRSS")
        for _ in range(_WARM_UP - 1):
            self._estimate()
