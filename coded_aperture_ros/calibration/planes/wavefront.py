"""How the PSF of a lens changes over the image, from planes at known depths."""

import dataclasses
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from coded_aperture_ros.bank.field import COLUMNS, ROWS, nearest_part, places_of
from coded_aperture_ros.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.bank.prior import NaturalImagePrior
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.arrays import DoubleArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.imaging import grey_image
from coded_aperture_ros.optics import Camera, FieldCurvature, Wavefront, psf_width
from coded_aperture_ros.optics.wavefront import NAMES, TERMS, parts_of_field

_FOURIER, _PRIOR, _STRIDE_PX = WindowedFourierBasis(48, 0.46), NaturalImagePrior(), 24
_COUNTED = _FOURIER.multiplicity > 0
# More planes are slower and tell little more.
_MOST_PLANES = 5
# What a lens is taken for before: rims that cut off a little on either side of the corner. Not
# alike: power spectra do not tell a PSF from itself turned round, so that nothing would change it.
_RIMS = (1.1, 0.4, 1.1, -0.2)
# What is fitted: mask extent, rims, terms. Steps that derivatives are made of, and how far each is
# from where it began where nothing tells.
_STEPS = np.array([0.002, *[0.01] * 4, *[0.005] * len(TERMS)])
_SPREAD = np.array([1.0, *[0.15, 0.3] * 2, *[0.07] * len(TERMS)])
_ASTIGMATISM = 0.15 * np.eye(5 + len(TERMS))[5 + NAMES.index("W222")]
_ROUNDS, _FIRST_ROUNDS, _MOST_DAMPING, _ENOUGH = 20, 5, 1e4, 1.0
_WIDER_PX = 6


@dataclasses.dataclass(frozen=True, eq=False)
class _Windows:
    """Windows of a plane in a part of the image, which share their PSF."""

    blur_size_px: float  # by the camera as it was
    tangent: DoubleArray
    powers: DoubleArray  # [n, K]
    noise: float  # variance


@dataclasses.dataclass(frozen=True, eq=False)
class _Textures:
    """Windows that share a PSF, sorted by the texture that explains them best."""

    windows: _Windows
    slopes: IndexArray  # [T]; which of the prior's
    contrasts: DoubleArray  # [T, 1]
    counts: DoubleArray  # [T, 1]; how many windows
    power: DoubleArray  # [T, K]; their sum


def fit_wavefront(
    camera: Camera, planes: Planes, used: Sequence[int], progress: Progress
) -> Camera:
    """Fit a wavefront and the mask's extent to some of the planes; return the camera with them.

    Its field curvature becomes that of the wavefront. By Fisher scoring of the likelihood of the
    windows' power spectra, for textures as those of a bank.
    """
    rows, columns = planes.images[0].shape[:2]
    k = camera.intrinsics.camera_matrix
    corner = np.hypot(max(k[5], rows - k[5]) / k[4], max(k[2], columns - k[2]) / k[0])
    lens = _Lens(camera, float(corner), _FOURIER.multiplicity[_COUNTED].astype(np.float64))
    windows = list(_windows(camera, planes, used))
    curvature = camera.field_curvature or FieldCurvature()
    first = np.array([1.0, *_RIMS, *[0.0] * len(TERMS)])
    first[5 + NAMES.index("W220")] = -curvature.second * lens.corner**2
    first[5 + NAMES.index("W420")] = -curvature.fourth * lens.corner**4
    count = sum(len(each.powers) for each in windows)
    prior = count * np.diag(_SPREAD**-2)
    # What is largest first, from astigmatism of either sign: else the best may never be found.
    starts = [first + sign * _ASTIGMATISM for sign in (-1, 0, 1)]
    costs = [lens.cost(at, [lens.textures(at, each) for each in windows]) for at in starts]
    state, damping = starts[int(np.argmin(costs))], 1e-2
    for number in progress(range(_ROUNDS)):
        active = np.arange(9 if number < _FIRST_ROUNDS else len(first))
        textures = [lens.textures(state, each) for each in windows]
        cost, gradient, information = lens.derivatives(state, textures, active)
        cost += (state - first) @ prior @ (state - first)
        gradient += (prior @ (state - first))[active]
        information += prior[np.ix_(active, active)]
        gained = 0.0
        while damping < _MOST_DAMPING:
            damped, moved = information + damping * np.diag(np.diag(information)), state.copy()
            moved[active] -= np.linalg.solve(damped, gradient)
            ahead = moved - first
            gained = cost - lens.cost(moved, textures) - ahead @ prior @ ahead
            if gained > 0:
                state, damping = moved, damping / 10
                break
            damping *= 10
        if number > _FIRST_ROUNDS and gained < _ENOUGH * count:
            break
    return lens.camera_of(state)


