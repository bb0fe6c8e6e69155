"""What is made of one frame of a bag."""

import dataclasses
import time
from typing import Any

from numpy.typing import NDArray

from coded_aperture_ros.bags.codec import Picture, read_picture
from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.timing import LapTimer
from coded_aperture_ros.depth import Health
from coded_aperture_ros.frames import ExpectedMotion, Frame, Gamma, PixelFormat
from coded_aperture_ros.io.messages import MessageError, pixels_from_frame
from coded_aperture_ros.pipeline import FramePipeline


@dataclasses.dataclass(frozen=True, eq=False)
class DepthMaps:
    """What the new bag has of a `DepthEstimate`; all maps are float32 and of one size."""

    depth_m: FloatArray
    confidence: FloatArray
    std_dev_m: FloatArray
    noise: float
    motion_px: FloatArray | None = None
    free_space_m: FloatArray | None = None
    second_m: FloatArray | None = None
    second_share: FloatArray | None = None
    health: Health | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class ProcessedFrame:
    """What was made of a frame; also of one that could not be used."""

    fault: str = ""  # why something is missing, in a word; empty if all is well
    reason: str = ""  # and in a line
    header: Any = None  # of the frame, as rosbags has it
    maps: DepthMaps | None = None
    sharp: NDArray | None = None  # all in focus, as stored in the encoding
    encoding: str = ""
    seconds: dict[str, float] = dataclasses.field(default_factory=dict)  # by stage
    processor_s: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class FrameProcessor:
    """Reads the message of a frame, estimates depth, and deblurs; also in another process."""

    pipeline: FramePipeline
    type_name: str  # of the messages
    size: Shape  # rows and columns of the frames
    map_size: Shape  # and of the depth images
    gamma: Gamma = 1.0  # of 8-bit frames
    prior: ExpectedMotion | None = None  # of all frames
    bits: int = 16  # of 16-bit frames

    def prepare(self, data: bytes) -> None:
        """Do with a message of a frame what the first one would wait for."""
        self(data)
        self.pipeline.reset()

    def __call__(self, data: bytes) -> ProcessedFrame:
        """Return what is made of a message of a frame."""
        started_s = time.process_time()
        result = self._result(data)
        return dataclasses.replace(result, processor_s=time.process_time() - started_s)

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
        processed = ProcessedFrame(
            header=picture.header,
            encoding=picture.encoding,
            maps=DepthMaps(
                estimate.depth_m,
                estimate.confidence,
                estimate.std_dev_m,
                estimate.noise,
                estimate.values("motion"),
                estimate.values("free_space"),
                estimate.values("second"),
                estimate.values("second_share"),
                estimate.health,
            ),
            seconds=timer.seconds,
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
        picture = read_picture(data, self.type_name)
        rows, columns = picture.pixels.shape[:2]
        if (rows, columns) != self.size:
            raise MessageError(
                "size", f"the frame is {columns}x{rows}, others are {self.size[1]}x{self.size[0]}"
            )
        pixel_format = PixelFormat(self.gamma, self.bits, picture.mosaic)
        colour = self.pipeline.deblurs
        frame = pixel_format.frame(picture.pixels, picture.lost, colour=colour, motion=self.prior)
        return picture, frame


def _fault(error: InputError, otherwise: str) -> tuple[str, str]:
    """Return a fault in a word and in a line."""
    return error.kind if isinstance(error, MessageError) else otherwise, str(error)
