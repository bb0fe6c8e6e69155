"""The arguments of `coded_aperture depth`, and which of them go together."""

import dataclasses
import textwrap

from coded_aperture_ros.cli.command import argument
from coded_aperture_ros.cli.estimation_arguments import (
    ESTIMATION_RULES,
    FIXED_FRAME,
    FIXED_FRAME_HELP,
    EstimationArguments,
)
from coded_aperture_ros.cli.frames import InputArguments
from coded_aperture_ros.cli.rules import excludes, needs, only_with
from coded_aperture_ros.depth import layer_specs

EXAMPLES = """examples:
  one frame, depth in metres and confidence as .npy, and a picture of both:
    coded_aperture depth --bank bank.npz coded.png -o depth.npy --pictures
  compared with the true depth, as sample and simulate have it:
    coded_aperture depth --bank bank.npz coded.png -o depth.npy --truth depth.png
  all frames of a folder:
    coded_aperture depth --bank bank.npz --regularize graphcut frames/ -o depth/
  a recorded video, each frame together with those before and after it:
    coded_aperture depth --bank bank.npz --temporal-frames 3 --look-ahead video.avi -o depth/
  a walk whose way is known, in lines of time, position and quaternion:
    coded_aperture depth --bank bank.npz --camera camera.yaml --temporal-frames 8 \\
        --moving-camera pose --poses way.txt frames/ -o depth/
  a mask of a few equal holes, without a bank:
    coded_aperture depth --method two_pixel --camera config/example_camera.yaml \\
        --depth-range 3.5 9 coded.png -o two_pixel.npy
  two frames of one view, the second with the lens focused at 0.6 m:
    coded_aperture depth --bank bank.npz --camera camera.yaml coded.png \\
        --refocused-frame refocused.png --refocused-to 0.6 -o depth.npy
  something moves during the exposure: its motion, px, as [row, column, right and down]:
    coded_aperture depth --bank bank.npz --motion coded.png -o moving.npy
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(InputArguments, EstimationArguments):
    """Arguments of `depth`."""

    output: str = argument(
        "depth map: .npy or .tiff in m, .png in mm; or a folder for one .npy per frame",
        written="-o --output OUT",
        is_output=True,
    )
    motion: bool = argument(
        "estimate motion blur too, with --method bank: x.motion.npy beside x.npy has the way "
        "during the exposure in px, [row, column, right and down], and x.motion.confidence.npy how "
        "sure it is",
        False,
    )
    look_ahead: bool = argument(
        "with --temporal-frames N: for recorded videos, and pictures in order. Each frame is "
        "estimated together with those after it, as far as with those before it (default: only "
        "those before it). About 8 N frames are held in memory",
        False,
    )
    poses: str | None = argument(
        "with --moving-camera pose: poses of the camera's optical frame in a fixed one, as text in "
        "lines of time in s, x y z in m, qx qy qz qw (TUM). Pictures whose names are times, and "
        "frames with stamps, have theirs interpolated, others a line each. Bags have their own",
        None,
        written="--poses FILE",
    )
    fixed_frame: str = argument(
        FIXED_FRAME_HELP, FIXED_FRAME, written="--fixed-frame NAME", daily=False
    )
    as_levels: bool = argument("write fractional level indices instead of metres", False)
    refocused_frame: str | None = argument(
        "a frame of the same view with the lens focused elsewhere",
        None,
        written="--refocused-frame FILE",
        daily=False,
    )
    refocused_to: float | None = argument(
        "with --refocused-frame and --camera: distance of its focus",
        None,
        written="--refocused-to M",
        unit="m",
        minimum=0.001,
        maximum=100_000,
        daily=False,
    )
    pictures: bool = argument("write colour pictures of depth and confidence too", False)
    truth: str | None = argument(
        "true depth of all frames: 16-bit PNG in mm, or .tiff or .npy in m. Errors are printed, "
        "and x.comparison.png shows them beside x.npy",
        None,
        written="--truth FILE",
    )
    movie: str | None = argument(
        "write a video of the frames beside their depth too, 10 a second",
        None,
        written="--movie FILE.mp4",
        is_output=True,
    )
    points: bool = argument("write coloured points (x.ply) too; needs --camera", False)
    frame_scale: float = argument(
        "resample frames by S, best below 1, to the size that bank and camera file are for; maps "
        "keep the frames' own size",
        1.0,
        written="--frame-scale S",
        minimum=0.1,
        maximum=10,
        daily=False,
    )
    json: bool = argument("print a summary as JSON", False)


def layers_text() -> str:
    """Return what is written beside a depth map, for the help."""
    lines = ["files beside x.npy, where there is something to tell:"]
    for spec in layer_specs():
        lines.append(f"  x{spec.file_suffix}.npy")
        lines.append(textwrap.indent(textwrap.fill(spec.description, 73), "      "))
    return "\n".join(lines)


RULES = (
    *ESTIMATION_RULES,
    needs("--look-ahead", "--temporal-frames"),
    excludes("--look-ahead", "--angular-velocity", note="which is of one frame"),
    only_with("--poses", "--moving-camera pose"),
    only_with("--fixed-frame", "--moving-camera pose"),
    excludes("--poses", "--fixed-frame"),
    needs("--points", "--camera"),
    excludes("--points", "--as-levels"),
    excludes("--truth", "--as-levels"),
    excludes("--frame-scale", "--look-ahead", "--motion | --method motion"),
    needs("--refocused-frame", "--refocused-to", "--camera"),
    needs("--refocused-to", "--refocused-frame"),
    excludes(
        "--refocused-frame",
        *("--motion | --method motion", "--temporal-frames", "--as-levels", "--frame-scale"),
        "--method two_pixel",
    ),
)
