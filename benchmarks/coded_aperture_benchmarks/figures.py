"""Figures of the benchmarks. Needs matplotlib, which is imported only here and only when drawing.

No window is opened: figures go to files.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.figures import PANEL_INCHES, PathLike, new_figure, save_figure

# As in thesis figure 6.4.
_DEVIATIONS = 3.0
_UNKNOWN = "0.8"


def new_panels(down: int, across: int, width: float = 1.1) -> tuple[Any, Any]:
    """Return a figure, and its axes [down, across]."""
    figure = new_figure(width * PANEL_INCHES * across, PANEL_INCHES * down)
    return figure, figure.subplots(down, across, squeeze=False)


def stair_spread(rows: Sequence[Mapping[str, Any]], path: PathLike) -> None:
    """Draw estimated against true level, mean and three standard deviations (thesis figure 6.4).

    Parameters
    ----------
    rows : sequence of mapping
        One for each mask, noise and method: `mask`, `sigma`, `method`, `mean_of_step` and
        `deviation_of_step`. A panel for each mask (down) and noise (across).
    """
    masks = list(dict.fromkeys(row["mask"] for row in rows))
    sigmas = list(dict.fromkeys(row["sigma"] for row in rows))
    figure, panels = new_panels(len(masks), len(sigmas))
    for mask, line in zip(masks, panels, strict=True):
        for sigma, axes in zip(sigmas, line, strict=True):
            here = [row for row in rows if (row["mask"], row["sigma"]) == (mask, sigma)]
            levels = np.arange(len(here[0]["mean_of_step"]))
            axes.plot(levels, levels, "k--", linewidth=0.8)
            for index, row in enumerate(here):
                axes.errorbar(
                    levels + 0.25 * index,  # so that bars do not hide each other
                    row["mean_of_step"],
                    _DEVIATIONS * np.asarray(row["deviation_of_step"]),
                    label=row["method"],
                    linewidth=1,
                    elinewidth=0.6,
                )
            axes.set_title(f"{mask}, sigma {sigma:g}", fontsize=9)
            axes.set_ylim(-2, len(levels) + 1)
            axes.set_xlabel("true level", fontsize=8)
            axes.set_ylabel("estimated level", fontsize=8)
    panels[0][0].legend(fontsize=7, loc="lower right")
    save_figure(figure, path)


def stair_maps(maps: Mapping[str, NDArray[np.floating]], levels: int, path: PathLike) -> None:
    """Draw true and estimated maps of a stair side by side, squeezed (thesis figures 6.2, 6.3).

    Parameters
    ----------
    maps : mapping of str to ndarray of float, shape [rows, columns]
        Estimated levels; NaN is grey.
    levels : int
        Number of steps.
    """
    figure = new_figure(0.9 * (len(maps) + 2), 2 * PANEL_INCHES)
    true_map = np.arange(levels, dtype=np.float64)[:, None]
    shown = {"true": true_map, **maps}
    # Small blur sizes, near the camera, at the bottom.
    drawn = None
    for axes, (title, values) in zip(
        figure.subplots(1, len(shown), squeeze=False)[0], shown.items(), strict=True
    ):
        axes.set_facecolor(_UNKNOWN)
        drawn = axes.imshow(
            values,
            aspect="auto",
            origin="lower",
            cmap="turbo",
            vmin=0,
            vmax=levels - 1,
            interpolation="nearest",
        )
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_title(title, fontsize=7)
    figure.colorbar(drawn, ax=figure.axes, label="level", fraction=0.03)
    save_figure(figure, path)


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


def speed(results: Mapping[str, Any], path: PathLike) -> None:
    """Draw the times of `SpeedBenchmark.results`: stages, sizes, levels and threads."""
    figure, ((stages, sizes), (levels, threads)) = new_panels(2, 2, width=1.8)
    _draw_stages(stages, results["main"])
    _draw_sizes(sizes, results["sizes"])
    rows = results["levels"]["rows"]
    count = [row["levels"] for row in rows]
    levels.plot(count, [row["total"]["p50_ms"] for row in rows], "o-", label="frame, p50")
    levels.plot(count, [row["total"]["p99_ms"] for row in rows], "^:", label="frame, p99")
    levels.plot(count, [row["level_stages_p50_ms"] for row in rows], "s-", label="of levels, p50")
    levels.set_title(f"time ~ levels^{results['levels']['exponent']:.2f}", fontsize=9)
    levels.set_xlabel("levels", fontsize=8)
    levels.set_ylabel("ms", fontsize=8)
    levels.set_ylim(0)
    levels.set_xlim(0)
    levels.legend(fontsize=7)
    rows = results["threads"]["rows"]
    count = [row["threads"] for row in rows]
    threads.plot(count, count, "k--", linewidth=0.8, label="ideal")
    threads.plot(count, [row["speedup"]["p50"] for row in rows], "o-", label="frame")
    threads.plot(count, [row["speedup_engine"]["p50"] for row in rows], "s-", label="engine")
    threads.set_title("speed-up over one thread, p50", fontsize=9)
    threads.set_xlabel("threads", fontsize=8)
    threads.set_xticks(count)
    threads.set_ylim(0)
    threads.legend(fontsize=7)
    save_figure(figure, path)


def _draw_stages(axes: Any, main: Mapping[str, Any]) -> None:
    stages = main["stages"]
    p50 = np.array([times["p50_ms"] for times in stages.values()])
    beyond = np.array([times["p99_ms"] for times in stages.values()]) - p50
    # A bar ends at the median, its whisker at the 99th percentile.
    axes.barh(list(stages), p50, xerr=[np.zeros_like(p50), beyond], capsize=2, ecolor="0.4")
    axes.invert_yaxis()
    total = main["total"]
    rows, columns = main["size"]
    axes.set_title(
        f"{columns}x{rows}: p50 {total['p50_ms']:.0f}, p99 {total['p99_ms']:.0f} ms", fontsize=9
    )
    axes.set_xlabel("ms, p50 and p99", fontsize=8)
    axes.tick_params(axis="y", labelsize=8)


def _draw_sizes(axes: Any, sizes: Mapping[str, Any]) -> None:
    rows = sizes["rows"]
    pixels = np.array([row["size"][0] * row["size"][1] for row in rows], float)
    p50 = np.array([row["total"]["p50_ms"] for row in rows])
    # Through the middle of the points, as the fit goes.
    at_one = np.exp(np.log(p50).mean() - sizes["slope"] * np.log(pixels).mean())
    label = f"slope {sizes['slope']:.2f}"
    axes.loglog(pixels, at_one * pixels ** sizes["slope"], "k--", linewidth=0.8, label=label)
    axes.loglog(pixels, p50, "o", label="frame, p50")
    axes.loglog(pixels, [row["total"]["p99_ms"] for row in rows], "^", label="frame, p99")
    axes.loglog(pixels, [row["engine_p50_ms"] for row in rows], "s", label="engine, p50")
    axes.set_title("time over size", fontsize=9)
    axes.minorticks_off()
    powers = np.outer(10.0 ** np.arange(-1, 6), (1, 2, 5)).ravel()
    lowest, highest = axes.get_ylim()
    ticks = powers[(powers >= lowest) & (powers <= highest)]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks(pixels, [f"{row['size'][1]}x{row['size'][0]}" for row in rows])
    axes.tick_params(axis="x", labelsize=7)
    axes.set_ylabel("ms", fontsize=8)
    axes.legend(fontsize=7)


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


def distance_matrices(matrices: Mapping[str, NDArray[np.floating]], path: PathLike) -> None:
    """Draw distances between the subspaces of levels (thesis figure 9.5); bright is far.

    `matrices` has titles, and distances [L, L] as shares of the largest possible, 0 to 1.
    """
    columns = min(len(matrices), 5)
    rows = -(-len(matrices) // columns)
    figure, panels = new_panels(rows, columns)
    for axes in panels.flat:
        axes.set_axis_off()
    for axes, (title, matrix) in zip(panels.flat, matrices.items(), strict=False):
        axes.imshow(matrix, cmap="gray", vmin=0, vmax=1)
        axes.set_title(title, fontsize="small")
    save_figure(figure, path)
