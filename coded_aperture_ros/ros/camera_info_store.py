"""Camera model that a driver publishes, stored in a file as `camera_info_manager` does."""

import os
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from rclpy.node import Node
from sensor_msgs.srv import SetCameraInfo

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.share import share_directory
from coded_aperture_ros.frames import is_same_view
from coded_aperture_ros.io.messages import MessageError, sensor_intrinsics
from coded_aperture_ros.optics import Intrinsics, load_intrinsics

DEFAULT_URL = "file://${ROS_HOME}/camera_info/${NAME}.yaml"
_VARIABLE = re.compile(r"\$\{([^}]*)\}")


def camera_info_path(url: str, camera_name: str) -> Path:
    """Path of the calibration file that a URL names.

    Parameters
    ----------
    url : str
        `file:///PATH` or `package://PACKAGE/PATH`, where `${NAME}` is the camera's name and
        `${ROS_HOME}` the environment variable or `~/.ros`.
    camera_name : str

    Raises
    ------
    InputError
        If it is another kind of URL, names another variable, or the package is not installed.
    """

    def value_of(match: re.Match[str]) -> str:
        if match[1] == "NAME":
            return camera_name
        if match[1] == "ROS_HOME":
            return os.environ.get("ROS_HOME") or str(Path.home() / ".ros")
        raise InputError(f"camera_info_url {url}: use ${{NAME}} or ${{ROS_HOME}}, not {match[0]}")

    kind, _, rest = _VARIABLE.sub(value_of, url).partition("://")
    rest = unquote(rest)
    if kind == "file" and rest.startswith("/"):
        return Path(rest)
    package, _, inside = rest.partition("/")
    if kind == "package" and package and inside:
        return _package_share(package, url) / inside
    raise InputError(f"camera_info_url {url}: expected file:///PATH or package://PACKAGE/PATH")


def _package_share(package: str, url: str) -> Path:
    if package == "coded_aperture_ros":  # also where it runs without being installed
        return share_directory()
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    try:
        return Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError, LookupError) as error:
        raise InputError(f"camera_info_url {url}: package {package} is not installed") from error


class CameraInfoStore:
    """Loads the camera model from its URL, and saves what a calibration program sends.

    The node offers the service `set_camera_info`.

    Parameters
    ----------
    node : Node
    url : str
        See `camera_info_path`; empty: that of `camera_info_manager`, if the file exists.
    camera_name : str

    Attributes
    ----------
    measured : Intrinsics or None
        Model that was loaded, or set last.

    Raises
    ------
    InputError
        If a URL was given and nothing can be loaded from it.
    """

    def __init__(self, node: Node, url: str, camera_name: str) -> None:
        self._node = node
        self._name = camera_name
        self._path = camera_info_path(url or DEFAULT_URL, camera_name)
        self.measured: Intrinsics | None = None
        self._frame_size: tuple[int, int] | None = None
        if url or self._path.is_file():
            self.measured = load_intrinsics(self._path)
            node.get_logger().info(f"camera_info loaded from {self._path}")
            if self.measured.camera_name != camera_name:
                node.get_logger().warning(
                    f"{self._path} is for camera {self.measured.camera_name!r}, "
                    f"not {camera_name!r}: check camera_info_url and camera_name"
                )
        self._service = node.create_service(SetCameraInfo, "set_camera_info", self._set)

    def model_for(self, width: int, height: int) -> Intrinsics | None:
        """Measured model scaled to frames of this size; None without one.

        Raises
        ------
        MessageError
            Of kind "size", if the model has other proportions than the frames.
        """
        self._frame_size = width, height
        return self.measured and _scaled_to(self.measured, width, height)

    def close(self) -> None:
        """End the service."""
        self._node.destroy_service(self._service)

    def _set(self, request: Any, response: Any) -> Any:
        try:
            measured = sensor_intrinsics(request.camera_info, self._name)
            if self._frame_size is not None:
                _scaled_to(measured, *self._frame_size)
            measured.save(self._path)
        except InputError as error:
            response.success = False
            response.status_message = str(error)
            self._node.get_logger().warning(f"set_camera_info refused: {error}")
            return response
        self.measured = measured
        unchecked = "; not compared with the frames: no frame has come yet"
        response.success = True
        response.status_message = f"saved in {self._path}{'' if self._frame_size else unchecked}"
        self._node.get_logger().info(f"camera_info {response.status_message}")
        return response


def _scaled_to(model: Intrinsics, width: int, height: int) -> Intrinsics:
    if not is_same_view((model.image_width, model.image_height), width, height):
        raise MessageError(
            "size",
            f"the calibration is for {model.image_width}x{model.image_height}, which does not have "
            f"the proportions of the {width}x{height} frames: calibrate with such frames",
        )
    return model.resized(width, height)
