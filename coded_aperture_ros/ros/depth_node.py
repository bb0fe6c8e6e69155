"""The node that turns coded frames into metric depth."""

import dataclasses
import functools
import math
import threading
from collections.abc import Callable
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, PointCloud2
from std_msgs.msg import Header

from coded_aperture_ros.core.blas import slow_blas_warning
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import option
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.depth import (
    MAP_SIZES,
    DepthConfig,
    map_size,
    nearest_obstacle_m,
    points_of_depth,
    refinement_note,
    side_warning,
)
from coded_aperture_ros.depth.config import VIDEO_FRAMES
from coded_aperture_ros.frames import hidden_noise
from coded_aperture_ros.io.messages import (
    DEPTH_FORMATS,
    MessageError,
    compressed_depth,
    frame_from_image,
    limit_depth,
    millimetres_from_depth,
    pixels_from_frame,
)
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.likelihood.bank import LearnConfig
from coded_aperture_ros.likelihood.choose import METHODS, new_model, with_settings
from coded_aperture_ros.likelihood.motion import MotionConfig
from coded_aperture_ros.likelihood.two_pixel import SimpleConfig
from coded_aperture_ros.optics.intrinsics import pixel_rays
from coded_aperture_ros.pipeline import FramePipeline, LateFrameError
from coded_aperture_ros.ros.diagnostics import Complaint
from coded_aperture_ros.ros.frame_model import FrameModel, ModelConfig
from coded_aperture_ros.ros.frame_node import FrameNode
from coded_aperture_ros.ros.gyro import Gyro, GyroConfig
from coded_aperture_ros.ros.messages import (
    cloud_from_points,
    compressed_message,
    image_from_array,
    stamp_ns,
)


