"""`coded_aperture depth`: depth maps from coded frames."""

import argparse
import json
import time
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import naming
from coded_aperture_ros.cli.frames import add_input_options, named_frames
from coded_aperture_ros.cli.options import add_config_options, add_gamma_option, config_from
from coded_aperture_ros.cli.progress import progress
from coded_aperture_ros.errors import InputError

_SUFFIXES = (".npy", ".tif", ".tiff", ".png")
_EPILOG = """examples:
  one frame, depth in metres and confidence as .npy, and a picture of both:
    coded_aperture depth --bank bank.npz coded.png -o depth.npy --pictures
  all frames of a folder:
    coded_aperture depth --bank bank.npz --regularize graphcut frames/ -o depth/
  a mask of a few equal holes, without a bank:
    coded_aperture depth --method simple --camera config/example_camera.yaml \\
        --depth-range 3.5 9 coded.png -o simple.npy
  something moves during the exposure: its motion, px, as [row, column, right and down]:
    coded_aperture depth --bank bank.npz --motion coded.png -o moving.npy
"""
_METHODS = ("bank", "simple")
_LEVELS = 33
_NOT_ASKED = "nothing expected"


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "depth",
        help="estimate depth from coded frames",
        description="Estimate the depth of every pixel of coded frames. Beside each depth "
        "map x.npy its confidence, 0 to 1, is written to x.confidence.npy; where that is low, the "
        "depth is unknown (NaN, or 0 in a 16-bit PNG).",
        epilog=_EPILOG,
    )
    add_input_options(
        parser,
        "depth map: .npy or .tiff in m, .png in mm; or a folder for one .npy per frame",
    )
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
    parser.add_argument(
        "--level-count",
        type=int,
        default=_LEVELS,
        metavar="N",
        help=f"with --method simple: blur levels in that range (default {_LEVELS})",
    )
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
    parser.add_argument(
        "--levels", action="store_true", help="write fractional level indices instead of metres"
    )
    parser.add_argument(
        "--pictures", action="store_true", help="write colour pictures of depth and confidence too"
    )
    add_gamma_option(parser)
    parser.add_argument("--json", action="store_true", help="print a summary as JSON")
    parser.add_late_options = _add_config_options


def _add_config_options(parser: argparse.ArgumentParser) -> None:
    from coded_aperture_ros.depth import DepthConfig
    from coded_aperture_ros.motion import MotionConfig
    from coded_aperture_ros.simple import SimpleConfig

    add_config_options(parser, DepthConfig, "estimation")
    add_config_options(parser, SimpleConfig, "with --method simple")
    add_config_options(parser, MotionConfig, "with --motion")


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    import numpy as np

    _check_method(args)
    if args.levels and args.output.lower().endswith(".png"):
        raise InputError(f"{args.output}: a PNG has depths in mm, write levels to .npy or .tiff")
    estimator, expected = _estimator(args), _expected(args)
    summaries: list[dict[str, Any]] = []
    frames = named_frames(args, ".npy", _SUFFIXES, lambda path: _outputs(path, args))
    for frame in frames:
        start = time.perf_counter()
        with naming(frame.source):
            estimate = estimator.estimate(frame.image, **expected)
        seconds = time.perf_counter() - start
        values = estimate.level if args.levels or estimate.depth_m is None else estimate.depth_m
        _write(frame.output, values, estimate, args)
        known = np.isfinite(values)
        summary: dict[str, Any] = {
            "output": str(frame.output),
            "unit": "level" if args.levels else "m",
            "known": round(float(known.mean()), 4),
            "median": round(float(np.median(values[known])), 4) if known.any() else None,
            "noise": round(estimate.noise, 6),
            "seconds": round(seconds, 3),
        }
        if args.motion:
            summary["moving"] = _moving_share(estimate.motion_px)
            summary["searched"] = estimate.searched
        summaries.append(summary)
        if not args.json:
            print(f"{frame.output}: {_in_words(summary)}")
    if args.json:
        print(json.dumps(summaries))
    return 0


def _check_method(args: argparse.Namespace) -> None:
    """Refuse options that the method needs and has not got, or has no use for."""
    if args.angular_velocity is not None:
        for name in ("motion", "camera", "exposure"):
            given = args.motion if name == "motion" else getattr(args, name) is not None
            if not given:
                args.usage_error(f"--angular-velocity: needs --{name} too")
    elif args.exposure is not None:
        args.usage_error("--exposure: only with --angular-velocity")
    if args.method == "bank":
        if args.bank is None:
            args.usage_error("the following arguments are required: --bank (or --method simple)")
        if args.depth_range is not None:
            args.usage_error("--depth-range: a bank has its own range; only for --method simple")
        return
    if args.motion:
        args.usage_error("--motion: only with --method bank")
    if args.bank is not None:
        args.usage_error("--bank: --method simple has none, leave it out")
    for name in ("camera", "depth_range"):
        if getattr(args, name) is None:
            option = f"--{name.replace('_', '-')}"
            args.usage_error(f"the following arguments are required with --method simple: {option}")


