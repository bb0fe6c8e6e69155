"""Figures in files, by matplotlib, which is imported only when drawing; no window is opened."""

import os
from typing import IO, Any

from coded_aperture_ros.core.errors import InputError

# Width and height of one panel of a figure, inches.
PANEL_INCHES = 3.0
_DOTS_PER_INCH = 100
# A path, or an open file that gets PNG.
PathLike = str | os.PathLike[str] | IO[bytes]


def new_figure(
    width_inches: float, height_inches: float, layout: str | None = "constrained"
) -> Any:
    """Empty figure; an `InputError` if matplotlib is not installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("figures need matplotlib: pip install matplotlib") from error
    return Figure(figsize=(width_inches, height_inches), layout=layout)


def save_figure(figure: Any, path: PathLike) -> None:
    """Write a figure to a file; an `InputError` if it cannot be written."""
    try:
        figure.savefig(path, dpi=_DOTS_PER_INCH)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
