"""Where the camera driver gets its frames from. No ROS in here."""

from coded_aperture_ros.io.sources.bag import BagSource
from coded_aperture_ros.io.sources.device import DeviceConfig, DeviceSource
from coded_aperture_ros.io.sources.opening import SIMULATOR, open_source
from coded_aperture_ros.io.sources.sequence import SequenceSource
from coded_aperture_ros.io.sources.simulator import SimulatorSource
from coded_aperture_ros.io.sources.source import Capture, Source

__all__ = [
    "SIMULATOR",
    "BagSource",
    "Capture",
    "DeviceConfig",
    "DeviceSource",
    "SequenceSource",
    "SimulatorSource",
    "Source",
    "open_source",
]
