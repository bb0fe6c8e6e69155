"""`coded_aperture bench deblur speed`: how long a frame takes to become all-in-focus."""

import argparse
import json
import time
from collections.abc import Sequence
from typing import Any

from coded_aperture_benchmarks.commands.bench_deblur_methods import own_methods
from coded_aperture_benchmarks.commands.bench_options import add_size_option, add_threads_option
from coded_aperture_ros.cli.options import at_least, table
from coded_aperture_ros.cli.progress import progress

_SIZE = (480, 640)
# Of the demo's camera: what a robot meets from 2 to 5 m.
_BLUR_SIZES_PX, _LEVELS = (3.0, 20.0), 30
_METHODS = ("fast", "cg")
# About as many seconds for each method.
_FRAMES = {"fast": 60, "cg": 5}
_EPILOG = """examples:
  the closed form and conjugate gradients, grey and in colour:
    coded_aperture bench deblur speed
  the closed form only, on a larger frame, in one thread:
    coded_aperture bench deblur speed --methods fast --size 1280x720 --threads 1
"""


def add_parser(subparsers: Any) -> None:
    """Add this frame to the parser of `bench deblur`."""
    parser = subparsers.add_parser(
        "speed",
        help="how long a frame takes",
        description="Time of deblurring simulated frames through levin's mask, of blur sizes from "
        f"{_BLUR_SIZES_PX[0]:g} to {_BLUR_SIZES_PX[1]:g} px ({_LEVELS} levels), by a map of half "
        "their size, as depth_node publishes it. The noise is estimated in each frame. What is "
        "made once for a camera is not counted.",
        epilog=_EPILOG,
    )
    parser.add_argument(
        "--methods",
        nargs="+",
        default=_METHODS,
        metavar="METHOD",
        help=f"as of the command deblur (default {' '.join(_METHODS)})",
    )
    add_size_option(parser, _SIZE)
    add_threads_option(parser)
    parser.add_argument(
        "--count",
        type=at_least(1),
        metavar="N",
        help=f"frames to measure (default: {_FRAMES['fast']} for fast, {_FRAMES['cg']} for others)",
    )
    parser.add_argument(
        "--backend",
        default="numpy",
        metavar="NAME",
        help="what cg computes with: numpy, torch, cuda or auto (default numpy)",
    )
    parser.add_argument("--json", action="store_true", help="print the results as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    for method in args.methods:
        if method not in own_methods():
            args.usage_error(
                f"--methods: unknown method {method!r}, use some of {', '.join(own_methods())}"
            )
    from coded_aperture_benchmarks.speed.machine import opencv_threads
    from coded_aperture_ros.likelihood import check_backend

    check_backend(args.backend)

    cases = [(method, colour) for method in args.methods for colour in (False, True)]
    with opencv_threads(args.threads):
        rows = [_measure(args, *case) for case in progress(cases, len(cases), "case")]
    results = {
        "benchmark": "deblur speed",
        "size": list(args.size),
        "threads": args.threads,
        "backend": args.backend,
        "cells": rows,
    }
    print(json.dumps(results, indent=1) if args.json else _table(results))
    return 0


def _measure(args: argparse.Namespace, method: str, colour: bool) -> dict[str, Any]:
    import dataclasses

    import numpy as np

    from coded_aperture_benchmarks.speed.frames import moving_frames
    from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
    from coded_aperture_ros.metrics.times import Times
    from coded_aperture_ros.optics import Mask, render_psf_stack

    stack = render_psf_stack(Mask.named("levin"), np.linspace(*_BLUR_SIZES_PX, _LEVELS))
    videos = [moving_frames(stack, args.size, seed=seed) for seed in range(3 if colour else 1)]
    frames = [np.dstack(channels) for channels in zip(*videos, strict=True)]
    rows, columns = (-(-length // 2) for length in args.size)
    # The simulated scene lies in four upright bands, each at a depth of its own.
    bands = np.arange(columns) * 4 // columns
    blur = stack.blur_sizes_px[np.linspace(0, _LEVELS - 1, 4).round().astype(int)][bands]
    blur_map = np.tile(blur.astype(np.float32), (rows, 1))
    config = DeblurConfig(method=method, threads=args.threads, backend=args.backend)
    deblurrer = Deblurrer(stack, config)
    seconds = []
    count = args.count or _FRAMES.get(method, _FRAMES["cg"])
    for number in range(count + 1):
        frame = np.ascontiguousarray(np.squeeze(frames[number % len(frames)]))
        start = time.perf_counter()
        deblurrer.deblur(frame, blur_map)
        seconds.append(time.perf_counter() - start)
    deblurrer.close()
    # The first frame has to wait for what is made once.
    times = Times.of(seconds[1:])
    return {"method": method, "channels": 3 if colour else 1, **dataclasses.asdict(times)}


def _table(results: dict[str, Any]) -> str:
    lines: Sequence[Sequence[str]] = [
        [
            row["method"],
            "colour" if row["channels"] == 3 else "grey",
            f"{row['p50_ms']:.1f}",
            f"{row['p99_ms']:.1f}",
            f"{1000 / row['p50_ms']:.1f}",
        ]
        for row in results["cells"]
    ]
    rows, columns = results["size"]
    return f"frames of {columns}x{rows} px, {results['threads']} threads\n" + table(
        ["method", "channels", "p50 ms", "p99 ms", "frames/s"], lines
    )
