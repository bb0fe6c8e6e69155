"""A bag of simulated frames, with their camera model and true depth."""

import dataclasses
import os
from collections.abc import Iterable
from pathlib import Path

from coded_aperture_ros.bags import codec
from coded_aperture_ros.bags.writing import bag_output
from coded_aperture_ros.io.messages import pixels_from_frame
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.simulation.scene import SimulatedFrame

_TRUTH = "/ground_truth/depth"
_KINDS = {"/image_raw": codec.IMAGE, "/camera_info": codec.CAMERA_INFO, _TRUTH: codec.IMAGE}


def record_views(
    path: str | os.PathLike[str], camera: Camera, views: Iterable[SimulatedFrame], rate_hz: int
) -> None:
    """Write frames of a simulated camera into a new MCAP bag.

    Parameters
    ----------
    path : str or path-like
        Folder of the bag.
    camera : Camera
    views : iterable of SimulatedFrame
        16-bit grey frames are made of them on `/image_raw`, and 32FC1 images on
        `/ground_truth/depth`.
    rate_hz : int

    Raises
    ------
    InputError
        With the path: the bag cannot be written, or rosbags is not installed.
    """
    info = codec.camera_info_message(camera.intrinsics)
    with bag_output(Path(path), "mcap") as bag:
        for topic, kind in _KINDS.items():
            bag.add_topic(codec.new_topic(topic, kind))
        for index, view in enumerate(views):
            time_ns = 10**9 + index * 10**9 // rate_hz
            sec, nanosec = divmod(time_ns, 10**9)
            stamp = dataclasses.replace(info.header.stamp, sec=sec, nanosec=nanosec)
            header = dataclasses.replace(info.header, stamp=stamp, frame_id="camera_optical_frame")
            pixels = pixels_from_frame(view.coded, "mono16")
            size = view.depth_m.shape
            bag.write("/image_raw", time_ns, codec.image_data(pixels, "mono16", header))
            bag.write("/camera_info", time_ns, codec.camera_info_data(info, size, header))
            bag.write(_TRUTH, time_ns, codec.image_data(view.depth_m, "32FC1", header))
