"""`coded_aperture bag`: depth and all-in-focus frames of a recorded bag, and how good they are."""

import argparse
import functools
import logging
import re
import sys
from collections.abc import Iterable
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
from coded_aperture_ros.core.workers import load_in_fork_server, processors

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
    if processors() > 1 and not args.scheduler:
        load_in_fork_server("coded_aperture_ros.bags.workers")
    if len(args.inputs) > 1 or args.scheduler:
        return _convert_all(args)
    return tell(args, _convert(args, Path(args.inputs[0]), Path(args.output)), _in_words)


def _convert(args: argparse.Namespace, source: Path, target: Path) -> dict[str, Any]:
    from coded_aperture_ros.bags import check_bag_output
    from coded_aperture_ros.bags.conversion import BagConversion
    from coded_aperture_ros.deblur import DeblurConfig
    from coded_aperture_ros.optics import load_camera

    check_bag_output(target, [source, *inputs_of(args, "bank", "camera")], args.overwrite)
    camera = load_camera(args.camera)
    deblurring = {"rank": args.deblur_rank, "band": args.deblur_band}
    deblur = None if args.deblur == "none" else DeblurConfig(args.deblur, **deblurring)
    asked = {"motion": args.motion, "free_space": args.free_space_risk}
    asked |= dict.fromkeys(("second", "second_share"), args.second_surface)
    conversion = BagConversion(
        topic=args.topic,
        reference_topic=args.reference_depth,
        namespace=args.namespace,
        camera=camera,
        new_pipeline=lambda camera: pipeline_of(args, camera, deblur),
        gamma=args.gamma,
        bits=args.bits,
        map_size=args.output_size,
        more=tuple(name for name in asked if asked[name]),
        prior=lambda camera: expected_motion_of(args, camera),
        settings=_settings(args),
    )
    results = conversion.run(source, target, lambda steps, total: progress(steps, total, "frame"))
    if results["damage"]:
        logging.warning(f"{source}: processed up to the damage: {results['damage']}")
    for fault, reason in results["fault_reasons"].items():
        logging.warning(f"{results['faults'][fault]} frame(s) not used ({fault}): {reason}")
    return results


def _settings(args: argparse.Namespace) -> dict[str, Any]:
    plain = str | int | float | list | None  # not what belongs to the parser
    given = vars(args).items()
    return {name: of for name, of in given if isinstance(of, plain) and name not in _NO_SETTINGS}


def _convert_all(args: argparse.Namespace) -> int:
    from coded_aperture_ros.bags.many import jobs_of, write_summary

    for name in filter(vars(args).get, ("bank", "camera")):  # a worker may be elsewhere
        setattr(args, name, str(Path(getattr(args, name)).resolve()))
    del args.of_simple, args.of_motion  # these do not travel
    args.usage_error = sys.exit
    jobs = jobs_of(map(Path, args.inputs), Path(args.output))
    left = [job for job in jobs if args.overwrite or not job.done(_settings(args))]
    work = functools.partial(_failure, args)
    outcomes: Iterable[tuple[Any, str]] = ((job, work(job)) for job in left)
    if args.scheduler:
        from coded_aperture_ros.core.cluster import failures_on_workers

        outcomes = failures_on_workers(args.scheduler, work, left)
    failed = {job: reason for job, reason in progress(outcomes, len(left), "bag") if reason}
    for job, reason in failed.items():
        logging.error(f"{job.source}: {reason}")
    results = write_summary(Path(args.output), jobs, failed, len(jobs) - len(left))
    return tell(args, results, _all_in_words) or int(bool(failed))


def _failure(args: argparse.Namespace, job: Any) -> str:
    """Work on a bag, perhaps far from who asked for it; return what went wrong, or nothing."""
    try:  # who did it before may have died before saying so
        if args.overwrite or not job.done(_settings(args)):
            _convert(args, job.source, job.target)
    except (InputError, SystemExit) as error:
        return str(error)
    return ""


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
