"""Camera model of a frame: the driver's, or else the camera file's."""

from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import View
from coded_aperture_ros.io.messages import CameraInfos, choose_camera_info, view_from_camera_info
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.ros.messages import camera_info_from_camera, region_camera_info, stamp_ns


def required_camera(path: str) -> Camera:
    """Camera of the parameter `camera_file`; an `InputError` if it is empty or does not load."""
    if not path:
        raise InputError(
            "parameter camera_file is empty: set it, as in --ros-args -p camera_file:=camera.yaml"
        )
    return load_camera(path)


class DriverInfo:
    """Camera models that the driver sends.

    Parameters
    ----------
    reject : callable
        Called with kind and reason for a model that has a value that no camera can have.
    """

    def __init__(self, reject: Callable[[str, str], None] = lambda kind, reason: None) -> None:
        self._infos = CameraInfos(lambda reason: reject("camera_info", reason))

    def receive(self, info: CameraInfo) -> None:
        """Keep a model from the driver."""
        self._infos.receive(info)

    def forget_stamps(self) -> None:
        """Keep the newest model only: stamps repeat after the clock has jumped back."""
        self._infos.forget_stamps()

    def at(self, header: Header) -> "CameraModel":
        """Model for all outputs of one frame, which later messages do not change."""
        return CameraModel(self._infos.at(stamp_ns(header)))


class CameraModel:
    """Camera model to publish for a frame: the driver's if it sends one, else the camera file's.

    The driver's region of interest and binning, or else its proportions, say which part of the
    camera's view the frame is.

    Parameters
    ----------
    info : sensor_msgs/CameraInfo or None
        Of the frame's time.
    """

    def __init__(self, info: Any = None) -> None:
        self._info = info

    def info(
        self,
        camera: Camera,
        frame_size: tuple[int, int],
        output_size: tuple[int, int],
        header: Header,
    ) -> CameraInfo:
        """Camera model of an output of a frame; sizes are (height, width), pixels."""
        height, width = frame_size
        info, _ = choose_camera_info(self._info, width, height, camera)
        if info is None:
            view = self._view(camera, frame_size)
            shown = camera if view is None else _shown(camera, view)
            info = camera_info_from_camera(shown, header)
        return region_camera_info(info, output_size[1], output_size[0], header)

    def complaint(self, camera: Camera, frame_size: tuple[int, int]) -> str:
        """Reason why the driver's model cannot be that of the frames (height, width), or ""."""
        height, width = frame_size
        _, reason = choose_camera_info(self._info, width, height, camera)
        return reason and f"{reason}: publishing that of the camera file"

    def view(self, camera: Camera, frame_size: tuple[int, int]) -> View:
        """Part of the camera's view that frames (height, width) show."""
        return self._view(camera, frame_size) or View.whole(frame_size[1], frame_size[0])

    def _view(self, camera: Camera, frame_size: tuple[int, int]) -> View | None:
        height, width = frame_size
        return self._info and view_from_camera_info(self._info, width, height, camera)


def _shown(camera: Camera, view: View) -> Camera:
    """Camera of what a view shows; the camera may be for another size of the whole view."""
    return camera.resized(view.whole_width, view.whole_height).for_view(view)