@dataclasses.dataclass(frozen=True, eq=False)
class _Lens:
    """The likelihood of windows seen through a lens with a state."""

    camera: Camera
    corner: float
    counts: DoubleArray  # multiplicity of the frequencies that count [K]

    def camera_of(self, state: DoubleArray) -> Camera:
        """Return the camera with the lens of a state."""
        wavefront, camera = self._wavefront(state), self.camera
        tangents = np.linspace(0, self.corner, 32)[1:]
        missing = [-wavefront.defocus(camera.mask, tangent) for tangent in tangents]
        bends = np.stack([tangents**2, tangents**4], axis=1)
        second, fourth = np.linalg.lstsq(bends, np.array(missing), rcond=None)[0]
        return dataclasses.replace(
            camera,
            mask_extent_mm=round(camera.mask_extent_mm * float(state[0]), 4),
            field_curvature=FieldCurvature(round(float(second), 4), round(float(fourth), 4)),
            wavefront=wavefront,
        )

    def textures(self, state: DoubleArray, windows: _Windows) -> _Textures:
        """Sort windows by the contrast and slope that explain them best."""
        contrasts = np.array(_PRIOR.contrasts)
        variance = contrasts[:, None, None] * self._expected(state, windows) + windows.noise
        variance = variance.reshape(-1, len(self.counts))
        costs = windows.powers @ (self.counts / variance).T + np.log(variance) @ self.counts
        found, which = np.unique(costs.argmin(axis=1), return_inverse=True)
        member = which == np.arange(len(found))[:, None]
        return _Textures(
            windows,
            found % len(_PRIOR.slopes),
            contrasts[found // len(_PRIOR.slopes), None],
            member.sum(axis=1, keepdims=True).astype(np.float64),
            member @ windows.powers,
        )

    def cost(self, state: DoubleArray, textures: list[_Textures]) -> float:
        """Twice the negative log-likelihood; infinite where no lens is like that."""
        try:
            return sum(self._cost(each, self._variance(state, each)) for each in textures)
        except InputError:
            return np.inf

    def derivatives(
        self, state: DoubleArray, textures: list[_Textures], active: IndexArray
    ) -> tuple[float, DoubleArray, DoubleArray]:
        """Return the cost, half its gradient, and half of what its curvature is expected to be.

        By the `active` parts of the state.
        """
        total, gradient = 0.0, np.zeros(len(active))
        information = np.zeros((len(active), len(active)))
        steps = np.diag(_STEPS)[active]

        def changes(each: _Textures) -> tuple[DoubleArray, DoubleArray]:
            moved = [
                self._variance(state + step, each) - self._variance(state - step, each)
                for step in steps
            ]
            return self._variance(state, each), np.array(moved) / 2 / _STEPS[active, None, None]

        with ThreadPoolExecutor(thread_count(0)) as pool:
            for each, (variance, slopes) in zip(textures, pool.map(changes, textures), strict=True):
                total += self._cost(each, variance)
                slopes /= variance
                weights = self.counts * each.counts
                excess = weights - self.counts * each.power / variance
                gradient += np.sum(slopes * excess, axis=(1, 2)) / 2
                information += np.einsum("itk,tk,jtk->ij", slopes, weights, slopes, optimize=True)
        return total, gradient, information / 2

    def _cost(self, textures: _Textures, variance: DoubleArray) -> float:
        terms = textures.power / variance + textures.counts * np.log(variance)
        return float(np.sum(terms @ self.counts))

    def _variance(self, state: DoubleArray, textures: _Textures) -> DoubleArray:
        expected = self._expected(state, textures.windows)[textures.slopes]
        return textures.contrasts * expected + textures.windows.noise

    def _expected(self, state: DoubleArray, windows: _Windows) -> DoubleArray:
        """Return the power of unit texture [slopes, K]."""
        size_px = windows.blur_size_px
        psf = self._wavefront(state).psf(
            self.camera.mask,
            size_px * state[0],
            self.camera.blur_per_dioptre_px,
            windows.tangent,
            psf_width(size_px) + 2 * _WIDER_PX,
        )
        powers = np.array([_FOURIER.expected_power(psf, slope, 2) for slope in _PRIOR.slopes])
        return powers[:, _COUNTED] + _PRIOR.model_error**2

    def _wavefront(self, state: DoubleArray) -> Wavefront:
        values = state.round(5).tolist()
        return Wavefront(self.corner, tuple(values[5:]), tuple(values[1:5]))


def _windows(camera: Camera, planes: Planes, used: Sequence[int]) -> Iterator[_Windows]:
    """Yield the windows of some planes and all parts of the image."""
    parts = parts_of_field(camera.intrinsics, ROWS, COLUMNS)
    chosen = np.unique(np.linspace(0, len(used) - 1, _MOST_PLANES).round().astype(int))
    for index in np.array(used)[chosen]:
        grey, _ = grey_image(planes.images[index], 1.0)
        power, grid = _FOURIER.power(grey, _STRIDE_PX)
        noise = max(float(np.quantile(power @ _FOURIER.noise_weights, 0.05)), 1e-9)
        places = places_of(grid, camera.intrinsics)
        part = nearest_part(places, parts)
        for inside in (part == number for number in np.unique(part)):
            size_px = float(camera.blur_size_px(planes.depths_m[index]))
            seen = power[inside][:, _COUNTED].astype(np.float64)
            yield _Windows(size_px, places[inside].mean(axis=0), seen, noise)
