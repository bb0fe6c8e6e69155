"""`coded_aperture simulate`: a coded frame from a sharp picture and its depth."""

import dataclasses
import json
import logging
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.cli.command import Command, argument, group
from coded_aperture_ros.cli.reading import GammaArguments
from coded_aperture_ros.cli.results import input_files, print_summary
from coded_aperture_ros.cli.rules import excludes, only_with, required
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import naming
from coded_aperture_ros.core.files import atomic_output, check_output, check_suffix, output_set
from coded_aperture_ros.design.diffraction import diffraction_warning
from coded_aperture_ros.frames import View
from coded_aperture_ros.io import PICTURE_SUFFIXES, read_depth, read_image, write_depth, write_image
from coded_aperture_ros.io.display import display_path, write_light_for_display
from coded_aperture_ros.optics import MASK_NAMES, Camera, load_camera, load_mask
from coded_aperture_ros.simulation import SensorModel, render_coded_frame
from coded_aperture_ros.simulation.layered import random_scene

_EXAMPLES = """examples:
  a scene that is 0.63 to 1.53 m away:
    coded_aperture simulate --camera config/demo_camera.yaml --image sharp.png --gamma srgb \\
        --depth depth.png -o coded.png --noise 0.002 --bits 12
  a random scene, in front of the focus and behind it, with its truth beside it:
    coded_aperture simulate --random 7 --mask zhou --side both --noise 0.002 -o random.png
"""
_MASK = "levin"
_SIDE = "far"
_SIZE = (480, 360)
_SMALLEST_PX = 16


