"""`coded_aperture bench simple-speed`: how long a frame behind a simple mask takes, and why."""

import argparse
import time
from collections.abc import Callable
from typing import Any

from coded_aperture_benchmarks.commands.bench_options import (
    add_size_option,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import add_numbers, mask_of, table
from coded_aperture_ros.cli.progress import progress
from coded_aperture_ros.core.threads import processors

_SIZE = (480, 640)
_MASK, _LEVELS, _WINDOW, _STRIDE, _FRAMES = "two_hole", 33, 48, 8, 20
_REGULARIZED = ("none", "semiglobal", "graphcut")
_WINDOWS = (48, 64, 96, 128)
# Holes in general position, so that no two pairs of them are parallel: N (N - 1) / 2 lines.
_SCATTERED = ((0, 3), (5, 19), (19, 7), (14, 0), (2, 12))
_GRID, _HOLE = 24, 4
_EPILOG = """examples:
  640x480, 33 levels, two holes, on all processors:
    coded_aperture bench simple-speed
  four holes, with the stride of the node:
    coded_aperture bench simple-speed --mask four_hole --stride 16
"""


def add_parser(subparsers: Any) -> None:
    """Add the benchmark to the parser of `bench`."""
    parser = subparsers.add_parser(
        "simple-speed",
        help="of depth behind masks of a few equal holes",
        description="Time of a frame by the method for simple masks: without regularisation, with "
        "the fast one and with graph cuts; and how the time of the statistics grows with the "
        "number of holes and with the window.",
        epilog=_EPILOG,
    )
    add_size_option(parser, _SIZE)
    parser.add_argument(
        "--mask", default=_MASK, metavar="MASK", help=f"name or file (default {_MASK})"
    )
    add_numbers(
        parser,
        ("levels", 2, _LEVELS, "blur levels, from 7 to 30 px"),
        ("window", 32, _WINDOW, "side of the windows, a multiple of 8, px"),
        ("stride", 1, _STRIDE, "distance between the windows, px"),
        ("threads", 1, processors(), "threads of the processor"),
        ("frames", 1, _FRAMES, "frames for every measurement"),
    )
    parser.add_argument(
        "--full-size",
        action="store_true",
        help="maps as large as the frame (default: within 320x240, as the node publishes)",
    )
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    parser.add_argument("--output", metavar="DIR", help="write results.json")


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    from coded_aperture_ros.methods.two_pixel import SimpleConfig, find_holes

    check_result_options(args)
    mask = mask_of(args.mask)
    find_holes(mask)
    SimpleConfig(window_px=args.window)
    if min(args.size) < args.window:
        args.usage_error(f"--size: smaller than the window of {args.window} px")
    windows = [px for px in _WINDOWS if px <= min(args.size)]
    steps: list[tuple[str, Any]] = [("regularize", how) for how in _REGULARIZED]
    steps += [("holes", count) for count in range(2, len(_SCATTERED) + 1)]
    steps += [("window", px) for px in windows]
    start = time.perf_counter()
    results: dict[str, Any] = {
        "benchmark": "simple-speed",
        "size": [args.size[1], args.size[0]],
        "mask": args.mask,
        "levels": args.levels,
        "window_px": args.window,
        "stride_px": args.stride,
        "threads": args.threads,
        "frames_measured": args.frames,
        "regularize": [],
        "holes": [],
        "window": [],
    }
    for kind, value in progress(steps, len(steps), "step"):
        results[kind].append(_MEASURED[kind](args, value))
    results["seconds"] = round(time.perf_counter() - start, 1)
    report(args, results, lambda: _tables(results))
    return 0


def scattered_holes(count: int) -> Any:
    """Return a mask of equal holes of which no two pairs are parallel; 2 to 5 of them."""
    import numpy as np

    from coded_aperture_ros.optics import Mask

    cells = np.zeros((_GRID, _GRID), np.float32)
    for row, column in _SCATTERED[:count]:
        cells[row : row + _HOLE, column : column + _HOLE] = 1
    return Mask(f"{count} scattered holes", cells)


def _times(args: argparse.Namespace, mask: Any, window_px: int, regularize: str) -> dict[str, Any]:
    """Time frames of a moving scene behind a mask."""
    from coded_aperture_benchmarks.speed.frames import moving_frames
    from coded_aperture_benchmarks.speed.setting import published_size
    from coded_aperture_benchmarks.stair import blur_stack
    from coded_aperture_ros.depth import DepthConfig, DepthEstimator
    from coded_aperture_ros.methods.two_pixel import SimpleConfig, neighbour_model
    from coded_aperture_ros.metrics.times import Times

    stack = blur_stack(mask, args.levels)
    model = neighbour_model(stack, mask, SimpleConfig(window_px=window_px))
    config = DepthConfig(stride_px=args.stride, threads=args.threads, regularize=regularize)
    estimator = DepthEstimator(model, config)
    frames = moving_frames(stack, args.size)
    size = published_size(args.size, args.full_size)
    estimator.estimate(frames[0], size)  # plans
    seconds: list[float] = []
    stages: dict[str, list[float]] = {}
    for number in range(args.frames):
        start = time.perf_counter()
        estimate = estimator.estimate(frames[number % len(frames)], size)
        seconds.append(time.perf_counter() - start)
        for stage, taken in estimate.seconds.items():
            stages.setdefault(stage, []).append(taken)
    estimator.close()
    times = Times.of(seconds)
    return {
        "lines": len(model.lines),
        "products": model.derivatives * len(model.lags),
        "p50_ms": round(times.p50_ms, 2),
        "p99_ms": round(times.p99_ms, 2),
        "frames_per_second": round(1000 / times.p50_ms, 1),
        "stages_ms": {stage: round(Times.of(taken).p50_ms, 2) for stage, taken in stages.items()},
    }


def _of_regularization(args: argparse.Namespace, how: str) -> dict[str, Any]:
    return {"regularize": how, **_times(args, mask_of(args.mask), args.window, how)}


def _of_holes(args: argparse.Namespace, count: int) -> dict[str, Any]:
    times = _times(args, scattered_holes(count), args.window, "none")
    return {"holes": count, "neighbours": count * (count - 1), **times}


def _of_window(args: argparse.Namespace, window_px: int) -> dict[str, Any]:
    return {"window_px": window_px, **_times(args, mask_of(args.mask), window_px, "none")}


_MEASURED: dict[str, Callable[[argparse.Namespace, Any], dict[str, Any]]] = {
    "regularize": _of_regularization,
    "holes": _of_holes,
    "window": _of_window,
}


def _tables(results: dict[str, Any]) -> str:
    width, height = results["size"]
    parts = [
        f"{width}x{height}, {results['mask']}, {results['levels']} levels, window "
        f"{results['window_px']} px, a window every {results['stride_px']} px, "
        f"{results['threads']} threads; ms of a frame, median"
    ]
    for kind, first, title in (
        ("regularize", ("regularize",), "regularisation"),
        ("holes", ("holes", "neighbours"), "holes in general position, not regularised"),
        ("window", ("window_px",), "window, not regularised"),
    ):
        rows = results[kind]
        stages = list(rows[0]["stages_ms"])
        header = [*first, "lines", "products", "p50", "p99", "frames/s", *stages]
        lines = [
            [
                *(str(row[name]) for name in first),
                *(str(row["lines"]), str(row["products"])),
                *(f"{row['p50_ms']:.1f}", f"{row['p99_ms']:.1f}"),
                f"{row['frames_per_second']:.1f}",
                *(f"{row['stages_ms'][stage]:.1f}" for stage in stages),
            ]
            for row in rows
        ]
        parts.append(f"{title}\n{table(header, lines)}")
    return "\n\n".join(parts)
