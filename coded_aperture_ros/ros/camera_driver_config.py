"""Options of the camera driver."""

import dataclasses

from coded_aperture_ros.core.options import option
from coded_aperture_ros.io.messages import PICTURE_FORMATS
from coded_aperture_ros.sources import SIMULATOR


@dataclasses.dataclass(frozen=True)
class CameraDriverConfig:
    """Source of the frames and how they are published; fixed while the node runs."""

    source: str = option(
        SIMULATOR,
        "simulator; a camera's index, device, URL or GStreamer pipeline; a video, picture, folder "
        "of pictures or bag:PATH; rgbd: coded from the topics rgbd/image and rgbd/depth",
    )
    camera_file: str = option("", "Camera file (YAML); empty: with the simulator, the demo's")
    rate_hz: float = option(15.0, "Frames per second", unit="Hz", within=(0.1, 1000.0))
    frame_id: str = option("camera_optical_frame", "Optical frame of the images")
    encoding: str = option(
        "bgr8",
        "Encoding of image_raw",
        choices=("mono8", "rgb8", "bgr8", "mono16", "bayer_rggb8", "bayer_rggb16"),
    )
    # The names are those of image_transport's plugin.
    compressed_format: str = option(
        "png",
        "Of image_raw/compressed: png keeps every pixel; jpeg is smaller, and hides the noise that "
        "depth reckons with (16 bits and mosaics are always png)",
        choices=PICTURE_FORMATS,
        parameter="image_raw.compressed.format",
    )
    jpeg_quality: int = option(
        95, "Of jpeg", within=(1, 100), parameter="image_raw.compressed.jpeg_quality"
    )
    loop: bool = option(True, "Start files again after their last frame")
    noise: float = option(
        -1.0,
        "Standard deviation of the simulated sensor's noise in linear light; -1: of the camera "
        "file's sensor at 300 lux and 20 Hz, or 0.002 if it has none",
        within=(-1.0, 0.5),
        parameter="simulation.noise",
    )
    camera_name: str = option(
        "", "Of the camera's calibration; empty: the node's namespace, or camera"
    )
    camera_info_url: str = option(
        "",
        "Calibration to publish, file:// or package://, with ${NAME} and ${ROS_HOME}; empty: that "
        "of a bag's frames, or file://${ROS_HOME}/camera_info/${NAME}.yaml if there is one, else "
        "the camera file's",
    )
    publish_clock: bool = option(False, "Publish the frames' stamps as the time, on /clock")
    base_frame: str = option(
        "",
        "Publish the static transform from this frame to frame_id; empty: none",
        parameter="base.frame",
    )
    base_x_m: float = option(0.0, "Camera position in base_frame", unit="m", parameter="base.x_m")
    base_y_m: float = option(0.0, "Camera position in base_frame", unit="m", parameter="base.y_m")
    base_z_m: float = option(0.0, "Camera position in base_frame", unit="m", parameter="base.z_m")
    base_pitch_deg: float = option(
        0.0,
        "How far the camera looks down",
        unit="degrees",
        within=(-180.0, 180.0),
        parameter="base.pitch_deg",
    )


@dataclasses.dataclass(frozen=True)
class LazyConfig:
    """Whether frames are produced without a subscriber."""

    lazy: bool = option(True, "Simulate, or read files, only while someone subscribes")
