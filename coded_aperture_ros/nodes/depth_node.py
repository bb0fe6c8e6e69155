"""The node that turns coded frames into metric depth."""

import dataclasses
import math
import sys
from collections.abc import Sequence
from typing import Any, cast

from sensor_msgs.msg import CameraInfo, Image

from coded_aperture_ros.bank import FilterBank, LearnConfig
from coded_aperture_ros.blas import slow_blas_warning
from coded_aperture_ros.calibration import with_noise_of
from coded_aperture_ros.configuration import check_options, option
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.nodes.camera_model import CameraModel
from coded_aperture_ros.nodes.frame_model import FrameModel, ModelConfig
from coded_aperture_ros.nodes.frame_node import FrameNode
from coded_aperture_ros.nodes.messages import (
    frame_from_image,
    image_from_array,
    limit_depth,
    millimetres_from_depth,
)
from coded_aperture_ros.nodes.running import run_nodes
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.simple import (
    NeighbourModel,
    SimpleConfig,
    SimpleEstimator,
    neighbour_model_for_camera,
)

# Best-effort messages larger than these float images are lost with default DDS settings.
_LARGEST_AUTO = (240, 320)
# What a camera's rate needs on two processors; a bank from a file brings its own rank.
_STRIDE_PX, _RANK = 16, 64
_DIVISORS = {"full": 1, "half": 2, "quarter": 4}


@dataclasses.dataclass(frozen=True)
class DepthNodeConfig:
    """What the node needs beside the model and the options of the estimator."""

    output_size: str = option(
        "auto",
        "Size of the depth image relative to the frame; auto: largest whole fraction of the frame "
        "that fits in 320x240",
        choices=("auto", *_DIVISORS),
    )
    method: str = option(
        "bank",
        "bank: a filter bank, for any mask; simple: a pixel and its neighbours, without a bank, "
        "for a mask of 2 to 8 equal holes",
        choices=("bank", "simple"),
        read_only=True,
    )

    def __post_init__(self) -> None:
        check_options(self)


class DepthNode(FrameNode[Image]):
    """Subscribes to coded frames and publishes depth, confidence and the matching camera model."""

    def __init__(self, **node_options: Any) -> None:
        super().__init__(
            "depth_node",
            ModelConfig(),
            DepthNodeConfig(),
            DepthConfig(stride_px=_STRIDE_PX),
            fixed={"learn.": LearnConfig(rank=_RANK), "simple.": SimpleConfig()},
            **node_options,
        )
        warning = slow_blas_warning()
        if warning:
            self.get_logger().warning(warning)
        self._range = self.configs[ModelConfig]
        learn = None
        if self.configs[DepthNodeConfig].method == "simple":
            if self._range.bank:
                raise InputError("method: simple has no bank: leave the parameter bank empty")
            learn = self._neighbour_model
        self._model = FrameModel(self, self.configs, learn)
        self._estimator = self._new_estimator()
        self._info = CameraModel()
        self.advertise("depth/image", Image)
        self.advertise("depth/image_raw", Image)
        self.advertise("depth/confidence", Image)
        self.advertise("depth/camera_info", CameraInfo)
        self.listen("image_raw", Image, self._on_image)
        self.listen("camera_info", CameraInfo, self._info.receive)
        self.start()

    def process(self, item: Image) -> None:
        """Estimate and publish the depth of one frame."""
        header = item.header
        frame = frame_from_image(item, self.frame_config.gamma)
        frame_size = frame.shape[0], frame.shape[1]
        size = output_size(frame_size, self.configs[DepthNodeConfig].output_size)
        self._model.fit(item.width, item.height)
        estimator = self._present_estimator()
        estimate = estimator.estimate(frame, size)
        if estimate.depth_m is None:
            raise InputError("the bank and the camera file give no depth")
        depth_m = limit_depth(estimate.depth_m, self._range.near_m, self._range.far_m or math.inf)
        if self.wants("depth/image"):
            self.send("depth/image", image_from_array(depth_m, "32FC1", header))
        if self.wants("depth/image_raw"):
            millimetres = millimetres_from_depth(depth_m)
            self.send("depth/image_raw", image_from_array(millimetres, "16UC1", header))
        if self.wants("depth/confidence"):
            confidence = image_from_array(estimate.confidence, "32FC1", header)
            self.send("depth/confidence", confidence)
        if self.wants("depth/camera_info"):
            info = self._info.info(self._model.camera, frame_size, size, header)
            self.send("depth/camera_info", info)
        self.sent(header, estimator.stages.seconds)

    def _on_image(self, message: Image) -> None:
        self.statistics.count_received()
        self.offer(message)

    def _present_estimator(self) -> DepthEstimator:
        """Return the estimator for the present camera, bank and parameters."""
        made, model = self._estimator, self._model
        if (
            made.bank is not model.bank
            or made.camera is not model.camera
            or self._made_for is not self.configs[DepthConfig]
        ):
            estimator = self._new_estimator()
            made.close()
            self._estimator = estimator
        return self._estimator

    def _new_estimator(self) -> DepthEstimator:
        # The estimator's own configuration may be another one: with the camera file's noise.
        self._made_for, camera = self.configs[DepthConfig], self._model.camera
        config, bank = with_noise_of(camera, self._made_for), self._model.bank
        if isinstance(bank, NeighbourModel):
            return SimpleEstimator(bank, config, camera)
        return DepthEstimator(bank, config, camera)

    def _neighbour_model(
        self, camera: Camera, near_m: float, far_m: float, levels: int
    ) -> FilterBank:
        """Make what stands in for a bank with the method for simple masks."""
        config = self.configs[SimpleConfig]
        return cast(FilterBank, neighbour_model_for_camera(camera, near_m, far_m, levels, config))


def output_size(frame_size: tuple[int, int], choice: str) -> tuple[int, int]:
    """Return the size (height, width) of the depth image for a frame of size (height, width)."""
    height, width = frame_size
    divisor = _DIVISORS.get(choice)
    if divisor is None:
        divisor = math.ceil(max(height / _LARGEST_AUTO[0], width / _LARGEST_AUTO[1], 1))
    return max(1, height // divisor), max(1, width // divisor)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit status."""
    return run_nodes([DepthNode], args)


if __name__ == "__main__":
    sys.exit(main())
