"""`coded_aperture bag`: depth and all-in-focus frames of a recorded bag, and how good they are."""

import argparse
import dataclasses
import functools
import logging
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from coded_aperture_ros.bags import check_bag_output
from coded_aperture_ros.bags.conversion import BagConversion
from coded_aperture_ros.bags.many import Job, Outcome, convert_jobs, plan_jobs, write_summary
from coded_aperture_ros.cli.command import Command, UsageError, argument, group
from coded_aperture_ros.cli.estimation import known_motion, make_pipeline
from coded_aperture_ros.cli.estimation_arguments import (
    ESTIMATION_RULES,
    FIXED_FRAME,
    FIXED_FRAME_HELP,
    EstimationArguments,
)
from coded_aperture_ros.cli.poses import check_no_gyroscope
from coded_aperture_ros.cli.reading import PixelArguments
from coded_aperture_ros.cli.results import Summary, input_files, print_summary
from coded_aperture_ros.cli.rules import excludes, only_with, required
from coded_aperture_ros.core.cluster import dask_client
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.leftovers import remove_leftovers
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text import listed
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig, no_depth_reason
from coded_aperture_ros.depth.stages.moving_camera import POSE
from coded_aperture_ros.depth.stages.temporal import VIDEO_FRAMES
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.pipeline import FramePipeline

_NAMESPACE = re.compile(r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*/?)?", re.ASCII)
_EXAMPLES = """examples:
  depth, confidence and all-in-focus frames beside the originals:
    coded_aperture bag recording -o results --bank bank.npz --camera camera.yaml
  compared with the depth that another camera recorded, depth only:
    coded_aperture bag recording -o scored --bank bank.npz --camera camera.yaml \\
        --reference-depth /ground_truth/depth --deblur none
  points of depth, for RViz, Foxglove and mapping:
    coded_aperture bag recording -o points --bank bank.npz --camera camera.yaml --points \
        --deblur none
  something moves during the exposures:
    coded_aperture bag recording -o moving --bank bank.npz --camera camera.yaml --motion
  the robot's /tf or odometry tells how the camera has moved:
    coded_aperture bag recording -o walked --bank bank.npz --camera camera.yaml \\
        --temporal-frames 8 --moving-camera pose --fixed-frame odom
  many bags, shared by the workers of a Dask scheduler; the same line again goes on where it stood:
    coded_aperture bag drives/* -o results --bank bank.npz --camera camera.yaml \\
        --scheduler tcp://host:8786
"""
# What does not change the results of a bag.
_NO_SETTINGS = {"inputs", "output", "overwrite", "json", "scheduler"}


def _ros_name(text: str) -> str:
    if not _NAMESPACE.fullmatch(text):
        raise argparse.ArgumentTypeError(
            "expected a ROS name such as /front/camera: letters, digits and _, no digit first, "
            f"got {text}"
        )
    return text


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(EstimationArguments, PixelArguments):
    """Arguments of `bag`."""

    inputs: tuple[str, ...] = argument("bag: its folder, or a .mcap or .db3 file", written="IN")
    output: str = argument(
        "folder of the new bag; with several, or --scheduler, of a folder for each that is not "
        "complete yet, and of a report over all",
        written="-o --output OUT",
    )
    scheduler: str | None = argument(
        "Dask scheduler, whose workers share the bags",
        None,
        written="--scheduler ADDRESS",
        daily=False,
    )
    overwrite: bool = argument("replace what is a bag already", False)
    topic: str | None = argument(
        "of the coded frames, raw or compressed; by default the only images, or image_raw",
        None,
        written="--topic T",
    )
    reference_depth: str | None = argument(
        "depth images (32FC1 in m, 16UC1 in mm) of the same view to compare with",
        None,
        written="--reference-depth T",
    )
    namespace: str | None = argument(
        "of the results (default: that of the coded frames)",
        None,
        written="--namespace NAME",
        parse=_ros_name,
        daily=False,
    )
    motion: bool = argument(
        "estimate motion blur too, with --method bank, so that it does not pass for blur by "
        "defocus: depth/motion has the way during the exposure, px, to the right and down (32FC2); "
        "--deblur cg and sparse remove it too",
        False,
    )
    deblur: str = argument(
        "how all-in-focus frames are made, see deblur --help",
        "fast",
        choices=("fast", "inverse", "cg", "sparse", "none"),
    )
    deblur_rank: int = argument(
        "kernels of the closed forms: fewer is faster", 10, written="--deblur-rank N", daily=False
    )
    deblur_band: str = argument(
        "frequencies that --deblur fast works on: half is faster, and leaves the finest details as "
        "they are",
        "full",
        choices=("full", "half"),
        daily=False,
    )
    points: bool = argument(
        "a cloud of coloured points, too: depth/points, with confidence and std_dev, in the "
        "camera's optical frame",
        False,
    )
    output_size: str = argument(
        "of the depth images, in parts of the frame; auto: at most 320x240",
        "full",
        choices=("full", "half", "quarter", "auto"),
    )
    fixed_frame: str = argument(FIXED_FRAME_HELP, FIXED_FRAME, written="--fixed-frame NAME")
    json: bool = argument("print the results as JSON", False)
    estimation: DepthConfig = group("estimation", DepthConfig(temporal_frames=VIDEO_FRAMES))


