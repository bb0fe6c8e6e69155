"""Where frames come from: files, bags, cameras, the simulator. No ROS in here."""

from coded_aperture_ros.io.sources.bag import BagSource
from coded_aperture_ros.io.sources.device import DeviceConfig, DeviceSource
from coded_aperture_ros.io.sources.files import PictureSource
from coded_aperture_ros.io.sources.opening import SIMULATOR, open_files, open_source
from coded_aperture_ros.io.sources.simulator import SimulatorSource
from coded_aperture_ros.io.sources.source import Capture, Source, captures
