"""One frame of a bag: its message through the pipeline, and what comes of it."""

import dataclasses
import functools
import os
import pickle
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bags.codec import Picture, read_picture
from coded_aperture_ros.bags.poses import BagPoses
from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import LapTimer
from coded_aperture_ros.depth import Health, Layer
from coded_aperture_ros.depth.points import point_colours
from coded_aperture_ros.frames import ExpectedMotion, Frame, Gamma, PixelFormat, View
from coded_aperture_ros.io.messages import MessageError, pixels_from_frame
from coded_aperture_ros.likelihood.bank import check_frame_size
from coded_aperture_ros.likelihood.choose import filter_bank
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.pipeline import FramePipeline


@dataclasses.dataclass(frozen=True, eq=False)
class DepthMaps:
    """Part of a `DepthEstimate` that goes into the new bag.

    Attributes
    ----------
    depth_m, confidence, std_dev_m : ndarray, float32 [rows, columns]
    noise : float
        Standard deviation of the frame's noise, linear light.
    health : Health or None
    layers : mapping of str to Layer
        Everything else that the estimate has, by name.
    colours : ndarray, uint8 [rows, columns, RGB], optional
        Of the points of a cloud.
    """

    depth_m: FloatArray
    confidence: FloatArray
    std_dev_m: FloatArray
    noise: float
    health: Health | None = None
    layers: Mapping[str, Layer] = dataclasses.field(default_factory=dict)
    colours: NDArray[np.uint8] | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class ProcessedFrame:
    """Results of a frame; also of one that could not be used.

    Attributes
    ----------
    fault : str
        Why something is missing, in a word; empty if nothing is.
    reason : str
        The same in a line.
    header : message, optional
        Of the frame, as rosbags has it.
    maps : DepthMaps, optional
    sharp : ndarray, optional
        All-in-focus picture, as stored in `encoding`.
    encoding : str
        Of the all-in-focus picture.
    seconds : dict of str to float
        Time of each stage.
    processor_s : float
        Processor time of all of them.
    process : int
        Number of the process that has done it.
    """

    fault: str = ""
    reason: str = ""
    header: Any = None
    maps: DepthMaps | None = None
    sharp: NDArray | None = None
    encoding: str = ""
    seconds: dict[str, float] = dataclasses.field(default_factory=dict)
    processor_s: float = 0.0
    process: int = 0


@dataclasses.dataclass(frozen=True, eq=False)
class FrameProcessor:
    """Reads the message of a frame, estimates depth, and deblurs.

    Attributes
    ----------
    pipeline : FramePipeline
    type_name : str
        Of the messages.
    size, map_size : (int, int)
        Rows and columns of the frames, and of the depth images.
    gamma : float or "srgb"
        Of 8-bit frames.
    prior : ExpectedMotion, optional
        Of all frames.
    bits : int
        Of 16-bit frames.
    mosaic : str
        Order of the colour filters of grey frames whose messages name none.
    points : bool
        Whether the results have the colours of point clouds.
    poses : BagPoses, optional
        Of the camera.
    """

    pipeline: FramePipeline
    type_name: str
    size: Shape
    map_size: Shape
    gamma: Gamma = 1.0
    prior: ExpectedMotion | None = None
    bits: int = 16
    mosaic: str = ""
    points: bool = False
    poses: BagPoses | None = None

    def prepare(self, data: bytes) -> None:
        """Compute beforehand, with a message of a frame, what the first one would wait for."""
        self(data)
        self.pipeline.reset()

    def __call__(self, data: bytes) -> ProcessedFrame:
        """Results of the frame in a message."""
        started_s = time.process_time()
        result = self._result(data)
        spent_s = time.process_time() - started_s
        return dataclasses.replace(result, processor_s=spent_s, process=os.getpid())

    def _result(self, data: bytes) -> ProcessedFrame:
        timer = LapTimer()
        try:
            picture, frame = self._decoded(data)
            timer.lap("decode")
            estimate = self.pipeline(frame, self.map_size)
            timer.lap("depth")
        except InputError as error:
            return ProcessedFrame(*_fault(error, "frame"))
        if estimate.depth_m is None or estimate.std_dev_m is None:
            return ProcessedFrame("frame", "the bank and the camera file give no depth")
        maps = DepthMaps(
            estimate.depth_m,
            estimate.confidence,
            estimate.std_dev_m,
            estimate.noise,
            estimate.health,
            estimate.layers,
            point_colours(frame.light, self.map_size, self.gamma) if self.points else None,
        )
        processed = ProcessedFrame(
            header=picture.header, encoding=picture.encoding, maps=maps, seconds=timer.seconds
        )
        if not self.pipeline.deblurs:
            return processed
        try:
            sharp = self.pipeline.deblur(frame, estimate)
            stored = pixels_from_frame(sharp, picture.encoding, self.gamma)
        except InputError as error:
            fault, reason = _fault(error, "no depth")
            return dataclasses.replace(processed, fault=fault, reason=reason)
        timer.lap("deblur")
        return dataclasses.replace(processed, sharp=stored, seconds=timer.seconds)

    def _decoded(self, data: bytes) -> tuple[Picture, Frame]:
        picture = read_picture(data, self.type_name, self.mosaic)
        rows, columns = picture.pixels.shape[:2]
        if (rows, columns) != self.size:
            raise MessageError(
                "size", f"the frame is {columns}x{rows}, others are {self.size[1]}x{self.size[0]}"
            )
        pixel_format = PixelFormat(self.gamma, self.bits, picture.mosaic)
        colour = self.pipeline.deblurs or self.points
        frame = pixel_format.frame(
            picture.pixels,
            picture.compression_loss,
            colour=colour,
            motion=self.prior,
            pose=self.poses and functools.partial(self.poses.at, picture.stamp_ns),
        )
        return picture, frame


