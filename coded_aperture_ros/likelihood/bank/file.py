"""Filter banks from disk: one `.npz` of plain arrays; `saving` writes it."""

import os
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.archive import read_archive
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank.empirical import EmpiricalPrior
from coded_aperture_ros.likelihood.bank.field import FieldFilters, FieldPsfs
from coded_aperture_ros.likelihood.bank.learning import with_channels
from coded_aperture_ros.likelihood.bank.model import (
    DEFAULT_STRIDE_PX,
    FilterBank,
    check_level_count,
)
from coded_aperture_ros.likelihood.bank.pattern import LearnedPattern
from coded_aperture_ros.likelihood.bank.prior import NaturalImagePrior
from coded_aperture_ros.optics import Intrinsics, Mask, PsfStack

SCHEMA = "coded-aperture filter bank"
# Version 2 may leave out high frequencies, and has a stride.
VERSION = 2

# Attributes that are stored under their own name, with the conversion on reading, and those that
# older banks lack, with their default.
STORED: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("ratios", "basis", "coefficients", "log_determinants"), np.asarray),
    **dict.fromkeys(("truncation_error", "noise"), float),
    **dict.fromkeys(("mask_digest", "learned_from"), str),
    "window_px": int,
}
NEWER: dict[str, tuple[Callable[[Any], Any], Any]] = {
    "highest_frequency": (float, 1.0),
    "stride_px": (int, DEFAULT_STRIDE_PX),
    "level_error": (float, np.nan),
    "image_width": (int, 0),
    "image_height": (int, 0),
    "setting_digest": (str, ""),
    **dict.fromkeys(
        ("reliability", "own_fit", "optics_limits"),
        (lambda values: tuple(np.asarray(values).tolist()), ()),
    ),
}
PATTERN: dict[str, Callable[[Any], Any]] = {
    "parts": np.asarray,
    **dict.fromkeys(("parts_extent", "slope_px_m", "inverse_focus"), float),
    "image_width": int,
}
FIELD = ("coefficients", "log_determinants")
# Of the names of the weights of a bank's own refinement.
REFINEMENT = "refinement_"
FRAMES = ("image_width", "image_height", "camera_matrix")
PRIOR = ("slopes", "contrasts", "model_error")


def load_bank(path: str | os.PathLike[str]) -> FilterBank:
    """Read a filter bank written by `save_bank`.

    Raises
    ------
    InputError
        Naming the file, if it is missing, truncated, of another kind, of a newer version, or
        inconsistent in itself.

    Examples
    --------
    >>> load_bank("missing.npz")
    Traceback (most recent call last):
    coded_aperture_ros.core.errors.InputError: ...
    """
    arrays = read_archive(path, SCHEMA, VERSION)
    try:
        bank = FilterBank(
            stack=PsfStack(
                arrays["blur_sizes_px"],
                arrays["psfs"],
                arrays.get("depths_m"),
                in_pixels="blur_sizes_are_indices" not in arrays,
                nominal="blur_sizes_are_nominal" in arrays,
                channel_psfs=arrays.get("channel_psfs"),
            ),
            prior=_prior(arrays),
            pattern=_pattern(arrays),
            field=_field(arrays),
            refinement={
                name.removeprefix(REFINEMENT): values
                for name, values in arrays.items()
                if name.startswith(REFINEMENT)
            }
            or None,
            **{name: read(arrays[name]) for name, read in STORED.items()},
            **{name: read(arrays.get(name, old)) for name, (read, old) in NEWER.items()},
        )
        _check_shapes(bank)
    except KeyError as error:
        raise InputError(f"{path}: {SCHEMA} without {error.args[0]}: learn it again") from error
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{path}: damaged {SCHEMA}: {error}") from error
    return with_channels(bank)


def _pattern(arrays: dict[str, NDArray[Any]]) -> LearnedPattern | None:
    if "pattern_mask" not in arrays:  # not learned from planes, or by an older version
        return None
    return LearnedPattern(
        mask=Mask(str(arrays["pattern_mask_name"]), arrays["pattern_mask"]),
        **{name: read(arrays[f"pattern_{name}"]) for name, read in PATTERN.items()},
    )


def _field(arrays: dict[str, NDArray[Any]]) -> FieldFilters | None:
    if "field_psfs" not in arrays:
        return None
    width, height, matrix = (arrays[f"field_{name}"] for name in FRAMES)
    frames = Intrinsics(int(width), int(height), tuple(matrix.tolist()))
    return FieldFilters(
        FieldPsfs(arrays["field_psfs"], arrays["field_tangents"], frames),
        **{name: arrays[f"field_{name}"] for name in FIELD},
    )


def _prior(arrays: dict[str, NDArray[Any]]) -> NaturalImagePrior:
    slopes, contrasts, model_error = (arrays[f"prior_{name}"].tolist() for name in PRIOR)
    if "prior_deviations" not in arrays:
        return NaturalImagePrior(tuple(slopes), tuple(contrasts), model_error)
    deviations = tuple(tuple(row) for row in arrays["prior_deviations"].tolist())
    return EmpiricalPrior(tuple(slopes), tuple(contrasts), model_error, deviations)


def _check_shapes(bank: FilterBank) -> None:
    check_level_count(bank.levels)
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
    arrays = {name: getattr(bank, name) for name in expected}
    if bank.field is not None:
        parts = len(bank.field.field.tangents)
        for name in FIELD:
            expected[f"field_{name}"] = (parts, *expected[name])
            arrays[f"field_{name}"] = getattr(bank.field, name)
    for name, shape in expected.items():
        array = arrays[name]
        if array.shape != shape or not np.isfinite(array).all():
            raise InputError(f"{name}: expected finite values of shape {shape}, got {array.shape}")
