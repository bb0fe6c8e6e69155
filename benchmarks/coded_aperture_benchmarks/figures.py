"""Figures of the benchmarks. Needs matplotlib, which is imported only here and only when drawing.

No window is opened: figures go to files.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.figures import PANEL_INCHES, PathLike, new_figure, save_figure

_UNKNOWN = "0.8"


def new_panels(down: int, across: int, width: float = 1.1) -> tuple[Any, Any]:
    """Return a figure, and its axes [down, across]."""
    figure = new_figure(width * PANEL_INCHES * across, PANEL_INCHES * down)
    return figure, figure.subplots(down, across, squeeze=False)


def signed_blur_maps(maps: Mapping[str, NDArray[np.floating]], path: PathLike) -> None:
    """Draw maps of signed blur side by side: red before the focal plane, blue beyond it.

    Parameters
    ----------
    maps : mapping of str to ndarray of float, shape [rows, columns]
        Titles, and blur sizes in px; NaN is grey.
    """
    rows, columns = next(iter(maps.values())).shape
    largest = max(float(np.nanmax(np.abs(values), initial=0.0)) for values in maps.values())
    height = PANEL_INCHES * rows / columns
    figure = new_figure(PANEL_INCHES * len(maps) + 0.8, height + 0.3)
    drawn = None
    for axes, (title, values) in zip(
        figure.subplots(1, len(maps), squeeze=False)[0], maps.items(), strict=True
    ):
        axes.set_facecolor(_UNKNOWN)
        drawn = axes.imshow(values, cmap="RdBu", vmin=-largest, vmax=largest)
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_title(title, fontsize=9)
    figure.colorbar(drawn, ax=figure.axes, label="blur, px", fraction=0.03)
    save_figure(figure, path)


def edge_profiles(
    panels: Mapping[str, Mapping[str, NDArray[np.floating]]],
    truths: Mapping[str, NDArray[np.floating]],
    path: PathLike,
) -> None:
    """Draw the mean level of every column of two planes.

    Parameters
    ----------
    panels : mapping of str to mapping of str to ndarray of float, shape [columns]
        For each panel's title, a curve for each method.
    truths : mapping of str to ndarray of float, shape [columns]
        The true level, for each title.
    """
    titles = list(panels)
    across = min(2, len(titles))
    figure, grid = new_panels(-(-len(titles) // across), across, width=1.6)
    for axes, title in zip([axes for line in grid for axes in line], titles, strict=False):
        truth = truths[title]
        position = np.arange(len(truth)) + 0.5 - len(truth) // 2
        axes.plot(position, truth, "k--", linewidth=1, label="true")
        for method, level in panels[title].items():
            axes.plot(position, level, linewidth=1, label=method)
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("distance from the edge, px", fontsize=8)
        axes.set_ylabel("mean level", fontsize=8)
    for axes in [axes for line in grid for axes in line][len(titles) :]:
        axes.set_visible(False)
    grid[0][0].legend(fontsize=7)
    save_figure(figure, path)


def seen_from_above(ways: Mapping[str, NDArray[np.floating]], path: PathLike) -> None:
    """Draw ways [n, 4, 4] from one place, x to the right and z upwards; the first one dashed."""
    figure = new_figure(6, 5)
    axes = figure.subplots()
    for index, (name, poses) in enumerate(ways.items()):
        places = (np.linalg.inv(poses[0]) @ poses)[:, :3, 3]
        axes.plot(places[:, 0], places[:, 2], "k--" if index == 0 else "-", label=name, linewidth=1)
    axes.set_aspect("equal")
    axes.set_xlabel("to the right, m", fontsize=8)
    axes.set_ylabel("ahead, m", fontsize=8)
    axes.legend(fontsize=7)
    save_figure(figure, path)


def shares_over_distance(
    panels: Mapping[str, Mapping[str, Sequence[float]]], parts: Sequence[str], path: PathLike
) -> None:
    """Draw shares for each part of the distances.

    Parameters
    ----------
    panels : mapping of str to mapping of str to sequence of float
        For each panel's title, a curve for each name; NaN is left out.
    parts : sequence of str
        What the parts are called.
    """
    figure, (line,) = new_panels(1, len(panels), width=1.3)
    for axes, (title, curves) in zip(line, panels.items(), strict=True):
        for index, (name, shares) in enumerate(curves.items()):
            # A little beside each other, so that they do not hide each other.
            place = np.arange(len(parts)) + 0.03 * (index - len(curves) / 2)
            axes.plot(place, 100 * np.asarray(shares, float), "o-", label=name, markersize=3)
        axes.axhline(50, color="0.6", linewidth=0.8, linestyle="--")
        axes.set_title(title, fontsize=9)
        axes.set_ylim(-5, 105)
        axes.set_xticks(range(len(parts)), parts, fontsize=7)
        axes.set_xlabel("distance, m", fontsize=8)
    line[0].set_ylabel("read, %", fontsize=8)
    figure.legend(*line[0].get_legend_handles_labels(), fontsize=7, loc="outside right")
    save_figure(figure, path)
