"""Sources of frames: files, bags, cameras, the simulator. No ROS in here."""

from coded_aperture_ros.sources.bag import BagSource
from coded_aperture_ros.sources.device import DeviceConfig, DeviceSource
from coded_aperture_ros.sources.files import PictureSource
from coded_aperture_ros.sources.opening import SIMULATOR, check_source, open_files, open_source
from coded_aperture_ros.sources.simulator import SimulatorSource
from coded_aperture_ros.sources.source import Capture, Source, captures

__all__ = [
    "SIMULATOR",
    "BagSource",
    "Capture",
    "DeviceConfig",
    "DeviceSource",
    "PictureSource",
    "SimulatorSource",
    "Source",
    "captures",
    "check_source",
    "open_files",
    "open_source",
]
