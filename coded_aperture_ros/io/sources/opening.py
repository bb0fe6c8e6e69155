"""From the text that names a source to the source."""

import dataclasses

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.bags import is_bag
from coded_aperture_ros.io.sources.bag import BagSource
from coded_aperture_ros.io.sources.device import DeviceConfig, DeviceSource
from coded_aperture_ros.io.sources.sequence import SequenceSource
from coded_aperture_ros.io.sources.simulator import SimulatorSource
from coded_aperture_ros.io.sources.source import Source
from coded_aperture_ros.optics import Camera

SIMULATOR = "simulator"
_BAG = "bag:"


def open_source(
    text: str,
    camera: Camera,
    rate_hz: float,
    *,
    loop: bool = True,
    noise: float = 0.0,
    device: DeviceConfig | None = None,
) -> Source:
    """Return the source that a text names.

    Parameters
    ----------
    text : str
        `simulator`; the index of a camera, a device (`/dev/video0`), a URL (`rtsp://...`) or a
        GStreamer pipeline; the path of a picture, a folder of pictures, a video or a bag; or `bag:`
        and the path of a bag, which may end in `#` and the topic of the frames.
    camera : Camera
        To simulate, or whose image size to ask a device for.
    rate_hz : float
    loop : bool
        Of files: begin again after the last frame.
    noise : float
        Of the simulator.
    device : DeviceConfig, optional
        Of a camera.

    Raises
    ------
    InputError
        If files are missing or unreadable. A device may be missing: it is opened by `read`.
    """
    if text == SIMULATOR:
        return SimulatorSource(camera, rate_hz, noise)
    if not text:
        raise InputError("parameter source is empty: use simulator, a camera index or a path")
    if text.startswith(_BAG):
        path, _, topic = text.removeprefix(_BAG).partition("#")
        return BagSource(path, loop, topic or None)
    if text.isdecimal() or text.startswith("/dev/"):
        address = int(text) if text.isdecimal() else text
        config = device or DeviceConfig()
        if not (config.width and config.height):
            config = dataclasses.replace(
                config, width=camera.image_width, height=camera.image_height
            )
        return DeviceSource(address, config, rate_hz)
    # Of a stream, the sender says how large it is and how fast.
    if "://" in text or " ! " in text:
        return DeviceSource(text)
    return BagSource(text, loop) if is_bag(text) else SequenceSource(text, loop)
