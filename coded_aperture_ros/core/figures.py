"""Figures on disk. Needs matplotlib, which is imported only when drawing; no window is opened."""

import os
from typing import IO, Any

from coded_aperture_ros.core.errors import InputError

PANEL_INCHES = 3.0
_DOTS_PER_INCH = 100
# Or an open file, for which the format is PNG.
PathLike = str | os.PathLike[str] | IO[bytes]


def new_figure(
    width_inches: float, height_inches: float, layout: str | None = "constrained"
) -> Any:
    """Return an empty figure; an `InputError` where matplotlib is not installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("figures need matplotlib: pip install matplotlib") from error
    return Figure(figsize=(width_inches, height_inches), layout=layout)


def save_figure(figure: Any, path: PathLike) -> None:
    """Write a figure to a file; an `InputError` where that is not possible."""
    try:
        figure.savefig(path, dpi=_DOTS_PER_INCH)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
