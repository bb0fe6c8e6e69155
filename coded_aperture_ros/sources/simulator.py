"""Frames of the simulated coded-aperture camera."""

import numpy as np

from coded_aperture_ros.optics import Camera
from coded_aperture_ros.simulation import PanningScene, SensorModel, motorcycle_scene
from coded_aperture_ros.simulation.scene import MOTORCYCLE_MODEL, MOTORCYCLE_SCALE
from coded_aperture_ros.sources.source import Capture

_NOISE_MARGIN_PX = 128
# Size of the scene per metre of focus distance: beyond the focus from 1.12 to 2.67 times as far, as
# before the demo's camera, which focuses at 0.57 m; or before it, up to 0.9 times as far.
_MODEL_BEYOND = MOTORCYCLE_MODEL / 0.57
_MODEL_BEFORE = 0.9 / 5.02


class SimulatorSource:
    """Model of a real scene that moves in front of a simulated camera, with ground truth.

    It is as large as suits the camera's focus: at the same distances relative to it as the demo's.

    Parameters
    ----------
    camera : Camera
    rate_hz : float
        Frames per second of simulated time.
    sensor : SensorModel
        Its noise; frames are not quantised.

    Raises
    ------
    InputError
        If the scene does not suit the camera, or is not installed.

    Examples
    --------
    See `open_source`.
    """

    live = False

    def __init__(self, camera: Camera, rate_hz: float, sensor: SensorModel) -> None:
        # Leaves the camera room to move about in, whatever its resolution.
        scale = MOTORCYCLE_SCALE * max(camera.image_width / 640, camera.image_height / 480)
        per_metre = _MODEL_BEFORE if camera.side == "near" else _MODEL_BEYOND
        model = per_metre * camera.focus_distance_m
        self._scene = PanningScene(motorcycle_scene(scale, model), camera)
        self._rate_hz = rate_hz
        self._frames = 0
        self._random = np.random.default_rng(0)
        # Drawing a million random numbers would take most of the time of a frame. Frames take
        # different windows of one larger field instead.
        shape = camera.image_height + _NOISE_MARGIN_PX, camera.image_width + _NOISE_MARGIN_PX, 3
        self._sensor = sensor
        self._noise = self._random.standard_normal(shape, np.float32)

    def read(self) -> Capture | None:
        """Next frame."""
        view = self._scene.frame(self._frames / self._rate_hz)
        self._frames += 1
        height, width = view.depth_m.shape
        top, left = self._random.integers(_NOISE_MARGIN_PX, size=2)
        noise = self._noise[top : top + height, left : left + width]
        coded = view.coded + self._sensor.deviation(view.coded) * noise
        return Capture(coded, view.depth_m, view.sharp)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""
