"""Camera model of a frame: the driver's, or else the camera file's."""

import math
from collections.abc import Callable

from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import View
from coded_aperture_ros.io.messages import view_from_camera_info
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.ros.messages import camera_info_from_camera, scaled_camera_info, stamp_ns

# Numbers of distortion coefficients that OpenCV has a model for.
_COEFFICIENT_COUNTS = (4, 5, 8, 12, 14)
# Models kept by their stamp: a frame may wait for its depth while so many others come.
_KEPT_MODELS = 200


def required_camera(path: str) -> Camera:
    """Camera of the parameter `camera_file`; an `InputError` if it is empty or does not load."""
    if not path:
        raise InputError(
            "parameter camera_file is empty: set it, as in --ros-args -p camera_file:=camera.yaml"
        )
    return load_camera(path)


class CameraModel:
    """Camera model to publish: the driver's if it sends one, else the camera file's.

    The driver's region of interest and binning, or else its proportions, say which part of the
    camera's view the frames are.

    Parameters
    ----------
    reject : callable
        Called with kind and reason for a model that has a value that no camera can have.
    """

    def __init__(self, reject: Callable[[str, str], None] = lambda kind, reason: None) -> None:
        self._reject = reject
        self._received: CameraInfo | None = None
        self._by_stamp: dict[int, CameraInfo] = {}

    def receive(self, info: CameraInfo) -> None:
        """Keep a model from the driver; one without a calibration (K is 0) is ignored."""
        if info.k[0] == 0:
            return
        try:
            _check(info)
        except InputError as error:
            used = "using the camera_info before it, or else the camera file"
            self._reject("camera_info", f"camera_info: {error}; {used}")
            return
        self._received = info
        by_stamp = self._by_stamp
        if stamp := stamp_ns(info.header):
            by_stamp.pop(stamp, None)  # a repeated one moves to the end: it is dropped last
            by_stamp[stamp] = info
        if len(by_stamp) > _KEPT_MODELS:
            del by_stamp[next(iter(by_stamp))]

    def forget_stamps(self) -> None:
        """Keep the newest model only: stamps repeat after the clock has jumped back."""
        self._by_stamp = {}

    def at(self, header: Header) -> "CameraModel":
        """Model for all outputs of one frame, which later messages do not change.

        It is the one with the frame's stamp, or else the newest.
        """
        model = CameraModel()
        model._received = self._by_stamp.get(stamp_ns(header), self._received)
        return model

    def info(
        self,
        camera: Camera,
        frame_size: tuple[int, int],
        output_size: tuple[int, int],
        header: Header,
    ) -> CameraInfo:
        """Camera model of an output of a frame; sizes are (height, width), pixels."""
        info = self._received
        if info is None or self._view(camera, frame_size) is None:
            info = camera_info_from_camera(camera, header)
        return scaled_camera_info(info, output_size[1], output_size[0], header)

    def complaint(self, camera: Camera, frame_size: tuple[int, int]) -> str:
        """Reason why the driver's model cannot be that of the frames (height, width), or ""."""
        info = self._received
        height, width = frame_size
        if info is None or self._view(camera, frame_size) is not None:
            return ""
        size = f"{info.roi.width or info.width}x{info.roi.height or info.height}"
        return (
            f"camera_info is for {size}, which does not have the proportions "
            f"of the {width}x{height} frames: publishing that of the camera file"
        )

    def view(self, camera: Camera, frame_size: tuple[int, int]) -> View:
        """Part of the camera's view that frames (height, width) show."""
        return self._view(camera, frame_size) or View.whole(frame_size[1], frame_size[0])

    def _view(self, camera: Camera, frame_size: tuple[int, int]) -> View | None:
        height, width = frame_size
        return self._received and view_from_camera_info(self._received, width, height, camera)


def _check(info: CameraInfo) -> None:
    """Raise an `InputError` if a driver's model has a value that no camera can have.

    The name of its distortion model does not matter: OpenCV goes by the number of coefficients, and
    region and binning do not depend on it.
    """
    if not (info.width and info.height):
        raise InputError("width or height is 0: set the size of the pictures in the driver")
    if not all(map(math.isfinite, (*info.k, *info.d))) or min(info.k[0], info.k[4]) <= 0:
        raise InputError("expected finite K and D, with focal lengths above 0: calibrate again")
    counts = (4,) if info.distortion_model == "equidistant" else _COEFFICIENT_COUNTS
    if any(info.d) and len(info.d) not in counts:
        raise InputError(f"D has {len(info.d)} coefficients, no lens model has: calibrate again")