_RULES = (
    required("--camera"),
    *ESTIMATION_RULES,
    only_with("--fixed-frame", "--moving-camera pose"),
    excludes("--deblur none", "--deblur-rank", "--deblur-band"),
)


def run(args: Arguments) -> int:
    """Write the new bag, or bags; return the exit status."""
    check_no_gyroscope(args.estimation)
    if len(args.inputs) > 1 or args.scheduler:
        return _convert_all(args)
    source = Path(args.inputs[0])
    results = _convert(args, source, Path(args.output))
    for line in _warnings(source, results):
        logging.warning(line)
    print_summary(results, _text, as_json=args.json)
    return _log_without_depth(source, results)


def _convert(args: Arguments, source: Path, target: Path, threads: int = 0) -> dict[str, Any]:
    """Convert a bag, in this process alone if `threads` says how many are for it."""
    check_bag_output(target, [source, *input_files(args.bank, camera=args.camera)], args.overwrite)
    conversion = BagConversion(
        topic=args.topic,
        reference_topic=args.reference_depth,
        namespace=args.namespace,
        camera=load_camera(str(args.camera)),
        new_pipeline=functools.partial(_new_pipeline, args),
        gamma=args.gamma,
        bits=args.bits,
        mosaic=args.bayer,
        points=args.points,
        fixed_frame=args.fixed_frame if args.estimation.moving_camera == POSE else "",
        map_size=args.output_size,
        prior=functools.partial(known_motion, args),
        settings=_settings(args),
        # Frames of a video go through one pipeline, in their order.
        processes=1 if threads or args.estimation.temporal_frames else 0,
        threads=threads,
    )
    return conversion.run(source, target, lambda steps, total: progress(steps, total, "frame"))


def _new_pipeline(args: Arguments, camera: Camera) -> FramePipeline:
    deblur = None
    if args.deblur != "none":
        deblur = DeblurConfig(args.deblur, rank=args.deblur_rank, band=args.deblur_band)
    return make_pipeline(args, camera, deblur)


def _warnings(source: Path, results: Summary) -> Iterator[str]:
    """Lines about a bag whose results are not as good as they might be."""
    if results["damage"]:
        yield f"{source}: read as far as it can be: {results['damage']}"
    if results["left_out"]:
        yield f"{source}: left out of the new bag: {listed(results['left_out'])}"
    for reason, count in results["camera_info"].items():
        yield f"{source}: {reason} ({count} message(s))"
    reference = results["reference"]
    if reference is not None and reference["paired_by_recording"]:
        yield (
            f"{source}: {reference['paired_by_recording']} frame(s) compared with the depth image "
            f"of {reference['topic']} that was recorded nearest to them: stamps do not tell which "
            "one belongs to them (none, repeated, or of another clock)"
        )
    for fault, reason in results["fault_reasons"].items():
        yield f"{results['faults'][fault]} frame(s) not used ({fault}): {reason}"
    if reference is not None and reference["complaint"]:
        yield f"{source}, {reference['topic']}: {reference['complaint']}"


def _log_without_depth(source: Path, results: Summary) -> int:
    """Log an error if no frame of a bag has depth; return the exit status."""
    depth = results["depth"]
    if depth["coverage"]:
        return 0
    logging.error(f"{source}: no frame has depth: {no_depth_reason(depth['misfits'])}")
    return 1


def _settings(args: Arguments) -> dict[str, Any]:
    """What the results depend on, by the names of the options, as JSON has it."""
    settings: dict[str, Any] = {}
    for field in dataclasses.fields(args):
        value = getattr(args, field.name)
        if dataclasses.is_dataclass(value):
            settings |= vars(value)
        elif field.name not in _NO_SETTINGS:
            settings[field.name] = list(value) if isinstance(value, tuple) else value
    return settings


