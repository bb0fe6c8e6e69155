"""Frames of a camera device or a network stream, through OpenCV."""

import dataclasses

import cv2

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.sources.source import Capture

# V4L2's values of the automatic exposure, for manual and automatic.
_MANUAL_EXPOSURE = 1
_AUTO_EXPOSURE = 3


@dataclasses.dataclass(frozen=True)
class DeviceConfig:
    """Settings of a camera device, where it has them.

    Examples
    --------
    >>> DeviceConfig(width=640, height=480).exposure
    -1.0
    """

    parameter_group = "device."
    width: int = option(
        0, "Width of the frames; 0: the camera file's", unit="px", within=(0, 65536)
    )
    height: int = option(
        0, "Height of the frames; 0: the camera file's", unit="px", within=(0, 65536)
    )
    exposure: float = option(
        -1.0,
        "Exposure time in the device's own unit (V4L2: 0.1 ms); 0: automatic, -1: as it is",
        within=(-1.0, 1e6),
    )
    gain: float = option(-1.0, "Gain in the device's own unit; -1: as it is", within=(-1.0, 1e6))
    white_balance_k: float = option(
        -1.0,
        "Colour temperature of the light; 0: automatic, -1: as it is",
        unit="K",
        within=(-1.0, 1e5),
    )

    def __post_init__(self) -> None:
        check_options(self)


class DeviceSource:
    """Camera device (its index), stream (its URL) or GStreamer pipeline.

    An address with an exclamation mark is a pipeline that ends in `appsink`. The device is opened
    at the first `read`, and again at the next one after a failure, so that a camera may be
    unplugged and come back. A `rate_hz` of 0 leaves the device's own. Automatic focus is switched
    off.

    Attributes
    ----------
    refused : tuple of str
        Settings that the open device does not accept.
    automatic : tuple of str
        What the device still changes by itself, such as the exposure.

    Examples
    --------
    See `open_source`.
    """

    live = True

    def __init__(
        self, address: int | str, config: DeviceConfig | None = None, rate_hz: float = 0.0
    ) -> None:
        self._address = address
        self._config = config or DeviceConfig()
        self._rate_hz = rate_hz
        self._device: cv2.VideoCapture | None = None
        self.refused: tuple[str, ...] = ()
        self.automatic: tuple[str, ...] = ()

    def configure(self, config: DeviceConfig) -> None:
        """Change the settings; a new size takes effect when the device is opened again."""
        self._config = config
        if self._device is not None:
            self.refused = self._set(self._device, _exposure_settings(config))
            self.automatic = self._changes(self._device)

    def read(self) -> Capture | None:
        """Next frame; waits for it."""
        device = self._device or self._open()
        succeeded, frame = device.read()
        if not succeeded or frame is None:
            self.close()
            raise InputError(f"camera {self._address} gives no frames, check that it is connected")
        return Capture(frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))

    def close(self) -> None:
        """Close the device."""
        if self._device is not None:
            self._device.release()
            self._device = None

    def _open(self) -> cv2.VideoCapture:
        pipeline = isinstance(self._address, str) and "!" in self._address
        if pipeline and cv2.CAP_GSTREAMER not in cv2.videoio_registry.getStreamBackends():
            raise InputError(
                f"{self._address}: this OpenCV was built without GStreamer; "
                "Ubuntu's python3-opencv has it"
            )
        device = cv2.VideoCapture(self._address, cv2.CAP_GSTREAMER if pipeline else cv2.CAP_ANY)
        if not device.isOpened():
            device.release()
            raise InputError(
                f"cannot open camera {self._address}, check that it is connected and not in use"
            )
        # The newest frame, not the oldest of a queue; not every driver knows this.
        device.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        size = {
            "width": (cv2.CAP_PROP_FRAME_WIDTH, float(self._config.width)),
            "height": (cv2.CAP_PROP_FRAME_HEIGHT, float(self._config.height)),
            "rate_hz": (cv2.CAP_PROP_FPS, self._rate_hz),
        }
        wanted = {name: setting for name, setting in size.items() if setting[1]}
        self.refused = self._set(device, {**wanted, **_exposure_settings(self._config)})
        device.set(cv2.CAP_PROP_AUTOFOCUS, 0.0)  # most lenses that take a mask have none
        self.automatic = self._changes(device)
        self._device = device
        return device

    @staticmethod
    def _changes(device: cv2.VideoCapture) -> tuple[str, ...]:
        settings = cv2.CAP_PROP_AUTOFOCUS, cv2.CAP_PROP_AUTO_EXPOSURE
        return automatic_controls(*map(device.get, settings))

    @staticmethod
    def _set(device: cv2.VideoCapture, wanted: dict[str, tuple[int, float]]) -> tuple[str, ...]:
        return tuple(
            name for name, (setting, value) in wanted.items() if not device.set(setting, value)
        )


def automatic_controls(autofocus: float, auto_exposure: float) -> tuple[str, ...]:
    """Names of the controls that a device changes by itself, from its values of these settings.

    A device that does not know a setting reports 0 or less.
    """
    on = {"focus": autofocus > 0, "exposure": auto_exposure == _AUTO_EXPOSURE}
    return tuple(name for name in on if on[name])


def _exposure_settings(config: DeviceConfig) -> dict[str, tuple[int, float]]:
    """OpenCV's settings for exposure, gain and white balance, by the options' names."""
    wanted: dict[str, tuple[int, float]] = {}
    if config.exposure == 0:
        wanted["automatic exposure"] = (cv2.CAP_PROP_AUTO_EXPOSURE, _AUTO_EXPOSURE)
    elif config.exposure > 0:
        wanted["exposure by hand"] = (cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
        wanted["exposure"] = (cv2.CAP_PROP_EXPOSURE, config.exposure)
    if config.gain >= 0:
        wanted["gain"] = (cv2.CAP_PROP_GAIN, config.gain)
    if config.white_balance_k == 0:
        wanted["automatic white balance"] = (cv2.CAP_PROP_AUTO_WB, 1.0)
    elif config.white_balance_k > 0:
        wanted["white balance by hand"] = (cv2.CAP_PROP_AUTO_WB, 0.0)
        wanted["white_balance_k"] = (cv2.CAP_PROP_WB_TEMPERATURE, config.white_balance_k)
    return wanted
