"""Prior of textures for PSFs that were measured, and so have errors of their own."""

import dataclasses

from coded_aperture_ros.likelihood.bank.prior import NaturalImagePrior

# Error of measured PSFs, and contrasts of print, whose fine texture is that of a larger variance.
_MODEL_ERROR = 5e-3
_PRINT_CONTRASTS = (10.0**-0.5, 1.0)


def prior_for_measured_psfs(prior: NaturalImagePrior) -> NaturalImagePrior:
    """The same textures, with the model error of measured PSFs, and the contrasts of print.

    With much light for the noise, errors of the PSFs decide: on a real photograph at 47 dB its own
    PSF is chosen at 75 to 100 % of the positions with the model error of masks, by what noise is
    stated, and at 99.7 % or more with this one.

    Examples
    --------
    >>> prior_for_measured_psfs(NaturalImagePrior()).model_error
    0.005
    """
    last = prior.contrasts[-1]
    more = [contrast for contrast in _PRINT_CONTRASTS if contrast > 1.01 * last]
    return dataclasses.replace(
        prior, model_error=max(prior.model_error, _MODEL_ERROR), contrasts=(*prior.contrasts, *more)
    )
