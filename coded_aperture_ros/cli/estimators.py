"""Options that choose what estimates depth, which `depth` and `bag` share."""

import argparse
import logging
from typing import Any

from coded_aperture_ros.cli.checks import naming
from coded_aperture_ros.cli.options import add_config_options, add_numbers, config_from
from coded_aperture_ros.core.errors import InputError

_METHODS = ("bank", "simple")


def add_estimator_options(parser: argparse.ArgumentParser) -> None:
    """Add the method, and what each of them needs."""
    parser.add_argument(
        "--method",
        choices=_METHODS,
        default=_METHODS[0],
        help="bank: a filter bank, for any mask; simple: a pixel and its neighbours, for a mask of "
        "2 to 8 equal holes, from --camera and --depth-range alone (default bank)",
    )
    parser.add_argument(
        "--bank", metavar="NPZ", help="filter bank, see learn; needed with --method bank"
    )
    parser.add_argument(
        "--camera",
        metavar="YAML",
        help="camera file, for a bank that does not know its depths; its noise, where it has any, "
        "stands in for --noise and --noise-gain",
    )
    parser.add_argument(
        "--depth-range",
        nargs=2,
        type=float,
        metavar=("NEAR", "FAR"),
        help="with --method simple: depths that are told apart, m",
    )


def add_estimator_settings(parser: argparse.ArgumentParser, **defaults: Any) -> None:
    """Add the settings of the estimators; `defaults` are other ones than theirs."""
    from coded_aperture_ros.bank import DEFAULT_LEVEL_COUNT
    from coded_aperture_ros.depth import DepthConfig
    from coded_aperture_ros.methods.two_pixel import SimpleConfig

    add_config_options(parser, DepthConfig, "estimation", **defaults)
    add_config_options(parser, SimpleConfig, "with --method simple")
    what = "with --method simple: blur levels in the depth range"
    add_numbers(parser, ("level-count", 2, DEFAULT_LEVEL_COUNT, what))


def check_estimator_options(args: argparse.Namespace) -> None:
    """Refuse options that the method needs and has not got, or has no use for."""
    if args.method == "bank":
        if args.bank is None:
            args.usage_error("the following arguments are required: --bank (or --method simple)")
        if args.depth_range is not None:
            args.usage_error("--depth-range: a bank has its own range; only for --method simple")
        return
    if args.bank is not None:
        args.usage_error("--bank: --method simple has none, leave it out")
    for name in ("camera", "depth_range"):
        if getattr(args, name) is None:
            option = f"--{name.replace('_', '-')}"
            args.usage_error(f"the following arguments are required with --method simple: {option}")


def estimator_of(args: argparse.Namespace, camera: Any) -> Any:
    """Return the estimator that the options ask for.

    Parameters
    ----------
    args : argparse.Namespace
    camera : Camera or None
        Of `--camera`, for the size of the frames.
    """
    from coded_aperture_ros.bank import load_bank
    from coded_aperture_ros.depth import DepthConfig, DepthEstimator, side_warning
    from coded_aperture_ros.methods.two_pixel import (
        SimpleConfig,
        neighbour_model_for_camera,
    )

    if args.method == "simple" and camera is not None:
        with naming(args.camera):
            near_m, far_m = args.depth_range
            settings = config_from(args, SimpleConfig)
            model = neighbour_model_for_camera(camera, near_m, far_m, args.level_count, settings)
            config = config_from(args, DepthConfig)
            return DepthEstimator(model, config, camera)
    bank = load_bank(args.bank)
    if camera is None and bank.stack.depths_m is None and not getattr(args, "levels", False):
        raise InputError(
            f"{args.bank}: the bank does not know how far its levels are: give --camera, or "
            "--levels for level indices"
        )
    with naming(args.camera or args.bank):
        config = config_from(args, DepthConfig)
        estimator = DepthEstimator(bank, config, camera)
    if warning := side_warning(bank):
        logging.warning(warning)
    return estimator
