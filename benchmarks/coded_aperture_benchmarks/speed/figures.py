"""The figure of `speed`. Needs matplotlib."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from coded_aperture_benchmarks.figures import new_panels
from coded_aperture_ros.core.figures import PathLike, save_figure


def draw_speed(results: Mapping[str, Any], path: PathLike) -> None:
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
