"""Frames of a camera device or a network stream, through OpenCV."""

import cv2

from coded_aperture_ros.errors import InputError
from coded_aperture_ros.sources.source import Capture


class DeviceSource:
    """A camera device (its index) or a stream (its URL).

    It is opened at the first `read`, and again at the next one after a failure, so that a camera
    may be unplugged and come back.

    Parameters
    ----------
    address : int or str
    width, height : int
        Wanted image size; 0 leaves the device's own.
    rate_hz : float
        Wanted frame rate; 0 leaves the device's own.
    """

    live = True

    def __init__(
        self, address: int | str, width: int = 0, height: int = 0, rate_hz: float = 0.0
    ) -> None:
        self._address = address
        self._wanted = {
            cv2.CAP_PROP_FRAME_WIDTH: width,
            cv2.CAP_PROP_FRAME_HEIGHT: height,
            cv2.CAP_PROP_FPS: rate_hz,
            cv2.CAP_PROP_BUFFERSIZE: 1,  # the newest frame, not the oldest of a queue
        }
        self._device: cv2.VideoCapture | None = None

    def read(self) -> Capture | None:
        """Wait for the next frame."""
        device = self._device or self._open()
        succeeded, frame = device.read()
        if not succeeded or frame is None:
            self.close()
            raise InputError(f"camera {self._address} gives no frames, check that it is connected")
        return Capture(frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))

    def close(self) -> None:
        """Let go of the device."""
        if self._device is not None:
            self._device.release()
            self._device = None

    def _open(self) -> cv2.VideoCapture:
        device = cv2.VideoCapture(self._address)
        if not device.isOpened():
            device.release()
            raise InputError(
                f"cannot open camera {self._address}, check that it is connected and not in use"
            )
        for setting, value in self._wanted.items():
            if value:
                device.set(setting, value)
        self._device = device
        return device
