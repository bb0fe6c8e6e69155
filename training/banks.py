"""Filter banks that training data are made with, learned once and kept in a folder."""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from coded_aperture_ros.depth.decoders.network.small import small_bank
from coded_aperture_ros.likelihood.bank import FilterBank, load_bank, save_bank


@dataclasses.dataclass(frozen=True, eq=False)
class BankPair:
    """A bank, and the one of the same levels for small patches."""

    bank: FilterBank
    small: FilterBank

    def with_levels(self, kept: np.ndarray) -> "BankPair":
        """Pair with some of the levels only."""
        return BankPair(_with_levels(self.bank, kept), _with_levels(self.small, kept))


def kept_banks(name: str, folder: Path, learn: Callable[[], FilterBank | None]) -> BankPair | None:
    """Banks of a name from a folder; learned, and written there, the first time.

    None if there is nothing to learn them from.
    """
    paths = folder / f"{name}.npz", folder / f"{name}_small.npz"
    if not all(path.exists() for path in paths):
        bank = learn()
        if bank is None:
            return None
        folder.mkdir(parents=True, exist_ok=True)
        for path, one in zip(paths, (bank, small_bank(bank)), strict=True):
            # Two processes may learn the same bank at once.
            part = path.with_suffix(f".{os.getpid()}.npz")
            save_bank(one, part)
            part.rename(path)
    return BankPair(*(load_bank(path) for path in paths))


def _with_levels(bank: FilterBank, kept: np.ndarray) -> FilterBank:
    stack = bank.stack
    return dataclasses.replace(
        bank,
        stack=dataclasses.replace(
            stack, blur_sizes_px=stack.blur_sizes_px[kept], psfs=stack.psfs[kept]
        ),
        coefficients=bank.coefficients[..., kept],
        log_determinants=bank.log_determinants[..., kept],
    )
