"""Simulated scenes with relief before a camera: error and fill of its depth over distance.

From end to end: the PSF of the camera with diffraction and occlusion, shot and read noise at an
illuminance, the estimate with a bank as users learn it, and what is published of it.
"""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import View
from coded_aperture_ros.likelihood.bank import DEFAULT_LEVEL_COUNT, learn_bank_for_camera
from coded_aperture_ros.likelihood.bank.for_camera import guarded_range
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.simulation import render_coded_frame
from coded_aperture_ros.simulation.exposure import Exposure
from coded_aperture_ros.simulation.layered.textures import TEXTURED_COUNT, texture

# A distance belongs to the range with at most this median relative error, and this share of the
# pixels with depth.
MOST_ERROR = 0.05
LEAST_FILL = 0.7
# Distances that figures are stated for, equally spaced in their inverse.
BINS = 6
# Objects before the back wall.
_OBJECTS = 9
_SMALLEST_PX = 60
_LARGEST_PX = 180
# Mean reflectance of surfaces, and standard deviation of their texture relative to it.
_REFLECTANCE = (0.12, 0.5)
_CONTRAST = (0.2, 0.5)
_DARKEST = 0.01
_BRIGHTEST = 0.95
# Samples of scenes along each side of a pixel: what is finer than a pixel is there, as on a sensor.
SUPERSAMPLING = 2
# The PSF of a thin lens is the same all over the image: a part of it shows as much.
SCENE_PX = (320, 240)
# Parts from the middle to the corner where it is not.
_PARTS = 4


@dataclasses.dataclass(frozen=True, eq=False)
class ReliefScene:
    """A sharp picture with the place of every point between the ends of a range.

    Rows and columns are those of samples, `SUPERSAMPLING` to each side of a pixel.
    """

    reflectance: FloatArray  # [rows, columns]
    place: FloatArray  # [rows, columns], from 0, the nearest, to 1; NaN where unknown

    @property
    def pixel_place(self) -> FloatArray:
        """Place of every pixel."""
        return self.place[::SUPERSAMPLING, ::SUPERSAMPLING]

    def light(self, camera: Camera, near_m: float, far_m: float) -> FloatArray:
        """Light on every pixel of a camera that the scene is put before, in a range."""
        depth_m = self.depth_m(near_m, far_m)
        return render_coded_frame(self.reflectance, depth_m, camera, supersampling=SUPERSAMPLING)

    def pixel_depth_m(self, near_m: float, far_m: float) -> FloatArray:
        """Depth of every pixel in a range, m."""
        return self.depth_m(near_m, far_m)[::SUPERSAMPLING, ::SUPERSAMPLING]

    def depth_m(self, near_m: float, far_m: float) -> FloatArray:
        """Depth [rows, columns] in a range, m: places are even in the inverse of the depth."""
        inverse = 1 / near_m - self.place * (1 / near_m - 1 / far_m)
        return np.asarray(1 / inverse, np.float32)


@dataclasses.dataclass(frozen=True)
class DistanceFigures:
    """What is published at some distances, over all scenes."""

    near_m: float
    far_m: float
    error: float  # median relative error of the published depth; infinite without any
    right: float  # share of the published pixels with a relative error of at most 10 %
    fill: float  # share of the pixels with published depth
    pixels: int = 0  # of all scenes

    @property
    def holds(self) -> bool:
        """Whether these distances belong to the range that is stated."""
        return self.error <= MOST_ERROR and self.fill >= LEAST_FILL


def relief_scene(
    seed: int, size: tuple[int, int] = SCENE_PX, magnification: float = 1.0
) -> ReliefScene:
    """Random scene: a slanted wall, and objects before it, so many times as large in pixels.

    `size` is width and height, px.

    Examples
    --------
    >>> scene = relief_scene(0)
    >>> scene.pixel_place.shape, float(scene.place.min()) >= 0, float(scene.place.max()) <= 1
    ((240, 320), True, True)
    """
    random = np.random.default_rng([58, seed])
    width, height = size = SUPERSAMPLING * size[0], SUPERSAMPLING * size[1]
    magnification *= SUPERSAMPLING
    y, x = np.mgrid[:height, :width].astype(np.float32)
    across, down = random.uniform(-0.25, 0.25, 2)
    place = 0.85 + across * (x / width - 0.5) + down * (y / height - 0.5)
    picture = _surface(random, size)
    for middle in sorted(random.uniform(0, 0.9, _OBJECTS), reverse=True):
        shape = np.zeros((height, width), np.uint8)
        at = (int(random.integers(width)), int(random.integers(height)))
        sides = magnification * random.uniform(_SMALLEST_PX, _LARGEST_PX, 2) / 2
        turned = float(random.uniform(0, 180))
        if random.random() < 0.5:
            cv2.ellipse(shape, (at, tuple(2 * sides), turned), 1, -1)
        else:
            corners = cv2.boxPoints((at, tuple(2 * sides), turned))
            cv2.fillConvexPoly(shape, corners.astype(np.int32), 1)
        inside = shape > 0
        slant = random.uniform(-0.1, 0.1) * (x - at[0]) / (magnification * _LARGEST_PX)
        place = np.where(inside, middle + slant, place)
        picture = np.where(inside, _surface(random, size), picture)
    return ReliefScene(picture, np.clip(place, 0, 1).astype(np.float32))


