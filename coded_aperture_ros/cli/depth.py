"""`coded_aperture depth`: depth maps from coded frames."""

import argparse
import dataclasses
import json
import logging
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from itertools import groupby, tee
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output
from coded_aperture_ros.cli.estimators import (
    add_estimator_options,
    add_estimator_settings,
    check_estimator_options,
    expected_motion_of,
    fit_camera,
    pipeline_of,
)
from coded_aperture_ros.cli.frames import (
    NamedFrame,
    Unusable,
    add_input_options,
    named_frames,
    single_frame,
    suitable,
)
from coded_aperture_ros.cli.measuring import rounded
from coded_aperture_ros.cli.options import add_gamma_option, add_options, written_name
from coded_aperture_ros.core.arguments import between
from coded_aperture_ros.core.errors import InputError, naming

_SUFFIXES = (".npy", ".tif", ".tiff", ".png")
_EPILOG = """examples:
  one frame, depth in metres and confidence as .npy, and a picture of both:
    coded_aperture depth --bank bank.npz coded.png -o depth.npy --pictures
  all frames of a folder:
    coded_aperture depth --bank bank.npz --regularize graphcut frames/ -o depth/
  a recorded video, each frame together with those before and after it:
    coded_aperture depth --bank bank.npz --temporal-frames 3 --look-ahead video.avi -o depth/
  a mask of a few equal holes, without a bank:
    coded_aperture depth --method simple --camera config/example_camera.yaml \\
        --depth-range 3.5 9 coded.png -o simple.npy
  two frames of one view, the second with the lens focused at 2 m:
    coded_aperture depth --bank bank.npz --camera camera.yaml coded.png \\
        --refocused-frame refocused.png --refocused-to 2 -o depth.npy
  something moves during the exposure: its motion, px, as [row, column, right and down]:
    coded_aperture depth --bank bank.npz --motion coded.png -o moving.npy
"""
_NOT_ASKED = "nothing expected"
_LOSSY = (
    "%s: compressed with loss: reckoned with noise of about %.4f or more, and less depth is sure: "
    "record pictures without loss, such as PNG"
)
# Beyond so many times the nearest depth hardly any are told apart: scales end there.
_FARTHEST = 10
# What has moved by this much during the exposure counts as moving.
_MOVING_PX = 0.5
_Frames = Iterator[NamedFrame]
_Fit = Callable[[NamedFrame], NamedFrame]
# Each frame, what is estimated of it, and how long that took, s.
_Results = Iterator[tuple[NamedFrame, Any, float]]


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "depth",
        help="estimate depth from coded frames",
        description="Estimate the depth of every pixel of coded frames. Beside each depth "
        "map x.npy its confidence, 0 to 1, is written to x.confidence.npy; where that is low, the "
        "depth is unknown (NaN, or 0 in a 16-bit PNG). In m, its standard deviation goes to "
        "x.std_dev.npy, the bound of --free-space-risk to x.free_space.npy, and --second-surface "
        "to x.second.npy and x.second_share.npy (not with --as-levels). With levels on both sides "
        "of the focal plane (side: both), x.side.npy has the probability that the side is right.",
        epilog=_EPILOG,
    )
    add_input_options(
        parser, "depth map: .npy or .tiff in m, .png in mm; or a folder for one .npy per frame"
    )
    add_estimator_options(
        parser,
        motion=": x.motion.npy beside x.npy has the way during the exposure in px, [row, column, "
        "right and down], and x.motion.confidence.npy how sure it is",
    )
    look_ahead = {
        "--look-ahead": "with --temporal-frames N: for recorded videos, and pictures in order. "
        "Each frame is estimated together with those after it, as far as with those before it "
        "(default: only those before it). About 8 N frames are held in memory"
    }
    as_levels = {"--as-levels": "write fractional level indices instead of metres"}
    add_options(parser, look_ahead)
    add_options(parser, as_levels)
    second = {"--refocused-frame FILE": "a frame of the same view with the lens focused elsewhere"}
    add_options(parser, second)
    focus = {"--refocused-to M": "with --refocused-frame and --camera: distance of its focus, m"}
    add_options(parser, focus, type=between(0.001, 100_000))
    add_options(parser, {"--pictures": "write colour pictures of depth and confidence too"})
    movie = "write a video of the frames beside their depth too, 10 a second"
    add_options(parser, {"--movie FILE.mp4": movie})
    add_options(parser, {"--points": "write coloured points (x.ply) too; needs --camera"})
    add_gamma_option(parser)
    scale = {
        "--frame-scale S": "resample frames by S, best below 1, to the size that bank and camera "
        "file are for; maps keep the frames' own size (default %(default)s)"
    }
    add_options(parser, scale, type=between(0.1, 10), default=1.0)
    add_options(parser, {"--json": "print a summary as JSON"})
    parser.add_late_options = add_estimator_settings


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    from coded_aperture_ros.depth.points import points_of_frame
    from coded_aperture_ros.io.movie_file import movie
    from coded_aperture_ros.io.points_file import write_points
    from coded_aperture_ros.likelihood.choose import bank_of
    from coded_aperture_ros.optics import load_camera

    _check_usage(args)
    camera = load_camera(args.camera) if args.camera else None
    if args.frame_scale != 1 and camera is not None:
        # Resampling changes the noise: it is estimated.
        camera = dataclasses.replace(camera, noise=0.0, noise_gain=0.0)
    pipeline = pipeline_of(args, camera)
    prior = expected_motion_of(args, camera)
    both_sides = pipeline.estimator.model.stack.has_both_sides
    files = partial(_files, args=args, both_sides=both_sides)
    unusable, bank = Unusable(), bank_of(pipeline.estimator.model)

    def fit(found: NamedFrame) -> NamedFrame:
        frame = suitable(found, bank, args.frame_scale)
        fit_camera(args, pipeline, camera, frame.frame.light)
        return frame

    shown: AbstractContextManager[Any] = movie(args.movie) if args.movie else nullcontext()
    scale = _scale(args, pipeline.estimator)
    frames = named_frames(args, ".npy", _SUFFIXES, lambda path: files(path).values(), unusable)
    summaries: list[dict[str, Any]] = []
    with shown as add_to_movie:
        for _, grouped in groupby(frames, key=lambda frame: frame.video):
            pipeline.reset()
            video = _told_if_lossy(grouped)
            if args.refocused_frame:
                results = _with_second(pipeline, video, fit, args)
            elif args.look_ahead:
                results = _with_look_ahead(pipeline, video, fit, unusable)
            else:
                results = _in_turn(pipeline, video, prior, fit, unusable)
            for frame, estimate, seconds in results:
                values = estimate.depth_m
                if args.as_levels or values is None:
                    values = estimate.level
                _write(files(frame.output), values, estimate, args, scale)
                if args.points and camera is not None:
                    points = points_of_frame(estimate, frame.frame.picture, camera, args.gamma)
                    write_points(files(frame.output)["points"], points)
                if add_to_movie is not None:
                    add_to_movie(_beside(frame.frame.picture, values, scale))
                summary = _summary(frame, values, estimate, seconds, args)
                summaries.append(summary)
                if not args.json:
                    print(f"{frame.output}: {_in_words(summary)}")
    if args.json:
        print(json.dumps(summaries))
    return unusable.status()


