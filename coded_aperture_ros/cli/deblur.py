"""`coded_aperture deblur`: all-in-focus frames from coded frames and depth."""

import dataclasses
import json
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.cli.command import Command, argument, group
from coded_aperture_ros.cli.estimation_arguments import CameraArguments
from coded_aperture_ros.cli.frames import InputArguments, SkippedInputs, named_frames
from coded_aperture_ros.cli.rules import needs, only_with
from coded_aperture_ros.cli.stereo_output import StereoArguments, StereoOutput
from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.files import Outputs, output_set
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.deblur import DeblurConfig, Uncertainty, covers_frame
from coded_aperture_ros.depth import DepthConfig, DepthEstimate, blur_sizes_px, check_depth_range
from coded_aperture_ros.frames import Frame
from coded_aperture_ros.io import PICTURE_SUFFIXES, read_depth, write_image
from coded_aperture_ros.io.display import display_path, write_light_for_display
from coded_aperture_ros.likelihood.bank import FilterBank, check_setting, load_bank
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.optics.camera_file import camera_files
from coded_aperture_ros.pipeline import FramePipeline

_EXAMPLES = """examples:
  with the depth estimated from the frame itself:
    coded_aperture deblur --bank bank.npz --depth auto coded.png -o sharp.png
  with a depth map, and as a 3D picture for red-cyan glasses too:
    coded_aperture deblur --bank bank.npz --depth depth.npy coded.png -o sharp.png \\
        --anaglyph 3d.png
  and what each opening of the mask sees:
    coded_aperture deblur --bank bank.npz --camera config/demo_camera.yaml --depth depth.npy \\
        coded.png -o sharp.png --views views/
  with what depth --motion has found of a moving scene:
    coded_aperture deblur --bank bank.npz --depth moving.npy --motion moving.motion.npy \\
        --method cg coded.png -o sharp.png
"""
_AUTO = "auto"
# What --std-dev writes beside a picture, and the steps of grey of the second.
_STD_DEV = ".uncertainty.npy"
_KIND = ".kind.png"
_GREY = 127


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(InputArguments, CameraArguments):
    """Arguments of `deblur`."""

    output: str = argument(
        "all-in-focus picture, or a folder for one .png per frame",
        written="-o --output OUT",
        is_output=True,
    )
    bank: str = argument("filter bank, see learn", written="--bank NPZ")
    depth: str = argument(
        "depth map in m (.npy, .tiff) or mm (16-bit .png) for all frames; auto estimates it",
        written="--depth FILE|auto",
    )
    motion: str | None = argument(
        "motion during the exposure, px, [row, column, right and down], as depth --motion writes "
        "it; removed too, by --method cg or sparse",
        None,
        written="--motion NPY",
        daily=False,
    )
    std_dev: bool = argument(
        "write OUT.uncertainty.npy, standard deviations in linear light, and OUT.kind.png, in "
        "which pixels are black that were made up, uncertain ones grey, and seen ones white",
        False,
    )
    threads: int | None = argument(
        "threads of the processor, at most as many as it has cores; 0: so many, but no more than "
        "four (default: 1 for the filters, 0 for --depth auto)",
        None,
        written="--threads N",
        minimum=0,
        maximum=1024,
        daily=False,
    )
    pictures: bool = argument(
        "write OUT.picture.png too, 8 bits and sRGB, beside linear pictures, which look dark in "
        "most viewers",
        True,
    )
    json: bool = argument("print a summary as JSON", False)
    stereo_output: StereoArguments = group(
        "3D pictures: 8 bits, sRGB or as --gamma says, .npy linear; folders where OUT is one",
        StereoArguments(),
    )
    deblurring: DeblurConfig = group("deblurring", DeblurConfig(), without=("threads",))

    @property
    def config(self) -> DeblurConfig:
        """Settings of deblurring."""
        if self.threads is None:
            return self.deblurring
        return dataclasses.replace(self.deblurring, threads=self.threads)


_RULES = (
    needs("--motion", "--method cg | --method sparse"),
    only_with("--parallax", "--anaglyph", "--stereo"),
    needs("--views", "--camera"),
)


def run(args: Arguments) -> int:
    """Write the all-in-focus picture of every frame; return the exit status."""
    bank = load_bank(args.bank)
    camera = load_camera(args.camera) if args.camera else None
    with naming(args.bank):
        stereo = StereoOutput(args.stereo_output, args.output, args.gamma, bank.stack, camera)
    restorer = _Restorer(args, bank, camera)
    bits = None if args.gamma == 1 else 8
    for_display = args.pictures and bits is None

    def files(output: Path) -> list[Path]:
        beside = [output.with_suffix(_STD_DEV), output.with_suffix(_KIND)] if args.std_dev else []
        beside += [display_path(output)] if for_display else []
        return [*stereo.outputs(output), *beside]

    skipped = SkippedInputs()
    summaries: list[dict[str, Any]] = []
    video: int | None = None
    outputs = Outputs(args.output, ".png", PICTURE_SUFFIXES, files, _files_read(args))
    for named in named_frames(args, outputs, skipped, camera):
        if named.video != video:
            restorer.reset()
            video = named.video
        start = time.perf_counter()
        try:
            with naming(named.source):
                named.suited(bank)
                stereo.check(named.frame.shape)
                sharp, depth = restorer.restored(named.frame)
                seconds = time.perf_counter() - start
                blur_size_px = restorer.blur_size_px(named.frame, depth)
                found = restorer.uncertainty(named.frame, sharp, depth) if args.std_dev else None
        except InputError as error:
            skipped.note(error)
            continue
        summary: dict[str, Any] = {"output": str(named.output), "seconds": round(seconds, 3)}
        with output_set():
            write_image(named.output, sharp, bits, args.gamma)
            if for_display:
                write_light_for_display(named.output, sharp)
            if found is not None:
                summary |= _write_uncertainty(found, named.output)
            summary |= stereo.write(named.output, sharp, blur_size_px)
        summaries.append(summary)
        if not args.json:
            print(f"{named.output}: deblurred in {seconds:.2f} s")
    if args.json:
        print(json.dumps(summaries))
    return skipped.status()


