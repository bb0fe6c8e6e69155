"""Graphs of a design as a picture. Needs matplotlib, which is imported only when drawing."""

import os
from importlib.util import find_spec
from typing import Any

import numpy as np

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.curves import Curves
from coded_aperture_ros.design.setting import Setting

_INCHES = (13.0, 3.8)
_DOTS_PER_INCH = 100
_SHADE = "0.88"


def has_matplotlib() -> bool:
    """Whether matplotlib is installed, without importing it."""
    return find_spec("matplotlib") is not None


def draw_design(
    setting: Setting,
    curves: Curves,
    near_m: float,
    far_m: float,
    path: str | os.PathLike[str],
) -> None:
    """Draw levels and hole blur against focus, and depth resolution (thesis figure 3.10).

    The stripe at the right has a band for each depth level: objects in one band cannot be told
    apart.

    Parameters
    ----------
    setting : Setting
        The camera as it is, which the graphs mark.
    curves : Curves
    near_m, far_m : float
        Depth range.
    path : path-like
        Picture file; matplotlib chooses the format by its name.

    Raises
    ------
    InputError
        If matplotlib is missing, or the file cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("figures need matplotlib: pip install matplotlib") from error
    figure = Figure(figsize=_INCHES)
    # A layout that measures every text would take longer than all the drawing.
    levels, blur, resolution, stripe = (
        figure.add_axes((left, 0.13, right - left, 0.79))
        for left, right in ((0.042, 0.3), (0.347, 0.605), (0.667, 0.919), (0.928, 0.945))
    )
    for axes in (levels, blur):
        axes.axvspan(near_m, far_m, color=_SHADE, label="ambiguous: focus in the depth range")
        axes.axvline(setting.focus_distance_m, color="k", linewidth=0.8, label="the camera's focus")
        axes.set_xlim(curves.focus_m[0], curves.focus_m[-1])
        axes.set_xlabel("focus distance, m", fontsize=9)
    _draw_by_side(levels, curves, curves.levels, near_m, "C0", None)
    levels.plot(setting.focus_distance_m, setting.levels, "ko", markersize=4)
    levels.set_title(f"depth levels: {setting.levels:.1f}", fontsize=10)
    levels.set_ylim(0, 1.25 * curves.levels.max())
    levels.set_ylabel("levels", fontsize=9)
    levels.legend(fontsize=7, loc="lower right")
    _draw_by_side(blur, curves, curves.hole_blur_mean_px, near_m, "C3", "mean over the range")
    _draw_by_side(blur, curves, curves.hole_blur_far_px, near_m, "C0", "at the far end")
    blur.axhline(1.0, color="k", linestyle="--", linewidth=0.8, label="1 pixel")
    blur.set_ylim(0, _upper_limit(setting, curves))
    blur.set_title(f"blur of a hole: {setting.hole_blur_mean_px:.2g} px in the mean", fontsize=10)
    blur.set_ylabel("blur of the smallest hole, px", fontsize=9)
    blur.legend(*_lines_only(blur), fontsize=7, loc="upper right")
    resolution.plot(curves.depth_m, curves.resolution_m)
    resolution.set_yscale("log")
    resolution.set_xlim(near_m, far_m)
    resolution.set_title(
        f"depth resolution, focus at {setting.focus_distance_m:.3g} m", fontsize=10
    )
    resolution.set_xlabel("depth, m", fontsize=9)
    resolution.set_ylabel("to the next depth told apart, m", fontsize=9)
    resolution.grid(True, which="both", color=_SHADE, linewidth=0.6)
    for axes, scales in ((levels, "x"), (blur, "x"), (resolution, "y")):
        _plain_numbers(axes, scales)
    _draw_stripe(stripe, curves, near_m, far_m)
    try:
        figure.savefig(path, dpi=_DOTS_PER_INCH)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


def _draw_by_side(
    axes: Any, curves: Curves, values: Any, near_m: float, colour: str, label: str | None
) -> None:
    """Draw one line for the focus before the depth range, and one for beyond it."""
    before = curves.focus_m <= near_m
    for index, side in enumerate((before, ~before)):
        if side.any():
            shown = None if index and before.any() else label
            axes.plot(curves.focus_m[side], values[side], color=colour, label=shown)


def _upper_limit(setting: Setting, curves: Curves) -> float:
    # Blur grows without bounds as the focus nears the lens, and would flatten all the rest.
    largest = float(np.maximum(curves.hole_blur_mean_px, curves.hole_blur_far_px).max())
    here = max(setting.hole_blur_mean_px, setting.hole_blur_far_px)
    return max(1.5, min(1.1 * largest, 3 * here))


def _lines_only(axes: Any) -> tuple[list[Any], list[str]]:
    handles, labels = axes.get_legend_handles_labels()
    kept = [
        (handle, label)
        for handle, label in zip(handles, labels, strict=True)
        if label in ("mean over the range", "at the far end", "1 pixel")
    ]
    return [handle for handle, _ in kept], [label for _, label in kept]


def _plain_numbers(axes: Any, which: str) -> None:
    """Make an axis logarithmic, with numbers such as 0.5 and 20 instead of powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis = axes.xaxis if which == "x" else axes.yaxis
    (axes.set_xscale if which == "x" else axes.set_yscale)("log")
    axis.set_major_locator(LogLocator(subs=(1, 2, 5), numticks=12))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _draw_stripe(axes: Any, curves: Curves, near_m: float, far_m: float) -> None:
    edges = np.minimum(curves.level_edges_m, far_m)
    bands = len(edges) - 1
    axes.pcolormesh([0, 1], edges, np.arange(bands)[:, None] % 2, cmap="Blues", vmin=-0.5, vmax=2)
    axes.set_ylim(near_m, far_m)
    axes.set_xticks([])
    axes.set_ylabel("depth, m: a band is one level", fontsize=9)
    axes.yaxis.set_label_position("right")
    axes.yaxis.tick_right()
