"""Refinement of a bank's own, as `coded_aperture learn --train` fits it."""

import sys
from pathlib import Path

from coded_aperture_ros.cli.results import Summary
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.likelihood.bank import FilterBank


def tuned_bank(
    bank: FilterBank, minutes: float, device: str, output: str
) -> tuple[FilterBank, Summary]:
    """Fit the refinement further to a bank.

    Parameters
    ----------
    bank : FilterBank
    minutes : float
        In all, with what was spent before.
    device : str
        `cpu` or `cuda`.
    output : str
        File that the bank will be in; frames and what was reached lie beside it.

    Returns
    -------
    bank : FilterBank
        With its own refinement, or as it was if that gains nothing.
    summary : Summary

    Raises
    ------
    InputError
        If PyTorch is not installed, the device is not there, the refinement does not support the
        bank, or what was reached is of other PSFs.
    """
    try:
        from coded_aperture_ros.calibration.fine_tuning.tune import tune_refinement
    except ImportError as error:
        raise InputError(
            f"--train needs {error.name}: in the folder of the checkout, pip install '.[train]'"
        ) from error
    folder = Path(output).with_suffix(".training")
    found = tune_refinement(bank, minutes, folder, device=device, say=_say, progress=progress)
    return found.bank, {
        "training_folder": str(folder),
        "training_frames": found.frames,
        "training_steps": found.steps,
        "right_before": round(found.before, 4),
        "right_after": round(found.after, 4),
        "refinement_kept": found.gains,
    }


def training_text(summary: Summary) -> str:
    """Say in two lines what came of it."""
    kept = "kept in the bank" if summary["refinement_kept"] else "no gain: not kept"
    return (
        "  refinement, {training_steps} steps: {right_after:.1%} of simulated scenes are right, "
        "{right_before:.1%} before: {kept}\n"
        "  a longer --train goes on from {training_folder}, which may be removed"
    ).format(kept=kept, **summary)


def _say(line: str) -> None:
    print(f"training: {line}", file=sys.stderr, flush=True)
