"""`coded_aperture bag`: depth and all-in-focus frames of a recorded bag, and how good they are."""

import argparse
import functools
import logging
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import inputs_of
from coded_aperture_ros.cli.estimators import (
    add_estimator_options,
    add_estimator_settings,
    check_estimator_options,
    expected_motion_of,
    pipeline_of,
)
from coded_aperture_ros.cli.measuring import tell
from coded_aperture_ros.cli.options import add_bits_option, add_gamma_option, add_options
from coded_aperture_ros.core.arguments import checked
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.workers import processors

_DEBLUR_RANK = 10
_NAMESPACE = re.compile(r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*/?)?", re.ASCII)
_EPILOG = """examples:
  depth, confidence and all-in-focus frames beside the originals:
    coded_aperture bag recording -o results --bank bank.npz --camera camera.yaml
  compared with the depth that another camera recorded, depth only:
    coded_aperture bag recording -o scored --bank bank.npz --camera camera.yaml \\
        --reference-depth /ground_truth/depth --deblur none
  something moves during the exposures:
    coded_aperture bag recording -o moving --bank bank.npz --camera camera.yaml --motion
  many bags, shared by the workers of a Dask scheduler; the same line again goes on where it stood:
    coded_aperture bag drives/* -o results --bank bank.npz --camera camera.yaml \\
        --scheduler tcp://host:8786
"""
# What does not change the results of a bag.
_NO_SETTINGS = {"command", "inputs", "output", "overwrite", "json", "scheduler"}


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "bag",
        help="estimate depth of a recorded bag, and score it",
        description="Work on every frame of a ROS 2 bag (MCAP or SQLite, also one that was cut "
        "off), without ROS. Into the new bag, of the same storage, all messages are copied, and "
        "beside the frames come depth/image, depth/confidence, depth/std_dev, "
        "depth/camera_info, deblurred/image and deblurred/camera_info, in the camera's namespace "
        "and with its stamps. The bag's folder also gets report/report.html and "
        "report/report.json.",
        epilog=_EPILOG,
    )
    bags = "bag: its folder, or a .mcap or .db3 file"
    parser.add_argument("inputs", metavar="IN", nargs="+", help=bags)
    each = "; with several, or --scheduler, of a folder for each that is not complete yet"
    output = {"-o --output OUT": f"folder of the new bag{each}, and of a report over all"}
    add_options(parser, output, required=True)
    topics = {
        "--scheduler ADDRESS": "Dask scheduler, whose workers share the bags",
        "--overwrite": "replace what is a bag already",
        "--topic T": "of the coded frames, raw or compressed; by default the only images, or "
        "image_raw",
        "--reference-depth T": "depth images (32FC1 in m, 16UC1 in mm) of the same view to compare "
        "with",
    }
    add_options(parser, topics)
    namespace = {"--namespace NAME": "of the results (default: that of the coded frames)"}
    allowed = "a ROS name such as /front/camera: letters, digits and _, no digit first"
    ros_name = checked(str, lambda name: bool(_NAMESPACE.fullmatch(name)), allowed)
    add_options(parser, namespace, type=ros_name)
    add_estimator_options(
        parser,
        motion=", so that it does not pass for blur by defocus: depth/motion has the way during "
        "the exposure, px, to the right and down (32FC2); --deblur cg and sparse remove it too",
    )
    method = {
        "--deblur {fast,inverse,cg,sparse,none}": "how all-in-focus frames are made, see deblur "
        "--help (default %(default)s)"
    }
    rank = {"--deblur-rank N": "kernels of the closed forms: fewer is faster (default %(default)s)"}
    sizes = {
        "--deblur-band {full,half}": "frequencies that --deblur fast works on: half is faster, and "
        "leaves the finest details as they are (default %(default)s)",
        "--output-size {full,half,quarter,auto}": "of the depth images, in parts of the frame; "
        "auto: at most 320x240 (default %(default)s)",
    }
    add_options(parser, method)
    add_options(parser, rank, type=int, default=_DEBLUR_RANK)
    add_options(parser, sizes)
    add_gamma_option(parser)
    add_bits_option(parser)
    add_options(parser, {"--json": "print the results as JSON"})
    parser.add_late_options = _add_settings


def _add_settings(parser: argparse.ArgumentParser) -> None:
    from coded_aperture_ros.depth.stages.temporal import VIDEO_FRAMES

    add_estimator_settings(parser, temporal_frames=VIDEO_FRAMES)


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    check_estimator_options(args)
    if args.camera is None:
        args.usage_error("the following arguments are required: --camera")
    if args.deblur == "none" and (args.deblur_rank, args.deblur_band) != (_DEBLUR_RANK, "full"):
        args.usage_error("--deblur none takes neither --deblur-rank nor --deblur-band")
    if len(args.inputs) > 1 or args.scheduler:
        return _convert_all(args)
    results = _convert(args, Path(args.inputs[0]), Path(args.output))
    for line in _warnings(Path(args.inputs[0]), results):
        logging.warning(line)
    return tell(args, results, _in_words)


