"""Lens prescriptions, and rays through them, which optiland traces."""

import dataclasses
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray
from coded_aperture_ros.core.errors import InputError, naming

_NEEDED = "needs optiland: pip install optiland"
_COLUMNS = "radius thickness index Abbe diameter, all in mm, 0 for flat, 'stop' after the stop's"


@dataclasses.dataclass(frozen=True, eq=False)
class Rays:
    """Intersections of rays with the stop and with the sensor; NaN if there is none.

    Attributes
    ----------
    stop, sensor : ndarray, float64 [2, n]
        Across and along the field, mm.
    passed : ndarray, bool [n]
        Whether no rim blocks the ray; the stop's own is left out.
    """

    stop: DoubleArray
    sensor: DoubleArray
    passed: BoolArray


@dataclasses.dataclass(frozen=True, eq=False)
class Lens:
    """Lens of surfaces one behind the other, as `load_lens` reads it."""

    optic: Any  # optiland's
    radii_mm: tuple[float, ...]  # of the rims, from the first surface on
    stop: int  # which of the surfaces

    @property
    def focal_length_mm(self) -> float:
        """Paraxial focal length, mm."""
        return float(self.optic.paraxial.f2())

    @property
    def pupil_mm(self) -> float:
        """Distance of the entrance pupil behind the first surface, mm."""
        return float(self.optic.paraxial.EPL())

    def trace(self, depth_m: float, tangent: float, points_mm: DoubleArray) -> Rays:
        """Rays of a point through points [2, n] of the entrance pupil.

        `depth_m` is from the entrance pupil, `tangent` that of the angle from the axis.
        """
        from optiland.rays import RealRays

        ahead_mm = 1e3 * depth_m
        count = points_mm.shape[1]
        start = np.array([0.0, tangent * ahead_mm, self.pupil_mm - ahead_mm])
        way = np.stack([*(points_mm - start[:2, None]), np.full(count, ahead_mm)])
        way /= np.linalg.norm(way, axis=0)
        micrometres = self.optic.primary_wavelength
        places = (np.full(count, coordinate) for coordinate in start)
        self.optic.updater.set_thickness(-start[2], 0)
        with np.errstate(invalid="ignore"):
            rays = RealRays(*places, *way, np.ones(count), np.full(count, micrometres))
            self.optic.surfaces.trace(rays)
            x = self.optic.surfaces.x
            y = self.optic.surfaces.y
            radius = np.hypot(x, y)[1 : 1 + len(self.radii_mm)]
        rims = np.array(self.radii_mm)[:, None]
        rims[self.stop - 1] = np.inf
        stop, sensor = (np.stack([x[index], y[index]]) for index in (self.stop, -1))
        return Rays(stop, sensor, (radius <= rims).all(axis=0) & np.isfinite(sensor).all(axis=0))

    def focused(self, depth_m: float, points_mm: DoubleArray) -> "Lens":
        """Lens with the sensor where a point on the axis has the smallest spot."""
        behind_mm = []
        for moved_mm in (0.0, 1.0):
            self._move_sensor(moved_mm)
            rays = self.trace(depth_m, 0.0, points_mm)
            stop = rays.stop[:, rays.passed]
            sensor = rays.sensor[:, rays.passed]
            behind_mm.append(np.sum(stop * sensor) / np.sum(stop * stop))
            self._move_sensor(-moved_mm)
        self._move_sensor(behind_mm[0] / (behind_mm[0] - behind_mm[1]))
        return self

    def _move_sensor(self, by_mm: float) -> None:
        last = len(self.radii_mm)
        before = float(np.ravel(self.optic.surfaces[last].thickness)[0])
        self.optic.updater.set_thickness(before + by_mm, last)


def load_lens(path: Path, wavelength_nm: float) -> Lens:
    """Lens from a Zemax file (.zmx), or a table of surfaces.

    Raises `InputError` with the file, and what a lens needs that is not in it.
    """
    with naming(str(path)), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            read = _of_zemax if path.suffix.lower() == ".zmx" else _of_table
            lens = read(path)
        except ModuleNotFoundError as error:
            raise InputError(_NEEDED) from error
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}") from error
        lens.optic.wavelengths.wavelengths.clear()
        lens.optic.wavelengths.add(value=wavelength_nm * 1e-3, is_primary=True)
        if not lens.focal_length_mm > 0:
            raise InputError(f"focal length {lens.focal_length_mm:.4g} mm: makes no image")
        return lens


def _of_zemax(path: Path) -> Lens:
    from optiland.fileio.zemax import ZemaxDataParser, ZemaxToOpticConverter

    try:
        data = ZemaxDataParser(str(path)).parse()
        optic = ZemaxToOpticConverter(data).convert()
    # What its reader raises for files that are none, and for kinds of surfaces that it has not.
    except (ValueError, KeyError, IndexError, NotImplementedError) as error:
        raise InputError(f"not a lens that optiland reads: {error}") from error
    surfaces = [data.surfaces[index] for index in sorted(data.surfaces)][1:-1]
    stops = [number for number, each in enumerate(surfaces, 1) if each.get("is_stop")]
    if len(stops) != 1:
        raise InputError("no surface is the stop, where the mask goes")
    return Lens(optic, tuple(each.get("diameter") or np.inf for each in surfaces), stops[0])


def _of_table(path: Path) -> Lens:
    from optiland.backend import inf
    from optiland.materials import AbbeMaterial
    from optiland.optic import Optic

    optic = Optic()
    radii = []
    stop = 0
    optic.surfaces.add(index=0, radius=inf, thickness=1e3)
    for radius, thickness, index, abbe, diameter, is_stop in _rows(path):
        glass = {"material": AbbeMaterial(index, abbe)} if index != 1 else {}
        radii.append(diameter / 2 or np.inf)
        stop = len(radii) if is_stop else stop
        shape = {"radius": radius or inf, "thickness": thickness, "is_stop": is_stop}
        optic.surfaces.add(index=len(radii), **shape, **glass)
    if not stop:
        raise InputError(f"no surface is the stop, where the mask goes: expected {_COLUMNS}")
    optic.surfaces.add(index=len(radii) + 1)
    optic.set_aperture("float_by_stop_size", 2 * min(radii[stop - 1], 1e3))
    optic.fields.set_type("angle")
    optic.fields.add(y=0)
    optic.wavelengths.add(value=0.55, is_primary=True)
    return Lens(optic, tuple(radii), stop)


def _rows(path: Path) -> Iterator[tuple[Any, ...]]:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").split()
        is_stop = words[-1:] == ["stop"]
        try:
            numbers = [float(word) for word in words[: len(words) - is_stop]]
        except ValueError:
            numbers = []
        if not words:
            continue
        if len(numbers) != 5 or not np.isfinite(numbers).all() or numbers[2] < 1:
            raise InputError(f"line {number}: expected {_COLUMNS}: {line.strip()!r}")
        yield (*numbers, is_stop)
