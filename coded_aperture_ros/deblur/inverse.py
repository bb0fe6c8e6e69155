"""The regularised inverses of all levels' PSFs, in one common basis."""

import dataclasses

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.bank import power_spectrum
from coded_aperture_ros.optics import PsfStack

# Power spectrum of photographs in linear light: fall-off and contrast (variance).
_SLOPE = 2.4
_CONTRAST = 0.02


def transfer_function(psf: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.complex64]:
    """Return the transform of a centred PSF for images of `shape`, as by ``scipy.fft.rfft2``."""
    width = len(psf)
    padded = np.zeros(shape, np.float32)
    padded[:width, :width] = psf
    return scipy.fft.rfft2(np.roll(padded, (-(width // 2), -(width // 2)), axis=(0, 1)))


def image_prior(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return the power spectrum of photographs of `shape`, as by ``scipy.fft.rfft2``."""
    return (_CONTRAST * power_spectrum(_SLOPE, shape)).astype(np.float32)


def wiener_filters(
    transfer: NDArray[np.complex64],
    prior: NDArray[np.float32],
    model_errors: NDArray[np.float64],
    noise: float,
) -> NDArray[np.complex64]:
    """Return the transforms of the inverse filters of one level.

    ``K = conj(H) S / ((|H|^2 + e^2) S + s^2)``, scaled by ``1 + e^2`` so that flat areas keep
    their brightness. It minimises thesis eq. 6.27 for one plane, with the power spectrum ``S`` of
    natural images as the prior and noise ``s``. The model error ``e`` stands for what the
    assumption of one plane leaves unexplained, as a fraction of the texture at every frequency;
    it bounds the gain where the PSF passes little.

    Parameters
    ----------
    transfer : ndarray, complex64 [rows, columns]
        Transform ``H`` of the level's PSF.
    prior : ndarray, float32 [rows, columns]
        ``S``, see `image_prior`.
    model_errors : ndarray, float64 [E]
    noise : float
        Standard deviation, > 0.

    Returns
    -------
    ndarray, complex64 [E, rows, columns]
    """
    error = (model_errors**2).astype(np.float32)[:, None, None]
    passed = transfer.real**2 + transfer.imag**2
    gain = prior * (1 + error) / ((passed + error) * prior + np.float32(noise**2))
    return gain * np.conj(transfer)


@dataclasses.dataclass(frozen=True, eq=False)
class InverseBasis:
    """A few filters whose combinations give the inverse filters of all levels.

    Attributes
    ----------
    stack : PsfStack
        L levels.
    model_errors : ndarray, float64 [E]
    noise : float
    combinations : ndarray, float32 [L, E, R]
        Orthonormal over levels and model errors: basis filter r is the sum of all inverse filters
        with these weights, and an inverse filter is the sum of all basis filters with the same.
    """

    stack: PsfStack
    model_errors: NDArray[np.float64]
    noise: float
    combinations: NDArray[np.float32]

    @classmethod
    def learn(
        cls, stack: PsfStack, model_errors: NDArray[np.float64], noise: float, rank: int
    ) -> "InverseBasis":
        """Factor the inverse filters of a PSF stack at a given rank.

        The factorisation is best for blurred natural images: each frequency counts as much as
        there is of it in them.
        """
        # Which filters resemble each other shows at a coarse sampling of the frequencies already.
        side = scipy.fft.next_fast_len(max(96, 4 * stack.psfs.shape[-1]), real=True)
        prior = image_prior((side, side))
        transfers = np.array([transfer_function(psf, (side, side)) for psf in stack.psfs])
        filters = np.array([wiener_filters(h, prior, model_errors, noise) for h in transfers])
        weight = np.sqrt(prior * np.mean(np.abs(transfers) ** 2, axis=0) + noise**2)
        rows = (filters * weight.astype(np.float32)).reshape(-1, weight.size).view(np.float32)
        # There are far fewer filters than frequencies: decompose the small Gram matrix.
        _, vectors = np.linalg.eigh(rows.astype(np.float64) @ rows.T)
        leading = vectors[:, ::-1][:, :rank].astype(np.float32)
        return cls(stack, model_errors, noise, leading.reshape(*filters.shape[:2], -1))

    def transforms(self, shape: tuple[int, int]) -> NDArray[np.complex64]:
        """Return the transforms of the basis filters for images of `shape`.

        Returns
        -------
        ndarray, complex64 [R, rows, columns // 2 + 1]
        """
        rank = self.combinations.shape[-1]
        basis = np.zeros((rank, shape[0] * (shape[1] // 2 + 1)), np.complex64)
        prior = image_prior(shape)
        for psf, combination in zip(self.stack.psfs, self.combinations, strict=True):
            transfer = transfer_function(psf, shape)
            filters = wiener_filters(transfer, prior, self.model_errors, self.noise)
            basis += combination.T @ filters.reshape(len(filters), -1)
        return basis.reshape(rank, shape[0], -1)
