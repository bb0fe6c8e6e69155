"""What patches look like under every hypothesis: kind of texture, level, contrast over noise."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis

# Contrast over noise variance: contrasts of 1e-5 to 0.1 under noise of 0.0002 to 0.01.
RATIOS = 10.0 ** (np.arange(-2, 14) / 2)


@dataclasses.dataclass(frozen=True, eq=False)
class Hypotheses:
    """Filters for the power of a patch; see `FilterBank`.

    Attributes
    ----------
    weights : ndarray, float64 [S, kinds * L, K]
        ``m / V``.
    scales : ndarray, float64 [S, K]
        The typical power of every frequency; 1 where none counts.
    log_determinants : ndarray, float64 [S, kinds, L]
        ``sum_k m_k log V_k``.
    """

    weights: DoubleArray
    scales: DoubleArray
    log_determinants: DoubleArray

    @classmethod
    def of(
        cls,
        fourier: WindowedFourierBasis,
        of_levels: FloatArray,
        textures: Sequence[Callable[[tuple[int, int]], DoubleArray]],
        model_error: float,
        progress: Progress = iter,
    ) -> "Hypotheses":
        """Compute them for PSFs [L, R, k, k], whose R parts add up, and kinds of texture."""
        expected = np.array(
            [
                [sum(fourier.expected_power(psf, texture) for psf in psfs) for texture in textures]
                for psfs in progress(of_levels)
            ]
        )  # [L, kinds, K]
        expected = expected.transpose(1, 0, 2) + model_error**2
        variances = RATIOS[:, None, None, None] * expected + 1  # [S, kinds, L, K]
        log_variances = np.log(variances)
        multiplicity = fourier.multiplicity.astype(np.float64)
        all_of_them = (len(RATIOS), -1, fourier.size)
        scales = np.exp(log_variances.reshape(all_of_them).mean(axis=1))
        scales[:, multiplicity == 0] = 1  # these have no weight at any level
        weights = (multiplicity / variances).reshape(all_of_them)
        return cls(weights, scales, log_variances @ multiplicity)