def _files_read(args: Arguments) -> list[Path]:
    """Files that the options name."""
    given = [Path(args.bank), *([Path(args.motion)] if args.motion else [])]
    if args.depth != _AUTO:
        given.append(Path(args.depth))
    return [*given, *(camera_files(args.camera) if args.camera else ())]


def _write_uncertainty(found: Uncertainty, output: Path) -> dict[str, str]:
    """Write how far a picture can be relied on; return the files."""
    files = {"std_dev": output.with_suffix(_STD_DEV), "kind": output.with_suffix(_KIND)}
    write_image(files["std_dev"], found.std_dev)
    write_image(files["kind"], (_GREY * found.kind).astype(np.uint8))
    return {name: str(path) for name, path in files.items()}


class _Restorer:
    """Makes all-in-focus pictures, with depth from the pipeline itself or from a file."""

    def __init__(self, args: Arguments, bank: FilterBank, camera: Camera | None) -> None:
        self._args = args
        self._motion_px = None if args.motion is None else _load_motion(args.motion)
        if camera is not None:
            with naming(args.camera):
                camera = check_setting(bank, camera)
        self._camera = camera
        self._depth_m = None if args.depth == _AUTO else _known_depths(args, bank, camera)
        config = args.config
        # A picture from depth that is not sure shows that itself.
        depth = DepthConfig(
            noise=config.noise,
            noise_gain=config.noise_gain,
            saturation=config.saturation,
            network=config.network,
            threads=args.threads or 0,
            check_fit=False,
        )
        with naming(args.camera or args.bank):
            iterations = partial(progress, unit="iteration")
            self._pipeline = FramePipeline(bank, camera, depth, config, iterations)

    def reset(self) -> None:
        """Forget the frames so far: another video begins."""
        self._pipeline.reset()

    def restored(self, frame: Frame) -> tuple[FloatArray, DepthEstimate | FloatArray]:
        """All-in-focus picture of a frame, and the depth that it was made with."""
        self._pipeline.fit(self._camera, frame)
        depth = self._pipeline(frame) if self._depth_m is None else self._depth_for(frame.shape)
        return self._pipeline.deblur(frame, depth, self._motion_px), depth

    def blur_size_px(self, frame: Frame, depth: DepthEstimate | FloatArray) -> FloatArray:
        """Blur sizes that a picture was made with, px [map rows, map columns]."""
        return self._pipeline.blur_size_px(frame, depth)

    def uncertainty(
        self, frame: Frame, sharp: FloatArray, depth: DepthEstimate | FloatArray
    ) -> Uncertainty:
        """How far each pixel of an all-in-focus picture can be relied on."""
        return self._pipeline.uncertainty(frame, sharp, depth)

    def _depth_for(self, shape: Shape) -> FloatArray:
        """Depth map that was given, m; an `InputError` if it does not cover frames of a shape."""
        assert self._depth_m is not None
        if not covers_frame(self._depth_m.shape, shape):
            of_map, of_frame = (f"{x[1]} x {x[0]}" for x in (self._depth_m.shape, shape))
            raise InputError(
                f"the depth map {self._args.depth} has {of_map} pixels, this frame {of_frame}: it "
                "must be of this size, or of this shape and smaller"
            )
        return self._depth_m


def _load_motion(path: str) -> FloatArray:
    """Map of motion for all frames."""
    try:
        motion_px: FloatArray = np.lib.format.open_memmap(path, mode="r")
    except (OSError, ValueError, EOFError) as error:
        what = "expected a .npy as depth --motion writes it"
        raise InputError(f"cannot read motion {path}: {what}") from error
    return motion_px


def _known_depths(args: Arguments, bank: FilterBank, camera: Camera | None) -> FloatArray:
    """Depths of the file, m, of which blur sizes can be made."""
    depth_m = read_depth(args.depth)
    blur_size_px = blur_sizes_px(bank, camera, depth_m)
    if blur_size_px is None:
        what = "the bank does not know how far its levels are: give --camera, or --depth auto"
        raise InputError(f"{args.bank}: {what}")
    if not np.isfinite(blur_size_px).any():
        raise InputError(f"{args.depth}: no pixel has a known depth")
    with naming(args.depth):
        check_depth_range(bank, camera, depth_m)
    return depth_m


COMMAND = Command(
    Arguments,
    run,
    description="Remove the blur of every pixel according to its depth. PNG pictures are written "
    "with 16 bits in linear light, which look dark in most viewers: look at x.picture.png beside "
    "x.png. With --gamma they are written, like the input, with 8 bits in that encoding.",
    examples=_EXAMPLES,
    rules=_RULES,
)
