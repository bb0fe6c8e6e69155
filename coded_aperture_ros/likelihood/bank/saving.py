"""Filter banks to disk; `file` reads them."""

import os

from coded_aperture_ros.core.archive import write_archive
from coded_aperture_ros.likelihood.bank.empirical import EmpiricalPrior
from coded_aperture_ros.likelihood.bank.file import (
    FIELD,
    FRAMES,
    NEWER,
    PATTERN,
    PRIOR,
    REFINEMENT,
    SCHEMA,
    STORED,
    VERSION,
)
from coded_aperture_ros.likelihood.bank.model import FilterBank


def save_bank(bank: FilterBank, path: str | os.PathLike[str]) -> None:
    """Write a filter bank; the file appears whole or not at all.

    Raises
    ------
    InputError
        If the folder cannot be written to.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from coded_aperture_ros.likelihood.bank import learn_bank, load_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("disc"), [3.0, 5.0, 7.0]))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_bank(bank, pathlib.Path(folder, "bank.npz"))
    ...     load_bank(pathlib.Path(folder, "bank.npz")).levels
    3
    """
    arrays = {name: getattr(bank, name) for name in (*STORED, *NEWER)}
    arrays |= {f"prior_{name}": getattr(bank.prior, name) for name in PRIOR}
    arrays |= {"blur_sizes_px": bank.stack.blur_sizes_px, "psfs": bank.stack.psfs}
    if not bank.stack.in_pixels:
        arrays["blur_sizes_are_indices"] = True
    if bank.stack.nominal:
        arrays["blur_sizes_are_nominal"] = True
    if bank.stack.channel_psfs is not None:
        arrays["channel_psfs"] = bank.stack.channel_psfs
    if bank.stack.depths_m is not None:
        arrays["depths_m"] = bank.stack.depths_m
    if isinstance(bank.prior, EmpiricalPrior):
        arrays["prior_deviations"] = bank.prior.deviations
    if bank.refinement is not None:
        arrays |= {f"{REFINEMENT}{name}": values for name, values in bank.refinement.items()}
    if bank.pattern is not None:
        arrays |= {f"pattern_{name}": getattr(bank.pattern, name) for name in PATTERN}
        arrays["pattern_mask"] = bank.pattern.mask.transmission
        arrays["pattern_mask_name"] = bank.pattern.mask.name
    if bank.field is not None:
        filters, field = bank.field, bank.field.field
        arrays |= {"field_psfs": field.psfs, "field_tangents": field.tangents}
        arrays |= {f"field_{name}": getattr(filters, name) for name in FIELD}
        arrays |= {f"field_{name}": getattr(field.intrinsics, name) for name in FRAMES}
    write_archive(path, SCHEMA, VERSION, arrays)
