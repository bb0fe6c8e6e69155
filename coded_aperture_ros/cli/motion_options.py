"""Options of what moves during the exposure."""

import argparse
from typing import Any

from coded_aperture_ros.cli.options import add_config_options, config_from
from coded_aperture_ros.cli.progress import progress


def add_motion_options(parser: argparse.ArgumentParser) -> None:
    """Add the wish for motion, and what is known of it beforehand."""
    parser.add_argument(
        "--motion",
        action="store_true",
        help="estimate motion blur too, with --method bank: x.motion.npy beside x.npy has the way "
        "during the exposure in px, [row, column, right and down], and x.motion.confidence.npy how "
        "sure it is",
    )
    parser.add_argument(
        "--angular-velocity",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="with --motion and --camera: of the camera around its axes to the right, down and "
        "forward, rad/s; only motions near what it lets expect are tried, which is faster",
    )
    parser.add_argument(
        "--exposure", type=float, metavar="S", help="with --angular-velocity: exposure time, s"
    )


def add_motion_settings(parser: argparse.ArgumentParser) -> None:
    """Add the settings of the estimate of motion."""
    from coded_aperture_ros.methods.motion import MotionConfig

    add_config_options(parser, MotionConfig, "with --motion")


def check_motion_options(args: argparse.Namespace) -> None:
    """Refuse options that do not go together."""
    if args.motion and args.method != "bank":
        args.usage_error("--motion: only with --method bank")
    if args.angular_velocity is not None:
        for name in ("motion", "camera", "exposure"):
            given = args.motion if name == "motion" else getattr(args, name) is not None
            if not given:
                args.usage_error(f"--angular-velocity: needs --{name} too")
    elif args.exposure is not None:
        args.usage_error("--exposure: only with --angular-velocity")


def moving(args: argparse.Namespace, estimator: Any) -> Any:
    """Return the estimator of depth and motion that takes the place of one of depth alone."""
    from coded_aperture_ros.depth import DepthEstimator
    from coded_aperture_ros.methods.motion import MotionConfig, MotionModel, learn_motion_bank

    settings = config_from(args, MotionConfig)
    motions = settings.motions
    bank = learn_motion_bank(
        estimator.model,
        motions,
        settings.motion_rank,
        lambda vectors: progress(vectors, len(motions), "motion"),
    )
    return DepthEstimator(MotionModel(bank, settings), estimator.config, estimator.camera)


def expected_motion_of(args: argparse.Namespace, camera: Any) -> Any:
    """Return what is known of the motion beforehand; None for nothing."""
    from coded_aperture_ros.methods.motion import expected_motion

    if args.angular_velocity is None:
        return None
    return expected_motion(args.angular_velocity, args.exposure, camera.intrinsics)
