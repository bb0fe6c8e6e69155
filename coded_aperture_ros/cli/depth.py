"""`coded_aperture depth`: depth maps from coded frames."""

import argparse
import json
import time
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import naming
from coded_aperture_ros.cli.estimators import (
    add_estimator_options,
    add_estimator_settings,
    check_estimator_options,
    estimator_of,
)
from coded_aperture_ros.cli.frames import add_input_options, named_frames
from coded_aperture_ros.cli.motion_options import (
    add_motion_options,
    add_motion_settings,
    check_motion_options,
    expected_motion_of,
    moving,
)
from coded_aperture_ros.cli.options import add_gamma_option
from coded_aperture_ros.core.errors import InputError

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
_NOT_ASKED = "nothing expected"


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "depth",
        help="estimate depth from coded frames",
        description="Estimate the depth of every pixel of coded frames. Beside each depth "
        "map x.npy its confidence, 0 to 1, is written to x.confidence.npy; where that is low, the "
        "depth is unknown (NaN, or 0 in a 16-bit PNG). With levels on both sides of the focal "
        "plane (side: both), x.side.npy has the probability that the side is right.",
        epilog=_EPILOG,
    )
    add_input_options(
        parser,
        "depth map: .npy or .tiff in m, .png in mm; or a folder for one .npy per frame",
    )
    add_estimator_options(parser)
    add_motion_options(parser)
    parser.add_argument(
        "--levels", action="store_true", help="write fractional level indices instead of metres"
    )
    parser.add_argument(
        "--pictures", action="store_true", help="write colour pictures of depth and confidence too"
    )
    add_gamma_option(parser)
    parser.add_argument("--json", action="store_true", help="print a summary as JSON")
    parser.add_late_options = _add_settings


def _add_settings(parser: argparse.ArgumentParser) -> None:
    add_estimator_settings(parser)
    add_motion_settings(parser)


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    import numpy as np

    from coded_aperture_ros.optics import load_camera

    check_motion_options(args)
    check_estimator_options(args)
    if args.levels and args.output.lower().endswith(".png"):
        raise InputError(f"{args.output}: a PNG has depths in mm, write levels to .npy or .tiff")
    camera = load_camera(args.camera) if args.camera else None
    estimator = estimator_of(args, camera)
    if args.motion:
        with naming(args.camera or args.bank):
            estimator = moving(args, estimator)
    expected = expected_motion_of(args, camera)
    summaries: list[dict[str, Any]] = []
    both_sides = estimator.model.stack.has_both_sides
    frames = named_frames(
        args,
        ".npy",
        _SUFFIXES,
        lambda path: [*_outputs(path, args), *([_side_output(path)] if both_sides else [])],
    )
    for frame in frames:
        start = time.perf_counter()
        with naming(frame.source):
            estimate = estimator.estimate(frame.image, prior=expected)
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
            summary["moving"] = _moving_share(estimate.motion.vectors_px)
            summary["searched"] = estimate.motion.searched
        summaries.append(summary)
        if not args.json:
            print(f"{frame.output}: {_in_words(summary)}")
    if args.json:
        print(json.dumps(summaries))
    return 0


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


def _side_output(path: Path) -> Path:
    """Return the file of how sure the side of the focal plane is."""
    return path.with_suffix(f".side{'.npy' if path.suffix.lower() == '.npy' else '.tiff'}")


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

    from coded_aperture_ros.core.files import atomic_output
    from coded_aperture_ros.io import confidence_picture, depth_picture, write_depth, write_image

    depth_path, confidence_path, *others = _outputs(path, args)
    write_depth(depth_path, values)
    write_depth(confidence_path, estimate.confidence)
    if estimate.side_confidence is not None:
        write_depth(_side_output(path), estimate.side_confidence)
    if args.pictures:
        write_image(others[0], depth_picture(values, unit="" if args.levels else "m"))
        write_image(others[1], confidence_picture(estimate.confidence))
    if args.motion:
        for output, motion in zip(
            others[-2:], (estimate.motion.vectors_px, estimate.motion.confidence), strict=True
        ):
            with atomic_output(output) as unfinished:
                np.save(unfinished, motion)
