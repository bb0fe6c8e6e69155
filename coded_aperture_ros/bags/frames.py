"""What is made of one frame of a bag."""

import dataclasses
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.stages import Stages
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.depth import DepthEstimator
from coded_aperture_ros.imaging import Gamma
from coded_aperture_ros.io.bags.codec import Picture, read_picture
from coded_aperture_ros.io.messages import MessageError, frame_from_pixels, pixels_from_frame


@dataclasses.dataclass(frozen=True, eq=False)
class DepthMaps:
    """Depth of a frame, as far as the new bag has it.

    Attributes
    ----------
    depth_m, confidence : ndarray, float32 [rows, columns]
    noise : float
        See `DepthEstimate`.
    """

    depth_m: NDArray[np.float32]
    confidence: NDArray[np.float32]
    noise: float


@dataclasses.dataclass(frozen=True, eq=False)
class FrameResult:
    """What was made of a frame; also of one that could not be used.

    Attributes
    ----------
    fault, reason : str
        Why something is missing, in a word and in a line; empty if all is well.
    header : std_msgs/Header or None
        Of the frame, as rosbags has it.
    encoding : str
        Of the all-in-focus frame.
    maps : DepthMaps or None
    sharp : ndarray or None
        All in focus, as stored; None if that was not wanted.
    seconds : dict of str to float
        What `decode`, `depth` and `deblur` took.
    processor_s : float
        Time of the processor.
    """

    fault: str = ""
    reason: str = ""
    header: Any = None
    encoding: str = ""
    maps: DepthMaps | None = None
    sharp: NDArray | None = None
    seconds: dict[str, float] = dataclasses.field(default_factory=dict)
    processor_s: float = 0.0


class FrameProcessor:
    """Reads a frame, estimates its depth, and deblurs it.

    Parameters
    ----------
    type_name : str
        Of the messages.
    size : (int, int)
        Rows and columns of the frames.
    gamma : float or "srgb"
        Of 8-bit frames.
    estimator : DepthEstimator
        For frames of that size.
    map_size : (int, int)
        Rows and columns of the depth images.
    deblur : DeblurConfig or None
        None: no all-in-focus frames are made.
    """

    def __init__(
        self,
        type_name: str,
        size: tuple[int, int],
        gamma: Gamma,
        estimator: DepthEstimator,
        map_size: tuple[int, int],
        deblur: DeblurConfig | None,
    ) -> None:
        self._type_name, self._size, self._gamma = type_name, size, gamma
        self._estimator, self._map_size = estimator, map_size
        self._deblur = deblur
        self._deblurrer: Deblurrer | None = None  # made where the work is done

    @property
    def remembers(self) -> bool:
        """Whether a frame's depth depends on those before it."""
        return self._estimator.config.temporal_frames > 0

    def prepare(self, data: bytes) -> None:
        """Do with a message of a frame what the first one would wait for."""
        self(data)
        self._estimator.reset()

    def __call__(self, data: bytes) -> FrameResult:
        """Return what is made of a message of a frame."""
        started_s = time.process_time()
        result = self._result(data)
        return dataclasses.replace(result, processor_s=time.process_time() - started_s)

    def _result(self, data: bytes) -> FrameResult:
        stages = Stages()
        try:
            picture, frame = self._decoded(data)
            stages.lap("decode")
            estimate = self._estimator.estimate(frame, self._map_size)
            stages.lap("depth")
        except InputError as error:
            return FrameResult(*_fault(error, "frame"))
        if estimate.depth_m is None:
            return FrameResult("frame", "the bank and the camera file give no depth")
        result = FrameResult(
            header=picture.header,
            encoding=picture.encoding,
            maps=DepthMaps(estimate.depth_m, estimate.confidence, estimate.noise),
            seconds=stages.seconds,
        )
        if self._deblur is None:
            return result
        self._deblurrer = self._deblurrer or Deblurrer(self._estimator.model.stack, self._deblur)
        try:
            sharp = self._deblurrer.deblur(frame, estimate.blur_size_px, estimate.noise)
        except InputError as error:
            fault, reason = _fault(error, "no depth")
            return dataclasses.replace(result, fault=fault, reason=reason)
        pixels = pixels_from_frame(sharp, picture.encoding, self._gamma)
        stages.lap("deblur")
        return dataclasses.replace(result, sharp=pixels, seconds=stages.seconds)

    def _decoded(self, data: bytes) -> tuple[Picture, NDArray[np.float32]]:
        picture = read_picture(data, self._type_name)
        rows, columns = picture.pixels.shape[:2]
        if (rows, columns) != self._size:
            raise MessageError(
                "size",
                f"the frame is {columns}x{rows}, others are {self._size[1]}x{self._size[0]}",
            )
        return picture, frame_from_pixels(picture.pixels, self._gamma)


def _fault(error: InputError, otherwise: str) -> tuple[str, str]:
    """Return a fault in a word and in a line."""
    return error.kind if isinstance(error, MessageError) else otherwise, str(error)
