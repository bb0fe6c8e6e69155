"""`coded_aperture simulate`: a coded frame from a sharp picture and its depth."""

import argparse
import json
import logging
import math
import time
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output, check_suffix, inputs_of
from coded_aperture_ros.cli.extension import BENCH
from coded_aperture_ros.cli.measuring import tell
from coded_aperture_ros.cli.options import add_gamma_option, add_options, mask_of
from coded_aperture_ros.core.errors import InputError, naming

_EPILOG = """examples:
  a scene that is 2.1 to 5.1 m away:
    coded_aperture simulate --camera config/demo_camera.yaml --image sharp.png --gamma srgb \\
        --depth depth.png -o coded.png --noise 0.002 --bits 12
  a random scene, in front of the focus and behind it, with its truth beside it:
    coded_aperture simulate --random 7 --mask zhou --side both --noise 0.002 -o random.png
"""
_OF_A_SCENE = ("camera", "image", "depth")
_SIZE = (480, 360)
_SMALLEST_PX = 16


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "simulate",
        help="render a coded frame from a sharp picture and its depth",
        description="Render what a coded-aperture camera records of a scene, given as a sharp "
        "picture and a depth map of the same size, with occlusion and sensor noise. Or of a random "
        "scene: its depth, all-in-focus picture and camera are then written beside the frame, as "
        "x.depth.npy, x.all_in_focus.png and x.camera.yaml for x.png.",
        epilog=_EPILOG,
    )
    files = {
        "--camera YAML": "camera file, as config/demo_camera.yaml",
        "--image FILE": "sharp picture",
        "--depth FILE": "depth map: 16-bit PNG in mm (0 = unknown), or float TIFF or .npy in m",
    }
    add_options(parser, files)
    add_options(parser, {"-o --output FILE": "coded frame"}, required=True)
    chance = parser.add_argument_group("a random scene instead (needs numba)")
    add_options(chance, {"--random SEED": "which one"}, type=int)
    add_options(chance, {"--mask NAME": "mask, or its file (default levin)"})
    side = {"--side {far,near,both}": "of the focal plane (default far)"}
    add_options(chance, side, default=None)
    add_options(chance, {"--size W H": "of the frame (default 480 360)"}, type=int)
    noise = {"--noise S": "standard deviation, 1 = full scale"}
    add_options(parser, noise, type=float, default=0.0)
    bits = "quantise to that many bits (default 0: do not)"
    parser.add_argument("--bits", type=int, default=0, choices=(0, 8, 12, 16), help=bits)
    add_options(parser, {"--seed N": "of the noise"}, type=int, default=0)
    add_gamma_option(parser)
    add_options(parser, {"--depth-scale M": "metres per unit of the depth map"}, type=float)
    add_options(parser, {"--json": "print a summary as JSON"})


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    from coded_aperture_ros.io import PICTURE_SUFFIXES
    from coded_aperture_ros.simulation import SensorModel

    _check_which_scene(args)
    try:
        sensor = SensorModel(args.noise, args.bits)
    except InputError as error:
        args.usage_error(f"--{error}")
    if args.seed < 0:
        args.usage_error(f"--seed: expected 0 or more, got {args.seed}")
    if args.depth_scale is not None and not 0 < args.depth_scale < math.inf:
        args.usage_error(f"--depth-scale: expected more than 0 m, got {args.depth_scale}")
    check_suffix(args.output, PICTURE_SUFFIXES)
    if args.random is not None:
        return _random(args, sensor)
    return _given(args, sensor)


def _check_which_scene(args: argparse.Namespace) -> None:
    """Refuse what is neither a scene nor a random one, or a bit of both."""
    missing = [f"--{name}" for name in _OF_A_SCENE if getattr(args, name) is None]
    if args.random is None:
        if missing:
            args.usage_error(
                f"the following arguments are required: {', '.join(missing)}; or --random SEED"
            )
        for name in ("mask", "side", "size"):
            if getattr(args, name) is not None:
                args.usage_error(f"--{name}: only with --random")
        return
    if len(missing) < len(_OF_A_SCENE):
        args.usage_error(f"--random makes a scene of its own: without --{', --'.join(_OF_A_SCENE)}")
    if args.depth_scale is not None or args.gamma != 1:
        args.usage_error("--depth-scale and --gamma: not with --random, which makes what they read")
    if args.random < 0:
        args.usage_error(f"--random: expected 0 or more, got {args.random}")
    if args.size is not None and min(args.size) < _SMALLEST_PX:
        args.usage_error(f"--size: expected at least {_SMALLEST_PX} px, got {args.size}")


