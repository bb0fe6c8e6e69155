"""Statistics of the frames of a bag, for its report."""

import dataclasses
import os
import time
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bags.codec import read_picture
from coded_aperture_ros.bags.contents import BagMessage
from coded_aperture_ros.bags.frames import DepthMaps, ProcessedFrame
from coded_aperture_ros.bags.score import FrameScore, summary
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import Gamma, PixelFormat
from coded_aperture_ros.io.messages import stamp_ns
from coded_aperture_ros.metrics.errors import median
from coded_aperture_ros.metrics.times import Times

# Frames that the report shows, at most.
_SAMPLES = 4
_STAGES = ("decode", "depth", "deblur")


@dataclasses.dataclass(eq=False)
class Sample:
    """Frame that the report shows.

    Attributes
    ----------
    index : int
    frame, sharp : ndarray, float32 [rows, columns] or [rows, columns, 3]
        Coded frame and, if there is one, all-in-focus frame, in linear light.
    maps : DepthMaps
    score : FrameScore or None
        Once its reference has come.
    """

    index: int
    frame: FloatArray
    sharp: FloatArray | None
    maps: DepthMaps
    score: FrameScore | None = None


class FrameLog:
    """Statistics of all frames, and a few of the frames.

    Parameters
    ----------
    type_name : str
        Of the frames' messages.
    bits : int
        Of 16-bit frames.
    gamma : float or "srgb"
        Of 8-bit frames.

    Attributes
    ----------
    frames : int
        Number of frames, also of those that could not be used.
    faults : Counter
        Number of frames that could not be used, by the reason in a word.
    reasons : dict of str to str
        First reason of each kind in a line.
    camera_info : Counter
        Number of camera models that were not used, by the reason in a line.
    samples : dict of int to Sample
        At most four frames, spread over the recording, by index.
    scores : dict of int to FrameScore
        By index, without the references.
    layers : dict of str to None
        Names of the layers that frames had, in their order.
    """

    def __init__(
        self, type_name: str, bits: int = 16, gamma: Gamma = 1.0, mosaic: str = ""
    ) -> None:
        self._type_name = type_name
        self._bits = bits
        self._gamma = gamma
        self._mosaic = mosaic
        self.frames = 0
        self.faults: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}
        self.camera_info: Counter[str] = Counter()
        self.samples: dict[int, Sample] = {}
        self.scores: dict[int, FrameScore] = {}
        self.layers: dict[str, None] = {}
        self._rows: dict[int, dict[str, Any]] = {}
        self._spacing = 1
        self._start_s = time.perf_counter()
        self._stop_s = self._start_s
        self._processor_s = 0.0
        self._own_start_s = 0.0

    def start(self) -> None:
        """Start the clock."""
        self._start_s = time.perf_counter()
        self._own_start_s = time.process_time()

    def stop(self) -> None:
        """Stop the clock."""
        self._stop_s = time.perf_counter()
        self._processor_s += time.process_time() - self._own_start_s

    def note_camera_info(self, reason: str) -> None:
        """Count a camera model that was not used."""
        self.camera_info[reason] += 1

    @property
    def used(self) -> int:
        """Number of frames with a depth image."""
        return len(self._rows)

    def add(self, index: int, recorded: BagMessage, result: ProcessedFrame) -> None:
        """Add the result of a frame, by its index in the topic and its message."""
        self.frames += 1
        if result.process != os.getpid():  # else it is in the time of this process
            self._processor_s += result.processor_s
        if result.fault:
            self.faults[result.fault] += 1
            self.reasons.setdefault(result.fault, result.reason)
        if (maps := result.maps) is None:
            return
        known = np.isfinite(maps.depth_m)
        depths = maps.depth_m[known]
        self._rows[index] = {
            "stamp_ns": stamp_ns(result.header) or recorded.time_ns,
            "coverage": depths.size / maps.depth_m.size,
            "median_depth_m": median(depths) if depths.size else None,
            "median_std_dev_m": _number(median(maps.std_dev_m[known])) if depths.size else None,
            "mean_confidence": float(maps.confidence.mean()),
            "noise": maps.noise,
            "health": None if maps.health is None else maps.health.value,
            "misfit": "" if maps.health is None else maps.health.cause,
            **{f"{stage}_s": seconds for stage, seconds in result.seconds.items()},
        }
        self.layers.update(dict.fromkeys(maps.layers))
        if index % self._spacing == 0:
            self._keep(index, recorded, result, maps)

    def add_scores(self, scores: Iterable[tuple[int, FrameScore]]) -> None:
        """Add scores of frames, by index."""
        for index, score in scores:
            if index in self.samples:
                self.samples[index].score = score
            nothing = np.empty((0, 0), np.float32)
            self.scores[index] = dataclasses.replace(score, reference_m=nothing)

    def series(self) -> list[dict[str, Any]]:
        """List a row for every frame that could be used, ready for JSON."""
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
        """Summary of depth, confidence and noise, ready for JSON."""
        rows = list(self._rows.values())

        def over_frames(name: str) -> float | None:
            known = [row[name] for row in rows if row[name] is not None]
            return float(np.median(known)) if known else None

        return {
            "coverage": float(np.mean([row["coverage"] for row in rows])),
            "mean_confidence": float(np.mean([row["mean_confidence"] for row in rows])),
            "median_depth_m": over_frames("median_depth_m"),
            "median_std_dev_m": over_frames("median_std_dev_m"),
            "noise": float(np.median([row["noise"] for row in rows])),
            # Frames that do not fit the bank, by the likeliest cause.
            "misfits": Counter(row["misfit"] for row in rows if row["misfit"]),
        }

    def reference(self, topic: str) -> dict[str, Any]:
        """Summary of the scores, ready for JSON; an `InputError` if there are none."""
        if not self.scores:
            raise InputError(f"no frame has a depth image in {topic} that was taken at its time")
        return {"topic": topic, **summary(list(self.scores.values()))}

    def timing(self) -> dict[str, Any]:
        """Summary of the times, ready for JSON."""
        rows = self._rows.values()
        stamps = [row["stamp_ns"] for row in rows]
        seconds = self._stop_s - self._start_s
        recorded_s = None
        if len(stamps) > 1 and max(stamps) > min(stamps):
            # The last frame lasts as long as the others.
            recorded_s = 1e-9 * (max(stamps) - min(stamps)) * self.used / (self.used - 1)
        return {
            "seconds": seconds,
            "processor_seconds": self._processor_s,
            "frames_per_second": self.frames / seconds,
            "recorded_s": recorded_s,
            "times_real_time": recorded_s and recorded_s / seconds,
            "stages": {
                stage: dataclasses.asdict(Times.from_seconds(times))
                for stage in _STAGES
                if (times := [row[f"{stage}_s"] for row in rows if f"{stage}_s" in row])
            },
        }

    def _keep(
        self, index: int, recorded: BagMessage, result: ProcessedFrame, maps: DepthMaps
    ) -> None:
        """Keep a sample; if there are too many, every other one is dropped."""
        picture = read_picture(recorded.data, self._type_name, self._mosaic)
        gamma = self._gamma
        self.samples[index] = Sample(
            index,
            PixelFormat(gamma, self._bits, picture.mosaic).picture(picture.pixels),
            None if result.sharp is None else _shown(result.sharp, result.encoding, gamma),
            maps,
        )
        while len(self.samples) > _SAMPLES:
            self._spacing *= 2
            self.samples = {
                index: sample
                for index, sample in self.samples.items()
                if index % self._spacing == 0
            }


def _shown(stored: NDArray, encoding: str, gamma: Gamma) -> FloatArray:
    """Linear light of stored pixels, in the order red, green, blue, without alpha."""
    pixels = stored[..., :3] if stored.ndim == 3 else stored
    return PixelFormat(gamma).light(pixels[..., ::-1] if encoding.startswith("bgr") else pixels)


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
