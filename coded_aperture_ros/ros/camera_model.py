"""Which camera a frame was taken with: the camera file, or what the driver says."""

from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.messages import MessageError, view_of
from coded_aperture_ros.optics import Camera, View, load_camera
from coded_aperture_ros.ros.messages import camera_info_from_camera, scaled_camera_info


def required_camera(path: str) -> Camera:
    """Return the camera of the parameter `camera_file`; an `InputError` if it is not set."""
    if not path:
        raise InputError(
            "parameter camera_file is empty: set it, as in --ros-args -p camera_file:=camera.yaml"
        )
    return load_camera(path)


def fitted_camera(camera: Camera, width: int, height: int) -> Camera:
    """Return the camera for frames of this size.

    A frame of the same proportions as the camera file's is taken to be the same view, resized.
    Raises `MessageError` of kind "size", where the proportions differ.
    """
    try:
        return camera.fitted(width, height)
    except InputError as error:
        raise MessageError("size", str(error)) from error


class CameraModel:
    """The camera model to publish: the driver's own if it sends one, else the camera file's.

    The driver's region of interest and binning, or else its proportions, say which part of its view
    frames are.
    """

    def __init__(self) -> None:
        self._received: CameraInfo | None = None

    def receive(self, info: CameraInfo) -> None:
        """Remember a model from the driver; one without a calibration (K is 0) is ignored."""
        if info.k[0] > 0 and info.k[4] > 0 and info.width and info.height:
            self._received = info

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
        return self._received and view_of(self._received, width, height, camera)
