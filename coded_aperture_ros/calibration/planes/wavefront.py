"""Wavefront of a lens, the change of its PSF over the image, from planes at known depths."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.calibration.scoring import Scoring, Windows, window_spectra
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.frames import grey_image
from coded_aperture_ros.likelihood.bank.field import COLUMNS, ROWS, nearest_part
from coded_aperture_ros.optics import Camera, FieldCurvature, Wavefront, psf_width
from coded_aperture_ros.optics.wavefront import TERM_NAMES, TERMS, field_tangents

_STRIDE_PX = 24
# More planes are slower and add little information.
_MAX_PLANES = 5
# Prior of the lens: rims that cut off a little on either side of the corner. Not symmetric: power
# spectra do not tell a PSF from itself turned by 180 degrees, and would give no gradient.
_RIMS = (1.1, 0.4, 1.1, -0.2)
# Parameters of the fit: mask extent, rims, terms. Steps of their finite differences, and standard
# deviations of their prior.
_STEPS = np.array([0.002, *[0.01] * 4, *[0.005] * len(TERMS)])
_SPREAD = np.array([1.0, *[0.15, 0.3] * 2, *[0.07] * len(TERMS)])
_ASTIGMATISM = 0.15 * np.eye(5 + len(TERMS))[5 + TERM_NAMES.index("W222")]
_ROUNDS = 20
_FIRST_ROUNDS = 5
_WIDER_PX = 6


def fit_wavefront(
    camera: Camera, planes: Planes, used: Sequence[int], progress: Progress
) -> Camera:
    """Camera with a wavefront and a mask extent fitted to some of the planes.

    Its field curvature becomes that of the wavefront. By Fisher scoring of the likelihood of the
    windows' power spectra, for textures as those of a bank.
    """
    rows, columns = planes.images[0].shape[:2]
    k = camera.intrinsics.camera_matrix
    corner = np.hypot(max(k[5], rows - k[5]) / k[4], max(k[2], columns - k[2]) / k[0])
    lens = _Lens(camera, float(corner))
    scoring = Scoring(lens.psf, _STEPS)
    windows = list(_windows(camera, planes, used))
    curvature = camera.field_curvature or FieldCurvature()
    first = np.array([1.0, *_RIMS, *[0.0] * len(TERMS)])
    first[5 + TERM_NAMES.index("W220")] = -curvature.second * lens.corner**2
    first[5 + TERM_NAMES.index("W420")] = -curvature.fourth * lens.corner**4
    # What is largest first, from astigmatism of either sign: else the best may never be found.
    starts = [first + sign * _ASTIGMATISM for sign in (-1, 0, 1)]
    costs = [scoring.cost(at, [scoring.textures(at, each) for each in windows]) for at in starts]
    begin = starts[int(np.argmin(costs))]

    def active(number: int) -> IndexArray:
        return np.arange(9 if number < _FIRST_ROUNDS else len(first))

    state, _ = scoring.fit(first, windows, _SPREAD, active, _ROUNDS, progress, begin)
    return lens.camera_for(state)


@dataclasses.dataclass(frozen=True, eq=False)
class _Lens:
    """Lens with a state of the fit."""

    camera: Camera
    corner: float

    def camera_for(self, state: DoubleArray) -> Camera:
        """Camera with the lens of a state."""
        wavefront = self._wavefront(state)
        camera = self.camera
        return dataclasses.replace(
            camera,
            mask_extent_mm=round(camera.mask_extent_mm * float(state[0]), 4),
            field_curvature=wavefront.field_curvature(camera.mask),
            wavefront=wavefront,
        )

    def psf(self, state: DoubleArray, windows: Windows) -> FloatArray:
        """PSF of some windows."""
        return self._wavefront(state).psf(
            self.camera.mask,
            windows.blur_size_px * state[0],
            self.camera.blur_per_dioptre_px,
            windows.tangent,
            psf_width(windows.blur_size_px) + 2 * _WIDER_PX,
        )

    def _wavefront(self, state: DoubleArray) -> Wavefront:
        values = state.round(5).tolist()
        return Wavefront(self.corner, tuple(values[5:]), tuple(values[1:5]))


def _windows(camera: Camera, planes: Planes, used: Sequence[int]) -> Iterator[Windows]:
    """Windows of some planes and all parts of the image."""
    parts = field_tangents(camera.intrinsics, ROWS, COLUMNS)
    k = camera.intrinsics.camera_matrix
    chosen = np.unique(np.linspace(0, len(used) - 1, _MAX_PLANES).round().astype(int))
    for index in np.array(used)[chosen]:
        grey, _ = grey_image(planes.images[index], 1.0)
        powers, noise, middles = window_spectra(grey, _STRIDE_PX)
        places = (middles - [k[5], k[2]]) / [k[4], k[0]]
        part = nearest_part(places[None], parts)[0]
        for inside in (part == number for number in np.unique(part)):
            size_px = float(camera.blur_size_px(planes.depths_m[index]))
            yield Windows(size_px, places[inside].mean(axis=0), powers[inside], noise)
