"""Node that turns coded frames and their depth into all-in-focus pictures."""

import dataclasses
import math
import threading
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur import DeblurConfig, blur_levels, covers_frame
from coded_aperture_ros.deblur.levels import RenderedLevels
from coded_aperture_ros.depth import check_depth_range
from coded_aperture_ros.frames.frame import LateFrameError, StampOrder
from coded_aperture_ros.io.messages import (
    MessageError,
    array_from_image,
    compressed_picture,
    frame_from_image,
    output_encoding,
    pixels_from_frame,
)
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.ros.frame_model import FrameModel, ModelConfig
from coded_aperture_ros.ros.frame_node import FrameNode
from coded_aperture_ros.ros.messages import compressed_message, image_from_array, stamp_ns
from coded_aperture_ros.ros.pairing import StampPairs

# Topics that the node publishes, and their message types.
OUTPUT_TYPES = {
    "deblurred/image": Image,
    "deblurred/image/compressed": CompressedImage,
    "deblurred/camera_info": CameraInfo,
}
# Frames kept while depth_node works on them: two seconds at 100 Hz. With fewer, a fast camera would
# push out the frame in work before its depth comes, and there would never be a pair.
_WAITING_FRAMES = 200
# Bytes that they take up at most.
_WAITING_BYTES = 256 * 2**20


class DeblurNode(FrameNode[tuple[Image, Image]]):
    """Pairs each coded frame with its depth image and publishes the all-in-focus picture."""

    def __init__(self, **node_options: Any) -> None:
        self.outputs = OUTPUT_TYPES
        super().__init__("deblur_node", ModelConfig(), DeblurConfig(), fixed={}, **node_options)
        self._pairs: StampPairs[Image, Image] = StampPairs(
            _WAITING_FRAMES,
            self.statistics.count_without_depth,
            _WAITING_BYTES,
            lambda message: len(message.data),
        )
        self._arriving = StampOrder()
        self._restarting = threading.Event()
        self._pipeline: FramePipeline | None = None
        self.listen_to_frames("image_raw", self._on_image)
        self.listen("depth/image", Image, self._on_depth)
        self.begin()

    def load(self) -> None:
        """Load the camera file and the bank, if any, and prepare the inverse filters."""
        self._model_config = self.configs[ModelConfig]
        self._model: FrameModel[FilterBank | RenderedLevels] = FrameModel(
            self, self.configs, blur_levels
        )
        camera = self._model.whole
        self._pipeline = FramePipeline(self._model.model, camera, deblur=self.configs[DeblurConfig])

    def unload(self) -> None:
        """End the threads of the pipeline."""
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            pipeline.close()

    def identity(self) -> dict[str, str]:
        """Keys and values of /diagnostics: camera file and bank."""
        return self._model.identity()

    def warm_up(self) -> None:
        """Run a frame of the camera's size through the pipeline."""
        camera = self._model.camera
        self._present_pipeline().warm_up((camera.image_height, camera.image_width))

    def restart(self) -> None:
        """Start a new video with the next frame; drop frames that wait for their depth."""
        super().restart()
        self._arriving.forget()
        self._pairs.clear()
        self._restarting.set()

    def _on_image(self, message: Image, _compression_loss: float) -> None:
        self.statistics.count_received()
        if self._arriving.follow(stamp_ns(message.header)) == "restart":
            # The same stamps may come again: depth must not be paired with frames from before.
            self._pairs.clear()
        self.offer(self._pairs.add(True, stamp_ns(message.header), message))

    def _on_depth(self, message: Image) -> None:
        self.offer(self._pairs.add(False, stamp_ns(message.header), message))

    def process(self, item: tuple[Image, Image]) -> None:
        """Deblur a frame with its depth and publish the picture."""
        image, depth = item
        header = image.header
        pixel_format = self.frame_config.pixel_format
        frame = frame_from_image(image, pixel_format, colour=True, stamp_ns=stamp_ns(header))
        depth_m = depth_of_frame(depth, image)
        try:
            check_depth_range(self._model.model, self._model.whole, depth_m)
        except InputError as error:
            raise MessageError("depth", f"depth/image: {error}") from error
        # Depth beyond the range is deblurred as the end of the range; NaN stays unknown.
        depth_m = np.clip(depth_m, self._model_config.near_m, self._model_config.far_m or math.inf)
        if not np.isfinite(depth_m).any():
            raise MessageError("depth", "no depth is known in the whole frame")
        driver = self.driver_info.at(header)
        view = driver.view(self._model.whole, frame.shape)
        self._model.fit(view)
        pipeline = self._present_pipeline()
        try:
            sharp = pipeline.deblur(dataclasses.replace(frame, view=view), depth_m)
        except LateFrameError as error:
            raise MessageError("late", str(error)) from error
        self._send_picture(sharp, output_encoding(image.encoding), header)
        camera = self._model.whole
        if complaint := driver.complaint(camera, frame.shape):
            self.reject("camera_info", complaint)
        info = driver.info(camera, frame.shape, frame.shape, header)
        self.send("deblurred/camera_info", info)
        self.finish_frame(header)

    def _send_picture(self, sharp: FloatArray, encoding: str, header: Header) -> None:
        compressed = self.wants("deblurred/image/compressed")
        if not (compressed or self.wants("deblurred/image")):
            return
        pixels = pixels_from_frame(sharp, encoding, self.frame_config.gamma)
        self.send("deblurred/image", image_from_array(pixels, encoding, header))
        if not compressed:
            return
        try:
            content = compressed_picture(pixels, encoding)
            self.send("deblurred/image/compressed", compressed_message(content, header))
        except MessageError as error:  # the other outputs do not depend on it
            self.reject(error.kind, str(error))

    def _present_pipeline(self) -> FramePipeline:
        """Pipeline with the present camera, PSFs and parameters."""
        pipeline = self._pipeline
        if pipeline is None:  # cleaned up while this frame was in work
            raise InputError("the node is being cleaned up")
        model = self._model.model
        camera = self._model.whole
        if model is not pipeline.model or camera != pipeline.camera:
            pipeline.reconfigure(model=model, camera=camera)
            pipeline.warm_up((camera.image_height, camera.image_width))
        pipeline.reconfigure(deblur=self.configs[DeblurConfig])
        if self._restarting.is_set():
            self._restarting.clear()
            pipeline.reset()
        return pipeline


def depth_of_frame(depth: Image, image: Image) -> FloatArray:
    """Depth map of a frame, metres, NaN where unknown; float32 [rows, columns].

    Parameters
    ----------
    depth : Image
        Message of encoding 32FC1, metres; 0 and NaN are unknown, -Inf is nearer than the range.
    image : Image
        Coded frame.

    Raises
    ------
    MessageError
        If `depth` cannot be the depth of that frame.
    """
    if stamp_ns(image.header) == 0:
        raise MessageError("stamp", "the frame has no stamp: its depth cannot be found")
    if depth.encoding != "32FC1":
        raise MessageError("depth", f"depth/image is {depth.encoding}, expected 32FC1")
    if not covers_frame((depth.height, depth.width), (image.height, image.width)):
        raise MessageError(
            "depth",
            f"depth/image of {depth.width}x{depth.height} does not have the proportions of the "
            f"{image.width}x{image.height} frame",
        )
    depth_m = array_from_image(depth)
    # Some drivers write 0 where depth is unknown; -Inf is too near.
    return np.where((depth_m > 0) | (depth_m == -np.inf), depth_m, np.float32(np.nan))