class Recipe(Protocol):
    """Whatever a worker makes its `FrameProcessor` from; it is pickled."""

    def make(self) -> FrameProcessor:
        """Return a new processor; an `InputError` if the bank does not suit the frames."""


@dataclasses.dataclass(frozen=True, eq=False)
class FrameRecipe:
    """Everything that a `FrameProcessor` is made from.

    Attributes
    ----------
    new_pipeline : callable
        Pipeline for a camera; it must be picklable.
    prior : callable
        Expected motion, or None, for a camera; it must be picklable.
    camera : Camera
        Of the whole view, at the scale of the frames.
    view : View
        What the frames show of it.
    type_name, map_size, gamma, bits, mosaic, points, poses
        See `FrameProcessor`.
    threads : int
        Of the pipeline, if its configuration leaves them open; 0: as many as it chooses.
    """

    new_pipeline: Callable[[Camera], FramePipeline]
    prior: Callable[[Camera], ExpectedMotion | None]
    camera: Camera
    view: View
    type_name: str
    map_size: Shape
    gamma: Gamma
    bits: int
    threads: int
    mosaic: str = ""
    points: bool = False
    poses: BagPoses | None = None

    def make(self) -> FrameProcessor:
        """Return a new processor; an `InputError` if the bank does not suit the frames."""
        pipeline = self.new_pipeline(self.camera)
        view = self.view
        bank = filter_bank(pipeline.estimator.model)
        if bank is not None:
            check_frame_size(bank, view.whole_width, view.whole_height)
        camera = self.camera.for_view(view)
        config = pipeline.estimator.config
        if self.threads and not config.threads:
            config = dataclasses.replace(config, threads=self.threads)
        pipeline.reconfigure(camera=camera, depth=config)
        return FrameProcessor(
            pipeline,
            self.type_name,
            (view.height, view.width),
            self.map_size,
            self.gamma,
            self.prior(camera),
            self.bits,
            self.mosaic,
            self.points,
            self.poses,
        )


@dataclasses.dataclass(frozen=True)
class StoredProcessor:
    """Recipe that loads a processor from a file, where `store` has put it.

    What the pipeline was computed from, perhaps for a long time, need not be computed again.
    """

    path: Path

    @classmethod
    def store(cls, processor: FrameProcessor, path: Path) -> "StoredProcessor":
        """Write a processor into a file."""
        path.write_bytes(pickle.dumps(processor))
        return cls(path)

    def make(self) -> FrameProcessor:
        """Return the processor of the file."""
        processor: FrameProcessor = pickle.loads(self.path.read_bytes())
        return processor


# The processor of each worker: of a process, or of a thread of one, as Dask has them.
_kept = threading.local()


def kept_processor(recipe: bytes) -> FrameProcessor:
    """Processor of a pickled recipe, which this worker keeps until it gets another recipe."""
    if getattr(_kept, "recipe", None) != recipe:
        if previous := getattr(_kept, "processor", None):
            previous.pipeline.close()
        _kept.recipe = None
        made: Recipe = pickle.loads(recipe)
        _kept.processor = made.make()
        _kept.recipe = recipe
    processor: FrameProcessor = _kept.processor
    return processor


def prepare(recipe: bytes, data: bytes) -> None:
    """Have a worker make its processor, and prepare it with a message of a frame."""
    kept_processor(recipe).prepare(data)


def process(recipe: bytes, data: bytes) -> ProcessedFrame:
    """Results of the frame in a message, by the processor that a worker keeps."""
    return kept_processor(recipe)(data)


def _fault(error: InputError, otherwise: str) -> tuple[str, str]:
    """Fault in a word, and in a line."""
    return error.kind if isinstance(error, MessageError) else otherwise, str(error)
