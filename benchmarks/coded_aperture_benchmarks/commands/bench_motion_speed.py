"""`coded_aperture bench motion speed`: what motion costs beside defocus alone."""

import argparse
import time
from typing import Any

from coded_aperture_benchmarks.commands.bench_options import (
    add_size_option,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import add_numbers, table
from coded_aperture_ros.cli.progress import progress

_SIZE = (480, 640)
# Of a robot that turns, rad/s, and its exposure, s.
_RATE, _EXPOSURE_S = (0.05, 0.4, 0.1), 0.015
_EPILOG = """examples:
  640x480, 30 levels, 64 motions:
    coded_aperture bench motion speed
  with the patches of depth maps that are twice as fine:
    coded_aperture bench motion speed --stride 8
"""


def add_parser(subparsers: Any) -> None:
    """Add these frames to the parser of `bench motion`."""
    parser = subparsers.add_parser(
        "speed",
        help="time of a frame with and without motion",
        description="Median processor time of a frame, one thread: of defocus alone, with all "
        "motions, and with those that a gyroscope lets expect. The three take turns on the same "
        "frame.",
        epilog=_EPILOG,
    )
    add_size_option(parser, _SIZE)
    add_numbers(
        parser,
        ("levels", 2, 30, "blur levels"),
        ("stride", 1, 16, "distance between patches, px"),
        ("repeats", 3, 15, "frames of each"),
    )
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    parser.add_argument("--output", metavar="DIR", help="write the results into this folder")


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    import dataclasses

    import numpy as np

    from coded_aperture_benchmarks import moving_scenes as frames
    from coded_aperture_ros.bank import learn_bank_for_camera
    from coded_aperture_ros.depth import DepthConfig, DepthEstimator
    from coded_aperture_ros.io.textures import load_textures
    from coded_aperture_ros.methods.motion import (
        MotionConfig,
        MotionModel,
        expected_motion,
        learn_motion_bank,
    )
    from coded_aperture_ros.optics import Mask

    check_result_options(args)
    rows, columns = args.size
    camera = dataclasses.replace(
        frames.scene_camera(Mask.named("levin")), image_width=columns, image_height=rows
    )
    bank = learn_bank_for_camera(camera, frames.NEAR_M, frames.FAR_M, args.levels)
    settings = MotionConfig()
    motion_bank = learn_motion_bank(bank, settings.motions, settings.motion_rank)
    config = DepthConfig(stride_px=args.stride)
    alone = DepthEstimator(bank, config, camera)
    together = DepthEstimator(MotionModel(motion_bank, settings), config, camera)
    expected = expected_motion(_RATE, _EXPOSURE_S, camera.intrinsics)
    random = np.random.default_rng(0)
    picture = load_textures("natural").crops(1, 300, 300, random)[0]
    frame = np.pad(picture, ((0, max(rows - 300, 0)), (0, max(columns - 300, 0))), "reflect")
    frame = frame[:rows, :columns] + np.float32(0.002) * random.standard_normal((rows, columns))
    frame = frame.astype(np.float32)
    ways = {
        "defocus alone": lambda: alone.estimate(frame),
        f"{len(motion_bank.motions) - 1} motions": lambda: together.estimate(frame),
        "expected motions": lambda: together.estimate(frame, prior=expected),
    }
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in progress(range(args.repeats + 1), args.repeats + 1, "frame"):
        for name, way in ways.items():
            start = time.process_time()
            way()
            times[name].append(time.process_time() - start)
    # The first frame pays for the plan.
    median = {name: float(np.median(seconds[1:])) for name, seconds in times.items()}
    base = median["defocus alone"]
    cells: list[dict[str, Any]] = [
        {"way": name, "ms": round(1000 * each, 1), "over_defocus": round(each / base, 2)}
        for name, each in median.items()
    ]
    report(
        args,
        {"benchmark": "motion speed", "size": list(args.size), "cells": cells},
        lambda: table(
            ["", "ms", "over defocus alone"],
            [[cell["way"], f"{cell['ms']:.1f}", f"{cell['over_defocus']:.2f}"] for cell in cells],
        ),
    )
    return 0