@dataclasses.dataclass(frozen=True, kw_only=True)
class RandomArguments:
    """Which random scene."""

    random: int | None = argument("which one", None, written="--random SEED", minimum=0)
    mask: str | None = argument(f"mask, or its file (default {_MASK})", None, written="--mask NAME")
    side: str | None = argument(
        f"of the focal plane (default {_SIDE})", None, choices=("far", "near", "both")
    )
    size: tuple[int, int] | None = argument(
        "of the frame (default 480 360)",
        None,
        written="--size W H",
        unit="px",
        minimum=_SMALLEST_PX,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(GammaArguments):
    """Arguments of `simulate`."""

    camera: str | None = argument(
        "camera file, as config/demo_camera.yaml", None, written="--camera YAML"
    )
    image: str | None = argument("sharp picture", None, written="--image FILE")
    depth: str | None = argument(
        "depth map: 16-bit PNG in mm (0 = unknown), or float TIFF or .npy in m",
        None,
        written="--depth FILE",
    )
    output: str = argument("coded frame", written="-o --output FILE", is_output=True)
    scene: RandomArguments = group("a random scene instead (needs numba)", RandomArguments())
    noise: float = argument(
        "standard deviation, 1 = full scale", 0.0, written="--noise S", minimum=0, maximum=1
    )
    bits: int = argument(
        "quantise to that many bits (default 0: do not)", 0, choices=(0, 8, 12, 16)
    )
    seed: int = argument("of the noise", 0, written="--seed N", minimum=0)
    depth_scale: float | None = argument(
        "metres per unit of the depth map", None, written="--depth-scale M", unit="m", above=0
    )
    json: bool = argument("print a summary as JSON", False)


_RULES = (
    *(required(option, "--random") for option in ("--camera", "--image", "--depth")),
    *(only_with(option, "--random") for option in ("--mask", "--side", "--size")),
    excludes(
        "--random",
        *("--camera", "--image", "--depth", "--depth-scale", "--gamma"),
        note="it makes a scene of its own",
    ),
)


def run(args: Arguments) -> int:
    """Write the frame; return the exit status."""
    check_suffix(args.output, PICTURE_SUFFIXES)
    if args.scene.random is not None:
        return _render_random_scene(args, args.scene.random)
    return _render_files(args, str(args.camera), str(args.image), str(args.depth))


def _render_random_scene(args: Arguments, number: int) -> int:
    """Render a random scene, and write what there is to know of it."""
    output = Path(args.output)
    mask = args.scene.mask or _MASK
    beside = {
        "depth": output.with_suffix(".depth.npy"),
        "all_in_focus": output.with_suffix(f".all_in_focus{output.suffix}"),
        "camera": output.with_suffix(".camera.yaml"),
    }
    pictures = display_path(output), display_path(beside["all_in_focus"])
    check_output([output, *beside.values(), *pictures], input_files(args.scene.mask))
    width, height = args.scene.size or _SIZE
    start = time.perf_counter()
    scene = random_scene(number, load_mask(mask), args.scene.side or _SIDE, (height, width))
    coded = scene.coded()
    depth_m = scene.depth_m()
    seconds = time.perf_counter() - start
    sharp = scene.all_in_focus()
    with output_set():
        _write_coded(args, coded)
        write_image(beside["all_in_focus"], sharp)
        write_light_for_display(beside["all_in_focus"], sharp)
        write_depth(beside["depth"], depth_m)
        with atomic_output(beside["camera"]) as path:
            path.write_text(_camera_text(scene.camera, mask))
    more: dict[str, Any] = {name: str(path) for name, path in beside.items()}
    more["depth_near_m"] = round(float(depth_m.min()), 3)
    more["depth_far_m"] = round(float(depth_m.max()), 3)
    return _print(args, scene.blur_size_px(), seconds, (height, width), more)


def _camera_text(camera: Camera, mask: str) -> str:
    kind = (
        f"name: {mask}" if mask in MASK_NAMES else f"file: {json.dumps(str(Path(mask).resolve()))}"
    )
    numbers = (
        *("focal_length_px", "focus_distance_m", "image_width", "image_height"),
        *("mask_extent_mm", "side"),
    )
    lines = [f"{name}: {getattr(camera, name)}" for name in numbers]
    return "\n".join([*lines, "calibrated: traced", "mask:", f"  {kind}", ""])


def _render_files(args: Arguments, camera_file: str, image_file: str, depth_file: str) -> int:
    """Render a scene that is given as picture and depth."""
    check_output(
        [Path(args.output), display_path(args.output)],
        input_files(image_file, depth_file, camera=camera_file),
    )
    camera = load_camera(camera_file)
    image = read_image(image_file, args.gamma)
    depth_m = read_depth(depth_file, args.depth_scale)
    height, width = image.shape[:2]
    whole = camera.image_width, camera.image_height
    if (width, height) != whole:
        margins = (whole[0] - width) / 2, (whole[1] - height) / 2
        camera = camera.for_view(View(width, height, *whole, *margins))
    start = time.perf_counter()
    with naming(f"{image_file} with {depth_file}"):
        coded = render_coded_frame(image, depth_m, camera)
    seconds = time.perf_counter() - start
    if (width, height) != whole:
        part = "the middle of" if width <= whole[0] and height <= whole[1] else "more than"
        logging.warning(
            "%s has %d x %d pixels, not the %d x %d of the camera file: taken as %s its image, "
            "with pixels of the same size; depth of it needs a camera file with its size",
            *(image_file, width, height, *whole, part),
        )
    _write_coded(args, coded)
    blur_px = camera.blur_map_px(depth_m)[~np.isnan(depth_m)]  # what is infinitely far has one
    if warning := diffraction_warning(camera, float(np.abs(blur_px).max())):
        logging.warning(warning)
    return _print(args, blur_px, seconds, (height, width), {})


def _write_coded(args: Arguments, coded: FloatArray) -> None:
    """Write the frame as the sensor reads it out."""
    sensor = SensorModel(args.noise, args.bits)
    exposed = sensor.expose(coded, np.random.default_rng(args.seed))
    with output_set():
        write_image(args.output, exposed, gamma=1.0)
        write_light_for_display(args.output, exposed)


def _print(
    args: Arguments,
    blur_px: NDArray[np.floating],
    seconds: float,
    shape: tuple[int, int],
    more: dict[str, Any],
) -> int:
    summary = {
        "output": args.output,
        "height": shape[0],
        "width": shape[1],
        "blur_size_min_px": round(float(blur_px.min()), 3),
        "blur_size_max_px": round(float(blur_px.max()), 3),
        "seconds": round(seconds, 3),
        **more,
    }
    text = "{output}: blur sizes {blur_size_min_px:.1f} to {blur_size_max_px:.1f} px, rendered in "
    text += "{seconds:.1f} s"
    return print_summary(summary, text.format_map, as_json=args.json)


COMMAND = Command(
    Arguments,
    run,
    description="Render what a coded-aperture camera records of a scene, given as a sharp "
    "picture and a depth map of the same size, with occlusion and sensor noise. Or of a random "
    "scene: its depth, all-in-focus picture and camera are then written beside the frame, as "
    "x.depth.npy, x.all_in_focus.png and x.camera.yaml for x.png. Pictures of linear light look "
    "dark in most viewers: look at x.picture.png beside x.png.",
    examples=_EXAMPLES,
    rules=_RULES,
)