def _check_usage(args: argparse.Namespace) -> None:
    """Refuse options that do not go together, or with the output."""
    check_estimator_options(args)
    if args.look_ahead and not args.temporal_frames:
        args.usage_error("--look-ahead: needs --temporal-frames above 0 too")
    if args.look_ahead and args.angular_velocity is not None:
        args.usage_error("--look-ahead: not with --angular-velocity, which is of one frame")
    if args.as_levels and args.output.lower().endswith(".png"):
        raise InputError(f"{args.output}: a PNG has depths in mm, write levels to .npy or .tiff")
    if args.points and (args.as_levels or not args.camera):
        args.usage_error("--points: needs --camera, and no --as-levels")
    if args.frame_scale != 1 and (args.look_ahead or args.motion):
        args.usage_error("--frame-scale: not with --look-ahead or --motion")
    if (args.refocused_frame is None) != (args.refocused_to is None):
        args.usage_error("--refocused-frame: needs --refocused-to too, and the other way round")
    if args.refocused_frame is not None:
        if args.camera is None or len(args.inputs) != 1:
            args.usage_error("--refocused-frame: needs --camera, and one frame beside it")
        for name in ("motion", "temporal_frames", "as_levels"):
            if getattr(args, name):
                args.usage_error(f"--refocused-frame: not with {written_name(name)}")
        if args.frame_scale != 1 or args.method != "bank":
            args.usage_error("--refocused-frame: not with --frame-scale or --method simple")
    if args.movie:
        check_output(args.movie, map(Path, args.inputs), (".mp4",))