@dataclasses.dataclass(frozen=True)
class DepthNodeConfig:
    """What the node needs beside the model and the options of the estimator."""

    output_size: str = option(
        "full",
        "Size of the depth image relative to the frame; auto: largest whole fraction of the frame "
        "that fits in 320x240, which best-effort subscribers get with any settings of DDS",
        choices=MAP_SIZES,
        parameter="output.size",
    )
    method: str = option(
        "bank",
        "bank: a filter bank, for any mask; simple: a pixel and its neighbours, without a bank, "
        "for a mask of 2 to 8 equal holes; motion: a bank, and blur by motion told from blur by "
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
    obstacle_share: float = option(
        0.005,
        "Part of the depth image that is taken up by what /diagnostics calls the nearest obstacle",
        within=(0.0, 1.0),
        parameter="diagnostics.obstacle_share",
    )


class DepthNode(FrameNode[tuple[Image, float]]):
    """Publishes depth of coded frames, how sure it is, and the matching camera model."""

    outputs: ClassVar = {
        "depth/image": Image,
        "depth/image/compressedDepth": CompressedImage,
        "depth/image_raw": Image,
        "depth/image_raw/compressedDepth": CompressedImage,
        "depth/confidence": Image,
        "depth/std_dev": Image,
        "depth/free_space": Image,  # only with free_space.risk, as its points
        "depth/free_points": PointCloud2,
        "depth/second": Image,  # only with second_surface.enabled, as its share
        "depth/second_share": Image,
        "depth/camera_info": CameraInfo,
        "depth/points": PointCloud2,
        "depth/motion": Image,  # only with method: motion
    }

    def __init__(self, **node_options: Any) -> None:
        super().__init__(
            "depth_node",
            ModelConfig(),
            DepthNodeConfig(),
            DepthConfig(temporal_frames=VIDEO_FRAMES),
            MotionConfig(),
            GyroConfig(),
            fixed={"learn.": LearnConfig(), "simple.": SimpleConfig()},
            **node_options,
        )
        if warning := slow_blas_warning():
            self.get_logger().warning(warning)
        self._gyro = Gyro()
        self._searched = ""
        self._restarting = threading.Event()
        self._pipeline: FramePipeline | None = None
        self.listen_to_frames("image_raw", self._on_image)
        if self._finds_motion:
            self.listen("imu", Imu, self._gyro.receive)
        self.begin()

    @property
    def _finds_motion(self) -> bool:
        return self.configs[DepthNodeConfig].method == "motion"

    def offers(self, topic: str) -> bool:
        """Return whether the method has this output."""
        return topic != "depth/motion" or self._finds_motion

    def load(self) -> None:
        """Load the camera file and load or learn the bank."""
        configs = self.configs
        self._range, method = configs[ModelConfig], configs[DepthNodeConfig].method
        if method == "simple" and self._range.bank:
            raise InputError("method: simple has no bank: leave the parameter bank empty")
        make = functools.partial(
            new_model,
            method,
            learn=configs[LearnConfig],
            simple=configs[SimpleConfig],
            motion=configs[MotionConfig],
        )
        self._model: FrameModel[LikelihoodModel] = FrameModel(self, configs, make)
        model, camera = self._model.model, self._model.camera
        if note := refinement_note(model, configs[DepthConfig]):
            self.get_logger().info(note)
        if warning := side_warning(model):
            self.get_logger().warning(warning)
        self._pipeline = FramePipeline(model, camera, configs[DepthConfig], deblur=None)

    def unload(self) -> None:
        """End the pipeline's threads."""
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            pipeline.close()

    def restart(self) -> None:
        """Begin another video with the next frame."""
        super().restart()
        self._restarting.set()
        self._gyro.forget()

    def identity(self) -> dict[str, str]:
        """Return which camera and bank the node works with."""
        identity = self._model.identity()
        if self._finds_motion:
            identity["motion"] = self._searched and f"all motions tried: {self._searched}"
        return identity

    def process(self, item: tuple[Image, float]) -> None:
        """Estimate and publish the depth of a frame; with it comes what compression has hidden."""
        (image, lost), config = item, self.configs[DepthNodeConfig]
        header, gamma = image.header, self.frame_config.gamma
        frame = frame_from_image(image, gamma, self.frame_config.bits)
        if hidden := hidden_noise(lost, frame, gamma):
            self.get_logger().warning(
                f"frames are compressed: their noise is taken to be about {hidden:.4f} at least",
                once=True,
            )
        frame_size = frame.shape[0], frame.shape[1]
        size = map_size(frame_size, config.output_size)
        driver = self.driver_info.at(header)
        self._model.fit(driver.view(self._model.whole, frame_size))
        camera, prior = self._model.camera, None
        if self._finds_motion:
            prior = self._gyro.expected(header, self.configs[GyroConfig], camera.intrinsics)
        try:
            pipeline, stamp = self._present_pipeline(), stamp_ns(header)
            result = pipeline(frame, stamp, size=size, prior=prior, hidden_noise=hidden)
        except LateFrameError as error:
            raise MessageError("late", str(error)) from error
        estimate = result.depth
        if estimate.depth_m is None or estimate.std_dev_m is None:
            raise InputError("the bank and the camera file give no depth")
        ends_m = self._range.near_m, self._range.far_m or math.inf
        depth_m = limit_depth(estimate.depth_m, *ends_m)
        self._send_depth("depth/image", lambda: depth_m, "32FC1", header)
        self._send_depth(
            "depth/image_raw", lambda: millimetres_from_depth(depth_m), "16UC1", header
        )
        std_dev_m = np.where(np.isinf(depth_m), np.float32(np.inf), estimate.std_dev_m)
        images = {"depth/confidence": estimate.confidence, "depth/std_dev": std_dev_m}
        clouds = {"depth/points": depth_m}
        if estimate.free_space_m is not None:
            free_m = np.minimum(estimate.free_space_m, ends_m[1])
            images["depth/free_space"] = clouds["depth/free_points"] = free_m
        if estimate.second_m is not None and estimate.second_share is not None:
            images["depth/second"] = limit_depth(estimate.second_m, *ends_m)
            images["depth/second_share"] = estimate.second_share
        for topic in filter(self.wants, images):
            self.send(topic, image_from_array(images[topic], "32FC1", header))
        if complaint := driver.complaint(self._model.whole, frame_size):
            self.reject("camera_info", complaint)
        info = driver.info(self._model.whole, frame_size, size, header)
        self.send("depth/camera_info", info)
        if wanted := list(filter(self.wants, clouds)):
            through = pixel_rays(info.distortion_model, tuple(info.k), tuple(info.d), *size)
            small = cv2.resize(frame, size[::-1], interpolation=cv2.INTER_AREA)
            maps = estimate.confidence, std_dev_m, pixels_from_frame(small, "rgb8", gamma), through
            for topic in wanted:
                ends = self._range.near_m, config.points_far_m
                points = points_of_depth(clouds[topic], *maps, *ends)
                self.send(topic, cloud_from_points(points, header))
        if estimate.motion is not None:
            self._searched = estimate.motion.searched
            if self.wants("depth/motion"):
                self.send(
                    "depth/motion", image_from_array(estimate.motion.vectors_px, "32FC2", header)
                )
        # What is a little nearer than the range is measured all the same.
        seen_m = np.where(depth_m == -np.inf, estimate.depth_m, depth_m)
        figures = {"nearest_obstacle_m": nearest_obstacle_m(seen_m, config.obstacle_share)}
        misfit: Complaint | None = None
        if (health := estimate.health) is not None:
            figures["health"] = health.value
            if not health.fits:
                given = "little depth is sure"
                if health.withheld:  # a guess may be asked for all the same (confidence.unknown)
                    guessed = not np.isnan(depth_m).all()
                    given = "the depth given is a guess" if guessed else "no depth is given"
                misfit = Complaint(f"{given}, the frame {health}", health.withheld)
        self.sent(header, estimate.seconds, figures, misfit)

    def _send_depth(
        self, topic: str, depth: Callable[[], NDArray[Any]], encoding: str, header: Header
    ) -> None:
        if self.wants(topic):
            self.send(topic, image_from_array(depth(), encoding, header))
        if self.wants(compressed := f"{topic}/compressedDepth"):
            content = compressed_depth(depth(), self.configs[DepthNodeConfig].compressed_depth)
            self.send(compressed, compressed_message(content, header))

    def _on_image(self, message: Image, lost: float) -> None:
        self.statistics.count_received()
        self.offer((message, lost))

    def _present_pipeline(self) -> FramePipeline:
        """Return the pipeline, brought up to date with the camera, the bank and the parameters."""
        pipeline = self._pipeline
        if pipeline is None:  # cleaned up while this frame was in work
            raise InputError("the node is being cleaned up")
        motion = self.configs[MotionConfig]
        self._model.change(lambda model: with_settings(model, motion))
        model, camera = self._model.model, self._model.camera
        # OpenCV runs the network, which is too much for the one thread of `limit_libraries`.
        depth = self.configs[DepthConfig]
        if cv2.getNumThreads() != (threads := thread_count(depth.threads)):
            cv2.setNumThreads(threads)
        pipeline.reconfigure(model=model, camera=camera, depth=depth)
        if self._restarting.is_set():
            self._restarting.clear()
            pipeline.reset()
        return pipeline
