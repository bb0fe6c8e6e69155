"""How long a frame behind a simple mask takes, and why."""

import dataclasses
import time

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.speed.frames import moving_frames
from coded_aperture_benchmarks.speed.setting import published_size
from coded_aperture_benchmarks.thesis.stair import blur_stack
from coded_aperture_ros.core.text import columns
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood.two_pixel import SimpleConfig, find_holes, neighbour_model
from coded_aperture_ros.metrics.times import Times
from coded_aperture_ros.optics import Mask, load_mask

_REGULARIZED = ("none", "semiglobal", "graphcut")
_WINDOWS = (48, 64, 96, 128)
# Holes in general position, so that no two pairs of them are parallel: N (N - 1) / 2 lines.
_SCATTERED = ((0, 3), (5, 19), (19, 7), (14, 0), (2, 12))
_GRID, _HOLE = 24, 4
# The tables: rows of the results, the title, and the columns that tell the rows apart.
_TABLES = {
    "regularize": ("regularisation", ("regularize",)),
    "holes": ("holes in general position, not regularised", ("holes", "neighbours")),
    "window": ("window, not regularised", ("window_px",)),
}


@dataclasses.dataclass(frozen=True)
class Cell:
    """A line of one of the tables: what tells it apart, and what is timed."""

    names: Row
    mask: Mask
    window_px: int
    config: DepthConfig
    levels: int
    size: tuple[int, int]
    map_size: tuple[int, int]
    frames: int


def _cells(args: options.Args) -> list[Cell]:
    mask = load_mask(args.mask)
    find_holes(mask)
    SimpleConfig(window_px=args.window)
    if min(args.size) < args.window:
        args.usage_error(f"--size: smaller than the window of {args.window} px")

    def cell(names: Row, mask: Mask, window_px: int, regularize: str) -> Cell:
        config = DepthConfig(stride_px=args.stride, threads=args.threads, regularize=regularize)
        sizes = (args.size, published_size(args.size, args.full_size))
        return Cell(names, mask, window_px, config, args.levels, *sizes, args.frames)

    return [
        *(cell({"regularize": how}, mask, args.window, how) for how in _REGULARIZED),
        *(
            cell(
                {"holes": count, "neighbours": count * (count - 1)},
                scattered_holes(count),
                args.window,
                "none",
            )
            for count in range(2, len(_SCATTERED) + 1)
        ),
        *(cell({"window_px": px}, mask, px, "none") for px in _WINDOWS if px <= min(args.size)),
    ]


def scattered_holes(count: int) -> Mask:
    """Return a mask of equal holes of which no two pairs are parallel; 2 to 5 of them."""
    cells = np.zeros((_GRID, _GRID), np.float32)
    for row, column in _SCATTERED[:count]:
        cells[row : row + _HOLE, column : column + _HOLE] = 1
    return Mask(f"{count} scattered holes", cells)


def measure(cell: Cell) -> Row:
    """Time frames of a moving scene behind a mask."""
    stack = blur_stack(cell.mask, cell.levels)
    model = neighbour_model(stack, cell.mask, SimpleConfig(window_px=cell.window_px))
    estimator = DepthEstimator(model, cell.config)
    frames = moving_frames(stack, cell.size)
    estimator.estimate(frames[0], cell.map_size)  # plans
    seconds: list[float] = []
    stages: dict[str, list[float]] = {}
    for number_ in range(cell.frames):
        start = time.perf_counter()
        estimate = estimator.estimate(frames[number_ % len(frames)], cell.map_size)
        seconds.append(time.perf_counter() - start)
        for stage, taken in estimate.seconds.items():
            stages.setdefault(stage, []).append(taken)
    estimator.close()
    times = Times.from_seconds(seconds)
    return {
        **cell.names,
        "lines": len(model.lines),
        "products": model.derivatives * len(model.lags),
        "p50_ms": round(times.p50_ms, 2),
        "p99_ms": round(times.p99_ms, 2),
        "frames_per_second": round(1000 / times.p50_ms, 1),
        "stages_ms": {
            stage: round(Times.from_seconds(taken).p50_ms, 2) for stage, taken in stages.items()
        },
    }


def _results(args: options.Args, rows: list[Row], seconds: float) -> Row:
    return {
        "benchmark": "simple-speed",
        "size": [args.size[1], args.size[0]],
        **options.header(args, "mask", "levels", "window"),
        "stride_px": args.stride,
        "threads": args.threads,
        "frames_measured": args.frames,
        **{name: [row for row in rows if names[0] in row] for name, (_, names) in _TABLES.items()},
        "seconds": seconds,
    }


def _text(results: Row) -> str:
    width, height = results["size"]
    parts = [
        f"{width}x{height}, {results['mask']}, {results['levels']} levels, window "
        f"{results['window_px']} px, a window every {results['stride_px']} px, "
        f"{results['threads']} threads; ms of a frame, median"
    ]
    for name, (title, names) in _TABLES.items():
        rows = results[name]
        described = {
            **{each: f"{{{each}}}" for each in names},
            "lines": "{lines}",
            "products": "{products}",
            "p50": "{p50_ms:.1f}",
            "p99": "{p99_ms:.1f}",
            "frames/s": "{frames_per_second:.1f}",
            **{stage: f"{{stages_ms[{stage}]:.1f}}" for stage in rows[0]["stages_ms"]},
        }
        parts.append(f"{title}\n{columns(rows, described)}")
    return "\n\n".join(parts)


SUITE = Suite(
    description="Time of a frame by the method for simple masks: without regularisation, with the "
    "fast one and with graph cuts; and how the time of the statistics grows with the number of "
    "holes and with the window.",
    examples="""examples:
  640x480, 33 levels, two holes, on all processors:
    python -m coded_aperture_benchmarks simple-speed
  four holes, and a window every 16 px:
    python -m coded_aperture_benchmarks simple-speed --mask four_hole --stride 16
""",
    options=(
        options.frame_size(480, 640),
        options.option("--mask", "name or file", "two_hole", metavar="MASK"),
        options.number("--levels", 2, 33, "blur levels, from 7 to 30 px"),
        options.number("--window", 32, 48, "side of the windows, a multiple of 8, px"),
        options.number("--stride", 1, 8, "distance between the windows, px"),
        options.number("--threads", 1, processors(), "threads of the processor"),
        options.number("--frames", 1, 20, "frames for every measurement"),
        options.option(
            "--full-size",
            "maps as large as the frame (default: within 320x240, a node's `output.size: auto`)",
            action="store_true",
        ),
        options.JSON,
        options.OUTPUT,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
