"""The blur of a real lens over its field: aberrations, and rims that cut off the pupil's edge."""

import dataclasses
import itertools
import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import has_type
from coded_aperture_ros.optics.field import FieldCurvature
from coded_aperture_ros.optics.intrinsics import Intrinsics
from coded_aperture_ros.optics.mask import Mask

# ``W_klm`` of Hopkins: powers of the field, of the radius in the pupil, of the angle's cosine.
_CURVATURE_AND_ASTIGMATISM = ((2, 2, 0), (4, 2, 0), (2, 2, 2), (4, 2, 2))
_COMA = ((1, 3, 1), (3, 3, 1), (5, 3, 1), (3, 3, 3), (1, 5, 1), (3, 5, 1))
_SPHERICAL = (
    (0, 4, 0),
    (2, 4, 0),
    (4, 4, 0),
    (2, 4, 2),
    (4, 4, 2),
    (0, 6, 0),
    (2, 6, 0),
    (2, 6, 2),
)
TERMS = _CURVATURE_AND_ASTIGMATISM + _COMA + _SPHERICAL
TERM_NAMES = tuple("W{}{}{}".format(*term) for term in TERMS)
# Largest coefficient [1/m], radius [half extents] and tangent of a real lens.
_MAX_VALUE = 100.0
# Rays per pixel along each side, and along each side of the smallest PSF.
_RAYS_PER_PX = 12
_MIN_RAYS = 96
# Share of the light that has to pass the rims.
_MIN_LIGHT = 1e-3
# Width of a rim in half extents, so that the transmitted light changes smoothly.
_RIM_SOFTNESS = 0.03


@dataclasses.dataclass(frozen=True)
class Wavefront:
    """Aberrations of a lens, and rims that cut off the pupil's edge (vignetting).

    A ray through the point ``(p, q)`` of the mask, in half extents, p along the field's radius,
    lands ``S / 2 (p, q) + M f / 4 grad W`` px from the middle of the PSF, with the blur size S on
    the axis and ``W = sum of W_klm h^k rho^l cos^m``. The field h is 1 at the tangent `corner`.

    Parameters
    ----------
    corner : float
        Tangent of the angle between the axis and the corner of the image.
    coefficients : tuple of float, optional
        ``W_klm`` in dioptres (1/m), in the order of `TERMS`.
    rims : tuple of 4 float, optional
        Two circles that the light passes through: radius in half extents of the mask, and shift
        of the circle, outwards in the image, at the corner.

    Raises
    ------
    InputError
        If numbers are not finite, or more than a lens can have.

    References
    ----------
    H. H. Hopkins, *Wave Theory of Aberrations*, 1950.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask, Wavefront
    >>> ideal = Wavefront(corner=0.3)
    >>> ideal.psf(Mask.named("disc"), 5.0, 10.0, (0.0, 0.0), 7).shape
    (7, 7)
    """

    corner: float
    coefficients: tuple[float, ...] = (0.0,) * len(TERMS)
    rims: tuple[float, float, float, float] = (_MAX_VALUE, 0.0, _MAX_VALUE, 0.0)

    def __post_init__(self) -> None:
        values = (self.corner, *self.coefficients, *self.rims)
        if not all(
            has_type(v, float) and math.isfinite(v) and abs(v) <= _MAX_VALUE for v in values
        ):
            raise InputError(f"wavefront: expected numbers up to {_MAX_VALUE:g}")
        if not (self.corner > 0 and self.rims[0] > 0 and self.rims[2] > 0):
            raise InputError("wavefront: the corner and the radii of rims must be more than 0")

    @classmethod
    def from_entry(cls, entry: Any) -> "Wavefront":
        """Wavefront from the entry of a camera file; missing terms are 0."""
        names = {"corner", "rims", *TERM_NAMES}
        if not isinstance(entry, Mapping) or "corner" not in entry or not set(entry) <= names:
            raise InputError(
                "wavefront: expected corner, rims and terms such as W222, as calibrate field gives"
            )
        rims = entry.get("rims", cls.rims)
        if not isinstance(rims, (list, tuple)) or len(rims) != 4:
            raise InputError("wavefront: rims: expected four numbers")
        return cls(entry["corner"], tuple(entry.get(name, 0.0) for name in TERM_NAMES), tuple(rims))

    @property
    def entry(self) -> dict[str, Any]:
        """Entry for a camera file."""
        terms = {k: round(v, 5) for k, v in zip(TERM_NAMES, self.coefficients, strict=True) if v}
        return {"corner": round(self.corner, 5), "rims": [round(v, 4) for v in self.rims], **terms}

    def psf(
        self, mask: Mask, blur_size_px: float, per_dioptre_px: float, tangent: ArrayLike, width: int
    ) -> FloatArray:
        """PSF [width, width] at a field angle, float32, unit sum.

        Parameters
        ----------
        mask : Mask
        blur_size_px : float
            Signed size S of the mask's extent on the axis.
        per_dioptre_px : float
            ``M f``; see `Camera.blur_per_dioptre_px`.
        tangent : array_like [2]
            Tangent of the angle from the axis, down and right.
        width : int
            Odd, px.

        Raises
        ------
        InputError
            If no light gets there.
        """
        rays = _MIN_RAYS + math.ceil(_RAYS_PER_PX * abs(blur_size_px))
        pupil_points, light = _pupil_samples(mask, rays)
        moved, passed = self.trace(
            pupil_points, blur_size_px, per_dioptre_px, np.asarray(tangent, float)
        )
        psf = _shared_by_pixels(moved + (width - 1) / 2, light * passed, width)
        if not psf.sum() > _MIN_LIGHT * light.sum():
            raise InputError("wavefront: the rims leave no light: check rims and corner")
        return (psf / psf.sum()).astype(np.float32)

    def transmitted_share(self, mask: Mask, tangent: ArrayLike) -> float:
        """Share of the light of a mask, or of a part of one, that passes the rims, 0 to 1."""
        pupil_points, light = _pupil_samples(mask, _MIN_RAYS)
        _, passed = self.trace(pupil_points, 0.0, 1.0, np.asarray(tangent, float))
        return float(np.average(passed, weights=light))

    def defocus(self, mask: Mask, tangent: float) -> float:
        """Defocus that fits the rays best at a tangent of the field angle, dioptres."""
        pupil_points, light = _pupil_samples(mask, _MIN_RAYS)
        moved, passed = self.trace(pupil_points, 0.0, 1.0, np.array([0.0, tangent]))
        light = light * passed
        apart = pupil_points - np.average(pupil_points, axis=1, weights=light)[:, None]
        return float(2 * np.sum(light * apart * moved) / np.sum(light * apart * apart))

    def field_curvature(self, mask: Mask) -> FieldCurvature:
        """Field curvature nearest to `defocus` between axis and corner."""
        tangents = np.linspace(0, self.corner, 32)[1:]
        missing = [-self.defocus(mask, tangent) for tangent in tangents]
        bends = np.stack([tangents**2, tangents**4], axis=1)
        second, fourth = np.linalg.lstsq(bends, np.array(missing), rcond=None)[0]
        return FieldCurvature(round(float(second), 4), round(float(fourth), 4))

    def trace(
        self,
        pupil_points: DoubleArray,
        blur_size_px: float,
        per_dioptre_px: float,
        tangent: DoubleArray,
    ) -> tuple[DoubleArray, DoubleArray]:
        """Landing points of rays on the sensor [2, n], px, and the share that passes the rims [n].

        `pupil_points` [2, n] are in half extents of the mask, down and right.
        """
        field = float(np.hypot(*tangent))
        down, right = tangent / field if field else (0.0, 1.0)
        turn = np.array([[down, right], [-right, down]])
        p, q = turn @ pupil_points
        h = field / self.corner
        passed = np.ones_like(p)
        for radius, shift in (self.rims[:2], self.rims[2:]):
            inside = radius - np.hypot(p - shift * h, q)
            passed *= np.clip(inside / _RIM_SOFTNESS + 0.5, 0, 1)
        along, across = self._gradient(p, q, h)
        moved = blur_size_px / 2 * np.array([p, q]) + per_dioptre_px / 4 * np.array([along, across])
        return turn.T @ moved, passed

    def _gradient(
        self, p: DoubleArray, q: DoubleArray, h: float
    ) -> tuple[DoubleArray, DoubleArray]:
        """Derivatives of W by p and by q [n], at points [n] of the mask and the field h."""
        strengths: dict[tuple[int, int], float] = {}
        for coefficient, (field_power, radius_power, m) in zip(
            self.coefficients, TERMS, strict=True
        ):
            term = (radius_power - m) // 2, m
            strengths[term] = strengths.get(term, 0.0) + coefficient * h**field_power
        squared = p * p + q * q
        radial = [np.ones_like(p), squared, squared**2, squared**2 * squared]
        angular = [radial[0], p, p**2, p**2 * p]
        radial_part = np.zeros_like(p)
        angular_part = np.zeros_like(p)
        for (half, m), strength in strengths.items():
            if half and strength:
                radial_part += 2 * half * strength * radial[half - 1] * angular[m]
            if m and strength:
                angular_part += m * strength * radial[half] * angular[m - 1]
        return radial_part * p + angular_part, radial_part * q


