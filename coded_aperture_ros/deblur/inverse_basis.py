"""Regularised inverses of all levels' PSFs, in one common basis."""

import dataclasses

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, Shape
from coded_aperture_ros.frames import transfer_function
from coded_aperture_ros.likelihood.bank import image_prior
from coded_aperture_ros.optics import PsfStack

# Model errors whose inverse filters span those of all in between.
MODEL_ERRORS = np.array([0.06, 0.1, 0.3])
_ROWS_PER_BATCH = 16
# A basis filter with less than this share of the power of the strongest one is rounding error.
_MIN_POWER_SHARE = 1e-8


def wiener_filters(
    transfer: NDArray[np.complex64], prior: FloatArray, model_errors: DoubleArray, noise: float
) -> NDArray[np.complex64]:
    """Transforms of the inverse filters of one or more PSFs, complex64 [..., E, rows, columns].

    ``K = conj(H) S / ((|H|^2 + e^2) S + s^2)``, scaled by ``1 + e^2`` so that flat areas keep their
    brightness. It minimises thesis eq. 6.27 for one plane, with the power spectrum ``S`` of natural
    images as the prior and noise ``s``. The model error ``e`` stands for the error of the
    assumption of one plane, as a fraction of the texture at every frequency; it bounds the gain
    where the PSF passes little.

    `transfer` has the transforms ``H`` [..., rows, columns], `prior` is ``S`` [rows, columns], see
    `image_prior`; there are E `model_errors`.
    """
    transfer = transfer[..., None, :, :]
    error = (model_errors**2).astype(np.float32)[:, None, None]
    passed = transfer.real**2 + transfer.imag**2
    gain = prior * (1 + error) / ((passed + error) * prior + np.float32(noise**2))
    return gain * np.conj(transfer)


@dataclasses.dataclass(frozen=True, eq=False)
class InverseBasis:
    """Filters whose combinations are the inverse filters of all levels."""

    stack: PsfStack
    # Each is the sum, with these weights [L, G, R], of the inverse filters of all levels for each
    # of the G `MODEL_ERRORS`, at the noise that the basis is best for.
    generators: FloatArray
    noise: float
    # They are orthogonal at a coarse sampling of the frequencies [R, n], times how much of each
    # there is in blurred photographs [n].
    coarse: NDArray[np.complex64]
    coarse_weight: FloatArray

    @classmethod
    def learn(cls, stack: PsfStack, noise: float, rank: int) -> "InverseBasis":
        """Basis of the inverse filters of a PSF stack, of a given rank.

        The factorisation is best for blurred photographs: each frequency is weighted by its share
        in them. Filters that resemble each other need, and get, a smaller rank.
        """
        prior, transfers = _coarse_model(stack)
        weight = np.sqrt(prior * np.mean(np.abs(transfers) ** 2, axis=0) + noise**2)
        weight = weight.ravel().astype(np.float32)
        filters = wiener_filters(transfers, prior, MODEL_ERRORS, noise)
        filters = filters.reshape(-1, weight.size) * weight
        # There are far fewer filters than frequencies: decompose the small Gram matrix.
        rows = filters.view(np.float32)
        powers, vectors = np.linalg.eigh(rows.astype(np.float64) @ rows.T)
        rank = min(rank, int(np.sum(powers > _MIN_POWER_SHARE * powers[-1])))
        leading = vectors[:, ::-1][:, :rank].astype(np.float32)
        generators = leading.reshape(len(stack), len(MODEL_ERRORS), -1)
        return cls(stack, generators, noise, leading.T @ filters, weight)

    def transforms(self, shape: Shape) -> NDArray[np.complex64]:
        """Transforms [R, rows, columns // 2 + 1] of the basis for images of `shape`."""
        prior = image_prior(shape)
        transfers = np.array([transfer_function(psf, shape) for psf in self.stack.psfs])
        weights = self.generators.reshape(-1, self.generators.shape[-1]).T
        basis = np.empty((len(weights), *prior.shape), np.complex64)
        # Some rows at a time: the inverse filters of all levels would fill the memory.
        for start in range(0, shape[0], _ROWS_PER_BATCH):
            rows = slice(start, start + _ROWS_PER_BATCH)
            filters = wiener_filters(transfers[:, rows], prior[rows], MODEL_ERRORS, self.noise)
            flat = filters.reshape(weights.shape[1], -1).view(np.float32)
            basis[:, rows] = (weights @ flat).view(np.complex64).reshape(basis[:, rows].shape)
        return basis

    def coefficients(self, model_errors: DoubleArray, noise: float) -> FloatArray:
        """Combinations [L, E, R] nearest to the inverse filters.

        They are scaled so that flat areas keep their brightness exactly.
        """
        prior, transfers = _coarse_model(self.stack)
        wanted = wiener_filters(transfers, prior, model_errors, noise)
        wanted = wanted.reshape(*wanted.shape[:2], -1) * self.coarse_weight
        power = np.sum(np.abs(self.coarse) ** 2, axis=1)
        coefficients = (wanted @ self.coarse.conj().T).real / power
        flat = coefficients @ (self.coarse[:, 0].real / self.coarse_weight[0])
        return (coefficients / flat[..., None]).astype(np.float32)


def _coarse_model(stack: PsfStack) -> tuple[FloatArray, NDArray[np.complex64]]:
    # Which filters resemble each other shows at a coarse sampling of the frequencies already.
    side = scipy.fft.next_fast_len(max(96, 4 * stack.psfs.shape[-1]), real=True)
    transfers = [transfer_function(psf, (side, side)) for psf in stack.psfs]
    return image_prior((side, side)), np.array(transfers)
