"""Numbers that help to set a camera up: light, focus, and a flat wall in front of it."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth import DepthEstimate
from coded_aperture_ros.optics import Camera

_CLIPPED = 0.995
# A wall is fitted to about so many pixels.
_FITTED = 4000
_DRAWN, _PASSES = 40, 4
# A wall: so much of the map is known, and so much of that within this share of one plane.
_KNOWN, _OF_KNOWN, _WITHIN = 0.15, 0.7, 0.1


@dataclasses.dataclass(frozen=True)
class Wall:
    """A plane that fills the picture.

    `distance_m` is along the optical axis; the angles say by how much its right and its lower side
    are nearer than if it were parallel to the sensor; `uneven` is the median relative distance of
    depth from the plane.
    """

    distance_m: float
    right_nearer_deg: float
    lower_nearer_deg: float
    uneven: float


@dataclasses.dataclass(frozen=True)
class Aid:
    """Of one frame.

    `light` is the mean of full scale, `clipped` and `known` are shares of the pixels, `noise` is a
    standard deviation in full scales. `sharpness`, of the middle of the picture, is largest where
    that is in focus.
    """

    light: float
    clipped: float
    noise: float
    sharpness: float
    known: float
    wall: Wall | None


def aid_of(frame: FloatArray, estimate: DepthEstimate, camera: Camera) -> Aid:
    """Measure a frame in linear light [rows, columns] or with channels, and its depth."""
    light = frame if frame.ndim == 2 else frame.mean(axis=-1)
    light = np.nan_to_num(light)
    brightest = np.nan_to_num(frame if frame.ndim == 2 else frame.max(axis=-1))
    depth = estimate.depth_m
    return Aid(
        light=float(light.mean()),
        clipped=float((brightest >= _CLIPPED).mean()),
        noise=float(estimate.noise),
        sharpness=_sharpness(light, estimate.noise),
        known=0.0 if depth is None else float(np.isfinite(depth).mean()),
        wall=None if depth is None else wall_of(depth, camera),
    )


def wall_of(depth_m: FloatArray, camera: Camera) -> Wall | None:
    """Return the plane that depth [rows, columns] lies on, or None if there is no such plane.

    In front of a pinhole the inverse depth of a plane is linear in the coordinates of the rays.
    """
    rows, columns = depth_m.shape
    rays = camera.intrinsics.rays(rows, columns)
    step = max(1, round((rows * columns / _FITTED) ** 0.5))
    some = depth_m[::step, ::step]
    known = np.isfinite(some)
    if known.mean() < _KNOWN:
        return None
    across = np.asarray(rays)[::step, ::step][known]
    directions = np.column_stack([across[:, :2], np.ones(len(across))])
    inverse = 1 / some[known].astype(float)
    plane = _median_plane(directions, inverse)
    for _ in range(_PASSES):
        relative = np.abs(directions @ plane / inverse - 1)
        near = relative <= 3 * max(float(np.median(relative)), 1e-4)
        plane = np.linalg.lstsq(directions[near], inverse[near], rcond=None)[0]
    relative = np.abs(directions @ plane / inverse - 1)
    if plane[2] <= 0 or (relative <= _WITHIN).mean() < _OF_KNOWN:
        return None
    right, lower = np.rad2deg(np.arctan(plane[:2] / plane[2]))
    return Wall(float(1 / plane[2]), float(right), float(lower), float(np.median(relative)))


def _median_plane(directions: NDArray[np.float64], inverse: NDArray[np.float64]) -> FloatArray:
    """Return the plane through three points that is nearest to half of all points."""
    drawn = np.random.default_rng(0).integers(len(inverse), size=(_DRAWN, 3))
    # Three points on a line tell no plane: a little is added so that they can be solved for.
    matrices = directions[drawn] + 1e-9 * np.eye(3)
    planes = np.linalg.solve(matrices, inverse[drawn][..., None])[..., 0]
    wrong = np.abs(planes @ directions.T / inverse - 1)
    best: FloatArray = planes[np.median(wrong, axis=1).argmin()]
    return best


def _sharpness(light: FloatArray, noise: float) -> float:
    """Return how much of the contrast in the middle of a picture is fine, without the noise's."""
    rows, columns = light.shape
    middle = light[rows // 3 : -(rows // 3) or None, columns // 3 : -(columns // 3) or None]
    # The squares of the Laplacian's weights add up to 20.
    fine = float((cv2.Laplacian(middle, cv2.CV_32F) ** 2).mean()) - 20 * noise**2
    contrast = float(middle.var()) - noise**2
    return float(np.sqrt(max(fine, 0.0) / contrast)) if contrast > noise**2 else 0.0
