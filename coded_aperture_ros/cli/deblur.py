"""`coded_aperture deblur`: all-in-focus frames from coded frames and depth."""

import argparse
import json
import time
from typing import Any

from coded_aperture_ros.cli.frames import add_input_options, named_frames
from coded_aperture_ros.cli.options import add_config_options, add_gamma_option, config_from
from coded_aperture_ros.errors import InputError

_EPILOG = """examples:
  with the depth estimated from the frame itself:
    coded_aperture deblur --bank bank.npz --depth auto coded.png -o sharp.png
  with a depth map:
    coded_aperture deblur --bank bank.npz --depth depth.npy coded.png -o sharp.png
"""


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "deblur",
        help="make all-in-focus frames from coded frames and depth",
        description="Remove the blur of every pixel according to its depth. Pictures "
        "are written like the input: 16-bit linear, or 8-bit with the given --gamma.",
        epilog=_EPILOG,
    )
    add_input_options(parser, "all-in-focus picture, or a folder for one .png per frame")
    parser.add_argument("--bank", required=True, metavar="NPZ", help="filter bank, see learn")
    parser.add_argument(
        "--depth",
        required=True,
        metavar="FILE|auto",
        help="depth map in m (.npy, .tiff) or mm (16-bit .png) for all frames; auto estimates it",
    )
    parser.add_argument(
        "--camera", metavar="YAML", help="camera file; only if the bank knows no depths"
    )
    parser.add_argument(
        "--method", choices=("fast",), default="fast", help="fast: closed form (default)"
    )
    add_gamma_option(parser)
    parser.add_argument("--json", action="store_true", help="print a summary as JSON")
    parser.add_late_options = _add_config_options


def _add_config_options(parser: argparse.ArgumentParser) -> None:
    from coded_aperture_ros.deblur import DeblurConfig

    add_config_options(parser, DeblurConfig, "deblurring")


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    from coded_aperture_ros.bank import load_bank
    from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
    from coded_aperture_ros.images import gamma_from_text, write_image

    bank = load_bank(args.bank)
    blur_sizes = _blur_sizes(args, bank)
    deblurrer = Deblurrer(bank.stack, config_from(args, DeblurConfig))
    gamma = gamma_from_text(args.gamma)
    encoding: dict[str, Any] = {} if gamma == 1 else {"bits": 8, "gamma": gamma}
    summaries = []
    for path, frame in named_frames(args, ".png"):
        start = time.perf_counter()
        sharp = deblurrer.deblur(frame, blur_sizes(frame))
        seconds = time.perf_counter() - start
        write_image(path, sharp, **encoding)
        summaries.append({"output": str(path), "seconds": round(seconds, 3)})
        if not args.json:
            print(f"{path}: deblurred in {seconds:.2f} s")
    if args.json:
        print(json.dumps(summaries))
    return 0


def _blur_sizes(args: argparse.Namespace, bank: Any) -> Any:
    """Return a function from a frame to its map of blur sizes."""
    from coded_aperture_ros.depth import DepthConfig, DepthEstimator
    from coded_aperture_ros.images import read_depth
    from coded_aperture_ros.optics import load_camera

    if args.depth == "auto":
        estimator = DepthEstimator(bank, DepthConfig(noise=args.noise))
        return lambda frame: estimator.estimate(frame).blur_size_px
    depth_m = read_depth(args.depth)
    if args.camera:
        blur_size_px = load_camera(args.camera).blur_size_px(depth_m)
    else:
        blur_size_px = bank.stack.blur_size_at(depth_m)
    if blur_size_px is None:
        raise InputError(f"{args.bank}: the bank does not know how far its levels are: --camera?")
    return lambda frame: blur_size_px
