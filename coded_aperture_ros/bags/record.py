"""What is noted while a bag is worked on, for its report."""

import dataclasses
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bags.process import Frame
from coded_aperture_ros.bags.score import FrameScore, summary
from coded_aperture_ros.io.bags.conversion import Conversion, stamp_ns_of
from coded_aperture_ros.io.messages import frame_from_pixels
from coded_aperture_ros.metrics.errors import median
from coded_aperture_ros.metrics.times import Times

# Frames that the report shows, at most.
_SAMPLES = 4
_STAGES = ("decode", "depth", "deblur")


@dataclasses.dataclass(eq=False)
class Sample:
    """A frame that the report shows.

    Attributes
    ----------
    frame, sharp : ndarray, [row, column] or [row, column, RGB]
        float32, linear light; `sharp` may be None.
    depth_m, confidence : ndarray, float32 [rows, columns]
    score : FrameScore or None
        Once its reference has come.
    """

    index: int
    stamp_ns: int
    frame: NDArray[np.float32]
    sharp: NDArray[np.float32] | None
    depth_m: NDArray[np.float32]
    confidence: NDArray[np.float32]
    score: FrameScore | None = None


class Record:
    """Notes the results of all frames, and keeps a few of them.

    Parameters
    ----------
    type_name : str
        Of the messages of frames.

    Attributes
    ----------
    frames : int
        All that came, also those that could not be used.
    samples : dict of int to Sample
        At most four, spread over the recording, by index.
    scores : dict of int to FrameScore
        By index, without the references themselves.
    """

    def __init__(self, type_name: str) -> None:
        self._type_name = type_name
        self.frames = 0
        self.samples: dict[int, Sample] = {}
        self.scores: dict[int, FrameScore] = {}
        self._rows: dict[int, dict[str, Any]] = {}
        self._seconds: dict[str, list[float]] = {stage: [] for stage in _STAGES}
        self._spacing = 1
        self._start_s = time.perf_counter()
        self._stop_s = self._start_s
        self._processor_s, self._own_start_s = 0.0, 0.0

    def start(self) -> None:
        """Begin to take the time."""
        self._start_s = time.perf_counter()
        self._own_start_s = time.process_time()

    def stop(self) -> None:
        """Stop taking the time."""
        self._stop_s = time.perf_counter()
        self._processor_s += time.process_time() - self._own_start_s

    @property
    def used(self) -> int:
        """Frames that have a depth image."""
        return len(self._rows)

    @property
    def seconds(self) -> float:
        """Between `start` and `stop`."""
        return self._stop_s - self._start_s

    def add(self, frame: Frame) -> None:
        """Note the result of a frame."""
        self.frames += 1
        result = frame.result
        self._processor_s += result.processor_s
        if result.depth_m is None or result.confidence is None:
            return
        depths = result.depth_m[np.isfinite(result.depth_m)]
        self._rows[frame.index] = {
            "stamp_ns": stamp_ns_of(result.header) or frame.recorded.time_ns,
            "coverage": depths.size / result.depth_m.size,
            "median_depth_m": median(depths) if depths.size else None,
            "mean_confidence": float(result.confidence.mean()),
            "noise": result.noise,
            **{f"{stage}_s": seconds for stage, seconds in result.seconds.items()},
        }
        for stage, seconds in result.seconds.items():
            self._seconds[stage].append(seconds)
        if frame.index % self._spacing == 0:
            self._keep(frame)

    def add_score(self, index: int, score: FrameScore) -> None:
        """Note how good the depth of a frame is."""
        if index in self.samples:
            self.samples[index].score = score
        nothing = np.empty((0, 0), np.float32)
        self.scores[index] = dataclasses.replace(score, reference_m=nothing)

    def series(self) -> list[dict[str, Any]]:
        """Return a row for every frame that could be used, ready for JSON."""
        rows = []
        for index, row in self._rows.items():
            row = {"index": index, **row}
            if index in self.scores:
                error = self.scores[index].error
                row["median_relative_error"] = _number(error.median)
                row["within_10_percent"] = _number(error.within_10_percent)
                row["coverage_of_reference"] = _number(error.coverage)
            rows.append(row)
        return rows

    def depth(self) -> dict[str, Any]:
        """Sum up what needs no reference, ready for JSON."""
        rows = list(self._rows.values())
        medians = [row["median_depth_m"] for row in rows if row["median_depth_m"] is not None]
        return {
            "coverage": float(np.mean([row["coverage"] for row in rows])),
            "mean_confidence": float(np.mean([row["mean_confidence"] for row in rows])),
            "median_depth_m": float(np.median(medians)) if medians else None,
            "noise": float(np.median([row["noise"] for row in rows])),
        }

    def reference(self) -> dict[str, Any] | None:
        """Sum up the scores, ready for JSON; None without any."""
        return summary(list(self.scores.values())) if self.scores else None

    def timing(self) -> dict[str, Any]:
        """Sum up how long it took, ready for JSON."""
        stamps = [row["stamp_ns"] for row in self._rows.values()]
        recorded_s = None
        if len(stamps) > 1 and max(stamps) > min(stamps):
            # The last frame lasts as long as the others.
            recorded_s = 1e-9 * (max(stamps) - min(stamps)) * self.used / (self.used - 1)
        return {
            "seconds": self.seconds,
            "processor_seconds": self._processor_s,
            "frames_per_second": self.frames / self.seconds,
            "recorded_s": recorded_s,
            "times_real_time": recorded_s and recorded_s / self.seconds,
            "stages": {
                stage: dataclasses.asdict(Times.of(seconds))
                for stage, seconds in self._seconds.items()
                if seconds
            },
        }

    def _keep(self, frame: Frame) -> None:
        """Keep a sample; every other one goes whenever there are too many."""
        result = frame.result
        assert result.depth_m is not None
        assert result.confidence is not None
        picture = Conversion().picture(frame.recorded.data, self._type_name)
        self.samples[frame.index] = Sample(
            frame.index,
            picture.stamp_ns,
            frame_from_pixels(picture.pixels),
            None if result.sharp is None else _shown(result.sharp, result.encoding),
            result.depth_m,
            result.confidence,
        )
        while len(self.samples) > _SAMPLES:
            self._spacing *= 2
            self.samples = {
                index: sample
                for index, sample in self.samples.items()
                if index % self._spacing == 0
            }


def _shown(stored: NDArray, encoding: str) -> NDArray[np.float32]:
    """Return stored pixels in the order red, green, blue, without alpha."""
    pixels = stored[..., :3] if stored.ndim == 3 else stored
    return frame_from_pixels(pixels[..., ::-1] if encoding.startswith("bgr") else pixels)


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
