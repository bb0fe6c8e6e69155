"""What is made of one frame of a bag."""

import dataclasses
import time
from typing import Any

from numpy.typing import NDArray

from coded_aperture_ros.bags.codec import Picture, read_picture
from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.stages import Stages
from coded_aperture_ros.depth import Health
from coded_aperture_ros.frames import ExpectedMotion, Gamma, hidden_noise
from coded_aperture_ros.io.messages import MessageError, frame_from_pixels, pixels_from_frame
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
        stages = Stages()
        try:
            picture, frame, coloured = self._decoded(data)
            stages.lap("decode")
            result = self.pipeline(
                frame,
                size=self.map_size,
                prior=self.prior,
                coloured=coloured,
                hidden_noise=hidden_noise(picture.lost, frame, self.gamma),
            )
            stages.lap("depth")
        except InputError as error:
            return ProcessedFrame(*_fault(error, "frame"))
        depth = result.depth
        if depth.depth_m is None or depth.std_dev_m is None:
            return ProcessedFrame("frame", "the bank and the camera file give no depth")
        motion_px = None if depth.motion is None else depth.motion.vectors_px
        processed = ProcessedFrame(
            header=picture.header,
            encoding=picture.encoding,
            maps=DepthMaps(
                depth.depth_m,
                depth.confidence,
                depth.std_dev_m,
                depth.noise,
                motion_px,
                depth.free_space_m,
                depth.second_m,
                depth.second_share,
                depth.health,
            ),
            seconds=stages.seconds,
        )
        if not self.pipeline.deblurs:
            return processed
        try:
            sharp = pixels_from_frame(result.all_in_focus, picture.encoding, self.gamma)
        except InputError as error:
            fault, reason = _fault(error, "no depth")
            return dataclasses.replace(processed, fault=fault, reason=reason)
        stages.lap("deblur")
        return dataclasses.replace(processed, sharp=sharp, seconds=stages.seconds)

    def _decoded(self, data: bytes) -> tuple[Picture, FloatArray, FloatArray | None]:
        picture = read_picture(data, self.type_name)
        rows, columns = picture.pixels.shape[:2]
        if (rows, columns) != self.size:
            raise MessageError(
                "size", f"the frame is {columns}x{rows}, others are {self.size[1]}x{self.size[0]}"
            )
        how, coloured = (picture.pixels, self.gamma, self.bits, picture.mosaic), None
        if picture.mosaic and self.pipeline.deblurs:
            coloured = frame_from_pixels(*how, coloured=True)
        return picture, frame_from_pixels(*how), coloured


def _fault(error: InputError, otherwise: str) -> tuple[str, str]:
    """Return a fault in a word and in a line."""
    return error.kind if isinstance(error, MessageError) else otherwise, str(error)
