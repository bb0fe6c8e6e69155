"""Figures for setting a camera up: light, focus, and a flat wall in front of it."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth import DepthEstimate
from coded_aperture_ros.optics import Camera

# Linear light from which on a pixel counts as clipped.
_CLIPPED_LIGHT = 0.995
# About so many pixels are used to fit the wall.
_FITTED_PIXELS = 4000
# Random triples of pixels that are tried for the first plane, and refinements of the best one.
_TRIPLES = 40
_REFINEMENTS = 4
# Least share of the map with known depth, and of those pixels near the plane, to call it a wall.
_LEAST_KNOWN = 0.15
_LEAST_NEAR_PLANE = 0.7
# Largest relative difference of depth from the plane of a pixel near it.
_NEAR_PLANE = 0.1


@dataclasses.dataclass(frozen=True)
class Wall:
    """Plane that fills the picture.

    Attributes
    ----------
    distance_m : float
        Along the optical axis.
    right_nearer_deg, lower_nearer_deg : float
        Tilt: by how much the right and the lower side are nearer than of a plane that is parallel
        to the sensor.
    uneven : float
        Median relative difference of depth from the plane.
    """

    distance_m: float
    right_nearer_deg: float
    lower_nearer_deg: float
    uneven: float


@dataclasses.dataclass(frozen=True)
class SetupFigures:
    """Figures of one frame for setting the camera up.

    Attributes
    ----------
    light : float
        Mean, linear light from 0 to 1.
    clipped, known : float
        Shares of the pixels: clipped ones, and those with depth.
    noise : float
        Standard deviation, linear light.
    sharpness : float
        Of the middle of the picture; largest in focus.
    wall : Wall or None
    """

    light: float
    clipped: float
    noise: float
    sharpness: float
    known: float
    wall: Wall | None


def setup_figures(frame: FloatArray, estimate: DepthEstimate, camera: Camera) -> SetupFigures:
    """Figures of a frame, linear light, float32 [rows, columns(, 3)], and of its depth."""
    light = frame if frame.ndim == 2 else frame.mean(axis=-1)
    light = np.nan_to_num(light)
    brightest = np.nan_to_num(frame if frame.ndim == 2 else frame.max(axis=-1))
    depth = estimate.depth_m
    return SetupFigures(
        light=float(light.mean()),
        clipped=float((brightest >= _CLIPPED_LIGHT).mean()),
        noise=float(estimate.noise),
        sharpness=_sharpness(light, estimate.noise),
        known=0.0 if depth is None else float(np.isfinite(depth).mean()),
        wall=None if depth is None else find_wall(depth, camera),
    )


def find_wall(depth_m: FloatArray, camera: Camera) -> Wall | None:
    """Plane through a depth map, m [rows, columns]; None if depth does not lie on one.

    In a pinhole camera the inverse depth of a plane is linear in the coordinates of the rays.
    """
    rows, columns = depth_m.shape
    rays = camera.intrinsics.rays(rows, columns)
    step = max(1, round((rows * columns / _FITTED_PIXELS) ** 0.5))
    sampled_m = depth_m[::step, ::step]
    known = np.isfinite(sampled_m)
    if known.mean() < _LEAST_KNOWN:
        return None
    sampled_rays = np.asarray(rays)[::step, ::step][known]
    directions = np.column_stack([sampled_rays[:, :2], np.ones(len(sampled_rays))])
    inverse = 1 / sampled_m[known].astype(float)
    plane = _median_plane(directions, inverse)
    for _ in range(_REFINEMENTS):
        relative = np.abs(directions @ plane / inverse - 1)
        near = relative <= 3 * max(float(np.median(relative)), 1e-4)
        plane = np.linalg.lstsq(directions[near], inverse[near], rcond=None)[0]
    relative = np.abs(directions @ plane / inverse - 1)
    if plane[2] <= 0 or (relative <= _NEAR_PLANE).mean() < _LEAST_NEAR_PLANE:
        return None
    right, lower = np.rad2deg(np.arctan(plane[:2] / plane[2]))
    return Wall(float(1 / plane[2]), float(right), float(lower), float(np.median(relative)))


def _median_plane(directions: NDArray[np.float64], inverse: NDArray[np.float64]) -> FloatArray:
    """Plane through three random points with the least median difference from all points [3]."""
    triples = np.random.default_rng(0).integers(len(inverse), size=(_TRIPLES, 3))
    # Three points on a line define no plane: a small diagonal keeps the matrices regular.
    matrices = directions[triples] + 1e-9 * np.eye(3)
    planes = np.linalg.solve(matrices, inverse[triples][..., None])[..., 0]
    differences = np.abs(planes @ directions.T / inverse - 1)
    best: FloatArray = planes[np.median(differences, axis=1).argmin()]
    return best


def _sharpness(light: FloatArray, noise: float) -> float:
    """Share of the contrast in the middle of a picture that is fine detail, less the noise."""
    rows, columns = light.shape
    middle = light[rows // 3 : -(rows // 3) or None, columns // 3 : -(columns // 3) or None]
    # White noise has 20 times its variance in the Laplacian: the squares of its weights add up.
    fine = float((cv2.Laplacian(middle, cv2.CV_32F) ** 2).mean()) - 20 * noise**2
    contrast = float(middle.var()) - noise**2
    return float(np.sqrt(max(fine, 0.0) / contrast)) if contrast > noise**2 else 0.0
