"""Sources of frames by name."""

import dataclasses
from pathlib import Path
from typing import Any

from coded_aperture_ros.bags import is_bag
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.picture_file import picture_files
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.sources.bag import BagSource
from coded_aperture_ros.sources.device import DeviceConfig, DeviceSource
from coded_aperture_ros.sources.files import VIDEO_SUFFIXES, FileSource, PictureSource, VideoSource
from coded_aperture_ros.sources.simulator import SimulatorSource
from coded_aperture_ros.sources.source import Source

SIMULATOR = "simulator"
_BAG = "bag:"


def open_files(text: str, loop: bool = False) -> FileSource[Any]:
    """Source of the frames in files; with `loop` it begins again after the last one.

    Parameters
    ----------
    text : str
        Path of a picture, a folder of pictures (sorted by name), a video or a bag; or `bag:` and
        the path of a bag, which may end in `#` and the topic of the frames.
    loop : bool, optional

    Raises
    ------
    InputError
        With the path: it is missing, a folder without pictures, or not readable. Reading a frame
        may raise it later.

    Examples
    --------
    See `captures`.
    """
    if text.startswith(_BAG):
        bag, _, topic = text.removeprefix(_BAG).partition("#")
        return BagSource(bag, loop, topic or None)
    path = Path(text)
    pictures = picture_files(path) if path.is_dir() else ()
    if not pictures and is_bag(path):
        return BagSource(path, loop)
    if path.is_dir() and not pictures:
        raise InputError(f"{text}: no pictures in this folder")
    if not path.exists():
        raise InputError(f"cannot read {text}: no such file or folder")
    if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file():
        return VideoSource(path, loop)
    return PictureSource(tuple(pictures) or (path,), loop)


def open_source(
    text: str,
    camera: Camera,
    rate_hz: float,
    *,
    loop: bool = True,
    sensor: SensorModel | None = None,
    device: DeviceConfig | None = None,
) -> Source:
    """Source of frames by name.

    Parameters
    ----------
    text : str
        `simulator`; the index of a camera, a device (`/dev/video0`), a URL (`rtsp://...`) or a
        GStreamer pipeline; or files, see `open_files`.
    camera : Camera
        Simulated camera, or the image size that a device is asked for.
    rate_hz : float
        Frame rate of simulator and device.
    loop : bool, optional
        Whether files begin again after the last frame.
    sensor : SensorModel, optional
        The simulator's noise; by default none.
    device : DeviceConfig, optional

    Returns
    -------
    Source

    Raises
    ------
    InputError
        If files are missing or unreadable. A device may be missing: it is opened by `read`.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.io import write_image
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(1000.0, 2.0, 64, 48, Mask.named("levin"), mask_extent_mm=10.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_image(pathlib.Path(folder, "a.png"), np.zeros((48, 64)))
    ...     source = open_source(folder, camera, rate_hz=30.0, loop=False)
    ...     source.read().frame.shape
    (48, 64)
    """
    if text == SIMULATOR:
        return SimulatorSource(camera, rate_hz, sensor or SensorModel())
    if not text:
        raise InputError("parameter source is empty: use simulator, a camera index or a path")
    if _is_device(text):
        config = device or DeviceConfig()
        if not (config.width and config.height):
            config = dataclasses.replace(
                config, width=camera.image_width, height=camera.image_height
            )
        return DeviceSource(int(text) if text.isdecimal() else text, config, rate_hz)
    # The sender of a stream chooses its size and rate.
    if _is_stream(text):
        return DeviceSource(text)
    return open_files(text, loop)


def check_source(text: str) -> None:
    """Raise an `InputError` if a source is files that are missing; nothing is opened.

    So a command names what the user has written first, before it reads other files.

    Examples
    --------
    >>> check_source("simulator")
    >>> check_source("nope.png")
    Traceback (most recent call last):
    ...
    coded_aperture_ros.core.errors.InputError: cannot read nope.png: no such file or folder
    """
    if text == SIMULATOR or not text or _is_device(text) or _is_stream(text):
        return
    path = text.removeprefix(_BAG).partition("#")[0] if text.startswith(_BAG) else text
    if not Path(path).exists():
        raise InputError(f"cannot read {path}: no such file or folder")


def _is_device(text: str) -> bool:
    return text.isdecimal() or text.startswith("/dev/")


def _is_stream(text: str) -> bool:
    return not text.startswith(_BAG) and ("://" in text or " ! " in text)