def _random(args: argparse.Namespace, sensor: Any) -> int:
    """Render a random scene, and write what there is to know of it."""
    import numpy as np

    from coded_aperture_ros.core.files import atomic_output
    from coded_aperture_ros.io import write_depth, write_image

    output, mask = Path(args.output), args.mask or "levin"
    beside = {
        "depth": output.with_suffix(".depth.npy"),
        "all_in_focus": output.with_suffix(f".all_in_focus{output.suffix}"),
        "camera": output.with_suffix(".camera.yaml"),
    }
    check_output([output, *beside.values()], inputs_of(args, "mask"))
    width, height = args.size or _SIZE
    start = time.perf_counter()
    make = BENCH.module("layered", "--random").random_scene
    scene = make(args.random, mask_of(mask), args.side or "far", (height, width))
    coded, depth_m = scene.coded(), scene.depth_m()
    seconds = time.perf_counter() - start
    write_image(output, sensor.expose(coded, np.random.default_rng(args.seed)))
    write_image(beside["all_in_focus"], scene.all_in_focus())
    write_depth(beside["depth"], depth_m)
    with atomic_output(beside["camera"]) as path:
        path.write_text(_camera_text(scene.camera, mask))
    more: dict[str, Any] = {name: str(path) for name, path in beside.items()}
    more["depth_near_m"] = round(float(depth_m.min()), 3)
    more["depth_far_m"] = round(float(depth_m.max()), 3)
    return _tell(args, depth_m, scene.blur_size_px(), seconds, more)


def _camera_text(camera: Any, mask: str) -> str:
    from coded_aperture_ros.optics import MASK_NAMES

    kind = (
        f"name: {mask}" if mask in MASK_NAMES else f"file: {json.dumps(str(Path(mask).resolve()))}"
    )
    numbers = (
        *("focal_length_px", "focus_distance_m", "image_width", "image_height"),
        *("mask_extent_mm", "side"),
    )
    lines = [f"{name}: {getattr(camera, name)}" for name in numbers]
    return "\n".join([*lines, "mask:", f"  {kind}", ""])


def _given(args: argparse.Namespace, sensor: Any) -> int:
    """Render a scene that is given as picture and depth."""
    import numpy as np

    from coded_aperture_ros.design.diffraction import diffraction_warning
    from coded_aperture_ros.io import read_depth, read_image, write_image
    from coded_aperture_ros.optics import View, load_camera
    from coded_aperture_ros.simulation import render_coded_frame

    check_output(args.output, inputs_of(args, "camera", "image", "depth"))
    camera = load_camera(args.camera)
    image = read_image(args.image, args.gamma)
    depth_m = read_depth(args.depth, args.depth_scale)
    (height, width), whole = image.shape[:2], (camera.image_width, camera.image_height)
    if (width, height) != whole:
        margins = (whole[0] - width) / 2, (whole[1] - height) / 2
        camera = camera.for_view(View(width, height, *whole, *margins))
    start = time.perf_counter()
    with naming(f"{args.image} with {args.depth}"):
        coded = render_coded_frame(image, depth_m, camera)
    seconds = time.perf_counter() - start
    if (width, height) != whole:
        part = "the middle of" if width <= whole[0] and height <= whole[1] else "more than"
        logging.warning(
            "%s has %d x %d pixels, not the %d x %d of the camera file: taken as %s its image, "
            "with pixels of the same size; depth of it needs a camera file with its size",
            *(args.image, width, height, *whole, part),
        )
    write_image(args.output, sensor.expose(coded, np.random.default_rng(args.seed)))
    blur = camera.blur_map_px(depth_m)[~np.isnan(depth_m)]  # what is infinitely far has one
    if warning := diffraction_warning(camera, float(np.abs(blur).max())):
        logging.warning(warning)
    return _tell(args, depth_m, blur, seconds, {})


def _tell(
    args: argparse.Namespace, depth_m: Any, blur: Any, seconds: float, more: dict[str, Any]
) -> int:
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
        summary | more,
        lambda found: (
            f"{args.output}: blur sizes {found['blur_size_min_px']:.1f} to "
            f"{found['blur_size_max_px']:.1f} px, rendered in {seconds:.1f} s"
        ),
    )