def _told_if_lossy(video: _Frames) -> _Frames:
    """Yield the frames of a video; warn of the first one that was compressed with loss."""
    told = False
    for frame in video:
        if frame.frame.compression_noise and not told:
            logging.warning(_LOSSY, frame.source, frame.frame.compression_noise)
            told = True
        yield frame


def _in_turn(pipeline: Any, frames: _Frames, prior: Any, fit: _Fit, unusable: Unusable) -> _Results:
    """Yield every frame, what is estimated of it, and how long that took, s."""
    for found in frames:
        start = time.perf_counter()
        try:
            with naming(found.source):
                frame = fit(found)
                # Pictures in a folder are a video in the order of their names, whatever the time.
                light = dataclasses.replace(frame.frame, motion=prior, stamp_ns=None)
                estimate = pipeline(light, frame.size)
        except InputError as error:
            unusable.note(error)
            continue
        yield frame, estimate, time.perf_counter() - start


def _with_second(pipeline: Any, frames: _Frames, fit: _Fit, args: argparse.Namespace) -> _Results:
    """Yield the only frame, and what is estimated of it together with the second one."""
    from coded_aperture_ros.depth.focus_pair import FocusPair

    frame, *others = frames
    if others:
        raise InputError(f"{args.inputs[0]}: expected one frame beside --refocused-frame")
    start = time.perf_counter()
    with naming(frame.source):
        fit(frame)
    second = single_frame(args.refocused_frame, args)
    with naming(args.refocused_frame):
        pair = FocusPair(pipeline.estimator, args.refocused_to)
        estimate = pair.estimate(frame.frame, second, frame.size)
    pair.close()
    yield frame, estimate, time.perf_counter() - start


def _with_look_ahead(pipeline: Any, frames: _Frames, fit: _Fit, unusable: Unusable) -> _Results:
    """Do the same with frames that are estimated several at a time: the first takes the time."""
    from coded_aperture_ros.depth.video import check_same_size

    waiting: deque[NamedFrame] = deque()
    unreadable: list[InputError] = []

    def suited() -> _Frames:
        shape: Any = None
        try:
            for frame in frames:
                try:
                    with naming(frame.source):
                        check_same_size(frame.frame.shape, shape or frame.frame.shape)
                        fit(frame)
                except InputError as error:
                    unusable.note(error)
                    continue
                shape = frame.frame.shape
                waiting.append(frame)
                yield frame
        except InputError as error:
            unreadable.append(error)  # the frames before it are finished first

    first, named = tee(suited())
    next(first, None)  # the pipeline is made for its size before it begins
    del first  # or it would keep all of them
    results = pipeline.video(frame.frame for frame in named)
    while True:
        start = time.perf_counter()
        try:
            result = next(results, None)
        except InputError as error:
            raise InputError(f"{waiting[-1].source}: {error}") from error
        if result is None:
            break
        yield waiting.popleft(), result[1], time.perf_counter() - start
    if unreadable:
        raise unreadable[0]


def _summary(
    frame: NamedFrame, values: Any, estimate: Any, seconds: float, args: argparse.Namespace
) -> dict[str, Any]:
    import numpy as np

    known = np.isfinite(values)
    summary: dict[str, Any] = {
        "output": str(frame.output),
        "unit": "level" if args.as_levels else "m",
        "known": round(float(known.mean()), 4),
        "median": rounded(np.median(values[known]), 4) if known.any() else None,
        "median_std_dev_m": None,
        "noise": round(estimate.noise, 6),
        "health": None if estimate.health is None else round(estimate.health.value, 3),
        "cause": "" if estimate.health is None else estimate.health.cause,
        "seconds": round(seconds, 3),
    }
    if not args.as_levels and known.any():
        summary["median_std_dev_m"] = rounded(np.median(estimate.std_dev_m[known]), 4)
    if args.motion:
        motion = estimate.layers["motion"]
        moving = np.linalg.norm(motion.values, axis=-1) >= _MOVING_PX
        summary["moving"] = round(float(moving.mean()), 4)
        summary["searched"] = motion.note
    return summary


