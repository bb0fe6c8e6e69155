"""`coded_aperture bench speed`: how long a frame takes, and why."""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_options import (
    RESULTS,
    add_size_option,
    add_threads_option,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import add_numbers, at_least, table
from coded_aperture_ros.cli.progress import progress
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.threads import processors

_FIGURE = "speed.png"
_SIZE = (480, 640)
# What `learn --budget-ms` chooses for these blur sizes and 60 frames per second.
_LEVELS, _WINDOW, _RANK, _STRIDE, _HIGHEST_FREQUENCY = 30, 64, 64, 24, 0.4
_BACKEND = "numpy"
_FRAMES, _QUICK_FRAMES = 20, 6
_TEMPORAL = 4.0
# Rows and columns.
_SIZES = ((240, 320), (480, 640), (720, 1280), (1080, 1920))
_QUICK_SIZES = _SIZES[:2]
_LEVEL_COUNTS, _QUICK_LEVEL_COUNTS = (10, 20, 30, 60), (10, 30)
_DENOISED, _QUICK_DENOISED = (3, 5), (3,)
_REPEATS, _QUICK_REPEATS = 3, 2
_TIMES = ("p50", "p99", "worst")
# What options are called that have another name than the library's settings.
_OPTION_OF = {
    "window_px": "window",
    "highest_frequency": "highest-frequency",
    "stride_px": "stride",
    "temporal_frames": "temporal",
}
_DEFAULTS = f"""the defaults are made for real time:
  A window of {_WINDOW} px, rank {_RANK} and a patch every {_STRIDE} px are about what
  `coded_aperture learn --budget-ms 33 --budget-threads 2` chose for frames of
  640x480 (every 21 px), and so are frequencies up to {_HIGHEST_FREQUENCY:g} cycles/px where no
  blur is smaller than 7 px. The line "accuracy" says what that costs: the mean
  error on the thesis' stair of 39 blur sizes (natural textures, noise 0.001, not
  regularised), over that of all filters and frequencies every 4 px.
"""
_EPILOG = f"""examples:
  everything, in a minute or two; a first look takes a quarter of that:
    coded_aperture bench speed
    coded_aperture bench speed --quick
  in one thread, with results and a figure in a folder:
    coded_aperture bench speed --threads 1 --output results/
  accurate instead of fast:
    coded_aperture bench speed --rank 128 --stride 8 --highest-frequency 1

{_DEFAULTS}
p50 is the median, p99 the 99th percentile: of less than 100 frames, nearly the worst
--output writes {RESULTS} and {_FIGURE}
"""


def add_parser(subparsers: Any) -> None:
    """Add the benchmark to the parser of `bench`."""
    parser = subparsers.add_parser(
        "speed",
        help="of depth: stages, roofline, scaling, other methods",
        description="Time of the stages of depth estimation on a simulated moving scene seen "
        "through levin's mask; the share of the machine's own speed that they attain; how the "
        "time grows with the size, the levels and the threads; and what other methods take.",
        epilog=_EPILOG,
    )
    add_size_option(parser, _SIZE)
    add_numbers(
        parser,
        ("levels", 2, _LEVELS, "blur levels, from 7 to 30 px"),
        ("window", 16, _WINDOW, "side of the bank's patches, px"),
        ("rank", 1, _RANK, "vectors in the bank's common basis"),
        ("stride", 1, _STRIDE, "distance between patches, px"),
    )
    parser.add_argument(
        "--highest-frequency",
        type=float,
        default=_HIGHEST_FREQUENCY,
        metavar="F",
        help="frequencies above this, in cycles/px, are left out; 1: all count "
        f"(default {_HIGHEST_FREQUENCY:g})",
    )
    add_threads_option(parser)
    parser.add_argument(
        "--temporal",
        type=_not_negative,
        default=_TEMPORAL,
        metavar="T",
        help="frames of the video that evidence is kept for; 0: every frame for itself "
        f"(default {_TEMPORAL:g})",
    )
    parser.add_argument(
        "--frames",
        type=at_least(1),
        metavar="N",
        help="for every measurement; five times as many for the stages "
        f"(default {_FRAMES}, or {_QUICK_FRAMES} with --quick)",
    )
    parser.add_argument(
        "--full-size",
        action="store_true",
        help="maps as large as the frame (default: the largest whole fraction within 320x240, as "
        "the node publishes)",
    )
    parser.add_argument(
        "--quick", action="store_true", help="fewer sizes, levels and repetitions, no accuracy"
    )
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    parser.add_argument("--output", metavar="DIR", help=f"write {RESULTS} and {_FIGURE}")
    parser.add_late_options = _add_backend


def _add_backend(parser: argparse.ArgumentParser) -> None:
    from coded_aperture_ros.likelihood import BACKENDS

    parser.add_argument(
        "--backend",
        choices=BACKENDS,
        default=_BACKEND,
        help="what computes the energies: torch needs PyTorch, cuda a GPU beside; auto takes the "
        f"GPU where there is one (default {_BACKEND})",
    )


def _not_negative(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"expected 0 to 1000, got {text}")
    return value


_not_negative.__name__ = "float"  # argparse says "invalid float value"


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    check_result_options(args)
    _check(args)
    from coded_aperture_benchmarks.speed import SpeedBenchmark

    start = time.perf_counter()
    benchmark = SpeedBenchmark(_setting(args), _extent(args))
    steps = benchmark.steps()
    for step in progress(steps, len(steps), "step"):
        step()
    results = {"benchmark": "speed", **benchmark.results()}
    results["seconds"] = round(time.perf_counter() - start, 1)
    report(args, results, lambda: _tables(results), lambda folder: _draw(results, folder))
    return 0


def _check(args: argparse.Namespace) -> None:
    """Refuse before a minute of work what would fail at its end."""
    if args.window % 2:
        args.usage_error(f"--window: expected an even number, got {args.window}")
    height, width = min(_sizes(args), key=min)
    if min(height, width) < args.window:
        args.usage_error(
            f"--size: frames of {width}x{height} px are smaller than the window of {args.window} px"
        )
    setting = _setting(args)
    try:
        # These check themselves, with check_threads and check_backend.
        _ = setting.learn_config, setting.depth_config
    except InputError as error:
        name, said = str(error).split(": ", 1)
        args.usage_error(f"--{_OPTION_OF.get(name, name)}: {said}")


def _sizes(args: argparse.Namespace) -> tuple[tuple[int, int], ...]:
    return (args.size, *(_QUICK_SIZES if args.quick else _SIZES))


def _setting(args: argparse.Namespace) -> Any:
    from coded_aperture_benchmarks.speed import Setting

    return Setting(
        size=args.size,
        levels=args.levels,
        window_px=args.window,
        rank=args.rank,
        highest_frequency=args.highest_frequency,
        stride_px=args.stride,
        backend=args.backend,
        threads=args.threads,
        temporal_frames=args.temporal,
        full_size=args.full_size,
    )


def _extent(args: argparse.Namespace) -> Any:
    from coded_aperture_benchmarks.speed import Extent, has_test_pictures, thread_counts

    counts = thread_counts(processors())
    return Extent(
        frames=args.frames or (_QUICK_FRAMES if args.quick else _FRAMES),
        sizes=_sizes(args)[1:],
        levels=_QUICK_LEVEL_COUNTS if args.quick else _LEVEL_COUNTS,
        threads=tuple(sorted({1, counts[-1]})) if args.quick else counts,
        repeats=_QUICK_REPEATS if args.quick else _REPEATS,
        denoised=_QUICK_DENOISED if args.quick else _DENOISED,
        accuracy=not args.quick and has_test_pictures(),
    )


def _tables(results: dict[str, Any]) -> str:
    parts = [
        _stage_table(results),
        _roofline_table(results),
        _size_table(results["sizes"]),
        _level_table(results["levels"]),
        _thread_table(results["threads"]),
        _comparison_table(results["comparison"]),
        _accuracy_line(results),
        f"{results['seconds']:.0f} s in all",
    ]
    return "\n\n".join(parts)


def _stage_table(results: dict[str, Any]) -> str:
    setting, main = results["setting"], results["main"]
    total, memory, rate = main["total"], main["memory"], main["frames_per_second"]
    moved = main["per_pixel"]["bytes"]
    rows = [
        [stage, *_milliseconds(times), f"{moved.get(stage, 0):.1f}"]
        for stage, times in main["stages"].items()
    ]
    rows.append(["total", *_milliseconds(total), f"{moved['total']:.1f}"])
    flop = main["per_pixel"]["flop"]
    return (
        f"{_size(main['size'])} frames to {_size(main['map_size'])} maps, {setting['levels']} "
        f"levels; window {setting['window_px']} px, rank {setting['rank']}, stride "
        f"{setting['stride_px']} px, up to {setting['highest_frequency']:g} cycles/px; "
        f"{setting['backend']}, {setting['threads']} of {results['machine']['processors']} "
        f"threads; {total['samples']} frames; ms\n"
        + table(["stage", *_TIMES, "bytes/pixel"], rows)
        + f"\nframes per second: {rate['p50']:.1f} from p50, {rate['sustained']:.1f} sustained "
        "(all frames in all their time)"
        f"\n{flop['total']:.0f} FLOP/pixel: spectra {flop['spectra']:.0f}, "
        f"hypotheses {flop['hypotheses']:.0f}"
        f"\nmemory: {memory['peak_mib']:.0f} MiB at most, {memory['planned_mib']:.1f} MiB by "
        f"planning and the first frame, {memory['growth_mib']:+.1f} MiB since"
    )


def _roofline_table(results: dict[str, Any]) -> str:
    machine, main = results["machine"], results["main"]
    rates = (
        f"this machine, {machine['threads']} thread(s): {machine['gemm_gflop_s']:.1f} GFLOP/s "
        f"(median {machine['gemm_p50_gflop_s']:.1f}) in float32 matrix products, "
        f"{machine['copy_gb_s']:.1f} GB/s (median {machine['copy_p50_gb_s']:.1f}) copying"
    )
    if main["roofline"] is None:
        return f"{rates}\nroofline: not known, a GPU computes"
    rows = [
        [
            f"{name} ({what})",
            f"{line['gflop']:.2f}",
            f"{line['mb']:.1f}",
            f"{line['bound_ms']:.1f}",
            line["limited_by"],
            f"{main[key]['p50_ms']:.1f}",
            f"{100 * line['attained']:.0f} %",
        ]
        for name, key, what in (
            ("engine", "engine", "spectra + energies"),
            ("frame", "total", "all stages"),
        )
        for line in (main["roofline"][name],)
    ]
    header = ["roofline", "GFLOP", "MB", "bound, ms", "limit", "p50, ms", "attained"]
    return f"{rates}\n{table(header, rows)}"


def _size_table(sizes: dict[str, Any]) -> str:
    rows = [
        [
            _size(row["size"]),
            _size(row["map_size"]),
            *_milliseconds(row["total"]),
            f"{row['engine_p50_ms']:.1f}",
            f"{row['time_per_pixel_relative']:.2f}",
        ]
        for row in sizes["rows"]
    ]
    return f"time ~ pixels^{sizes['slope']:.2f} (engine {sizes['slope_engine']:.2f}); ms\n" + table(
        ["size", "map", *_TIMES, "engine p50", "per pixel, relative"], rows
    )


def _level_table(levels: dict[str, Any]) -> str:
    rows = [
        [
            f"{row['levels']:.0f}",
            *_milliseconds(row["total"]),
            f"{row['level_stages_p50_ms']:.1f}",
        ]
        for row in levels["rows"]
    ]
    return (
        f"time ~ levels^{levels['exponent']:.2f} "
        f"(energies, temporal and regularise {levels['exponent_of_level_stages']:.2f}); ms\n"
        + table(["levels", *_TIMES, "of levels p50"], rows)
    )


def _thread_table(threads: dict[str, Any]) -> str:
    rows = [
        [
            str(row["threads"]),
            *_milliseconds(row["total"]),
            *(
                f"{row[name][which]:.2f}"
                for name in ("speedup", "speedup_engine")
                for which in ("p50", "p99")
            ),
        ]
        for row in threads["rows"]
    ]
    speedups = ["speed-up p50", "p99", "engine's p50", "p99"]
    return "against one thread; ms\n" + table(["threads", *_TIMES, *speedups], rows)


def _comparison_table(comparison: dict[str, Any]) -> str:
    thesis = comparison["thesis"]
    rows = [["bank: spectra + energies", *_milliseconds(thesis["engine"]), "", ""]]
    for key, name in (
        ("unfactored", "thesis' filters, unfactored *"),
        ("common_basis", "thesis' common basis *"),
    ):
        rows.append([name, *_milliseconds(thesis[key]["times"]), *_ratios(thesis[key]["ratio"])])
    if denoising := comparison["denoising"]:
        own = _milliseconds(denoising["still_and_temporal"])
        rows.append(["still + temporal", *own, "", ""])
        rows += [
            [
                f"fastNlMeansDenoisingMulti, {row['frames']} frames",
                *_milliseconds(row["times"]),
                *_ratios(row["ratio"]),
            ]
            for row in denoising["non_local_means"]
        ]
    notes = [
        f"* extrapolated, {name}: {thesis[key]['extrapolated']}; at every pixel, where the bank "
        f"has {thesis['pixels_per_patch']:.0f} pixels per patch: per place it is "
        f"{thesis[key]['ratio_per_place']['p50']:.1f} times"
        for key, name in (("unfactored", "unfactored"), ("common_basis", "common basis"))
    ]
    if cut := comparison["graph_cut"]:
        rows.append(["regularise: semiglobal", *_milliseconds(cut["semiglobal"]), "", ""])
        rows.append(["graph cut", *_milliseconds(cut["graphcut"]), *_ratios(cut["ratio"])])
    else:
        notes.append("graph cut: not measured, PyMaxflow is not installed")
    return "\n".join(
        [
            "against other methods; ms",
            table(["compared", *_TIMES, "p50 ratio", "p99 ratio"], rows),
            *notes,
        ]
    )


def _accuracy_line(results: dict[str, Any]) -> str:
    accuracy, window_px = results["accuracy"], results["setting"]["window_px"]
    if accuracy is None:
        return (
            "accuracy: not measured (it is left out with --quick, and without the pictures of "
            "scikit-image and scikit-learn)"
        )
    return (
        f"accuracy: mean error {accuracy['level_error']:.2f} levels on the thesis' stair, "
        f"{accuracy['ratio']:.2f} times the {accuracy['reference_level_error']:.2f} of all "
        f"filters and frequencies every 4 px (same window, {window_px} px)"
    )


def _milliseconds(times: dict[str, Any]) -> Sequence[str]:
    return [_number(times[f"{name}_ms"]) for name in _TIMES]


def _ratios(ratio: dict[str, float]) -> Sequence[str]:
    return [f"x {_number(ratio[name])}" for name in ("p50", "p99")]


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 1000 else f"{value:.1f}"


def _size(size: Sequence[int]) -> str:
    return f"{size[1]}x{size[0]}"


def _draw(results: dict[str, Any], folder: Path) -> None:
    from coded_aperture_benchmarks import plots

    plots.speed(results, folder / _FIGURE)
