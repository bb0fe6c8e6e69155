"""The camera model that a driver publishes, kept in a file as `camera_info_manager` keeps it."""

import os
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.share import share_directory
from coded_aperture_ros.frames import is_same_view
from coded_aperture_ros.io.messages import MessageError
from coded_aperture_ros.optics import Intrinsics, load_intrinsics

DEFAULT_URL = "file://${ROS_HOME}/camera_info/${NAME}.yaml"
_VARIABLE = re.compile(r"\$\{([^}]*)\}")


def camera_info_path(url: str, camera_name: str) -> Path:
    """Return the file that the URL of a calibration stands for.

    It is `file:///PATH` or `package://PACKAGE/PATH`, where `${NAME}` is the camera's name and
    `${ROS_HOME}` the environment variable or `~/.ros`. Raises `InputError` if it is another kind
    of URL, names another variable, or the package is not installed.
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
        return _share_of(package, url) / inside
    raise InputError(f"camera_info_url {url}: expected file:///PATH or package://PACKAGE/PATH")


def _share_of(package: str, url: str) -> Path:
    if package == "coded_aperture_ros":  # which also runs from where no index knows it
        return share_directory()
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    try:
        return Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError, LookupError) as error:
        raise InputError(f"camera_info_url {url}: no package {package} is installed") from error


class CameraInfoStore:
    """Loads the camera model from its URL, and saves what a calibration program sends.

    The node offers the service `set_camera_info`. An empty URL stands for that of
    `camera_info_manager`, if there is such a file; `measured` is what was loaded, or set last.
    Raises `InputError` if a URL was given and nothing can be loaded from it.
    """

    def __init__(self, node: Node, url: str, camera_name: str) -> None:
        self._node, self._name = node, camera_name
        self._path = camera_info_path(url or DEFAULT_URL, camera_name)
        self.measured: Intrinsics | None = None
        self._frame_size: tuple[int, int] | None = None
        if url or self._path.is_file():
            self.measured = load_intrinsics(self._path)
            node.get_logger().info(f"camera_info is that of {self._path}")
            if self.measured.camera_name != camera_name:
                node.get_logger().warning(
                    f"{self._path} is of camera {self.measured.camera_name!r}, "
                    f"this one is {camera_name!r}"
                )
        self._service = node.create_service(SetCameraInfo, "set_camera_info", self._set)

    def fitted(self, width: int, height: int) -> Intrinsics | None:
        """Return the measured model for the frames, which are of this size; None without one.

        Raises `MessageError` of kind "size", where their proportions are not those of the model.
        """
        self._frame_size = width, height
        return self.measured and _fitted(self.measured, width, height)

    def close(self) -> None:
        """End the service."""
        self._node.destroy_service(self._service)

    def _set(self, request: Any, response: Any) -> Any:
        try:
            measured = intrinsics_of(request.camera_info, self._name)
            if self._frame_size is not None:
                _fitted(measured, *self._frame_size)
            measured.save(self._path)
        except InputError as error:
            response.success, response.status_message = False, str(error)
            self._node.get_logger().warning(f"set_camera_info refused: {error}")
            return response
        self.measured = measured
        untold = "; no frame has come yet, so whether it has their proportions is not known"
        response.success = True
        response.status_message = f"saved in {self._path}{'' if self._frame_size else untold}"
        self._node.get_logger().info(f"camera_info {response.status_message}")
        return response


def intrinsics_of(info: CameraInfo, camera_name: str) -> Intrinsics:
    """Return the model of a message.

    Raises `InputError`, naming the value that no camera can have.
    """
    return Intrinsics(
        image_width=int(info.width),
        image_height=int(info.height),
        camera_matrix=tuple(map(float, info.k)),
        distortion_coefficients=tuple(map(float, info.d)),
        distortion_model=info.distortion_model or "plumb_bob",
        rectification_matrix=tuple(map(float, info.r)),
        projection_matrix=tuple(map(float, info.p)) if info.p[0] else (),
        camera_name=camera_name,
    )


def _fitted(model: Intrinsics, width: int, height: int) -> Intrinsics:
    if not is_same_view((model.image_width, model.image_height), width, height):
        raise MessageError(
            "size",
            f"the calibration is for {model.image_width}x{model.image_height}, which does not have "
            f"the proportions of the {width}x{height} frames: calibrate with such frames",
        )
    return model.resized(width, height)
