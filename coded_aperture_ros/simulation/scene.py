"""Scenes for the simulated camera, and its sensor: noise and quantisation."""

import dataclasses
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import SRGB, PixelFormat
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.simulation.hidden import fill_unknown
from coded_aperture_ros.simulation.render import render_coded_frame

# Calibration of the Middlebury 2014 motorcycle pair in the size that scikit-image ships.
_MOTORCYCLE_FOCAL_PX = 994.978
_MOTORCYCLE_BASELINE_M = 0.193001
_MOTORCYCLE_DISPARITY_OFFSET_PX = 31.086
# The camera of the demo sees a model of it, of this share of its size and of its distances: a lens
# that exists blurs it as much as one with three times the mask would blur the motorcycle itself.
MOTORCYCLE_MODEL = 1 / 3.3
# What the model covers, and a little more, m.
MOTORCYCLE_RANGE_M = (0.63, 1.53)
# Enlargement of the picture of 741 x 500 to the focal length of the demo's camera; it leaves a
# window of 640 x 480 room to move in.
MOTORCYCLE_SCALE = 1.269


@dataclasses.dataclass(frozen=True)
class SensorModel:
    """Additive Gaussian noise, with shot noise, then quantisation.

    Parameters
    ----------
    noise : float, optional
        Standard deviation, 1 = full scale.
    bits : {0, 8, 12, 16}, optional
        Values are clipped to 0..1 and rounded to `2**bits - 1` steps; 0: no quantisation.
    gain : float, optional
        Variance of the shot noise per unit of light.

    Raises
    ------
    InputError
        If a value is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> sensor = SensorModel(bits=8)
    >>> exposed = sensor.expose(np.array([0.0, 0.3, 1.2]), np.random.default_rng(0))
    >>> (255 * exposed).round().tolist()
    [0.0, 76.0, 255.0]
    """

    noise: float = 0.0
    bits: int = 0
    gain: float = 0.0

    def __post_init__(self) -> None:
        for name in ("noise", "gain"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name}: expected 0 to 1, got {getattr(self, name)!r}")
        if self.bits not in (0, 8, 12, 16):
            raise InputError(f"bits: expected 0, 8, 12 or 16, got {self.bits!r}")

    def expose(self, image: NDArray, rng: np.random.Generator) -> FloatArray:
        """Image as the sensor reads it out, float32, linear light, shape of `image`."""
        exposed = np.array(image, dtype=np.float32)
        if self.noise or self.gain:
            exposed += self.deviation(exposed) * rng.standard_normal(exposed.shape, np.float32)
        if self.bits:
            steps = np.float32(2**self.bits - 1)
            exposed = np.rint(np.clip(exposed, 0.0, 1.0) * steps) / steps
        return exposed

    def deviation(self, light: FloatArray) -> FloatArray:
        """Standard deviation of the noise at this light, float32, of its shape or one number."""
        if not self.gain:
            return np.asarray(self.noise, np.float32)
        variance = np.float32(self.gain) * np.maximum(light, np.float32(0))
        return np.asarray(np.sqrt(variance + np.float32(self.noise**2)), np.float32)


@dataclasses.dataclass(frozen=True)
class Scene:
    """Sharp image with the depth of every pixel.

    Parameters
    ----------
    image : ndarray of float32 [h, w, 3]
        Linear light, RGB.
    depth_m : ndarray of float32 [h, w]
        All known, m.
    focal_length_px : float
        Of the camera that took the image, px.

    Examples
    --------
    See `PanningScene`.
    """

    image: FloatArray  # [h, w, 3], linear light, RGB
    depth_m: FloatArray  # [h, w], all known
    focal_length_px: float  # of the camera that took the picture


