"""How long a frame takes to become all-in-focus."""

import dataclasses
import itertools
import time

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.methods.deblurring import own_methods
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.speed.frames import moving_frames
from coded_aperture_benchmarks.speed.machine import opencv_threads
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.metrics.times import Times
from coded_aperture_ros.optics import Mask, render_psf_stack

# Of the demo's camera: what a robot meets from 2 to 5 m.
_BLUR_SIZES_PX, _LEVELS = (3.0, 20.0), 30
_METHODS = ("fast", "cg")
# About as many seconds for each method.
_FRAMES = {"fast": 60, "cg": 5}
_COLUMNS = {
    "method": "{method}",
    "channels": lambda row: "colour" if row["channels"] == 3 else "grey",
    "p50 ms": "{p50_ms:.1f}",
    "p99 ms": "{p99_ms:.1f}",
    "frames/s": lambda row: f"{1000 / row['p50_ms']:.1f}",
}


@dataclasses.dataclass(frozen=True)
class Cell:
    """Frames of one size and number of channels, and how they are deblurred."""

    config: DeblurConfig
    size: tuple[int, int]
    channels: int
    count: int


def _cells(args: options.Args) -> list[Cell]:
    options.check_known(args, "methods", args.methods, own_methods())
    return [
        Cell(
            DeblurConfig(method=method, threads=args.threads),
            args.size,
            channels,
            args.count or _FRAMES.get(method, _FRAMES["cg"]),
        )
        for method, channels in itertools.product(args.methods, (1, 3))
    ]


def measure(cell: Cell) -> Row:
    """Deblur frame after frame, with a map of half their size."""
    stack = render_psf_stack(Mask.named("levin"), np.linspace(*_BLUR_SIZES_PX, _LEVELS))
    videos = [moving_frames(stack, cell.size, seed=seed) for seed in range(cell.channels)]
    frames = [np.squeeze(np.dstack(channels)) for channels in zip(*videos, strict=True)]
    rows, width = (-(-length // 2) for length in cell.size)
    # The simulated scene lies in four upright bands, each at a depth of its own.
    bands = np.arange(width) * 4 // width
    blur = stack.blur_sizes_px[np.linspace(0, _LEVELS - 1, 4).round().astype(int)][bands]
    blur_map = np.tile(blur.astype(np.float32), (rows, 1))
    deblurrer = Deblurrer(stack, cell.config)
    seconds = []
    with opencv_threads(cell.config.threads):
        for number_ in range(cell.count + 1):
            frame = np.ascontiguousarray(frames[number_ % len(frames)])
            start = time.perf_counter()
            deblurrer.deblur(frame, blur_map)
            seconds.append(time.perf_counter() - start)
    deblurrer.close()
    # The first frame has to wait for what is made once.
    times = Times.from_seconds(seconds[1:])
    return {"method": cell.config.method, "channels": cell.channels, **dataclasses.asdict(times)}


def _results(args: options.Args, rows: list[Row]) -> Row:
    return {"size": list(args.size), "cells": rows}


def _text(results: Row) -> str:
    rows, width = results["size"]
    title = f"frames of {width}x{rows} px, {results['threads']} threads"
    return f"{title}\n{columns(results['cells'], _COLUMNS)}"


SUITE = Suite(
    name="deblur speed",
    said=("threads", "backend"),
    description="Time of deblurring simulated frames through levin's mask, of blur sizes from "
    f"{_BLUR_SIZES_PX[0]:g} to {_BLUR_SIZES_PX[1]:g} px ({_LEVELS} levels), by a map of half "
    "their size. The noise is estimated in each frame. What is made once for a camera is not "
    "counted.",
    examples="""examples:
  the closed form and conjugate gradients, grey and in colour:
    coded_aperture bench deblur speed
  the closed form only, on a larger frame, in one thread:
    coded_aperture bench deblur speed --methods fast --size 1280x720 --threads 1
""",
    options=(
        options.option("--methods", "as of the command deblur", _METHODS, metavar="METHOD"),
        options.frame_size(480, 640),
        options.THREADS,
        options.number(
            "--count",
            1,
            None,
            f"frames to measure (default: {_FRAMES['fast']} for fast, {_FRAMES['cg']} for others)",
        ),
        options.option(
            "--backend",
            "what cg computes with: numpy, torch, cuda or auto",
            "numpy",
            metavar="NAME",
        ),
        options.JSON,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
