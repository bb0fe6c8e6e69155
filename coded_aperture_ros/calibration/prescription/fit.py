"""Camera of a lens prescription: focal length, mask extent and wavefront, from rays."""

import dataclasses
import math

import numpy as np
from scipy.optimize import minimize

from coded_aperture_ros.calibration.prescription.lens import Lens, Rays
from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera, Wavefront
from coded_aperture_ros.optics.wavefront import TERMS

_FIELDS = 9
_DEPTHS = 5
_RAYS = 41
_RIMS = (1.1, 0.4, 1.1, -0.2)
_SOFT = 0.03


@dataclasses.dataclass(frozen=True, eq=False)
class _Bundle:
    """Rays of one point that pass the mask's square; lengths in half extents, and in px."""

    field: float
    inverse_m: float
    places: DoubleArray  # [2, n] of the mask, along the field and across
    light: DoubleArray  # what the mask passes [n]
    moved_px: DoubleArray  # [2, n]; where they come out in the image
    passed: DoubleArray  # the rims, 0 or 1 [n]


def traced_camera(
    camera: Camera, lens: Lens, mask_mm: float, pitch_um: float, near_m: float, far_m: float
) -> tuple[Camera, float]:
    """Camera with the blur that a lens gives its mask, and the residual of the fit, px.

    Parameters
    ----------
    camera : Camera
        For its mask, size, and focus: there a point on the axis has the smallest spot.
    lens : Lens
    mask_mm : float
        Extent of the mask's grid in the stop, mm.
    pitch_um : float
        Distance between pixels, um.
    near_m, far_m : float
        Depths, from the entrance pupil, between which the blur has to be right, m.

    Raises
    ------
    InputError
        If no ray gets through, or there is no image of the focus distance.
    """
    half_mm = mask_mm / 2
    grid = np.linspace(-1, 1, _RAYS)
    square = np.stack(np.meshgrid(grid, grid, indexing="ij")).reshape(2, -1)
    # First the size of the entrance pupil, from rays near the axis.
    tried = lens.trace(1e3, 0.0, 0.01 * square)
    pupil = 0.01 * np.ptp(grid) / np.ptp(tried.stop[1])
    points = 1.15 * half_mm * pupil * square
    lens = lens.focused(camera.focus_distance_m, _open(camera, points, half_mm * pupil))
    per_tangent_mm = lens.trace(far_m, 0.01, np.zeros((2, 1))).sensor[1, 0] / 0.01
    focal_px = float(abs(per_tangent_mm)) * 1e3 / pitch_um
    corner = math.hypot(camera.image_height, camera.image_width) / 2 / focal_px
    bundles = [
        _bundle(camera, lens.trace(1 / inverse_m, h * corner, points), h, inverse_m, half_mm)
        for inverse_m in np.linspace(1 / far_m, 1 / near_m, _DEPTHS)
        for h in np.linspace(0, 1, _FIELDS)
    ]
    pitch_mm = pitch_um * 1e-3
    solved, left = _solve(bundles, pitch_mm)
    at_infinity = 2 * solved[0]
    per_dioptre = -2 * solved[1]
    coefficients = 4 * solved[2:] / per_dioptre
    wavefront = Wavefront(corner, tuple(coefficients.tolist()), _rims(bundles))
    found = dataclasses.replace(
        camera,
        focal_length_px=focal_px,
        focal_length_mm=lens.focal_length_mm,
        focus_distance_m=float(per_dioptre / at_infinity),
        mask_extent_mm=float(per_dioptre / focal_px * 1e3),
        lens_mask_distance_mm=0.0,
        measured=None,
        field_curvature=wavefront.field_curvature(camera.mask),
        wavefront=wavefront,
    )
    return found, left


def _open(camera: Camera, points: DoubleArray, half_mm: float) -> DoubleArray:
    return points[:, _light(camera, points / half_mm) > 0]


def _light(camera: Camera, places: DoubleArray) -> DoubleArray:
    """Transmission of the mask at places [2, n], in half extents, down and right."""
    cells = camera.mask.transmission
    index = np.floor((places + 1) / 2 * max(cells.shape)).astype(int)
    inside = ((index >= 0) & (index < np.array(cells.shape)[:, None])).all(axis=0)
    row, column = np.where(inside, index, 0)
    return np.where(inside, cells[row, column], 0.0)


def _bundle(camera: Camera, rays: Rays, field: float, inverse_m: float, half_mm: float) -> _Bundle:
    places = rays.stop / half_mm
    inside = (np.abs(places) <= 1).all(axis=0) & np.isfinite(rays.sensor).all(axis=0)
    if not (inside & rays.passed).any():
        raise InputError(
            f"no ray reaches {field:.0%} of the way to the corner: check stop and diameters"
        )
    # The image is upside down: seen upright, both axes turn. Along the field comes first.
    along, across = rays.sensor[::-1] * -1.0
    turned = places[::-1, inside]
    return _Bundle(
        field,
        inverse_m,
        turned,
        _light(camera, turned),
        np.stack([along, across])[:, inside],
        rays.passed[inside].astype(float),
    )


def _solve(bundles: list[_Bundle], pitch_mm: float) -> tuple[DoubleArray, float]:
    """Linear fit of half the blur size at infinity and per 1/m, and of a wavefront, px."""
    moments = 0.0
    sides = 0.0
    total = 0.0
    weights = 0.0
    terms = [Wavefront(1.0, tuple(row)) for row in np.eye(len(TERMS)).tolist()]
    for each in bundles:
        light = each.light * each.passed
        columns = [each.places, each.places * each.inverse_m]
        columns += [
            term.trace(each.places, 0.0, 4.0, np.array([each.field, 0]))[0] for term in terms
        ]
        rows = np.stack(columns, axis=-1)
        seen = each.moved_px / pitch_mm
        # The position of the blur is not part of the fit.
        rows = rows - np.average(rows, axis=1, weights=light)[:, None]
        seen = seen - np.average(seen, axis=1, weights=light)[:, None]
        weighted = rows * light[:, None]
        moments = moments + np.einsum("dni,dnj->ij", weighted, rows)
        sides = sides + np.einsum("dni,dn->i", weighted, seen)
        total += np.sum(light * seen * seen)
        weights += 2 * np.sum(light)
    solved = np.linalg.lstsq(np.asarray(moments), np.asarray(sides), rcond=1e-12)[0]
    left = total - solved @ np.asarray(sides)
    return solved, float(np.sqrt(max(left, 0) / weights))


def _rims(bundles: list[_Bundle]) -> tuple[float, float, float, float]:
    """Two circles fitted to the rays that get through."""
    field = np.concatenate([np.full(len(each.light), each.field) for each in bundles])
    p, q = np.concatenate([each.places for each in bundles], axis=1)
    passed = np.concatenate([each.passed for each in bundles])
    area = np.maximum(field, field[field > 0].min() / 2)  # of the image that sees it like that

    def off(rims: DoubleArray) -> float:
        through = np.ones_like(p)
        for radius, shift in (rims[:2], rims[2:]):
            through *= np.clip((radius - np.hypot(p - shift * field, q)) / _SOFT + 0.5, 0, 1)
        return float(np.average((through - passed) ** 2, weights=area))

    found = minimize(off, _RIMS, method="Nelder-Mead", options={"maxiter": 2000}).x
    return tuple(float(value) for value in found)  # type: ignore[return-value]