def _convert_all(args: Arguments) -> int:
    """Convert several bags, those that are not complete yet; return the exit status."""
    # A worker may be elsewhere.
    bank = args.bank and str(Path(args.bank).resolve())
    camera = args.camera and str(Path(args.camera).resolve())
    args = dataclasses.replace(args, bank=bank, camera=camera)
    jobs = plan_jobs(map(Path, args.inputs), Path(args.output))
    # A bag that was about to be replaced has its name again.
    remove_leftovers(Path(args.output))
    left = [job for job in jobs if args.overwrite or not job.done(_settings(args))]
    processes = 1 if args.scheduler else _bags_at_once(args, len(left))
    threads = processors() // processes if processes > 1 else 0
    convert = functools.partial(_outcome, args, 1 if args.scheduler else threads)
    with dask_client(args.scheduler) if args.scheduler else nullcontext() as client:
        outcomes = dict(progress(convert_jobs(convert, left, processes, client), len(left), "bag"))
    for line in dict.fromkeys(line for each in outcomes.values() for line in each.warnings):
        logging.warning(line)
    failed = {job: outcome.failure for job, outcome in outcomes.items() if outcome.failure}
    for job, reason in failed.items():
        logging.error(f"{job.source}: {reason}")
    results = write_summary(Path(args.output), jobs, failed, len(jobs) - len(left))
    print_summary(results, _text_of_all, as_json=args.json)
    done = [job for job in jobs if job not in failed]
    without = [_log_without_depth(job.source, job.report()) for job in done]
    return int(bool(failed) or any(without))


def _bags_at_once(args: Arguments, count: int) -> int:
    """Return the number of processes with a bag each.

    Fewer bags than processors are better worked on one after the other, with their frames shared
    among all processors, which frames of a video cannot be.
    """
    if count < processors() and not args.estimation.temporal_frames:
        return 1
    return max(1, min(count, processors()))


def _outcome(args: Arguments, threads: int, job: Job) -> Outcome:
    """Convert a bag, perhaps far from who asked for it, unless its results are complete."""
    if threads:
        os.environ["TQDM_DISABLE"] = "1"  # the program shows how far all bags are
    with _logged() as lines:
        try:
            # Another worker may have done it, and died before saying so.
            if args.overwrite or not job.done(_settings(args)):
                lines.extend(_warnings(job.source, _convert(args, job.source, job.target, threads)))
        except (InputError, UsageError) as error:
            return Outcome(str(error), tuple(lines))
    return Outcome("", tuple(lines))


@contextmanager
def _logged() -> Iterator[list[str]]:
    """Collect warnings, which a worker has nobody to show to."""
    lines: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: lines.append(record.getMessage())  # type: ignore[method-assign]
    root = logging.getLogger()
    before = root.handlers
    root.handlers = [handler]
    try:
        yield lines
    finally:
        root.handlers = before


def _text_of_all(results: Summary) -> str:
    bags = f"{len(results['bags'])} bags, {results['complete_before']} of them complete before"
    frames = f"depth of {results['used']} of {results['frames']} frames"
    return f"{results['output']}: {bags}; {frames}\nreport: {results['report']}"


def _text(results: Summary) -> str:
    timing, depth, reference = results["timing"], results["depth"], results["reference"]
    speed = f"{timing['frames_per_second']:.1f} frames/s"
    if timing["times_real_time"]:
        speed += f", {timing['times_real_time']:.1f} times real time"
    lines = [
        f"{results['output']}: {results['used']} of {results['frames']} frames, depth at "
        f"{100 * depth['coverage']:.0f} % of the pixels; {speed}"
    ]
    if reference is not None and reference["median_relative_error"] is not None:
        lines.append(
            f"against {reference['topic']}: median error "
            f"{100 * reference['median_relative_error']:.2f} %, "
            f"{100 * reference['within_10_percent']:.0f} % of the depths within 10 %, "
            f"{reference['frames']} frames"
        )
    lines.append(f"report: {results['report']}")
    return "\n".join(lines)


COMMAND = Command(
    Arguments,
    run,
    description="Work on every frame of a ROS 2 bag (MCAP or SQLite, also one that was cut off), "
    "without ROS. Into the new bag, of the same storage, all messages are copied, and beside the "
    "frames come depth/image, depth/confidence, depth/std_dev, depth/camera_info, deblurred/image "
    "and deblurred/camera_info, with --points depth/points, in the camera's namespace and with its "
    "stamps. The bag's folder also gets report/report.html and report/report.json.",
    examples=_EXAMPLES,
    rules=_RULES,
)
