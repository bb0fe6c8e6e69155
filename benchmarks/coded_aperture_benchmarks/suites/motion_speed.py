"""What motion costs beside defocus alone."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from coded_aperture_benchmarks.datasets import moving_scenes as frames
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.options import JSON, OUTPUT, Args, frame_size, number
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.text import columns
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import Frame
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.likelihood.motion import MotionConfig, MotionModel, learn_motion_bank
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.optics.rotation import expected_motion

# Of a robot that turns, rad/s, and its exposure, s.
_RATE, _EXPOSURE_S = (0.05, 0.4, 0.1), 0.015
_ALONE = "defocus alone"
_COLUMNS = {"": "{way}", "ms": "{ms:.1f}", "over defocus alone": "{over_defocus:.2f}"}

# By name, what is timed.
Ways = dict[str, Callable[[], Any]]


def _cells(args: Args) -> list[Ways]:
    """Return all ways again and again: they take turns on the same frame."""
    rows, width = args.size
    camera = dataclasses.replace(
        frames.scene_camera(Mask.named("levin")), image_width=width, image_height=rows
    )
    bank = learn_bank_for_camera(camera, frames.NEAR_M, frames.FAR_M, args.levels)
    settings = MotionConfig()
    motion_bank = learn_motion_bank(bank, settings.motions, settings.motion_rank)
    config = DepthConfig(stride_px=args.stride, threads=1)
    alone = DepthEstimator(bank, config, camera)
    together = DepthEstimator(MotionModel(motion_bank, settings), config, camera)
    expected = expected_motion(_RATE, _EXPOSURE_S, camera.intrinsics)
    frame = _frame(rows, width)
    ways: Ways = {
        _ALONE: lambda: alone.estimate(frame),
        f"{len(motion_bank.motions) - 1} motions": lambda: together.estimate(frame),
        "expected motions": lambda: together.estimate(Frame(frame, motion=expected)),
    }
    return [ways] * (args.repeats + 1)


def _frame(rows: int, width: int) -> Any:
    random = np.random.default_rng(0)
    picture = load_textures("natural").crops(1, 300, 300, random)[0]
    frame = np.pad(picture, ((0, max(rows - 300, 0)), (0, max(width - 300, 0))), "reflect")
    noise = np.float32(0.002) * random.standard_normal((rows, width))
    return (frame[:rows, :width] + noise).astype(np.float32)


def measure(ways: Ways) -> dict[str, float]:
    """Return the processor time of each way, s."""
    seconds = {}
    for name, way in ways.items():
        start = time.process_time()
        way()
        seconds[name] = time.process_time() - start
    return seconds


def _results(args: Args, turns: list[dict[str, float]], _: float) -> Row:
    # The first frame pays for the plan.
    median = {name: float(np.median([turn[name] for turn in turns[1:]])) for name in turns[0]}
    cells = [
        {"way": name, "ms": round(1000 * each, 1), "over_defocus": round(each / median[_ALONE], 2)}
        for name, each in median.items()
    ]
    return {"benchmark": "motion speed", "size": list(args.size), "cells": cells}


SUITE = Suite(
    description="Median processor time of a frame, one thread: of defocus alone, with all "
    "motions, and with those that a gyroscope lets expect. The three take turns on the same frame.",
    examples="""examples:
  640x480, 30 levels, 64 motions:
    python -m coded_aperture_benchmarks motion speed
  with the patches of depth maps that are twice as fine:
    python -m coded_aperture_benchmarks motion speed --stride 8
""",
    options=(
        frame_size(480, 640),
        number("--levels", 2, 30, "blur levels"),
        number("--stride", 1, 16, "distance between patches, px"),
        number("--repeats", 3, 15, "frames of each"),
        JSON,
        OUTPUT,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=lambda results: columns(results["cells"], _COLUMNS),
)