def _convert(
    args: argparse.Namespace, source: Path, target: Path, threads: int = 0
) -> dict[str, Any]:
    """Convert a bag, in this process alone if `threads` says how many are for it."""
    from coded_aperture_ros.bags import check_bag_output
    from coded_aperture_ros.bags.conversion import BagConversion
    from coded_aperture_ros.optics import load_camera

    check_bag_output(target, [source, *inputs_of(args, "bank", "camera")], args.overwrite)
    options = _picklable(args)
    conversion = BagConversion(
        topic=args.topic,
        reference_topic=args.reference_depth,
        namespace=args.namespace,
        camera=load_camera(args.camera),
        new_pipeline=functools.partial(_new_pipeline, options),
        gamma=args.gamma,
        bits=args.bits,
        map_size=args.output_size,
        prior=functools.partial(expected_motion_of, options),
        settings=_settings(args),
        # Frames of a video go through one pipeline, in their order.
        processes=1 if threads or args.temporal_frames else 0,
        threads=threads,
    )
    return conversion.run(source, target, lambda steps, total: progress(steps, total, "frame"))


def _new_pipeline(args: argparse.Namespace, camera: Any) -> Any:
    from coded_aperture_ros.deblur import DeblurConfig

    deblurring = {"rank": args.deblur_rank, "band": args.deblur_band}
    deblur = None if args.deblur == "none" else DeblurConfig(args.deblur, **deblurring)
    return pipeline_of(args, camera, deblur)


def _warnings(source: Path, results: dict[str, Any]) -> Iterator[str]:
    """Lines about a bag whose results are not as good as they might be."""
    if results["damage"]:
        yield f"{source}: processed up to the damage: {results['damage']}"
    for fault, reason in results["fault_reasons"].items():
        yield f"{results['faults'][fault]} frame(s) not used ({fault}): {reason}"


def _picklable(args: argparse.Namespace) -> argparse.Namespace:
    """Arguments without what belongs to the parser, for a worker."""
    parsers = "of_simple", "of_motion"
    given = {name: value for name, value in vars(args).items() if name not in parsers}
    return argparse.Namespace(**given | {"usage_error": sys.exit})


def _settings(args: argparse.Namespace) -> dict[str, Any]:
    plain = str | int | float | list | None  # not what belongs to the parser
    given = vars(args).items()
    return {name: of for name, of in given if isinstance(of, plain) and name not in _NO_SETTINGS}


def _convert_all(args: argparse.Namespace) -> int:
    from coded_aperture_ros.bags.many import convert_jobs, jobs_of, write_summary
    from coded_aperture_ros.core.cluster import dask_client

    args = _picklable(args)
    for name in filter(vars(args).get, ("bank", "camera")):  # a worker may be elsewhere
        setattr(args, name, str(Path(getattr(args, name)).resolve()))
    jobs = jobs_of(map(Path, args.inputs), Path(args.output))
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
    return tell(args, results, _all_in_words) or int(bool(failed))


def _bags_at_once(args: argparse.Namespace, count: int) -> int:
    """Return the number of processes with a bag each.

    Fewer bags than processors are better worked on one after the other, with their frames shared
    among all processors, which frames of a video cannot be.
    """
    if count < processors() and not args.temporal_frames:
        return 1
    return max(1, min(count, processors()))


def _outcome(args: argparse.Namespace, threads: int, job: Any) -> Any:
    """Convert a bag, perhaps far from who asked for it, unless its results are complete."""
    from coded_aperture_ros.bags.many import Outcome

    if threads:
        os.environ["TQDM_DISABLE"] = "1"  # the program shows how far all bags are
    with _logged() as lines:
        try:
            # Another worker may have done it, and died before saying so.
            if args.overwrite or not job.done(_settings(args)):
                lines.extend(_warnings(job.source, _convert(args, job.source, job.target, threads)))
        except (InputError, SystemExit) as error:
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


def _all_in_words(results: dict[str, Any]) -> str:
    bags = f"{len(results['bags'])} bags, {results['complete_before']} of them complete before"
    frames = f"depth of {results['used']} of {results['frames']} frames"
    return f"{results['output']}: {bags}; {frames}\nreport: {results['report']}"


def _in_words(results: dict[str, Any]) -> str:
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
