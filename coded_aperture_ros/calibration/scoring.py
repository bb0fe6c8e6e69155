"""Likelihood of the power spectra of windows for a PSF with unknown parameters."""

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.prior import NaturalImagePrior

FOURIER = WindowedFourierBasis(48, 0.46)
_PRIOR = NaturalImagePrior()
_COUNTED = FOURIER.multiplicity > 0
_COUNTS = FOURIER.multiplicity[_COUNTED].astype(np.float64)
_CONTRASTS = np.array(_PRIOR.contrasts)
_MAX_DAMPING = 1e4
_MIN_GAIN = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class Windows:
    """Windows that share their PSF."""

    blur_size_px: float  # by the camera as it was
    tangent: DoubleArray  # [2]; where they are
    powers: DoubleArray  # [n, K]; of the frequencies that count
    noise: float  # variance


@dataclasses.dataclass(frozen=True, eq=False)
class Textures:
    """Windows that share a PSF, sorted by the texture that explains them best."""

    windows: Windows
    slopes: IndexArray  # [T]; which of the prior's
    contrasts: DoubleArray  # [T, 1]
    counts: DoubleArray  # [T, 1]; how many windows
    power: DoubleArray  # [T, K]; their sum


def window_spectra(grey: FloatArray, stride_px: int) -> tuple[DoubleArray, float, IndexArray]:
    """Power of the windows of an image [n, K], the variance of its noise, and their middles [n, 2].

    The middles are rows and columns, in px.
    """
    power, grid = FOURIER.power(grey, stride_px)
    noise = max(float(np.quantile(power @ FOURIER.noise_weights, 0.05)), 1e-9)
    middles = np.stack(np.meshgrid(grid.row_centres, grid.column_centres, indexing="ij"), axis=-1)
    counted = power.reshape(-1, power.shape[-1])[:, _COUNTED].astype(np.float64)
    return counted, noise, middles.reshape(-1, 2)


def saturated_cost(powers: DoubleArray) -> DoubleArray:
    """Cost (see `Scoring.costs`) of windows [n, K] whose power is exactly as expected [n]."""
    return np.asarray((1 + np.log(np.maximum(powers, 1e-30))) @ _COUNTS)


@dataclasses.dataclass(frozen=True, eq=False)
class Scoring:
    """Fisher scoring of the likelihood of windows' spectra, for textures as those of a bank.

    `psf` returns the PSF of some windows for a state, or raises `InputError` if there is none;
    derivatives are differences over `steps`.
    """

    psf: Callable[[DoubleArray, Windows], FloatArray]
    steps: DoubleArray

    def fit(
        self,
        first: DoubleArray,
        windows: list[Windows],
        spread: DoubleArray,
        active: Callable[[int], IndexArray],
        rounds: int,
        progress: Progress,
        begin: DoubleArray | None = None,
    ) -> tuple[DoubleArray, DoubleArray]:
        """Most likely state, and its covariance.

        Parameters
        ----------
        first : ndarray [S]
            State of the prior.
        windows : list of Windows
        spread : ndarray [S]
            Standard deviation of the prior, for a single window.
        active : callable
            Indices of the parameters that a round moves.
        rounds : int
            Largest number of rounds.
        progress : callable
            Wraps the rounds.
        begin : ndarray [S], optional
            State to begin from; by default `first`.
        """
        count = sum(len(each.powers) for each in windows)
        prior = count * np.diag(spread**-2)
        state = first if begin is None else begin
        damping = 1e-2
        information = prior
        for number in progress(range(rounds)):
            moving = active(number)
            textures = [self.textures(state, each) for each in windows]
            cost, gradient, information = self.derivatives(state, textures, moving)
            cost += float((state - first) @ prior @ (state - first))
            gradient += (prior @ (state - first))[moving]
            information += prior[np.ix_(moving, moving)]
            gained = 0.0
            while damping < _MAX_DAMPING:
                damped = information + damping * np.diag(np.diag(information))
                moved = state.copy()
                moved[moving] -= np.linalg.solve(damped, gradient)
                ahead = moved - first
                gained = cost - self.cost(moved, textures) - float(ahead @ prior @ ahead)
                if gained > 0:
                    state = moved
                    damping = damping / 10
                    break
                damping *= 10
            if len(moving) == len(first) and gained < _MIN_GAIN * count:
                break
        return state, np.asarray(np.linalg.inv(information))

    def textures(self, state: DoubleArray, windows: Windows) -> Textures:
        """Windows sorted by the contrast and slope that explain them best."""
        costs = self.costs(state, windows)
        found, which = np.unique(costs.argmin(axis=1), return_inverse=True)
        member = which == np.arange(len(found))[:, None]
        return Textures(
            windows,
            found % len(_PRIOR.slopes),
            _CONTRASTS[found // len(_PRIOR.slopes), None],
            member.sum(axis=1, keepdims=True).astype(np.float64),
            member @ windows.powers,
        )

    def costs(self, state: DoubleArray, windows: Windows) -> DoubleArray:
        """Twice the negative log-likelihood of windows by texture [n, T]."""
        variance = _CONTRASTS[:, None, None] * self._expected(state, windows) + windows.noise
        variance = variance.reshape(-1, len(_COUNTS))
        return windows.powers @ (_COUNTS / variance).T + np.log(variance) @ _COUNTS

    def cost(self, state: DoubleArray, textures: list[Textures]) -> float:
        """Twice the negative log-likelihood; infinite for an impossible lens."""
        try:
            return sum(self._cost(each, self._variance(state, each)) for each in textures)
        except InputError:
            return np.inf

    def derivatives(
        self, state: DoubleArray, textures: list[Textures], active: IndexArray
    ) -> tuple[float, DoubleArray, DoubleArray]:
        """Cost, half its gradient, and half its expected curvature, by the `active` parameters."""
        total = 0.0
        gradient = np.zeros(len(active))
        information = np.zeros((len(active), len(active)))
        steps = np.diag(self.steps)[active]

        def changes(each: Textures) -> tuple[DoubleArray, DoubleArray]:
            moved = [
                self._variance(state + step, each) - self._variance(state - step, each)
                for step in steps
            ]
            return self._variance(state, each), np.array(moved) / 2 / self.steps[active, None, None]

        with ThreadPoolExecutor(thread_count(0)) as pool:
            for each, (variance, slopes) in zip(textures, pool.map(changes, textures), strict=True):
                total += self._cost(each, variance)
                slopes /= variance
                weights = _COUNTS * each.counts
                excess = weights - _COUNTS * each.power / variance
                gradient += np.sum(slopes * excess, axis=(1, 2)) / 2
                information += np.einsum("itk,tk,jtk->ij", slopes, weights, slopes, optimize=True)
        return total, gradient, information / 2

    def _cost(self, textures: Textures, variance: DoubleArray) -> float:
        terms = textures.power / variance + textures.counts * np.log(variance)
        return float(np.sum(terms @ _COUNTS))

    def _variance(self, state: DoubleArray, textures: Textures) -> DoubleArray:
        expected = self._expected(state, textures.windows)[textures.slopes]
        return textures.contrasts * expected + textures.windows.noise

    def _expected(self, state: DoubleArray, windows: Windows) -> DoubleArray:
        """Power of unit texture [slopes, K]."""
        psf = self.psf(state, windows)
        powers = np.array([FOURIER.expected_power(psf, slope, 2) for slope in _PRIOR.slopes])
        return powers[:, _COUNTED] + _PRIOR.model_error**2
