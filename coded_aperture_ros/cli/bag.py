"""`coded_aperture bag`: depth and all-in-focus frames of a recorded bag, and how good they are."""

import argparse
import logging
import re
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
from coded_aperture_ros.cli.options import add_bits_option, add_gamma_option, add_options, checked
from coded_aperture_ros.cli.progress import progress
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
"""


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
    parser.add_argument("input", metavar="IN", help="bag: its folder, or a .mcap or .db3 file")
    add_options(parser, {"-o --output OUT": "folder of the new bag"}, required=True)
    topics = {
        "--overwrite": "replace OUT, if that is a bag already",
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
    from coded_aperture_ros.depth.config import VIDEO_FRAMES

    add_estimator_settings(parser, temporal_frames=VIDEO_FRAMES)


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    check_estimator_options(args)
    if args.camera is None:
        args.usage_error("the following arguments are required: --camera")
    deblurring = {"rank": args.deblur_rank, "band": args.deblur_band}
    if args.deblur == "none" and deblurring != {"rank": _DEBLUR_RANK, "band": "full"}:
        args.usage_error("--deblur none takes neither --deblur-rank nor --deblur-band")
    if processors() > 1:
        load_in_fork_server("coded_aperture_ros.bags.workers")
    from coded_aperture_ros.bags.conversion import BagConversion
    from coded_aperture_ros.deblur import DeblurConfig
    from coded_aperture_ros.io.bags import check_bag_output
    from coded_aperture_ros.optics import load_camera

    source, target = Path(args.input), Path(args.output)
    check_bag_output(target, [source, *inputs_of(args, "bank", "camera")], args.overwrite)
    camera = load_camera(args.camera)
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
    )
    results = conversion.run(source, target, lambda steps, total: progress(steps, total, "frame"))
    if results["damage"]:
        logging.warning(f"{source}: processed up to the damage: {results['damage']}")
    for fault, reason in results["fault_reasons"].items():
        logging.warning(f"{results['faults'][fault]} frame(s) not used ({fault}): {reason}")
    return tell(args, results, _in_words)


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
