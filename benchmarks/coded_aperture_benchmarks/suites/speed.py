"""How long a frame takes, and why."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.run import RESULTS, Row, Suite
from coded_aperture_benchmarks.speed import (
    Extent,
    Setting,
    SpeedBenchmark,
    has_test_pictures,
    thread_counts,
)
from coded_aperture_benchmarks.speed.figures import draw_speed
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.text_table import columns, table
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.likelihood import BACKENDS

_FIGURE = "speed.png"
# A bank for real time at these blur sizes.
_LEVELS, _WINDOW, _RANK, _STRIDE, _HIGHEST_FREQUENCY = 30, 64, 64, 24, 0.4
_FRAMES, _QUICK_FRAMES = 20, 6
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


def _cells(args: options.Args) -> list[Callable[[], Any]]:
    """Return the steps of the benchmark; what it has found is the result of the last one."""
    options.check_window(args)
    sizes = (args.size, *(_QUICK_SIZES if args.quick else _SIZES))
    height, width = min(sizes, key=min)
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
    counts = thread_counts(processors())
    quick = args.quick
    extent = Extent(
        frames=args.frames or (_QUICK_FRAMES if quick else _FRAMES),
        sizes=sizes[1:],
        levels=_QUICK_LEVEL_COUNTS if quick else _LEVEL_COUNTS,
        threads=tuple(sorted({1, counts[-1]})) if quick else counts,
        repeats=_QUICK_REPEATS if quick else _REPEATS,
        denoised=_QUICK_DENOISED if quick else _DENOISED,
        accuracy=not quick and has_test_pictures(),
        quick=quick,
    )
    benchmark = SpeedBenchmark(setting, extent)
    return [*benchmark.steps(), benchmark.results]


def _setting(args: options.Args) -> Setting:
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


def measure(step: Callable[[], Any]) -> Any:
    """Do one step."""
    return step()


def _results(_: options.Args, found: list[Any]) -> Row:
    return {**found[-1]}


def _text(results: Row) -> str:
    return "\n\n".join(
        [
            _grid_table(results["grid"]),
            _stage_table(results),
            _roofline_table(results),
            _size_table(results["sizes"]),
            _level_table(results["levels"]),
            _thread_table(results["threads"]),
            _comparison_table(results["comparison"]),
            accuracy_line(results),
            f"{results['seconds']:.0f} s in all",
        ]
    )


def _grid_table(rows: list[Row]) -> str:
    stages = list(dict.fromkeys(stage for row in rows for stage in row["stages"]))

    def of_stage(stage: str) -> Callable[[Row], str]:
        return lambda row: _number(row["stages"][stage]) if stage in row["stages"] else ""

    described = {
        "stride": "{stride_px}",
        "size": lambda row: _size(row["size"]),
        "frames": lambda row: "colour" if row["colour"] else "grey",
        "levels by": "{regularize}",
        **{stage: of_stage(stage) for stage in stages},
        "p50": lambda row: _number(row["total"]["p50_ms"]),
        "p99": lambda row: _number(row["total"]["p99_ms"]),
        "fps": "{frames_per_second:.1f}",
        "engine / GEMM": lambda row: f"{100 * row['engine_of_gemm']:.0f} %",
    }
    title = "depth as nodes estimate it: the bank that `learn` makes, full-size maps; ms"
    return f"{title}\n{columns(rows, described)}"


def _stage_table(results: Row) -> str:
    setting, main = results["setting"], results["main"]
    total, memory, rate = main["total"], main["memory"], main["frames_per_second"]
    moved, flop = main["per_pixel"]["bytes"], main["per_pixel"]["flop"]
    stages = {**main["stages"], "total": total}
    rows = [
        [stage, *_milliseconds(times), f"{moved.get(stage, 0):.1f}"]
        for stage, times in stages.items()
    ]
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


def _roofline_table(results: Row) -> str:
    machine, main = results["machine"], results["main"]
    rates = (
        "this machine, {threads} thread(s): {gemm_gflop_s:.1f} GFLOP/s (median "
        "{gemm_p50_gflop_s:.1f}) in float32 matrix products, {copy_gb_s:.1f} GB/s (median "
        "{copy_p50_gb_s:.1f}) copying"
    ).format_map(machine)
    if main["roofline"] is None:
        return f"{rates}\nroofline: not known, a GPU computes"
    rows = [
        {**main["roofline"][name], "name": title, "p50_ms": main[key]["p50_ms"]}
        for name, key, title in (
            ("engine", "engine", "engine (spectra + energies)"),
            ("frame", "total", "frame (all stages)"),
        )
    ]
    described = {
        "roofline": "{name}",
        "GFLOP": "{gflop:.2f}",
        "MB": "{mb:.1f}",
        "bound, ms": "{bound_ms:.1f}",
        "limit": "{limited_by}",
        "p50, ms": "{p50_ms:.1f}",
        "attained": lambda row: f"{100 * row['attained']:.0f} %",
    }
    return f"{rates}\n{columns(rows, described)}"


def _size_table(sizes: Row) -> str:
    described = {
        "size": lambda row: _size(row["size"]),
        "map": lambda row: _size(row["map_size"]),
        **_TOTAL,
        "engine p50": "{engine_p50_ms:.1f}",
        "per pixel, relative": "{time_per_pixel_relative:.2f}",
    }
    title = "time ~ pixels^{slope:.2f} (engine {slope_engine:.2f}); ms".format_map(sizes)
    return f"{title}\n{columns(sizes['rows'], described)}"


def _level_table(levels: Row) -> str:
    described = {"levels": "{levels:.0f}", **_TOTAL, "of levels p50": "{level_stages_p50_ms:.1f}"}
    title = (
        "time ~ levels^{exponent:.2f} (energies, temporal and decode "
        "{exponent_of_level_stages:.2f}); ms"
    ).format_map(levels)
    return f"{title}\n{columns(levels['rows'], described)}"


def _thread_table(threads: Row) -> str:
    described = {
        "threads": "{threads}",
        **_TOTAL,
        "speed-up p50": "{speedup[p50]:.2f}",
        "p99 ": "{speedup[p99]:.2f}",
        "engine's p50": "{speedup_engine[p50]:.2f}",
        " p99": "{speedup_engine[p99]:.2f}",
    }
    return f"against one thread; ms\n{columns(threads['rows'], described)}"


def _comparison_table(comparison: Row) -> str:
    thesis, denoising = comparison["thesis"], comparison["denoising"]
    named = (
        ("unfactored", "unfactored", "thesis' filters, unfactored *"),
        ("common_basis", "common basis", "thesis' common basis *"),
    )
    rows = [["bank: spectra + energies", *_milliseconds(thesis["engine"]), "", ""]]
    rows += [
        _compared(title, thesis[key]["times"], thesis[key]["ratio"]) for key, _, title in named
    ]
    if denoising:
        own = _milliseconds(denoising["still_and_temporal"])
        rows.append(["static average + temporal", *own, "", ""])
        rows += [
            _compared(
                f"fastNlMeansDenoisingMulti, {row['frames']} frames", row["times"], row["ratio"]
            )
            for row in denoising["non_local_means"]
        ]
    notes = [
        f"* extrapolated, {name}: {thesis[key]['extrapolated']}; at every pixel, where the bank "
        f"has {thesis['pixels_per_patch']:.0f} pixels per patch: per place it is "
        f"{thesis[key]['ratio_per_place']['p50']:.1f} times"
        for key, name, _ in named
    ]
    if cut := comparison["graph_cut"]:
        rows.append(["decode: semiglobal", *_milliseconds(cut["semiglobal"]), "", ""])
        rows.append(_compared("graph cut", cut["graphcut"], cut["ratio"]))
    else:
        notes.append("graph cut: not measured, PyMaxflow is not installed")
    compared = table(["compared", *_TIMES, "p50 ratio", "p99 ratio"], rows)
    return "\n".join(["against other methods; ms", compared, *notes])


def _compared(title: str, times: Row, ratio: dict[str, float]) -> list[str]:
    return [title, *_milliseconds(times), *(f"x {_number(ratio[name])}" for name in _TIMES[:2])]


def accuracy_line(results: Row) -> str:
    """Say what the speed costs in accuracy."""
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


def _milliseconds(times: Row) -> list[str]:
    return [_number(times[f"{name}_ms"]) for name in _TIMES]


_TOTAL = {name: lambda row, key=f"{name}_ms": _number(row["total"][key]) for name in _TIMES}


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 1000 else f"{value:.1f}"


def _size(size: Sequence[int]) -> str:
    return f"{size[1]}x{size[0]}"


def _draw(_: options.Args, found: list[Any], folder: Path) -> None:
    draw_speed(found[-1], folder / _FIGURE)


def _frames_kept(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"expected 0 to 1000, got {text}")
    return value


_frames_kept.__name__ = "float"  # argparse says "invalid float value"

SUITE = Suite(
    name="speed",
    description="Time of the stages of depth estimation on a simulated moving scene seen through "
    "levin's mask; the share of the machine's own speed that they attain; how the time grows with "
    "the size, the levels and the threads; and what other methods take.",
    examples=f"""examples:
  everything, in a minute or two; a first look takes a quarter of that:
    coded_aperture bench speed
    coded_aperture bench speed --quick
  in one thread, with results and a figure in a folder:
    coded_aperture bench speed --threads 1 --output results/
  accurate instead of fast:
    coded_aperture bench speed --rank 128 --stride 8 --highest-frequency 1