def flat_scene(seed: int, place: float, size: tuple[int, int] = SCENE_PX) -> ReliefScene:
    """Plane with a random texture at one place of a range.

    `size` is width and height, px.

    Examples
    --------
    >>> float(flat_scene(0, 1.0).place.min())
    1.0
    """
    samples = SUPERSAMPLING * size[0], SUPERSAMPLING * size[1]
    picture = _surface(np.random.default_rng([59, seed]), samples)
    return ReliefScene(picture, np.full_like(picture, place))


def _surface(random: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Reflectance of a surface with a random texture."""
    whole = texture(int(random.integers(TEXTURED_COUNT))).astype(np.float32)
    width, height = size
    top = int(random.integers(max(1, whole.shape[0] - height)))
    left = int(random.integers(max(1, whole.shape[1] - width)))
    cut = whole[top : top + height, left : left + width]
    missing = ((0, height - cut.shape[0]), (0, width - cut.shape[1]))
    cut = np.pad(cut, missing, mode="symmetric")
    light = np.exp(random.uniform(*np.log(_REFLECTANCE)))
    contrast = random.uniform(*_CONTRAST)
    return np.asarray(np.clip(light * (1 + contrast * cut), _DARKEST, _BRIGHTEST), np.float32)


def measure_scenes(
    camera: Camera,
    range_m: tuple[float, float],
    exposure: Exposure,
    scenes: Sequence[ReliefScene],
    bins: int = BINS,
) -> list[DistanceFigures]:
    """Figures over distance of scenes put into a range, with a bank for it.

    Parameters
    ----------
    camera : Camera
        Its side is that of the range.
    range_m : (float, float)
        Of the scenes and of the bank, m.
    exposure : Exposure
    scenes : sequence of ReliefScene
        No larger than the camera's image.
    bins : int, optional
        Parts of the range, equal in the inverse of the distance.

    Returns
    -------
    list of DistanceFigures
        From the nearest to the farthest.

    Raises
    ------
    InputError
        If the camera has no bank for the range.
    """
    camera = dataclasses.replace(camera, diffraction=True, noise=0.0, noise_gain=0.0)
    bank = learn_bank_for_camera(camera, *guarded_range(camera, *range_m, DEFAULT_LEVEL_COUNT))
    places, errors = [], []
    for number, scene in enumerate(scenes):
        part = part_of_image(camera, scene.pixel_place.shape, number)
        light = scene.light(part, *range_m)
        frame = exposure.exposed(light, camera, np.random.default_rng(number))
        estimator = DepthEstimator(bank, DepthConfig(), part)
        depth_m = np.asarray(estimator.estimate(frame).depth_m)
        estimator.close()
        true_m = scene.pixel_depth_m(*range_m)
        known = np.isfinite(true_m)
        places.append(scene.pixel_place[known])
        errors.append(np.abs(depth_m / true_m - 1)[known])
    return _by_distance(np.concatenate(places), np.concatenate(errors), range_m, bins)


def _by_distance(
    places: FloatArray, errors: FloatArray, range_m: tuple[float, float], bins: int
) -> list[DistanceFigures]:
    near_m, far_m = range_m
    edges_m = 1 / np.linspace(1 / near_m, 1 / far_m, bins + 1)
    chosen = np.minimum((places * bins).astype(int), bins - 1)
    found = []
    for number in range(bins):
        own = errors[chosen == number]
        known = own[np.isfinite(own)]
        found.append(
            DistanceFigures(
                float(edges_m[number]),
                float(edges_m[number + 1]),
                float(np.median(known)) if known.size else np.inf,
                float((known <= 0.1).mean()) if known.size else 0.0,
                known.size / own.size if own.size else 0.0,
                own.size,
            )
        )
    return found


def part_of_image(camera: Camera, shape: tuple[int, ...], number: int = 0) -> Camera:
    """Camera of a part of the image that is as large as a scene: the middle of it.

    Where the PSF changes over the image, the parts go from the middle to the corner. Its lens is
    rendered exactly as it is described.
    """
    whole = camera.image_width, camera.image_height
    height, width = shape
    changes = camera.wavefront is not None or camera.field_curvature is not None
    away = 1 - (number % _PARTS) / (_PARTS - 1) if changes else 1.0
    left, top = away * (whole[0] - width) / 2, away * (whole[1] - height) / 2
    exact = dataclasses.replace(camera, calibrated="traced")
    return exact.for_view(View(width, height, *whole, left, top))


def usable_range_m(figures: Sequence[DistanceFigures]) -> tuple[float, float] | None:
    """Ends of the longest run of distances that hold, m; None if none does.

    Examples
    --------
    >>> errors = (0.2, 0.01, 0.02)
    >>> figures = [DistanceFigures(z, z + 1, error, 1.0, 0.9) for z, error in enumerate(errors, 1)]
    >>> usable_range_m(figures)
    (2, 4)
    """
    best: tuple[float, float] | None = None
    run: list[DistanceFigures] = []
    for one in figures:
        run = [*run, one] if one.holds else []
        if run and (best is None or run[-1].far_m / run[0].near_m > best[1] / best[0]):
            best = run[0].near_m, run[-1].far_m
    return best