def _estimator(args: argparse.Namespace) -> Any:
    """Return the estimator that the options ask for."""
    from coded_aperture_ros.bank import load_bank
    from coded_aperture_ros.calibration import with_noise_of
    from coded_aperture_ros.depth import DepthConfig, DepthEstimator
    from coded_aperture_ros.motion import MotionConfig, MotionEstimator, learn_motion_bank
    from coded_aperture_ros.optics import load_camera
    from coded_aperture_ros.simple import (
        SimpleConfig,
        SimpleEstimator,
        neighbour_model_for_camera,
    )

    camera = load_camera(args.camera) if args.camera else None
    if args.method == "simple" and camera is not None:
        with naming(args.camera):
            near_m, far_m = args.depth_range
            settings = config_from(args, SimpleConfig)
            model = neighbour_model_for_camera(camera, near_m, far_m, args.level_count, settings)
            config = with_noise_of(camera, config_from(args, DepthConfig))
            return SimpleEstimator(model, config, camera)
    bank = load_bank(args.bank)
    if camera is None and bank.stack.depths_m is None and not args.levels:
        raise InputError(
            f"{args.bank}: the bank does not know how far its levels are: give --camera, or "
            "--levels for level indices"
        )
    with naming(args.camera or args.bank):
        config = with_noise_of(camera, config_from(args, DepthConfig))
        if not args.motion:
            return DepthEstimator(bank, config, camera)
        settings = config_from(args, MotionConfig)
        motions = settings.motions
        motion_bank = learn_motion_bank(
            bank,
            motions,
            settings.motion_rank,
            lambda vectors: progress(vectors, len(motions), "motion"),
        )
        return MotionEstimator(motion_bank, config, camera, settings)


def _expected(args: argparse.Namespace) -> dict[str, Any]:
    """Return what is known of the motion beforehand, as an argument of `estimate`."""
    from coded_aperture_ros.motion import expected_motion
    from coded_aperture_ros.optics import load_camera

    if args.angular_velocity is None:
        return {}
    intrinsics = load_camera(args.camera).intrinsics
    return {"expected": expected_motion(args.angular_velocity, args.exposure, intrinsics)}


def _moving_share(motion_px: Any) -> float:
    """Return the share of the pixels that have moved by half a pixel or more."""
    import numpy as np

    return round(float((np.hypot(motion_px[..., 0], motion_px[..., 1]) >= 0.5).mean()), 4)


def _in_words(summary: dict[str, Any]) -> str:
    if summary["median"] is None:
        found = "depth unknown everywhere (too dark, saturated, or without texture)"
    else:
        median = f"{summary['median']:.4g} {summary['unit']}"
        found = f"depth at {100 * summary['known']:.0f} % of the pixels, median {median}"
    if "moving" in summary:
        found += f", {100 * summary['moving']:.0f} % moving"
        if summary["searched"] not in ("", _NOT_ASKED):
            found += f" (all motions tried: {summary['searched']})"
    return f"{found}; noise {summary['noise']:.4f}, {summary['seconds']:.2f} s"


def _outputs(path: Path, args: argparse.Namespace) -> list[Path]:
    """Return the files of depth and confidence, and of pictures and motion if wanted."""
    # A PNG cannot hold floating values.
    suffix = ".tiff" if path.suffix.lower() == ".png" else path.suffix
    paths = [path, path.with_suffix(f".confidence{suffix}")]
    if args.pictures:
        paths += [path.with_suffix(".picture.png"), path.with_suffix(".confidence.picture.png")]
    if args.motion:
        paths += [path.with_suffix(".motion.npy"), path.with_suffix(".motion.confidence.npy")]
    return paths


def _write(path: Path, values: Any, estimate: Any, args: argparse.Namespace) -> None:
    import numpy as np

    from coded_aperture_ros.files import atomic_output
    from coded_aperture_ros.images import (
        confidence_picture,
        depth_picture,
        write_depth,
        write_image,
    )

    depth_path, confidence_path, *others = _outputs(path, args)
    write_depth(depth_path, values)
    write_depth(confidence_path, estimate.confidence)
    if args.pictures:
        write_image(others[0], depth_picture(values, unit="" if args.levels else "m"))
        write_image(others[1], confidence_picture(estimate.confidence))
    if args.motion:
        for output, motion in zip(
            others[-2:], (estimate.motion_px, estimate.motion_confidence), strict=True
        ):
            with atomic_output(output) as unfinished:
                np.save(unfinished, motion)
