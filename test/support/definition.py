"""The energies of a filter bank by their definition: one after the other, in no hurry."""

import numpy as np

from coded_aperture_ros.likelihood.scoring import MIN_EXCESS, MIN_NOISE_SHARE, plausible_ratios


def energies_by_definition(bank, grey, stride_px, noise):
    """Return what `FilterBank.energies` should be [rows, columns, L]."""
    power, _ = bank.fourier.power(grey, stride_px)
    projected = power @ bank.functions_of_power
    tried = plausible_ratios(bank.ratios, bank.prior.contrasts, float(np.median(noise)))
    count = bank.fourier.multiplicity.sum()
    precision = 1 / (count * np.broadcast_to(np.square(noise), power.shape[:2])[..., None])
    excess = np.tensordot(projected[..., :-1] * precision, bank.coefficients[:, tried], axes=1)
    determinants = np.exp(bank.log_determinants[tried] / count)
    best = ((excess + MIN_NOISE_SHARE) * determinants).min(axis=(-3, -2))
    textureless = projected[..., -1:] * precision + MIN_NOISE_SHARE
    return (count * np.log(np.clip(best, MIN_EXCESS, textureless))).astype(np.float32)
