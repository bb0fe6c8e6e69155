"""Figures of a design. Matplotlib is imported only when drawing."""

from importlib.util import find_spec
from typing import Any

import numpy as np

from coded_aperture_ros.core.figures import PathLike, new_figure, save_figure
from coded_aperture_ros.design.curves import Curves
from coded_aperture_ros.design.setting import Setting

_INCHES = (13.0, 3.8)
_SHADE = "0.88"
_SMALL = {"fontsize": 9}


def has_matplotlib() -> bool:
    """Whether matplotlib is installed, without importing it."""
    return find_spec("matplotlib") is not None


def draw_design(
    setting: Setting, curves: Curves, near_m: float, far_m: float, path: PathLike
) -> None:
    """Draw levels and hole blur against focus, and depth resolution (thesis figure 3.10).

    The graphs mark `setting`, the camera as it is. The stripe at the right has a band for each
    depth level: objects in one band cannot be told apart. The name of the file chooses the format.
    Raises `InputError` if matplotlib is missing, or the file cannot be written.
    """
    # A layout that measures every text would take longer than all the drawing.
    figure = new_figure(*_INCHES, layout=None)
    levels, blur, resolution, stripe = (
        figure.add_axes((left, 0.13, right - left, 0.79))
        for left, right in ((0.042, 0.3), (0.347, 0.605), (0.667, 0.919), (0.928, 0.945))
    )
    for axes in (levels, blur):
        axes.axvspan(near_m, far_m, color=_SHADE, label="ambiguous: focus in the depth range")
        axes.axvline(setting.focus_distance_m, color="k", linewidth=0.8, label="the camera's focus")
        axes.set_xlim(curves.focus_m[0], curves.focus_m[-1])
        axes.set_xlabel("focus distance, m", **_SMALL)
        _plain_logarithmic(axes, "x")
    _draw_by_side(levels, curves, curves.levels, near_m, color="C0")
    levels.plot(setting.focus_distance_m, setting.levels, "ko", markersize=4)
    levels.set_title(f"depth levels: {setting.levels:.1f}", fontsize=10)
    levels.set_ylim(0, 1.25 * curves.levels.max())
    levels.set_ylabel("levels", **_SMALL)
    levels.legend(fontsize=7, loc="lower right")
    _draw_blur(blur, setting, curves, near_m)
    resolution.plot(curves.depth_m, curves.resolution_m)
    resolution.set_xlim(near_m, far_m)
    resolution.set_title(
        f"depth resolution, focus at {setting.focus_distance_m:.3g} m", fontsize=10
    )
    resolution.set_xlabel("depth, m", **_SMALL)
    resolution.set_ylabel("to the next depth told apart, m", **_SMALL)
    resolution.grid(True, which="both", color=_SHADE, linewidth=0.6)
    _plain_logarithmic(resolution, "y")
    _draw_stripe(stripe, curves, near_m, far_m)
    save_figure(figure, path)


def _draw_blur(axes: Any, setting: Setting, curves: Curves, near_m: float) -> None:
    lines = []
    for values, color, label in (
        (curves.hole_blur_mean_px, "C3", "mean over the range"),
        (curves.hole_blur_far_px, "C0", "at the far end"),
    ):
        lines += _draw_by_side(axes, curves, values, near_m, color=color, label=label)[:1]
    lines.append(axes.axhline(1.0, color="k", linestyle="--", linewidth=0.8, label="1 pixel"))
    # Blur grows without bounds as the focus nears the lens, and would flatten all the rest.
    largest = float(np.maximum(curves.hole_blur_mean_px, curves.hole_blur_far_px).max())
    here = max(setting.hole_blur_mean_px, setting.hole_blur_far_px)
    axes.set_ylim(0, max(1.5, min(1.1 * largest, 3 * here)))
    axes.set_title(f"blur of a hole: {setting.hole_blur_mean_px:.2g} px in the mean", fontsize=10)
    axes.set_ylabel("blur of the smallest hole, px", **_SMALL)
    axes.legend(handles=lines, fontsize=7, loc="upper right")


def _draw_by_side(axes: Any, curves: Curves, values: Any, near_m: float, **style: Any) -> list[Any]:
    """Lines for the focus before the depth range, and for the focus beyond it."""
    before = curves.focus_m <= near_m
    sides = [side for side in (before, ~before) if side.any()]
    return [axes.plot(curves.focus_m[side], values[side], **style)[0] for side in sides]


def _plain_logarithmic(axes: Any, which: str) -> None:
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
    axes.set_ylabel("depth, m: a band is one level", **_SMALL)
    axes.yaxis.set_label_position("right")
    axes.yaxis.tick_right()