def _scale(args: argparse.Namespace, estimator: Any) -> tuple[float, float, str]:
    """Return ends and unit of the scale that all pictures of a video have: depths, or levels."""
    import numpy as np

    depths = estimator.depths_m
    if args.as_levels or depths is None:
        return 0.0, len(estimator.model.stack) - 1.0, ""
    nearest_m, farthest_m = np.nanmin(depths), np.nanmax(depths)
    return float(nearest_m), float(min(farthest_m, _FARTHEST * nearest_m)), "m"


def _beside(image: Any, values: Any, scale: tuple[float, float, str]) -> Any:
    """Return a frame, of any size, and its depth side by side, uint8 [h + strip, 2 w, RGB]."""
    import cv2
    import numpy as np

    from coded_aperture_ros.frames import SRGB, encode
    from coded_aperture_ros.io import depth_picture

    depth = depth_picture(values, *scale)
    light = cv2.resize(image, values.shape[::-1], interpolation=cv2.INTER_AREA)
    light = light if light.ndim == 3 else cv2.cvtColor(light, cv2.COLOR_GRAY2RGB)
    frame = np.full_like(depth, 255)
    frame[: len(light)] = np.rint(255 * encode(np.clip(light, 0, 1), SRGB))
    return np.hstack([frame, depth])


def _in_words(summary: dict[str, Any]) -> str:
    from coded_aperture_ros.depth import Health

    if summary["median"] is None:
        found = "depth unknown everywhere"
        if not summary["cause"]:
            found += " (too dark, saturated, or without texture)"
    else:
        median = f"{summary['median']:.4g} {summary['unit']}"
        found = f"depth at {100 * summary['known']:.0f} % of the pixels, median {median}"
        if summary["median_std_dev_m"] is not None:
            found += f", standard deviation {summary['median_std_dev_m']:.2g} m"
    if "moving" in summary:
        found += f", {100 * summary['moving']:.0f} % moving"
        if summary["searched"] not in ("", _NOT_ASKED):
            found += f" (all motions tried: {summary['searched']})"
    if summary["cause"]:
        found += f"; {Health(summary['health'], summary['cause'])}"
    return f"{found}; noise {summary['noise']:.4f}, {summary['seconds']:.2f} s"


def _files(path: Path, args: argparse.Namespace, both_sides: bool) -> dict[str, Path]:
    """Return the file of each result."""
    # A PNG cannot hold floating values.
    suffix = ".tiff" if path.suffix.lower() == ".png" else path.suffix
    ends = {"confidence": f".confidence{suffix}"}
    if not args.as_levels:
        ends["std_dev"] = f".std_dev{suffix}"
        if args.free_space_risk:
            ends["free_space"] = f".free_space{suffix}"
        if args.second_surface:
            ends |= {name: f".{name}{suffix}" for name in ("second", "second_share")}
    if args.pictures:
        ends |= {"picture": ".picture.png", "confidence picture": ".confidence.picture.png"}
    if args.points:
        ends["points"] = ".ply"
    if args.motion:
        ends |= {"motion": ".motion.npy", "motion confidence": ".motion.confidence.npy"}
    if both_sides:
        ends["side"] = f".side{'.npy' if suffix.lower() == '.npy' else '.tiff'}"
    return {"depth": path, **{name: path.with_suffix(end) for name, end in ends.items()}}


def _write(
    files: dict[str, Path], values: Any, estimate: Any, args: argparse.Namespace, scale: Any
) -> None:
    from coded_aperture_ros.io import confidence_picture, depth_picture, write_depth, write_image

    results = {"depth": values, "confidence": estimate.confidence}
    results["std_dev"] = estimate.std_dev_m
    for name in ("side", "free_space", "second", "second_share", "motion"):
        results[name] = estimate.values(name)
    results["motion confidence"] = estimate.values("motion/confidence")
    for name in results.keys() & files.keys():
        if results[name] is not None:  # as sides are that a second focus has told
            write_depth(files[name], results[name])
    if args.pictures:
        # Depths of each frame have a scale of their own, which shows more.
        write_image(files["picture"], depth_picture(values, *(scale if args.as_levels else ())))
        write_image(files["confidence picture"], confidence_picture(estimate.confidence))