the defaults are made for real time:
  A window of {_WINDOW} px, rank {_RANK}, a patch every {_STRIDE} px and frequencies up to
  {_HIGHEST_FREQUENCY:g} cycles/px suit frames of 640x480 and maps of half the size, where no
  blur is smaller than 7 px. The line "accuracy" says what that costs: the mean error on
  the thesis' stair of 39 blur sizes (natural textures, noise 0.001, not regularised),
  over that of all filters and frequencies every 4 px.

p50 is the median, p99 the 99th percentile: of less than 100 frames, nearly the worst
--output writes {RESULTS} and {_FIGURE}
""",
    options=(
        options.frame_size(480, 640),
        options.number("--levels", 2, _LEVELS, "blur levels, from 7 to 30 px"),
        options.number("--window", 16, _WINDOW, "side of the bank's patches, px"),
        options.number("--rank", 1, _RANK, "vectors in the bank's common basis"),
        options.number("--stride", 1, _STRIDE, "distance between patches, px"),
        options.option(
            "--highest-frequency",
            "frequencies above this, in cycles/px, are left out; 1: all count",
            _HIGHEST_FREQUENCY,
            type=float,
            metavar="F",
        ),
        options.THREADS,
        options.option(
            "--temporal",
            "frames of the video that costs are kept for; 0: every frame for itself",
            4.0,
            type=_frames_kept,
            metavar="T",
        ),
        options.number(
            "--frames",
            1,
            None,
            "for every measurement; five times as many for the stages "
            f"(default {_FRAMES}, or {_QUICK_FRAMES} with --quick)",
        ),
        options.option(
            "--full-size",
            "maps as large as the frame (default: the largest whole fraction within 320x240, "
            "a node's `output.size: auto`)",
            action="store_true",
        ),
        options.option(
            "--quick", "fewer sizes, levels and repetitions, no accuracy", action="store_true"
        ),
        options.option(
            "--backend",
            "what computes the costs: torch needs PyTorch, cuda a GPU beside; auto takes the GPU "
            "where there is one",
            "numpy",
            choices=BACKENDS,
        ),
        options.JSON,
        options.option("--output", f"write {RESULTS} and {_FIGURE}", metavar="DIR"),
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
