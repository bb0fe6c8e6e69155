"""Health by a bank's own coefficients, for PSFs that the network of the check was not fitted to."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.quality.causes import CAUSES
from coded_aperture_ros.depth.quality.health import TRUSTED, outputs_of
from coded_aperture_ros.depth.quality.spectra import NAMES

# Alternatives whose gain is limited to what fitting frames show, and how the logit of health falls
# above that: to one half at 0.3 hundredths of the negative log-likelihood above it.
_LIMITED = ("rot90", "mirror")
_TRUSTED_LOGIT = float(np.log(TRUSTED / (1 - TRUSTED)))
_SLOPE = _TRUSTED_LOGIT / 0.3
_TERMS = 2 + len(CAUSES) + len(NAMES)  # with the constant
_TURNED = 1 + list(CAUSES).index("turned")


def fit_terms(features: FloatArray) -> FloatArray:
    """Terms of the own check [k]: the networks' mean output, and the gains of the alternatives."""
    return np.concatenate([outputs_of(features), features[: len(NAMES)]])


def turned_gains(terms: FloatArray) -> FloatArray:
    """Gains [..., 2] of the PSFs turned and mirrored, of `fit_terms` [..., k]."""
    return terms[..., [NAMES.index(name) - len(NAMES) for name in _LIMITED]]


class OwnFit:
    """Output of the networks, but for health that of a logistic regression.

    Health is less where the PSFs turned or mirrored explain a frame better than those of the bank,
    by more than fitting frames show.

    Parameters
    ----------
    coefficients : tuple of float
        Of 1 and the `fit_terms`; then the largest `turned_gains` of fitting frames, which banks of
        earlier releases lack.
    """

    def __init__(self, coefficients: tuple[float, ...]) -> None:
        self._constant, *slopes = coefficients[:_TERMS]
        self._slopes, self._limits = np.array(slopes), np.array(coefficients[_TERMS:])

    def __call__(self, features: FloatArray) -> FloatArray:
        """Logits of health, then of the causes; see `outputs_of`."""
        terms = fit_terms(features)
        outputs = terms[: -len(NAMES)].copy()
        outputs[0] = self._constant + terms @ self._slopes
        if self._limits.size:
            above = float((turned_gains(terms) - self._limits).max())
            most = _TRUSTED_LOGIT - _SLOPE * above
            if above > 0 and most < outputs[0]:
                outputs[0], outputs[_TURNED] = most, outputs[1:].max() + 1
        return outputs
