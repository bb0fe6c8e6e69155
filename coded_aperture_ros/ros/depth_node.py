"""Node that turns coded frames into metric depth."""

import dataclasses
import functools
import math
import threading
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, PointCloud2
from std_msgs.msg import Header

from coded_aperture_ros.calibration.psf.optics_limits import checked_model
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.blas import slow_blas_warning
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import option
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.depth import (
    MAP_SIZES,
    DepthConfig,
    DepthEstimate,
    layer_specs,
    map_size,
    model_notes,
    nearest_obstacle_m,
    points_of_depth,
    unchecked_note,
)
from coded_aperture_ros.depth.core_maps import CONFIDENCE, CORE_MAPS, DEPTH, DEPTH_MM, STD_DEV
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.points import point_colours
from coded_aperture_ros.depth.stages import moving_camera
from coded_aperture_ros.depth.stages.temporal import VIDEO_FRAMES
from coded_aperture_ros.frames import Frame
from coded_aperture_ros.frames.frame import LateFrameError
from coded_aperture_ros.frames.pose import Pose
from coded_aperture_ros.io.messages import (
    DEPTH_FORMATS,
    MessageError,
    compressed_depth,
    frame_from_image,
    limit_depth,
    limit_layer,
    millimetres_from_depth,
)
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.likelihood.bank import LearnConfig
from coded_aperture_ros.likelihood.choose import METHODS
from coded_aperture_ros.likelihood.motion import MotionConfig, with_motion_config
from coded_aperture_ros.likelihood.two_pixel import TwoPixelConfig
from coded_aperture_ros.optics.distortion import pixel_rays
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.ros.camera_model import CameraModel
from coded_aperture_ros.ros.camera_motion import MANY, CameraMotion
from coded_aperture_ros.ros.diagnostics import Complaint
from coded_aperture_ros.ros.drift import NodeDrift
from coded_aperture_ros.ros.frame_model import FrameModel, ModelConfig
from coded_aperture_ros.ros.frame_node import FrameNode
from coded_aperture_ros.ros.gyro import Gyro, GyroConfig
from coded_aperture_ros.ros.messages import (
    cloud_from_points,
    compressed_message,
    image_from_array,
    stamp_ns,
)

_INFO, _ODOMETRY = "depth/camera_info", "depth/odometry"


@dataclasses.dataclass(frozen=True)
class DepthNodeConfig:
    """Options of the node beside those of the model and of the estimator."""

    output_size: str = option(
        "full",
        "Size of the depth image relative to the frame; auto: largest whole fraction of the frame "
        "that fits in 320x240, which best-effort subscribers get with any settings of DDS",
        choices=MAP_SIZES,
        parameter="output.size",
    )
    method: str = option(
        "bank",
        "bank: a filter bank, for any mask; two_pixel: a pixel and its neighbours, without a bank, "
        "for a mask of 2 to 8 equal holes; motion: a bank, and motion blur distinguished from "
        "defocus",
        choices=METHODS,
        read_only=True,
    )
    points_far_m: float = option(
        0.0,
        "Where depth/points puts what is surely beyond far_m, so that it clears an obstacle map; "
        "0: it has no point",
        unit="m",
        within=(0.0, 10_000.0),
        parameter="output.points_far_m",
    )
    compressed_depth: str = option(
        "png",
        "How the topics that end in compressedDepth are compressed",
        choices=DEPTH_FORMATS,
        parameter="output.compressed_depth",
    )
    fixed_frame: str = option(
        "odom",
        "Frame in which the camera moves, of tf or odometry; for temporal.moving_camera: pose",
        parameter="temporal.fixed_frame",
    )
    obstacle_share: float = option(
        0.005,
        "Part of the depth image that is taken up by what /diagnostics calls the nearest obstacle",
        within=(0.0, 1.0),
        parameter="diagnostics.obstacle_share",
    )