def _shared_by_pixels(places: DoubleArray, light: DoubleArray, width: int) -> DoubleArray:
    """Light [n] at places [2, n], each shared by the four pixels around it [width, width]."""
    first = np.floor(places).astype(np.intp)
    beyond = places - first
    found = np.zeros(width * width)
    for down, right in itertools.product((0, 1), repeat=2):
        pixel = first + np.array([[down], [right]])
        share = np.abs(1 - down - beyond[0]) * np.abs(1 - right - beyond[1])
        seen = ((pixel >= 0) & (pixel < width)).all(axis=0)
        index = np.ravel_multi_index(tuple(pixel[:, seen]), (width, width))
        found += np.bincount(index, (light * share)[seen], width * width)
    return found.reshape(width, width)


@lru_cache(maxsize=16)
def _pupil_samples(mask: Mask, rays: int) -> tuple[DoubleArray, DoubleArray]:
    """Evenly spaced points [2, n] of the mask's openings, in half extents, and their light [n]."""
    cells = mask.transmission
    each = math.ceil(rays / max(cells.shape))
    light = np.kron(cells, np.ones((each, each)))
    open_ = np.nonzero(light)
    middle = (np.array(light.shape)[:, None] - 1) / 2
    pupil_points = (np.array(open_) - middle) / (max(light.shape) / 2)
    return pupil_points, light[open_].astype(np.float64)


def field_tangents(frames: Intrinsics, rows: int, columns: int) -> DoubleArray:
    """Tangents (down, right) of the middles of a grid of parts of the image [rows * columns, 2]."""
    k = frames.camera_matrix
    down = ((np.arange(rows) + 0.5) * frames.image_height / rows - 0.5 - k[5]) / k[4]
    right = ((np.arange(columns) + 0.5) * frames.image_width / columns - 0.5 - k[2]) / k[0]
    return np.stack(np.meshgrid(down, right, indexing="ij"), axis=-1).reshape(-1, 2)
