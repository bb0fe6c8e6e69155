"""`coded_aperture deblur`: all-in-focus frames from coded frames and depth."""

import argparse
import dataclasses
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.estimators import CAMERA_OPTION, fit_camera
from coded_aperture_ros.cli.frames import (
    NamedFrame,
    Unusable,
    add_input_options,
    named_frames,
    suitable,
)
from coded_aperture_ros.cli.options import add_gamma_option, add_options, config_from, settings_of
from coded_aperture_ros.cli.stereo_output import StereoOutput, add_stereo_options
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.progress import progress

_EPILOG = """examples:
  with the depth estimated from the frame itself:
    coded_aperture deblur --bank bank.npz --depth auto coded.png -o sharp.png
  with a depth map, and as a 3D picture for red-cyan glasses too:
    coded_aperture deblur --bank bank.npz --depth depth.npy coded.png -o sharp.png \\
        --anaglyph 3d.png
  and what each opening of the mask sees, and a video on the way around them:
    coded_aperture deblur --bank bank.npz --camera config/demo_camera.yaml --depth depth.npy \\
        coded.png -o sharp.png --views views/
  with what depth --motion has found of a moving scene:
    coded_aperture deblur --bank bank.npz --depth moving.npy --motion moving.motion.npy \\
        --method cg coded.png -o sharp.png
"""
# What --std-dev writes beside a picture, and the steps of grey of the second.
_BESIDE, _GREY = {"std_dev": ".uncertainty.npy", "kind": ".kind.png"}, 127


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "deblur",
        help="make all-in-focus frames from coded frames and depth",
        description="Remove the blur of every pixel according to its depth. PNG pictures are "
        "written with 16 bits in linear light, which look dark in most viewers; with --gamma they "
        "are written, like the input, with 8 bits in that encoding.",
        epilog=_EPILOG,
    )
    add_input_options(parser, "all-in-focus picture, or a folder for one .png per frame")
    needed = {
        "--bank NPZ": "filter bank, see learn",
        "--depth FILE|auto": "depth map in m (.npy, .tiff) or mm (16-bit .png) for all frames; "
        "auto estimates it",
    }
    motion = {
        "--motion NPY": "motion during the exposure, px, [row, column, right and down], as depth "
        "--motion writes it; removed too, by --method cg or sparse"
    }
    add_options(parser, needed, required=True)
    add_options(parser, CAMERA_OPTION | motion)
    beside = "write OUT.uncertainty.npy, standard deviations in linear light, and OUT.kind.png, in "
    beside += "which pixels are black that were made up, uncertain ones grey, and seen ones white"
    add_options(parser, {"--std-dev": beside})
    add_stereo_options(parser)
    add_gamma_option(parser)
    add_options(parser, {"--json": "print a summary as JSON"})
    parser.add_late_options = settings_of({"deblur.DeblurConfig": "deblurring"}, threads=None)


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    from coded_aperture_ros.io import PICTURE_SUFFIXES, write_image
    from coded_aperture_ros.likelihood.bank import load_bank
    from coded_aperture_ros.optics import load_camera

    bank = load_bank(args.bank)
    camera = load_camera(args.camera) if args.camera else None
    stereo = StereoOutput(args, bank.stack, camera)
    restore, reset, uncertainty = _restorer(args, bank, camera)

    def beside(output: Path) -> dict[str, Path]:
        return {name: output.with_suffix(_BESIDE[name]) for name in _BESIDE if args.std_dev}

    def outputs(output: Path) -> list[Path]:
        return [*stereo.outputs(output), *beside(output).values()]

    encoding: dict[str, Any] = {} if args.gamma == 1 else {"bits": 8, "gamma": args.gamma}
    summaries = []
    unusable = Unusable()
    video: int | None = None
    for frame in named_frames(args, ".png", PICTURE_SUFFIXES, outputs, unusable):
        if frame.video != video:
            reset()
            video = frame.video
        start = time.perf_counter()
        try:
            with naming(frame.source):
                suitable(frame, bank)
                stereo.check(frame.frame.light)
                sharp, blur_size_px = restore(frame)
                seconds = time.perf_counter() - start
                if args.std_dev:
                    found = uncertainty(frame.frame.picture, sharp, blur_size_px)
        except InputError as error:
            unusable.note(error)
            continue
        write_image(frame.output, sharp, **encoding)
        written = {name: str(path) for name, path in beside(frame.output).items()}
        if written:
            write_image(written["std_dev"], found.std_dev)
            write_image(written["kind"], (_GREY * found.kind).astype("uint8"))
        written |= stereo.write(frame.output, sharp, blur_size_px)
        summaries.append({"output": str(frame.output), "seconds": round(seconds, 3), **written})
        if not args.json:
            print(f"{frame.output}: deblurred in {seconds:.2f} s")
    if args.json:
        print(json.dumps(summaries))
    return unusable.status()


