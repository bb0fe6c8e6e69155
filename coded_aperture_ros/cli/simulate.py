"""`coded_aperture simulate`: a coded frame from a sharp picture and its depth."""

import argparse
import logging
import math
import time
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output, check_suffix, naming
from coded_aperture_ros.cli.measuring import tell
from coded_aperture_ros.cli.options import add_gamma_option, add_options
from coded_aperture_ros.core.errors import InputError

_EPILOG = """example, for a scene that is 2.1 to 5.1 m away:
  coded_aperture simulate --camera config/demo_camera.yaml --image sharp.png --gamma srgb \\
      --depth depth.png -o coded.png --noise 0.002 --bits 12
"""


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "simulate",
        help="render a coded frame from a sharp picture and its depth",
        description="Render what a coded-aperture camera records of a scene, given as a sharp "
        "picture and a depth map of the same size, with occlusion and sensor noise.",
        epilog=_EPILOG,
    )
    files = {
        "--camera YAML": "camera file, as config/demo_camera.yaml",
        "--image FILE": "sharp picture",
        "--depth FILE": "depth map: 16-bit PNG in mm (0 = unknown), or float TIFF or .npy in m",
        "-o --output FILE": "coded frame",
    }
    add_options(parser, files, required=True)
    add_options(
        parser, {"--noise S": "standard deviation, 1 = full scale"}, type=float, default=0.0
    )
    parser.add_argument(
        "--bits",
        type=int,
        default=0,
        choices=(0, 8, 12, 16),
        help="quantise to that many bits (default 0: do not)",
    )
    add_options(parser, {"--seed N": "of the noise"}, type=int, default=0)
    add_gamma_option(parser)
    add_options(parser, {"--depth-scale M": "metres per unit of the depth map"}, type=float)
    add_options(parser, {"--json": "print a summary as JSON"})


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    import numpy as np

    from coded_aperture_ros.io import PICTURE_SUFFIXES, read_depth, read_image, write_image
    from coded_aperture_ros.optics import load_camera
    from coded_aperture_ros.simulation import SensorModel, render_coded_frame

    try:
        sensor = SensorModel(args.noise, args.bits)
    except InputError as error:
        args.usage_error(f"--{error}")
    if args.seed < 0:
        args.usage_error(f"--seed: expected 0 or more, got {args.seed}")
    if args.depth_scale is not None and not 0 < args.depth_scale < math.inf:
        args.usage_error(f"--depth-scale: expected more than 0 m, got {args.depth_scale}")
    check_suffix(args.output, PICTURE_SUFFIXES)
    check_output(args.output, [Path(args.image), Path(args.depth)])
    camera = load_camera(args.camera)
    image = read_image(args.image, args.gamma)
    depth_m = read_depth(args.depth, args.depth_scale)
    if image.shape[:2] != (camera.image_height, camera.image_width):
        logging.warning(
            "%s has %d x %d pixels, not the %d x %d of the camera file: taken as a part of its "
            "image, with pixels of the same size",
            *(args.image, image.shape[1], image.shape[0]),
            *(camera.image_width, camera.image_height),
        )
    start = time.perf_counter()
    with naming(f"{args.image} with {args.depth}"):
        coded = render_coded_frame(image, depth_m, camera)
    seconds = time.perf_counter() - start
    write_image(args.output, sensor.expose(coded, np.random.default_rng(args.seed)))
    blur = camera.blur_size_px(depth_m[np.isfinite(depth_m)])
    summary = {
        "output": args.output,
        "height": depth_m.shape[0],
        "width": depth_m.shape[1],
        "blur_size_min_px": round(float(blur.min()), 3),
        "blur_size_max_px": round(float(blur.max()), 3),
        "seconds": round(seconds, 3),
    }
    return tell(
        args,
        summary,
        lambda found: (
            f"{args.output}: blur sizes {found['blur_size_min_px']:.1f} to "
            f"{found['blur_size_max_px']:.1f} px, rendered in {seconds:.1f} s"
        ),
    )
