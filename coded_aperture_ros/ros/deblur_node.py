"""The node that turns coded frames and their depth into all-in-focus frames."""

import math
import threading
from typing import Any, ClassVar

import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.stamp_order import StampOrder
from coded_aperture_ros.deblur import (
    AnyDeblurrer,
    DeblurConfig,
    blur_levels,
    covers_frame,
    make_deblurrer,
)
from coded_aperture_ros.frames import KnownNoise, channel_noise
from coded_aperture_ros.io.messages import (
    MessageError,
    array_from_image,
    compressed_picture,
    frame_from_image,
    output_encoding,
    pixels_from_frame,
)
from coded_aperture_ros.likelihood import BlurLevels
from coded_aperture_ros.ros.frame_model import FrameModel, ModelConfig
from coded_aperture_ros.ros.frame_node import FrameNode
from coded_aperture_ros.ros.messages import compressed_message, image_from_array, stamp_ns
from coded_aperture_ros.ros.pairing import StampPairs

# Frames to keep while depth_node works on them. Those that come meanwhile must not push out the one
# in work, however fast they come: there would never be a pair. Two seconds at 100 Hz.
_WAITING_FRAMES = 200
_WAITING_BYTES = 256 * 2**20


class DeblurNode(FrameNode[tuple[Image, Image]]):
    """Pairs each coded frame with its own depth image and publishes the frame all in focus."""

    outputs: ClassVar = {
        "deblurred/image": Image,
        "deblurred/image/compressed": CompressedImage,
        "deblurred/camera_info": CameraInfo,
    }

    def __init__(self, **node_options: Any) -> None:
        super().__init__("deblur_node", ModelConfig(), DeblurConfig(), fixed={}, **node_options)
        self._pairs: StampPairs[Image, Image] = StampPairs(
            _WAITING_FRAMES,
            lambda: self.statistics.count_dropped("no_depth"),
            _WAITING_BYTES,
            lambda message: len(message.data),
        )
        # Of the frames that come, and of those that are deblurred, in the worker's thread.
        self._arriving, self._deblurred = StampOrder(), StampOrder()
        self._restarting = threading.Event()
        self._deblurrer: AnyDeblurrer | None = None
        self.listen_to_frames("image_raw", self._on_image)
        self.listen("depth/image", Image, self._on_depth)
        self.begin()

    def load(self) -> None:
        """Load the camera file, and the bank if there is one, and prepare the deblurring."""
        self._range = self.configs[ModelConfig]
        self._model: FrameModel[BlurLevels] = FrameModel(self, self.configs, blur_levels)
        self._deblurrer = self._new_deblurrer()

    def unload(self) -> None:
        """End the deblurrer's threads."""
        deblurrer, self._deblurrer = self._deblurrer, None
        if deblurrer is not None:
            deblurrer.close()

    def identity(self) -> dict[str, str]:
        """Return which camera and bank the node works with."""
        return self._model.identity()

    def restart(self) -> None:
        """Forget the frames so far, and those that wait for their depth."""
        super().restart()
        self._arriving.forget()
        self._pairs.clear()
        self._restarting.set()

    def _on_image(self, message: Image, _: float) -> None:
        self.statistics.count_received()
        if self._arriving.follow(stamp_ns(message.header)) == "restart":
            # The same stamps may come again, and frames from before are not theirs.
            self._pairs.clear()
        self.offer(self._pairs.add(True, stamp_ns(message.header), message))

    def _on_depth(self, message: Image) -> None:
        self.offer(self._pairs.add(False, stamp_ns(message.header), message))

    def process(self, item: tuple[Image, Image]) -> None:
        """Deblur and publish one frame."""
        image, depth = item
        header, gamma = image.header, self.frame_config.gamma
        frame = frame_from_image(image, gamma, self.frame_config.bits, coloured=True)
        depth_m = depth_of_frame(depth, image)
        # Beyond the range is deblurred as the end of the range; NaN stays unknown.
        depth_m = np.clip(depth_m, self._range.near_m, self._range.far_m or math.inf)
        size = image.height, image.width
        driver = self.driver_info.at(header)
        self._model.fit(driver.view(self._model.whole, size))
        camera, config = self._model.whole, self.configs[DeblurConfig]
        blur_size_px = self._model.blur_size_px(depth_m)
        if not np.isfinite(blur_size_px).any():
            raise MessageError("depth", "no depth is known in the whole frame")
        deblurrer = self._present_deblurrer(config)
        if self._begins_anew(stamp_ns(header)):
            deblurrer.reset()
        noise = channel_noise(frame, KnownNoise.of(config, camera, self._model.model))
        sharp = deblurrer.deblur(frame, blur_size_px, noise)
        encoding = output_encoding(image.encoding)
        compressed = self.wants("deblurred/image/compressed")
        if compressed or self.wants("deblurred/image"):
            pixels = pixels_from_frame(sharp, encoding, gamma)
            self.send("deblurred/image", image_from_array(pixels, encoding, header))
        if compressed:
            try:
                content = compressed_picture(pixels, encoding)
                self.send("deblurred/image/compressed", compressed_message(content, header))
            except MessageError as error:  # the other outputs do not depend on it
                self.reject(error.kind, str(error))
        if complaint := driver.complaint(camera, size):
            self.reject("camera_info", complaint)
        self.send("deblurred/camera_info", driver.info(camera, size, size, header))
        self.sent(header)

    def _begins_anew(self, stamp: int) -> bool:
        """Return whether a frame is the first one of another video."""
        if self._restarting.is_set():
            self._restarting.clear()
            self._deblurred.forget()
            self._deblurred.follow(stamp)
            return True
        return self._deblurred.follow(stamp) == "restart"

    def _present_deblurrer(self, config: DeblurConfig) -> AnyDeblurrer:
        """Return the deblurrer for the present PSFs and parameters."""
        made = self._deblurrer
        if made is None:  # cleaned up while this frame was in work
            raise InputError("the node is being cleaned up")
        if made.stack is not self._model.model.stack:
            self._deblurrer = self._new_deblurrer()
            made.close()
            return self._deblurrer
        if made.config is not config:
            made.reconfigure(config)
        return made

    def _new_deblurrer(self) -> AnyDeblurrer:
        deblurrer = make_deblurrer(self._model.model, self.configs[DeblurConfig])
        camera = self._model.camera
        deblurrer.prepare((camera.image_height, camera.image_width))
        return deblurrer


def depth_of_frame(depth: Image, image: Image) -> FloatArray:
    """Return the depth image of a frame in metres, NaN where it says nothing.

    Raises `MessageError` if it cannot be the depth of that frame.
    """
    if stamp_ns(image.header) == 0:
        raise MessageError("stamp", "the frame has no stamp, so its depth cannot be told apart")
    if depth.encoding != "32FC1":
        raise MessageError("depth", f"depth/image is {depth.encoding}, expected 32FC1")
    if not covers_frame((depth.height, depth.width), (image.height, image.width)):
        raise MessageError(
            "depth",
            f"depth/image of {depth.width}x{depth.height} does not have the proportions of the "
            f"{image.width}x{image.height} frame",
        )
    depth_m = array_from_image(depth)
    # Some drivers say 0 where depth is unknown; -Inf is too near.
    return np.where((depth_m > 0) | (depth_m == -np.inf), depth_m, np.float32(np.nan))