def _restorer(
    args: argparse.Namespace, bank: Any, camera: Any
) -> tuple[Callable[[NamedFrame], tuple[Any, Any]], Callable[[], None], Callable[..., Any]]:
    """Return what makes pictures and maps of blur sizes, what begins a video, what tells errors."""
    from coded_aperture_ros.deblur import DeblurConfig, covers_frame, make_deblurrer
    from coded_aperture_ros.depth import DepthConfig, blur_sizes_px
    from coded_aperture_ros.frames import KnownNoise
    from coded_aperture_ros.likelihood.bank import check_setting
    from coded_aperture_ros.pipeline import FramePipeline

    motion_px = _motion(args)
    config = config_from(args, DeblurConfig)
    noise = dataclasses.asdict(KnownNoise.of(config, camera, bank))
    config = dataclasses.replace(config, **noise)
    iterations = partial(progress, unit="iteration")
    deblurrer = make_deblurrer(bank, config, iterations)
    if camera is not None:
        with naming(args.camera):
            camera = check_setting(bank, camera)
    given: Any = None if args.depth == "auto" else _known_depths(args, bank, camera)
    pipeline: Any = None
    if given is None:
        shared = {"saturation": config.saturation, "network": config.network}
        # A picture from depth that is not sure shows that itself.
        depth = DepthConfig(**noise, **shared, threads=args.threads or 0, check_fit=False)
        with naming(args.camera or args.bank):
            pipeline = FramePipeline(bank, camera, depth, config, iterations)

    def restored(named: NamedFrame) -> tuple[Any, Any]:
        frame = named.frame
        fitted = fit_camera(args, pipeline, camera, frame.light)
        blur_size_px: Any = None if given is None else blur_sizes_px(bank, fitted, given)
        if given is None:
            estimate = pipeline(frame)
            blur_size_px = estimate.blur_size_px
            if motion_px is None:
                return pipeline.deblur(frame, estimate), blur_size_px
        elif not covers_frame(given.shape, frame.shape):
            of_map, of_frame = (f"{x.shape[1]} x {x.shape[0]}" for x in (given, frame))
            raise InputError(
                f"the depth map {args.depth} has {of_map} pixels, this frame {of_frame}: it must "
                "be of this size, or of this shape and smaller"
            )
        return deblurrer.deblur(frame.picture, blur_size_px, motion_px=motion_px), blur_size_px

    reset = deblurrer.reset if pipeline is None else pipeline.reset
    return restored, reset, deblurrer.uncertainty


def _motion(args: argparse.Namespace) -> Any:
    """Return the map of motion for all frames; None if there is none."""
    import numpy as np

    if args.motion is None:
        return None
    if args.method in ("fast", "inverse"):
        args.usage_error(f"--motion: --method {args.method} removes no motion, use cg or sparse")
    try:
        return np.lib.format.open_memmap(args.motion, mode="r")
    except (OSError, ValueError, EOFError) as error:
        what = "expected a .npy as depth --motion writes it"
        raise InputError(f"cannot read motion {args.motion}: {what}") from error


def _known_depths(args: argparse.Namespace, bank: Any, camera: Any) -> Any:
    """Return the file's depths, of which blur sizes can be made."""
    import numpy as np

    from coded_aperture_ros.depth import blur_sizes_px
    from coded_aperture_ros.io import read_depth

    depth_m = read_depth(args.depth)
    blur_size_px = blur_sizes_px(bank, camera, depth_m)
    if blur_size_px is None:
        what = "the bank does not know how far its levels are: give --camera, or --depth auto"
        raise InputError(f"{args.bank}: {what}")
    if not np.isfinite(blur_size_px).any():
        raise InputError(f"{args.depth}: no pixel has a known depth")
    return depth_m