def motorcycle_scene(scale: float = MOTORCYCLE_SCALE, model: float = MOTORCYCLE_MODEL) -> Scene:
    """Model of Middlebury's motorcycle, which scikit-image ships, 0.64 to 1.52 m away.

    Parameters
    ----------
    scale : float, optional
        Enlargement of the picture of 741 x 500; by default to the focal length of the demo's
        camera.
    model : float, optional
        Size of the model, as a share of the motorcycle's: 1 is the motorcycle itself, 2.1 to 5.0 m
        away.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If scikit-image is not installed.

    References
    ----------
    D. Scharstein et al., *High-Resolution Stereo Datasets with Subpixel-Accurate Ground Truth*,
    2014.

    Examples
    --------
    >>> motorcycle_scene(0.2).depth_m.shape  # doctest: +SKIP
    (100, 148)
    """
    try:
        from skimage.data import stereo_motorcycle
    except ImportError as error:
        raise InputError("the demo scene needs scikit-image: pip install scikit-image") from error
    left, _, disparity = stereo_motorcycle()
    measured = np.isfinite(disparity) & (disparity > 0)
    distance_px = np.where(measured, disparity, np.nan) + _MOTORCYCLE_DISPARITY_OFFSET_PX
    depth_m = fill_unknown(_MOTORCYCLE_FOCAL_PX * _MOTORCYCLE_BASELINE_M / distance_px)
    image = PixelFormat(SRGB).light(left)
    height, width = depth_m.shape
    size = round(width * scale), round(height * scale)
    # Cubic interpolation overshoots at edges; depths must not be mixed across them.
    image = np.clip(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), 0.0, 1.0)
    depth_m = cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST)
    return Scene(image, depth_m * np.float32(model), _MOTORCYCLE_FOCAL_PX * scale)


@dataclasses.dataclass(frozen=True)
class SimulatedFrame:
    """Frame of the simulated camera at one time, with ground truth."""

    coded: FloatArray  # the frame [h, w, 3], with noise
    sharp: FloatArray  # the same view without blur and noise
    depth_m: FloatArray  # the true one [h, w]


class PanningScene:
    """Scene that moves back and forth in front of a simulated coded-aperture camera.

    The scene is rendered once, at the start; a frame is a window of it, moved by whole pixels, with
    fresh noise. The same time gives the same frame.

    Parameters
    ----------
    scene : Scene
        At least as large as the camera's image.
    camera : Camera
    sensor : SensorModel, optional
    period_s : float, optional
        Time for once to the right and back, s; up and down takes twice as long.
    seed : int, optional
        Of the noise.

    Attributes
    ----------
    camera : Camera
    sensor : SensorModel

    Raises
    ------
    InputError
        If the scene does not suit the camera, or the period is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.optics import Mask
    >>> grey, depth_m = np.full((60, 80, 3), 0.5, np.float32), np.full((60, 80), 3.0, np.float32)
    >>> scene = Scene(grey, depth_m, focal_length_px=1000.0)
    >>> camera = Camera(1000.0, 2.0, 64, 48, Mask.named("levin"), mask_extent_mm=10.0)
    >>> PanningScene(scene, camera).frame(1.5).coded.shape
    (48, 64, 3)
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        sensor: SensorModel | None = None,
        period_s: float = 12.0,
        seed: int = 0,
    ) -> None:
        height, width = scene.depth_m.shape
        if width < camera.image_width or height < camera.image_height:
            raise InputError(
                f"the scene, {width} x {height} pixels, is smaller than the camera's image, "
                f"{camera.image_width} x {camera.image_height}"
            )
        if not period_s > 0:
            raise InputError(f"period: expected more than 0 s, got {period_s!r}")
        self._scene = scene
        self.camera = camera
        self.sensor = sensor or SensorModel()
        self._period_s = period_s
        self._seed = seed
        # Two blocks a side: the demo should not wait for the last tenth of the accuracy.
        self._coded = render_coded_frame(scene.image, scene.depth_m, camera, aperture_blocks=2)

    def frame(self, time_s: float) -> SimulatedFrame:
        """Frame at a time (s, zero or later)."""
        window = self._window(time_s)
        rng = np.random.default_rng([self._seed, round(abs(time_s) * 1e6)])
        return SimulatedFrame(
            self.sensor.expose(self._coded[window], rng),
            self._scene.image[window],
            self._scene.depth_m[window],
        )

    def _window(self, time_s: float) -> tuple[slice, slice]:
        scene_height, scene_width = self._scene.depth_m.shape
        height = self.camera.image_height
        width = self.camera.image_width
        turns = time_s / self._period_s
        top = _cosine_position(turns / 2, scene_height - height)
        left = _cosine_position(turns, scene_width - width)
        return slice(top, top + height), slice(left, left + width)


def _cosine_position(turns: float, max_offset: int) -> int:
    """Position between 0 and `max_offset` that moves smoothly there and back in one turn."""
    return round(max_offset * (1.0 - math.cos(2.0 * math.pi * turns)) / 2.0)
