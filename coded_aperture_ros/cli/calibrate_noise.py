"""`coded_aperture calibrate noise`: noise of a sensor from frames of something that is still."""

import dataclasses

from coded_aperture_ros.calibration.noise import noise_from_frames
from coded_aperture_ros.cli.command import Command, UsageError, argument
from coded_aperture_ros.cli.plane_pictures import pictures_in
from coded_aperture_ros.cli.reading import GammaArguments
from coded_aperture_ros.cli.results import Summary, print_summary
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.io import read_image

_EXAMPLES = """example:
    coded_aperture calibrate noise frame1.png frame2.png frame3.png

Then: put noise and noise_gain into the camera file, or give them to depth with --noise and
--noise-gain.
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(GammaArguments):
    """Arguments of `calibrate noise`."""

    frames: tuple[str, ...] = argument("two or more, or their folder", written="FRAME")
    json: bool = argument("print the numbers as JSON", False)


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    names = pictures_in(args.frames)
    frames: list[FloatArray] = []
    if len(names) < 2:
        raise UsageError(f"give two or more frames of one scene: {args.frames[0]} has not so many")
    for name in progress(names, len(names), "frame"):
        frames.append(read_image(name, args.gamma))
        if frames[-1].shape != frames[0].shape:
            raise InputError(
                f"{name}: has the shape {list(frames[-1].shape)}, {names[0]} "
                f"{list(frames[0].shape)}: frames of one camera are needed"
            )
    with naming(f"{names[0]} to {names[-1]}"):
        found = noise_from_frames(frames)
    warnings = []
    if not found.gain_is_known:
        warnings.append(
            f"the light is {found.darkest:.3f} to {found.brightest:.3f} only, which does not tell "
            "noise in the dark from shot noise: photograph something with dark and bright parts"
        )
    elif found.dark_is_extrapolated:
        warnings.append(
            f"nothing is darker than {found.darkest:.3f}, where shot noise hides the noise in the "
            "dark: photograph something that has black parts, too"
        )
    summary = {"frames": len(frames), **dataclasses.asdict(found), "warnings": warnings}
    return print_summary(summary, _text, as_json=args.json, warnings=warnings)


def _text(summary: Summary) -> str:
    return (
        "noise: {noise:.6f}        # standard deviation in the dark, linear light\n"
        "noise_gain: {noise_gain:.7f}  # variance of shot noise per unit of light\n"
        "# from {frames} frames, light {darkest:.3f} to {brightest:.3f}; "
        "variances lie {fit_error:.1%} off the line"
    ).format_map(summary)


COMMAND = Command(
    Arguments,
    run,
    description="Measure the noise of a sensor from two or more frames of one scene, taken "
    "with camera and scene unmoved and equal exposures. Textured or flat, with parts as dark "
    "and as bright as possible. Frames have to be linear.",
    examples=_EXAMPLES,
)
