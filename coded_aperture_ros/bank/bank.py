"""The filter bank: energies of every blur level for every patch of a frame."""

import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.bank.prior import NaturalImagePrior
from coded_aperture_ros.optics import PsfStack


@dataclasses.dataclass(frozen=True)
class FilterBank:
    """Everything that depth estimation needs to know about a mask and its blur sizes.

    For a patch with power spectrum ``P`` and noise of standard deviation ``s`` the energy of
    blur level ``d`` is twice the negative log-likelihood of a Gaussian texture seen through
    that level's PSF, minimised over the texture's contrast ``a`` and slope::

        E_d = min_a,slope  sum_k m_k [ (P_k / s^2) / V_k + log V_k ]
        V_k = (a / s^2) (C_k + e^2) + 1

    with the expected power ``C_k`` of unit-contrast texture at level ``d``, the multiplicity
    ``m_k`` and the model error ``e``. This is the noise-aware form of the distance to the
    subspace of thesis eq. 6.22, to which it tends without noise. Only the ratio
    ``a / s^2`` enters the weights, so one bank serves every noise level: the noise scales the
    spectrum, and selects which ratios are plausible.

    The weights ``m / V`` of all hypotheses share one basis (thesis 8.3.1).

    Attributes
    ----------
    stack : PsfStack
        The L levels: blur sizes in px (or indices) and PSFs.
    window_px : int
        Side of the patches.
    prior : NaturalImagePrior
        Hypotheses for sharp texture.
    ratios : ndarray, float64 [S]
        Grid of contrast over noise variance, in half decades.
    basis : ndarray, float32 [K, R]
        Common basis of the weights.
    coefficients : ndarray, float32 [R, S, slopes, L]
        Weights in that basis.
    log_determinants : ndarray, float32 [S, slopes, L]
        ``sum_k m_k log V_k``.
    truncation_error : float
        Relative root-mean-square error of the weights at this rank.
    noise : float
        Standard deviation of the camera's noise; 0 if it has to be estimated in every frame.
    learned_from : str
        How the bank came to be, for a person to read.
    """

    stack: PsfStack
    window_px: int
    prior: NaturalImagePrior
    ratios: NDArray[np.float64]
    basis: NDArray[np.float32]
    coefficients: NDArray[np.float32]
    log_determinants: NDArray[np.float32]
    truncation_error: float
    noise: float
    learned_from: str

    @property
    def blur_sizes_px(self) -> NDArray[np.float64]:
        """Signed blur size of every level [L], px."""
        return self.stack.blur_sizes_px

    @property
    def levels(self) -> int:
        """Number L of levels."""
        return len(self.stack.blur_sizes_px)

    @cached_property
    def fourier(self) -> WindowedFourierBasis:
        """The transform that the bank's filters act on."""
        return WindowedFourierBasis(self.window_px)

    @property
    def noise_range(self) -> tuple[float, float]:
        """Noise (standard deviation) for which every contrast hypothesis is in the bank."""
        contrasts = self.prior.contrasts
        return (
            float(np.sqrt(max(contrasts) / self.ratios[-1])),
            float(np.sqrt(min(contrasts) / self.ratios[0])),
        )

    def energies(self, power: NDArray[np.float32], noise: float) -> NDArray[np.float32]:
        """Return the energy of every level for every patch.

        Parameters
        ----------
        power : ndarray, float32 [rows, columns, K]
            Power spectra, from ``bank.fourier.power``.
        noise : float
            Standard deviation of the frame's noise, linear light, > 0.

        Returns
        -------
        ndarray, float32 [rows, columns, L]
            Lower is likelier. A patch that is better explained by noise alone than by any
            texture has the same energy at every level.
        """
        plausible = self._plausible_ratios(noise)
        coefficients = self.coefficients[:, plausible].reshape(self.basis.shape[1], -1)
        log_determinants = self.log_determinants[plausible].reshape(-1)
        spread = (-1, self.levels)
        energies = np.empty((*power.shape[:2], self.levels), np.float32)
        # A row of patches at a time keeps the hypotheses in the processor's cache.
        for row, spectra in enumerate(power):
            spectra = spectra / np.float32(noise**2)
            hypotheses = (spectra @ self.basis) @ coefficients + log_determinants
            textured = hypotheses.reshape(len(spectra), *spread).min(axis=1)
            textureless = spectra @ self.fourier.multiplicity
            np.minimum(textured, textureless[:, None], out=energies[row])
        return energies

    def _plausible_ratios(self, noise: float) -> slice:
        count = len(self.prior.contrasts)
        wanted = min(self.prior.contrasts) / noise**2
        first = int(np.argmin(np.abs(np.log(self.ratios / wanted))))
        first = min(first, len(self.ratios) - count)
        return slice(first, first + count)
