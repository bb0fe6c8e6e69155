"""`coded_aperture simulate`: a coded frame from a sharp picture and its depth."""

import argparse
import json
import time
from typing import Any

_EPILOG = """example:
  coded_aperture simulate --camera config/example_camera.yaml --image sharp.png --gamma srgb \\
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
    parser.add_argument("--camera", required=True, metavar="YAML", help="camera file")
    parser.add_argument("--image", required=True, metavar="FILE", help="sharp picture")
    parser.add_argument(
        "--depth",
        required=True,
        metavar="FILE",
        help="depth map: 16-bit PNG in mm (0 = unknown), or float TIFF or .npy in m",
    )
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="coded frame")
    parser.add_argument(
        "--noise", type=float, default=0.0, metavar="S", help="standard deviation, 1 = full scale"
    )
    parser.add_argument(
        "--bits",
        type=int,
        default=0,
        choices=(0, 8, 12, 16),
        help="quantise to that many bits (default 0: do not)",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the noise")
    parser.add_argument(
        "--gamma",
        default="1",
        metavar="G",
        help="how an 8-bit picture is encoded: an exponent or srgb (default 1: linear light)",
    )
    parser.add_argument(
        "--depth-scale", type=float, metavar="M", help="metres per unit of the depth map"
    )
    parser.add_argument("--json", action="store_true", help="print a summary as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    import numpy as np

    from coded_aperture_ros.images import gamma_from_text, read_depth, read_image, write_image
    from coded_aperture_ros.optics import load_camera
    from coded_aperture_ros.simulation import SensorModel, render_coded_frame

    camera = load_camera(args.camera)
    sensor = SensorModel(args.noise, args.bits)
    image = read_image(args.image, gamma_from_text(args.gamma))
    depth_m = read_depth(args.depth, args.depth_scale)
    start = time.perf_counter()
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
    if args.json:
        print(json.dumps(summary))
    else:
        print(
            f"{args.output}: blur sizes {summary['blur_size_min_px']:.1f} to "
            f"{summary['blur_size_max_px']:.1f} px, rendered in {seconds:.1f} s"
        )
    return 0
