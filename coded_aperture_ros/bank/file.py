"""Filter banks on disk: one `.npz` of plain arrays."""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank.empirical import EmpiricalPrior
from coded_aperture_ros.bank.learning import check_levels
from coded_aperture_ros.bank.model import DEFAULT_STRIDE_PX, FilterBank
from coded_aperture_ros.bank.pattern import LearnedPattern
from coded_aperture_ros.bank.prior import NaturalImagePrior
from coded_aperture_ros.core.archive import read_archive, write_archive
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask, PsfStack

SCHEMA = "coded-aperture filter bank"
# Version 2 may leave out high frequencies, and knows its stride.
VERSION = 2


def save_bank(bank: FilterBank, path: str | os.PathLike[str]) -> None:
    """Write a filter bank; the file appears whole or not at all.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    arrays = {
        "blur_sizes_px": bank.stack.blur_sizes_px,
        "psfs": bank.stack.psfs,
        "window_px": bank.window_px,
        "prior_slopes": bank.prior.slopes,
        "prior_contrasts": bank.prior.contrasts,
        "prior_model_error": bank.prior.model_error,
        "noise_range": bank.noise_range,
        "ratios": bank.ratios,
        "basis": bank.basis,
        "coefficients": bank.coefficients,
        "log_determinants": bank.log_determinants,
        "truncation_error": bank.truncation_error,
        "noise": bank.noise,
        "mask_digest": bank.mask_digest,
        "learned_from": bank.learned_from,
        "highest_frequency": bank.highest_frequency,
        "stride_px": bank.stride_px,
        "level_error": bank.level_error,
    }
    if not bank.stack.in_pixels:
        arrays["blur_sizes_are_indices"] = True
    if bank.stack.depths_m is not None:
        arrays["depths_m"] = bank.stack.depths_m
    if isinstance(bank.prior, EmpiricalPrior):
        arrays["prior_deviations"] = bank.prior.deviations
    if bank.pattern is not None:
        arrays |= _pattern_arrays(bank.pattern)
    write_archive(path, SCHEMA, VERSION, arrays)


def load_bank(path: str | os.PathLike[str]) -> FilterBank:
    """Read a filter bank written by `save_bank`.

    Raises
    ------
    InputError
        Naming the file, if it is missing, truncated, of another kind, of a newer version, or
        inconsistent in itself.
    """
    arrays = read_archive(path, SCHEMA, VERSION)
    try:
        bank = FilterBank(
            stack=PsfStack(
                arrays["blur_sizes_px"],
                arrays["psfs"],
                arrays.get("depths_m"),
                in_pixels="blur_sizes_are_indices" not in arrays,
            ),
            window_px=int(arrays["window_px"]),
            prior=_prior(arrays),
            ratios=arrays["ratios"],
            basis=arrays["basis"],
            coefficients=arrays["coefficients"],
            log_determinants=arrays["log_determinants"],
            truncation_error=float(arrays["truncation_error"]),
            noise=float(arrays["noise"]),
            mask_digest=str(arrays["mask_digest"]),
            learned_from=str(arrays["learned_from"]),
            highest_frequency=float(arrays.get("highest_frequency", 1.0)),
            stride_px=int(arrays.get("stride_px", DEFAULT_STRIDE_PX)),
            level_error=float(arrays.get("level_error", np.nan)),
            pattern=_pattern(arrays),
        )
        _check_shapes(bank)
    except KeyError as error:
        raise InputError(f"{path}: {SCHEMA} without {error.args[0]}: learn it again") from error
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{path}: damaged {SCHEMA}: {error}") from error
    return bank


def _pattern_arrays(pattern: LearnedPattern) -> dict[str, Any]:
    return {
        "pattern_mask": pattern.mask.transmission,
        "pattern_mask_name": pattern.mask.name,
        "pattern_parts": pattern.parts,
        "pattern_parts_extent": pattern.parts_extent,
        "pattern_slope_px_m": pattern.slope_px_m,
        "pattern_inverse_focus": pattern.inverse_focus,
        "pattern_image_width": pattern.image_width,
    }


def _pattern(arrays: dict[str, NDArray[Any]]) -> LearnedPattern | None:
    if "pattern_mask" not in arrays:  # not learned from planes, or by an older version
        return None
    return LearnedPattern(
        mask=Mask(str(arrays["pattern_mask_name"]), arrays["pattern_mask"]),
        parts=arrays["pattern_parts"],
        parts_extent=float(arrays["pattern_parts_extent"]),
        slope_px_m=float(arrays["pattern_slope_px_m"]),
        inverse_focus=float(arrays["pattern_inverse_focus"]),
        image_width=int(arrays["pattern_image_width"]),
    )


def _prior(arrays: dict[str, NDArray[Any]]) -> NaturalImagePrior:
    slopes = tuple(arrays["prior_slopes"].tolist())
    contrasts = tuple(arrays["prior_contrasts"].tolist())
    model_error = float(arrays["prior_model_error"])
    if "prior_deviations" not in arrays:
        return NaturalImagePrior(slopes, contrasts, model_error)
    deviations = tuple(tuple(row) for row in arrays["prior_deviations"].tolist())
    return EmpiricalPrior(slopes, contrasts, model_error, deviations)


def _check_shapes(bank: FilterBank) -> None:
    check_levels(bank.levels)
    if bank.ratios.ndim != 1 or len(bank.ratios) < len(bank.prior.contrasts):
        raise InputError(f"ratios: expected at least {len(bank.prior.contrasts)} in a row")
    if not (np.all(bank.ratios > 0) and 0 <= bank.noise < np.inf):
        raise InputError("ratios and noise: expected positive numbers")
    rank = bank.basis.shape[-1] if bank.basis.ndim else 0
    hypotheses = (len(bank.ratios), len(bank.prior.slopes), bank.levels)
    expected = {
        "basis": (bank.fourier.size, rank),
        "coefficients": (rank, *hypotheses),
        "log_determinants": hypotheses,
    }
    for name, shape in expected.items():
        array = getattr(bank, name)
        if array.shape != shape or not np.isfinite(array).all():
            raise InputError(f"{name}: expected finite values of shape {shape}, got {array.shape}")
