"""`coded_aperture depth`: depth maps from coded frames."""

import dataclasses
import json
import logging
import time
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.cli.command import Command, UsageError
from coded_aperture_ros.cli.depth_arguments import EXAMPLES, RULES, Arguments, layers_text
from coded_aperture_ros.cli.depth_pictures import (
    comparison_file,
    depth_scale,
    frame_beside_depth,
    picture_files,
    write_pictures,
)
from coded_aperture_ros.cli.depth_video import look_ahead, with_second_focus
from coded_aperture_ros.cli.estimation import estimates_motion, known_motion, make_pipeline
from coded_aperture_ros.cli.frames import (
    InputsWithoutDepth,
    NamedFrame,
    SkippedInputs,
    named_frames,
)
from coded_aperture_ros.cli.poses import with_poses
from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.files import Outputs, check_output, output_set
from coded_aperture_ros.core.text import rounded
from coded_aperture_ros.depth import DepthEstimate, Health, depth_range_m
from coded_aperture_ros.depth.files import estimate_files, write_estimate
from coded_aperture_ros.depth.points import points_of_frame
from coded_aperture_ros.io.movie_file import movie
from coded_aperture_ros.io.points_file import write_points
from coded_aperture_ros.likelihood.choose import filter_bank
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.optics.camera_file import camera_files
from coded_aperture_ros.pipeline import FramePipeline

_SUFFIXES = (".npy", ".tif", ".tiff", ".png")
_LOSSY = (
    "%s: compressed with loss: reckoned with noise of about %.4f or more, and less depth is sure: "
    "record pictures without loss, such as PNG"
)
# What has moved by this much during the exposure counts as moving.
_MOVING_PX = 0.5


def run(args: Arguments) -> int:
    """Write the depth of every frame; return the exit status."""
    _check_output(args)
    camera = load_camera(args.camera) if args.camera else None
    resampled = args.frame_scale != 1
    if resampled and camera is not None:
        # Resampling changes the noise: it is estimated.
        camera = dataclasses.replace(camera, noise=0.0, noise_gain=0.0)
    pipeline = make_pipeline(
        args,
        camera,
        as_levels=args.as_levels,
        resampled=resampled,
        warns_of_sides=args.refocused_frame is None,
    )
    truth = None
    if args.truth:
        from coded_aperture_ros.cli.depth_truth import TrueDepth

        truth = TrueDepth.from_file(args.truth, depth_range_m(pipeline.model, pipeline.camera))
    skipped = SkippedInputs()
    outputs = Outputs(
        args.output, ".npy", _SUFFIXES, partial(_files_beside, args), _files_read(args)
    )
    without_depth = InputsWithoutDepth()
    summaries: list[dict[str, Any]] = []
    with movie(args.movie) if args.movie else nullcontext() as add_to_movie:
        frames = named_frames(args, outputs, skipped, camera)
        if args.estimation.moving_camera in ("pose", "gyro"):
            frames = with_poses(args, frames)
        for named, estimate, seconds in _estimates(args, pipeline, camera, frames, skipped):
            values = estimate.depth_values(as_levels=args.as_levels)
            if args.pictures or add_to_movie is not None:
                scale = depth_scale(pipeline.estimator, as_levels=args.as_levels)
            with output_set():
                _write(args, named, estimate, values, camera)
                if args.pictures:
                    # Depths of each frame have a scale of their own, which shows more.
                    ends = scale if args.as_levels else ()
                    write_pictures(named.output, values, estimate.confidence, ends)
            if add_to_movie is not None:
                add_to_movie(frame_beside_depth(named.frame.picture, values, scale))
            summary = _summary(args, named, estimate, values, seconds)
            if truth is not None:
                summary["truth"] = truth.compare(named.output, named.frame.picture, estimate)
            summaries.append(summary)
            without_depth.note(named, summary["median"] is not None, summary["cause"])
            if not args.json:
                print(f"{named.output}: {_text(summary)}")
        if args.movie and not summaries:
            skipped.status()  # says why; the movie only that it is empty
    if args.json:
        print(json.dumps(summaries))
    return max(skipped.status(), without_depth.status())


def _check_output(args: Arguments) -> None:
    """Refuse outputs that do not go with the options."""
    if args.as_levels and args.output.lower().endswith(".png"):
        raise InputError(f"{args.output}: a PNG has depths in mm, write levels to .npy or .tiff")
    if args.refocused_frame is not None and len(args.inputs) != 1:
        raise UsageError("--refocused-frame: needs one frame beside it")
    if args.movie:
        check_output(args.movie, map(Path, args.inputs), (".mp4",))


def _files_read(args: Arguments) -> list[Path]:
    """Files that the options name."""
    files = args.bank, args.refocused_frame, args.truth, args.poses
    given = [Path(path) for path in files if path]
    return [*given, *(camera_files(args.camera) if args.camera else ())]


