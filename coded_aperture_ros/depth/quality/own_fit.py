"""Health by a bank's own coefficients, for PSFs that the network of the check was not fitted to."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.quality.health import outputs_of
from coded_aperture_ros.depth.quality.spectra import NAMES


def fit_terms(features: FloatArray) -> FloatArray:
    """Terms of the own check [k]: the networks' mean output, and the gains of the alternatives."""
    return np.concatenate([outputs_of(features), features[: len(NAMES)]])


class OwnFit:
    """Output of the networks, but for health that of a logistic regression.

    Parameters
    ----------
    coefficients : tuple of float
        Of 1 and the `fit_terms`.
    """

    def __init__(self, coefficients: tuple[float, ...]) -> None:
        self._constant, *slopes = coefficients
        self._slopes = np.array(slopes)

    def __call__(self, features: FloatArray) -> FloatArray:
        """Logits of health, then of the causes; see `outputs_of`."""
        terms = fit_terms(features)
        outputs = terms[: -len(NAMES)].copy()
        outputs[0] = self._constant + terms @ self._slopes
        return outputs
