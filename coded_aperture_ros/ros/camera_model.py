"""Which camera a frame was taken with: the camera file, or what the driver says."""

import math
from collections.abc import Callable

from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import View
from coded_aperture_ros.io.messages import view_from_camera_info
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.ros.messages import camera_info_from_camera, scaled_camera_info, stamp_ns

# So many coefficients does a model of distortion have that OpenCV undoes.
_COEFFICIENTS = (4, 5, 8, 12, 14)
# A frame may wait for its depth for so many others.
_KEPT = 200


def required_camera(path: str) -> Camera:
    """Return the camera of the parameter `camera_file`; an `InputError` if it is not set."""
    if not path:
        raise InputError(
            "parameter camera_file is empty: set it, as in --ros-args -p camera_file:=camera.yaml"
        )
    return load_camera(path)


class CameraModel:
    """The camera model to publish: the driver's own if it sends one, else the camera file's.

    The driver's region of interest and binning, or else its proportions, say which part of its view
    frames are. `reject` is told the kind and the fault of a model that no camera can have.
    """

    def __init__(self, reject: Callable[[str, str], None] = lambda kind, reason: None) -> None:
        self._reject = reject
        self._received: CameraInfo | None = None
        self._by_stamp: dict[int, CameraInfo] = {}

    def receive(self, info: CameraInfo) -> None:
        """Remember a model from the driver; one without a calibration (K is 0) is ignored."""
        if info.k[0] == 0:
            return
        try:
            _check(info)
        except InputError as error:
            going_on = "the one before it holds, or else the camera file"
            self._reject("camera_info", f"camera_info: {error}; {going_on}")
            return
        self._received, by_stamp = info, self._by_stamp
        if stamp := stamp_ns(info.header):
            by_stamp.pop(stamp, None)  # one that comes again is the last to be forgotten
            by_stamp[stamp] = info
        if len(by_stamp) > _KEPT:
            del by_stamp[next(iter(by_stamp))]

    def forget_stamps(self) -> None:
        """Keep the newest model alone: the same stamps come again where time has gone back."""
        self._by_stamp = {}

    def at(self, header: Header) -> "CameraModel":
        """Return the model for all that is made of one frame: what comes later does not change it.

        It is the one with the frame's stamp, or the newest where that has not come.
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
        """Return the model of what was made of a frame; sizes are (height, width)."""
        info = self._received
        if info is None or self._view(camera, frame_size) is None:
            info = camera_info_from_camera(camera, header)
        return scaled_camera_info(info, output_size[1], output_size[0], header)

    def complaint(self, camera: Camera, frame_size: tuple[int, int]) -> str:
        """Say why the driver's model cannot be that of frames (height, width); empty if it can."""
        info, (height, width) = self._received, frame_size
        if info is None or self._view(camera, frame_size) is not None:
            return ""
        size = f"{info.roi.width or info.width}x{info.roi.height or info.height}"
        return (
            f"camera_info is for {size}, which does not have the proportions "
            f"of the {width}x{height} frames: that of the camera file is published"
        )

    def view(self, camera: Camera, frame_size: tuple[int, int]) -> View:
        """Return which part of the camera's view frames (height, width) show."""
        return self._view(camera, frame_size) or View.whole(frame_size[1], frame_size[0])

    def _view(self, camera: Camera, frame_size: tuple[int, int]) -> View | None:
        height, width = frame_size
        return self._received and view_from_camera_info(self._received, width, height, camera)


def _check(info: CameraInfo) -> None:
    """Refuse a driver's model with a value that no camera can have, by an `InputError`.

    Its distortion may have any name: OpenCV goes by the number of coefficients, and the region and
    the binning hold whatever it is.
    """
    if not (info.width and info.height):
        raise InputError("width or height is 0: the driver has to say the size of its pictures")
    if not all(map(math.isfinite, (*info.k, *info.d))) or min(info.k[0], info.k[4]) <= 0:
        raise InputError("expected finite K and D, with focal lengths above 0: calibrate again")
    counts = (4,) if info.distortion_model == "equidistant" else _COEFFICIENTS
    if any(info.d) and len(info.d) not in counts:
        raise InputError(f"D has {len(info.d)} coefficients, as no lens model has: calibrate again")