def _estimates(
    args: Arguments,
    pipeline: FramePipeline,
    camera: Camera | None,
    frames: Iterable[NamedFrame],
    skipped: SkippedInputs,
) -> Iterator[tuple[NamedFrame, DepthEstimate, float]]:
    """Yield every frame, what is estimated of it, and how long that took, s; video by video."""
    bank = filter_bank(pipeline.estimator.model)
    motion = known_motion(args, camera)
    new_model = None if args.bank else lambda resized: make_pipeline(args, resized).model

    def suited(named: NamedFrame) -> NamedFrame:
        """Frame of the bank's size, for which the pipeline is made."""
        named = named.suited(bank, args.frame_scale)
        pipeline.fit(camera, named.frame, new_model)
        return named

    for _, video in groupby(frames, key=lambda named: named.video):
        told = _warn_if_lossy(video)
        if args.refocused_frame is not None and args.refocused_to is not None:
            second = args.refocused_frame, args.refocused_to
            yield with_second_focus(args, pipeline, told, suited, *second)
            continue
        if args.look_ahead:
            yield from look_ahead(pipeline, told, suited, skipped)
            continue
        pipeline.reset()
        for named in told:
            start = time.perf_counter()
            try:
                with naming(named.source):
                    named = suited(named)
                    # Pictures in a folder are a video in the order of their names.
                    frame = dataclasses.replace(named.frame, motion=motion, stamp_ns=None)
                    estimate = pipeline(frame, named.size)
            except InputError as error:
                skipped.note(error)
                continue
            yield named, estimate, time.perf_counter() - start


def _warn_if_lossy(video: Iterable[NamedFrame]) -> Iterator[NamedFrame]:
    """Yield the frames of a video; warn of the first one that was compressed with loss."""
    told = False
    for named in video:
        if named.frame.compression_noise and not told:
            logging.warning(_LOSSY, named.source, named.frame.compression_noise)
            told = True
        yield named


def _files_beside(args: Arguments, path: Path) -> list[Path]:
    """All files that belong to a depth map, and the map itself."""
    files = estimate_files(path, metric=not args.as_levels)
    if args.pictures:
        files += picture_files(path)
    if args.truth:
        files.append(comparison_file(path))
    if args.points:
        files.append(path.with_suffix(".ply"))
    return list(dict.fromkeys(files))


def _write(
    args: Arguments,
    named: NamedFrame,
    estimate: DepthEstimate,
    values: FloatArray,
    camera: Camera | None,
) -> None:
    """Write a depth map, and beside it everything else that was found."""
    path = named.output
    write_estimate(path, estimate, values, metric=not args.as_levels)
    if args.points and camera is not None and named.capture is not None:
        light, model = named.frame.picture, named.capture.intrinsics(camera)
        write_points(path.with_suffix(".ply"), points_of_frame(estimate, light, model, args.gamma))


def _summary(
    args: Arguments, named: NamedFrame, estimate: DepthEstimate, values: FloatArray, seconds: float
) -> dict[str, Any]:
    """What is known of a depth map, for JSON."""
    known = np.isfinite(values)
    std_dev_m = None if args.as_levels or estimate.std_dev_m is None else estimate.std_dev_m
    health = estimate.health
    summary = {
        "output": str(named.output),
        "unit": "level" if args.as_levels else "m",
        "known": round(float(known.mean()), 4),
        "median": _median(values, known),
        "median_std_dev_m": None if std_dev_m is None else _median(std_dev_m, known),
        "noise": round(estimate.noise, 6),
        "health": None if health is None else round(health.value, 3),
        "cause": "" if health is None else health.cause,
        "seconds": round(seconds, 3),
    }
    if estimates_motion(args):
        motion = estimate.layers["motion"]
        moving = np.linalg.norm(motion.values, axis=-1) >= _MOVING_PX
        summary["moving"] = round(float(moving.mean()), 4)
        summary["searched"] = motion.note
    return summary


def _median(values: FloatArray, known: BoolArray) -> float | None:
    return rounded(float(np.median(values[known])), 4) if known.any() else None


def _text(summary: dict[str, Any]) -> str:
    if summary["median"] is None:
        why = "" if summary["cause"] else " (too dark, saturated, or without texture)"
        found = f"depth unknown everywhere{why}"
    else:
        median = f"{summary['median']:.4g} {summary['unit']}"
        found = f"depth at {100 * summary['known']:.0f} % of the pixels, median {median}"
        if summary["median_std_dev_m"] is not None:
            found += f", standard deviation {summary['median_std_dev_m']:.2g} m"
    if "moving" in summary:
        found += f", {100 * summary['moving']:.0f} % moving"
        if summary["searched"] not in ("", "nothing expected"):
            found += f" (all motions tried: {summary['searched']})"
    if "truth" in summary:
        from coded_aperture_ros.cli.depth_truth import truth_text

        found += f"; {truth_text(summary['truth'])}"
    if summary["cause"]:
        found += f"; {Health(summary['health'], summary['cause'])}"
    return f"{found}; noise {summary['noise']:.4f}, {summary['seconds']:.2f} s"


COMMAND = Command(
    Arguments,
    run,
    description="Estimate the depth of every pixel of coded frames. Beside each depth map x.npy "
    "its confidence, 0 to 1, is written to x.confidence.npy; where that is low, the depth is "
    "unknown (NaN, or 0 in a 16-bit PNG). In m, its standard deviation goes to x.std_dev.npy. "
    "What else the options ask for, or the levels tell, is written beside them, see below; what is "
    "of depths in m, not with --as-levels.",
    examples=f"{layers_text()}\n\n{EXAMPLES}",
    rules=RULES,
)
