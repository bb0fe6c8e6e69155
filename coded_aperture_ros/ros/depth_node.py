"""The node that turns coded frames into metric depth."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2
from std_msgs.msg import Header

from coded_aperture_ros.bank import FilterBank, LearnConfig
from coded_aperture_ros.core.blas import slow_blas_warning
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.core.stamp_order import StampOrder
from coded_aperture_ros.depth import (
    MAP_SIZES,
    DepthConfig,
    DepthEstimate,
    DepthEstimator,
    map_size,
    nearest_obstacle_m,
    points_of_depth,
    side_warning,
)
from coded_aperture_ros.depth.config import REAL_TIME_STRIDE_PX
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.methods.motion import (
    MotionConfig,
    MotionModel,
    learn_motion_bank,
)
from coded_aperture_ros.methods.two_pixel import (
    SimpleConfig,
    neighbour_model_for_camera,
)
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.ros.camera_model import CameraModel
from coded_aperture_ros.ros.frame_model import FrameModel, ModelConfig
from coded_aperture_ros.ros.frame_node import FrameNode
from coded_aperture_ros.ros.gyro import Gyro, GyroConfig
from coded_aperture_ros.ros.messages import (
    MessageError,
    cloud_from_points,
    frame_from_image,
    image_from_array,
    image_from_motion,
    limit_depth,
    millimetres_from_depth,
    stamp_ns,
)
from coded_aperture_ros.ros.running import run_nodes

# What a camera's rate needs on two processors; a bank from a file brings its own rank.
_RANK = 64


@dataclasses.dataclass(frozen=True)
class DepthNodeConfig:
    """What the node needs beside the model and the options of the estimator."""

    output_size: str = option(
        "auto",
        "Size of the depth image relative to the frame; auto: largest whole fraction of the frame "
        "that fits in 320x240",
        choices=MAP_SIZES,
        parameter="output.size",
    )
    method: str = option(
        "bank",
        "bank: a filter bank, for any mask; simple: a pixel and its neighbours, without a bank, "
        "for a mask of 2 to 8 equal holes; motion: a bank, and blur by motion told from blur by "
        "defocus",
        choices=("bank", "simple", "motion"),
        read_only=True,
    )
    points_far_m: float = option(
        0.0,
        "Where depth/points puts what is surely beyond far_m, so that it clears an obstacle map; "
        "0: it has no point",
        unit="m",
        minimum=0.0,
        maximum=10_000.0,
        parameter="output.points_far_m",
    )
    obstacle_share: float = option(
        0.005,
        "Part of the depth image that is taken up by what /diagnostics calls the nearest obstacle",
        minimum=0.0,
        maximum=1.0,
        parameter="diagnostics.obstacle_share",
    )

    def __post_init__(self) -> None:
        check_options(self)


class DepthNode(FrameNode[Image]):
    """Subscribes to coded frames and publishes depth, confidence and the matching camera model."""

    outputs: ClassVar = {
        "depth/image": Image,
        "depth/image_raw": Image,
        "depth/confidence": Image,
        "depth/camera_info": CameraInfo,
        "depth/points": PointCloud2,
        "depth/motion": Image,  # with method: motion
    }

    def __init__(self, **node_options: Any) -> None:
        super().__init__(
            "depth_node",
            ModelConfig(),
            DepthNodeConfig(),
            DepthConfig(stride_px=REAL_TIME_STRIDE_PX),
            MotionConfig(),
            GyroConfig(),
            fixed={"learn.": LearnConfig(rank=_RANK), "simple.": SimpleConfig()},
            **node_options,
        )
        warning = slow_blas_warning()
        if warning:
            self.get_logger().warning(warning)
        self._info = CameraModel()
        self._order = StampOrder()
        self._gyro = Gyro()
        self._searched = ""
        self._restarting = False
        self._motions: MotionModel | None = None
        self._estimator: DepthEstimator | None = None
        self.listen_to_frames("image_raw", self._on_image)
        self.listen("camera_info", CameraInfo, self._info.receive)
        if self._finds_motion:
            self.listen("imu", Imu, self._gyro.receive)
        self.begin()

    @property
    def _finds_motion(self) -> bool:
        return self.configs[DepthNodeConfig].method == "motion"

    def load(self) -> None:
        """Load the camera file and load or learn the bank."""
        learn = None
        self._range = self.configs[ModelConfig]
        if self.configs[DepthNodeConfig].method == "simple":
            if self._range.bank:
                raise InputError("method: simple has no bank: leave the parameter bank empty")
            learn = self._neighbour_model
        self._model = FrameModel(self, self.configs, learn)
        if warning := side_warning(self._model.bank):
            self.get_logger().warning(warning)
        self._estimator = self._new_estimator()

    def unload(self) -> None:
        """End the estimator's threads."""
        estimator, self._estimator = self._estimator, None
        if estimator is not None:
            estimator.close()

    def rest(self) -> None:
        """Forget the frames so far: what comes after a pause is another video."""
        self.restart()

    def restart(self) -> None:
        """Begin another video with the next frame."""
        self._restarting = True
        self._gyro.forget()

    def identity(self) -> dict[str, str]:
        """Return which camera and bank the node works with."""
        identity = self._model.identity()
        if self._finds_motion:
            identity["motion"] = self._searched and f"all motions tried: {self._searched}"
        return identity

    def process(self, item: Image) -> None:
        """Estimate and publish the depth of one frame."""
        header = item.header
        frame = frame_from_image(item, self.frame_config.gamma)
        frame_size = frame.shape[0], frame.shape[1]
        size = map_size(frame_size, self.configs[DepthNodeConfig].output_size)
        self._model.fit(item.width, item.height)
        estimator = self._present_estimator()
        self._keep_order(item, estimator)
        estimate = self._estimate(estimator, frame, size, header)
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
        config = self.configs[DepthNodeConfig]
        if self.wants("depth/camera_info") or self.wants("depth/points"):
            info = self._info.info(self._model.camera, frame_size, size, header)
            if self.wants("depth/camera_info"):
                self.send("depth/camera_info", info)
            if self.wants("depth/points"):
                points = points_of_depth(
                    depth_m, estimate.confidence, info.p, self._range.near_m, config.points_far_m
                )
                self.send("depth/points", cloud_from_points(points, header))
        if estimate.motion is not None and self.wants("depth/motion"):
            self.send("depth/motion", image_from_motion(estimate.motion.vectors_px, header))
        obstacle_m = nearest_obstacle_m(depth_m, config.obstacle_share)
        self.sent(header, estimate.seconds, {"nearest_obstacle_m": obstacle_m})

    def _estimate(
        self,
        estimator: DepthEstimator,
        frame: NDArray[np.float32],
        size: tuple[int, int],
        header: Header,
    ) -> DepthEstimate:
        if not self._finds_motion:
            return estimator.estimate(frame, size)
        intrinsics = self._model.camera.intrinsics
        expected = self._gyro.expected(header, self.configs[GyroConfig], intrinsics)
        estimate = estimator.estimate(frame, size, expected)
        if estimate.motion is not None:
            self._searched = estimate.motion.searched
        return estimate

    def _keep_order(self, item: Image, estimator: DepthEstimator) -> None:
        """Begin anew where time has gone back; refuse a frame that a later one has overtaken."""
        if self._restarting:
            self._restarting = False
            self._order.forget()
            estimator.reset()
        order = self._order.follow(stamp_ns(item.header))
        if order == "restart":
            estimator.reset()
        elif order == "late" and self.configs[DepthConfig].temporal_frames:
            raise MessageError("late", "a frame is older than the one before it")

    def _on_image(self, message: Image) -> None:
        self.statistics.count_received()
        self.offer(message)

    def _present_estimator(self) -> DepthEstimator:
        """Return the estimator for the present camera, bank and parameters."""
        made, model = self._estimator, self._model
        if made is None:  # cleaned up while this frame was in work
            raise InputError("the node is being cleaned up")
        if (
            self._made_for_bank is not model.bank
            or made.camera is not model.camera
            or self._made_for is not self.configs[DepthConfig]
            or self._made_for_motion is not self.configs[MotionConfig]
        ):
            estimator = self._new_estimator()
            made.close()
            self._estimator = made = estimator
        return made

    def _new_estimator(self) -> DepthEstimator:
        self._made_for, camera = self.configs[DepthConfig], self._model.camera
        self._made_for_motion = self.configs[MotionConfig]
        self._made_for_bank = bank = self._model.bank
        model: LikelihoodModel = bank
        if self._finds_motion:
            model = self._motion_model(bank)
        return DepthEstimator(model, self._made_for, camera)

    def _motion_model(self, bank: FilterBank) -> MotionModel:
        """Return the model of motions that belongs to a bank; learned anew only for another one."""
        config = self._made_for_motion
        if self._motions is None or self._motions.bank.defocus is not bank:
            self.get_logger().info("learning the filters of motions")
            motions = learn_motion_bank(bank, config.motions, config.motion_rank)
            self._motions = MotionModel(motions, config)
        self._motions = dataclasses.replace(self._motions, config=config)
        return self._motions

    def _neighbour_model(
        self, camera: Camera, near_m: float, far_m: float, levels: int
    ) -> FilterBank:
        """Make what stands in for a bank with the method for simple masks."""
        config = self.configs[SimpleConfig]
        return cast(FilterBank, neighbour_model_for_camera(camera, near_m, far_m, levels, config))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit status."""
    return run_nodes([DepthNode], args)