def output_types() -> dict[str, type]:
    """Message type of every topic that the node publishes; layers come from the stages of depth."""
    types: dict[str, type] = {_INFO: CameraInfo, _ODOMETRY: Odometry}
    for spec in (*CORE_MAPS, *layer_specs()):
        types[spec.topic] = Image
        if spec.points_topic:
            types[spec.points_topic] = PointCloud2
    for spec in (DEPTH, DEPTH_MM):
        types[_compressed_topic(spec)] = CompressedImage
    return types


def _compressed_topic(spec: LayerSpec) -> str:
    return f"{spec.topic}/compressedDepth"


class DepthNode(FrameNode[tuple[Image, float]]):
    """Publishes depth of coded frames, its confidence, the layers, and the camera model.

    A work item is a frame and its compression loss.
    """

    def __init__(self, **node_options: Any) -> None:
        self.outputs = output_types()
        super().__init__(
            "depth_node",
            ModelConfig(),
            DepthNodeConfig(),
            DepthConfig(temporal_frames=VIDEO_FRAMES),
            MotionConfig(),
            GyroConfig(),
            fixed={"learn.": LearnConfig(), "two_pixel.": TwoPixelConfig()},
            **node_options,
        )
        if warning := slow_blas_warning():
            self.get_logger().warning(warning)
        self._gyro = Gyro()
        self._drift = NodeDrift()
        self._camera_motion = CameraMotion(self.get_logger())
        self._motion_note = ""
        self._restarting = threading.Event()
        self._pipeline: FramePipeline | None = None
        self.listen_to_frames("image_raw", self._on_image)
        if self._finds_motion or self._told_by == moving_camera.GYRO:
            self.listen("imu", Imu, self._gyro.receive, MANY)
        if self._told_by == moving_camera.POSE:
            self._camera_motion.listen(self.listen)
        self.begin()

    @property
    def _finds_motion(self) -> bool:
        return self.configs[DepthNodeConfig].method == "motion"

    @property
    def _told_by(self) -> str:
        return self.configs[DepthConfig].moving_camera

    def load(self) -> None:
        """Load the camera file and load or learn the bank."""
        configs = self.configs
        method = configs[DepthNodeConfig].method
        self._model_config = configs[ModelConfig]
        if method == "two_pixel" and self._model_config.bank:
            raise InputError("method: two_pixel has no bank: leave the parameter bank empty")
        # With limits at any rate: the check may be turned on while the node runs.
        make = functools.partial(
            checked_model,
            method,
            learn=configs[LearnConfig],
            two_pixel=configs[TwoPixelConfig],
            motion=configs[MotionConfig],
        )
        self._model: FrameModel[LikelihoodModel] = FrameModel(self, configs, make)
        model = self._model.model
        self._drift.use(model)
        for note in model_notes(model, configs[DepthConfig], self._model.camera):
            self.get_logger().warning(note)
        self._pipeline = FramePipeline(model, self._model.camera, configs[DepthConfig], deblur=None)

    def unload(self) -> None:
        """End the threads of the pipeline."""
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            pipeline.close()

    def warm_up(self) -> None:
        """Run a frame of the camera's size through the pipeline."""
        camera = self._model.camera
        self._present_pipeline().warm_up((camera.image_height, camera.image_width))

    def restart(self) -> None:
        """Start a new video with the next frame."""
        super().restart()
        self._restarting.set()
        self._gyro.forget()
        self._camera_motion.forget_poses()

    def identity(self) -> dict[str, str]:
        """Keys and values of /diagnostics: camera file, bank, and what is known of motion."""
        identity = self._model.identity()
        identity["fit_check"] = "on"
        if not self.configs[DepthConfig].check_fit:
            identity["fit_check"] = "off"
        elif note := unchecked_note(self._model.model):
            identity["fit_check"] = note
        if self._finds_motion:
            identity["motion"] = self._motion_note and f"all motions tried: {self._motion_note}"
        if self.configs[DepthConfig].moving_camera:
            identity["camera_motion"] = self._camera_motion.note
        return identity

    def process(self, item: tuple[Image, float]) -> None:
        """Estimate and publish the depth of a frame."""
        image, compression_loss = item
        header = image.header
        driver = self.driver_info.at(header)
        frame = self._decode_frame(image, compression_loss, driver)
        shape = frame.shape
        size = map_size(shape, self.configs[DepthNodeConfig].output_size)
        try:
            estimate = self._present_pipeline()(frame, size)
        except LateFrameError as error:
            raise MessageError("late", str(error)) from error
        if estimate.depth_m is None or estimate.std_dev_m is None:
            raise InputError("the bank's levels have no depth: use a bank for this camera file")
        depth_m = limit_depth(estimate.depth_m, *self._range_m)
        self._camera_motion.follow(estimate.camera_step, header)
        if self.wants(_ODOMETRY) and (odometry := self._camera_motion.odometry(header)):
            self.send(_ODOMETRY, odometry)
        self._send_maps(estimate, depth_m, header)
        self._send_layers(estimate, header)
        if complaint := driver.complaint(self._model.whole, shape):
            self.reject("camera_info", complaint)
        info = driver.info(self._model.whole, shape, size, header)
        self.send(_INFO, info)
        self._send_points(frame, estimate, depth_m, info)
        figures, misfit = self._figures(estimate, estimate.depth_m, depth_m)
        averages, drift = self._drift.see(frame, estimate, self.configs[DepthConfig])
        self.finish_frame(header, estimate.seconds, figures | averages, misfit or drift)

    def _decode_frame(self, image: Image, compression_loss: float, driver: CameraModel) -> Frame:
        """Frame of a message, with its view and expected motion; fits the model to the view."""
        header = image.header
        frame = frame_from_image(
            image, self.frame_config.pixel_format, compression_loss, stamp_ns=stamp_ns(header)
        )
        if frame.compression_noise:
            self.get_logger().warning(
                "frames are lossily compressed: at least "
                f"{frame.compression_noise:.4f} of noise is assumed",
                once=True,
            )
        view = driver.view(self._model.whole, frame.shape)
        self._model.fit(view)
        motion = None
        if self._finds_motion:
            intrinsics = self._model.camera.intrinsics
            motion = self._gyro.expected(header, self.configs[GyroConfig], intrinsics)
        pose: Callable[[], Pose | DoubleArray | None] | None = None
        if self._told_by == moving_camera.POSE:
            pose = self._camera_motion.pose_of(header, self.configs[DepthNodeConfig].fixed_frame)
        elif self._told_by == moving_camera.GYRO:
            gyro = self.configs[GyroConfig]
            pose = functools.partial(self._gyro.pose, stamp_ns(header), gyro)
        return dataclasses.replace(frame, view=view, motion=motion, pose=pose)

    @property
    def _range_m(self) -> tuple[float, float]:
        """Nearest and farthest depth that are published as numbers, m."""
        return self._model_config.near_m, self._model_config.far_m or math.inf

    def _send_maps(self, estimate: DepthEstimate, depth_m: FloatArray, header: Header) -> None:
        """Publish the core results: depth, confidence and standard deviation."""
        self._send_depth(DEPTH, lambda: depth_m, header)
        self._send_depth(DEPTH_MM, lambda: millimetres_from_depth(depth_m), header)
        self._send_map(CONFIDENCE, estimate.confidence, header)
        if self.wants(STD_DEV.topic):
            self._send_map(STD_DEV, _std_dev_m(estimate, depth_m), header)

    def _send_depth(
        self, spec: LayerSpec, depth: Callable[[], NDArray[Any]], header: Header
    ) -> None:
        """Publish a depth image, raw and compressed; it is only made where one is wanted."""
        if self.wants(spec.topic):
            self.send(spec.topic, image_from_array(depth(), spec.encoding, header))
        if self.wants(compressed := _compressed_topic(spec)):
            content = compressed_depth(depth(), self.configs[DepthNodeConfig].compressed_depth)
            self.send(compressed, compressed_message(content, header))

    def _send_map(self, spec: LayerSpec, values: FloatArray, header: Header) -> None:
        if self.wants(spec.topic):
            self.send(spec.topic, image_from_array(values, spec.encoding, header))

    def _send_layers(self, estimate: DepthEstimate, header: Header) -> None:
        """Publish the images of all layers."""
        for layer in estimate.layers.values():
            spec = layer.spec
            if self.wants(spec.topic):
                values = limit_layer(layer.values, spec.kind, *self._range_m)
                self._send_map(spec, values, header)
        motion = estimate.layers.get("motion")
        self._motion_note = "" if motion is None else motion.note

    def _send_points(
        self, frame: Frame, estimate: DepthEstimate, depth_m: FloatArray, info: CameraInfo
    ) -> None:
        """Publish the point clouds of depth and of the layers that have one."""
        clouds = {DEPTH.points_topic: depth_m}
        for layer in estimate.layers.values():
            if layer.spec.points_topic:
                values = limit_layer(layer.values, layer.spec.kind, *self._range_m)
                clouds[layer.spec.points_topic] = values
        wanted = [topic for topic in clouds if self.wants(topic)]
        if not wanted:
            return
        size = depth_m.shape
        rays = pixel_rays(info.distortion_model, tuple(info.k), tuple(info.d), *size)
        colours = point_colours(frame.light, size, self.frame_config.gamma)
        std_dev_m = _std_dev_m(estimate, depth_m)
        near_m = self._model_config.near_m
        far_m = self.configs[DepthNodeConfig].points_far_m
        for topic in wanted:
            points = points_of_depth(
                clouds[topic], estimate.confidence, std_dev_m, colours, rays, near_m, far_m
            )
            self.send(topic, cloud_from_points(points, info.header))

    def _figures(
        self, estimate: DepthEstimate, measured_m: FloatArray, depth_m: FloatArray
    ) -> tuple[dict[str, float], Complaint | None]:
        """Figures of a frame for diagnostics, and the complaint about it, if any."""
        share = self.configs[DepthNodeConfig].obstacle_share
        figures = {"nearest_obstacle_m": nearest_obstacle_m(depth_m, share, measured_m)}
        health = estimate.health
        if health is None:
            return figures, None
        figures["health"] = health.value
        if health.fits:
            return figures, None
        outcome = "little depth is sure"
        if health.withheld:  # confidence.unknown may fill the map with guesses all the same
            guessed = not np.isnan(depth_m).all()
            outcome = "the depth given is a guess" if guessed else "no depth is given"
        return figures, Complaint(f"{outcome}, the frame {health}", health.withheld)

    def _on_image(self, message: Image, compression_loss: float) -> None:
        self.statistics.count_received()
        self.offer((message, compression_loss))

    def _present_pipeline(self) -> FramePipeline:
        """Pipeline with the present camera, bank and parameters."""
        pipeline = self._pipeline
        if pipeline is None:  # cleaned up while this frame was in work
            raise InputError("the node is being cleaned up")
        motion = self.configs[MotionConfig]
        self._model.change(lambda model: with_motion_config(model, motion))
        # OpenCV runs the network, which is too much for the one thread of `limit_libraries`.
        depth = self.configs[DepthConfig]
        threads = thread_count(depth.threads)
        if cv2.getNumThreads() != threads:
            cv2.setNumThreads(threads)
        self._drift.use(self._model.model)
        pipeline.reconfigure(model=self._model.model, camera=self._model.whole, depth=depth)
        if self._restarting.is_set():
            self._restarting.clear()
            pipeline.reset()
            self._camera_motion.restart()
        return pipeline


def _std_dev_m(estimate: DepthEstimate, depth_m: FloatArray) -> FloatArray:
    """Standard deviation of the depth as published, m: infinite where that is."""
    assert estimate.std_dev_m is not None  # `process` has looked
    return np.where(np.isinf(depth_m), np.float32(np.inf), estimate.std_dev_m)
