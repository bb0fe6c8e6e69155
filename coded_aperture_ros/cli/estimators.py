"""Options that choose the method and its settings, which `depth` and `bag` share."""

import argparse
import dataclasses
import logging
from typing import Any

from coded_aperture_ros.cli.options import add_config_options, add_options, changed, config_from
from coded_aperture_ros.core.arguments import at_least
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.progress import progress

# Of `depth`, `bag` and `deblur`.
CAMERA_OPTION = {
    "--camera YAML": "camera file, for a bank that does not know its depths; its noise, where it "
    "has any, stands in for --noise and --noise-gain"
}


def add_estimator_options(parser: argparse.ArgumentParser, motion: str) -> None:
    """Add the method, what each of them needs, and what a gyroscope says of the motion.

    `motion` says what comes of `--motion`.
    """
    method = {
        "--method {bank,simple,motion}": "bank: a filter bank, for any mask; simple: a pixel and "
        "its neighbours, for a mask of 2 to 8 equal holes, from --camera and --depth-range alone; "
        "motion: bank with --motion (default bank)",
        "--bank NPZ": "filter bank, see learn; needed with --method bank",
    }
    depths = {"--depth-range NEAR FAR": "with --method simple: depths that are told apart, m"}
    add_options(parser, method | CAMERA_OPTION)
    add_options(parser, depths, type=float)
    add_options(parser, {"--motion": f"estimate motion blur too, with --method bank{motion}"})
    gyroscope = {
        "--angular-velocity X Y Z": "with --motion and --camera: of the camera around its axes to "
        "the right, down and forward, rad/s; only motions near what it lets expect are tried, "
        "which is faster",
        "--exposure S": "with --angular-velocity: exposure time, s",
    }
    add_options(parser, gyroscope, type=float)


def add_estimator_settings(parser: argparse.ArgumentParser, **defaults: Any) -> None:
    """Add the settings of the estimate, with defaults of their own, and of the methods."""
    from coded_aperture_ros.depth import DepthConfig
    from coded_aperture_ros.likelihood.bank import DEFAULT_LEVEL_COUNT
    from coded_aperture_ros.likelihood.motion import MotionConfig
    from coded_aperture_ros.likelihood.two_pixel import SimpleConfig

    add_config_options(parser, DepthConfig, "estimation", **defaults)
    simple = add_config_options(parser, SimpleConfig, "with --method simple")
    count = {"--level-count N": f"blur levels in the depth range (default {DEFAULT_LEVEL_COUNT})"}
    add_options(simple, count, type=at_least(2), default=DEFAULT_LEVEL_COUNT)
    motion = add_config_options(parser, MotionConfig, "with --motion")
    parser.set_defaults(of_simple=simple, of_motion=motion)  # for what has a use for them


def check_estimator_options(args: argparse.Namespace) -> None:
    """Refuse options that the method needs and has not got, or has no use for."""
    if args.method == "motion":
        args.method, args.motion = "bank", True
    if args.motion and args.method != "bank":
        args.usage_error("--motion: only with --method bank")
    if args.method == "bank":
        if args.bank is None:
            args.usage_error("the following arguments are required: --bank (or --method simple)")
        if args.depth_range is not None:
            args.usage_error("--depth-range: a bank has its own range; only for --method simple")
    else:
        if args.bank is not None:
            args.usage_error("--bank: --method simple has none, leave it out")
        for name, option in (("camera", "--camera"), ("depth_range", "--depth-range")):
            if getattr(args, name) is None:
                what = "the following arguments are required with --method simple"
                args.usage_error(f"{what}: {option}")
    if args.method == "bank" and (given := changed(args, args.of_simple)):
        args.usage_error(f"{given[0]}: a bank has its own, see learn; only for --method simple")
    if not args.motion and (given := changed(args, args.of_motion)):
        args.usage_error(f"{given[0]}: only with --motion")
    if args.angular_velocity is None:
        if args.exposure is not None:
            args.usage_error("--exposure: only with --angular-velocity")
        return
    for name in ("motion", "camera", "exposure"):
        # An exposure of 0 is equal to False, and is given all the same.
        if (given := getattr(args, name)) is None or given is False:
            args.usage_error(f"--angular-velocity: needs --{name} too")


def pipeline_of(args: argparse.Namespace, camera: Any, deblur: Any = None) -> Any:
    """Return the `FramePipeline` that the options ask for.

    `camera` is that of `--camera`, if any; `deblur` a `DeblurConfig`, None to deblur nothing.
    """
    from coded_aperture_ros.depth import DepthConfig, refinement_note, side_warning
    from coded_aperture_ros.depth.decoders.regularize import LEARNED
    from coded_aperture_ros.likelihood.bank import check_setting, load_bank
    from coded_aperture_ros.likelihood.choose import new_model
    from coded_aperture_ros.likelihood.motion import MotionConfig
    from coded_aperture_ros.likelihood.two_pixel import SimpleConfig
    from coded_aperture_ros.pipeline import FramePipeline

    bank = load_bank(args.bank) if args.bank else None
    if bank is not None and getattr(args, "frame_scale", 1) != 1:
        bank = dataclasses.replace(bank, noise=0.0)  # resampling changes it: it is estimated
    as_levels = getattr(args, "as_levels", False)
    if bank is not None and bank.stack.depths_m is None and camera is None and not as_levels:
        raise InputError(
            f"{args.bank}: the bank does not know how far its levels are: give --camera, or "
            "--as-levels for level indices"
        )
    with naming(args.camera or args.bank):
        if bank is not None and camera is not None:
            camera = check_setting(bank, camera)
        model = new_model(
            "motion" if args.motion else args.method,
            camera=camera,
            bank=bank,
            depth_range_m=args.depth_range,
            level_count=args.level_count,
            simple=config_from(args, SimpleConfig),
            motion=config_from(args, MotionConfig),
            progress=lambda vectors: progress(vectors, unit="motion"),
        )
        config = config_from(args, DepthConfig)
        pipeline = FramePipeline(model, camera, config, deblur)
    if note := refinement_note(model, config):
        logging.warning(note)
    elif config.regularize in ("none", LEARNED) and config.smoothness != DepthConfig.smoothness:
        others = "semiglobal, tv or graphcut"
        args.usage_error(f"--smoothness: --regularize {config.regularize} has none, use {others}")
    if (warning := side_warning(model)) and not getattr(args, "refocused_frame", None):
        logging.warning(warning)
    return pipeline


def fit_camera(args: argparse.Namespace, pipeline: Any, camera: Any, image: Any) -> Any:
    """Make a pipeline that for an image's size; return the camera, if any, of such images."""
    if camera is None:
        return None
    fitted = camera.resized(*image.shape[1::-1])
    if pipeline is not None and fitted != pipeline.estimator.camera:
        model = None if args.bank else pipeline_of(args, fitted).estimator.model
        pipeline.reconfigure(model=model, camera=fitted)
    return fitted


def expected_motion_of(args: argparse.Namespace, camera: Any) -> Any:
    """Return what is known of the motion beforehand, or None."""
    from coded_aperture_ros.optics.rotation import expected_motion

    if args.angular_velocity is None:
        return None
    return expected_motion(args.angular_velocity, args.exposure, camera.intrinsics)
