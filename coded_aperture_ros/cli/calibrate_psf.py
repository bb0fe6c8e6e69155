"""`coded_aperture calibrate psf`: PSFs from photographs of dots."""

import dataclasses
import math
import re
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from coded_aperture_ros.calibration.pictures import psf_picture
from coded_aperture_ros.calibration.psf.centre import CentredPsf
from coded_aperture_ros.calibration.psf.dots import DotPsf, psf_from_dots
from coded_aperture_ros.calibration.psf.stack import psf_stack
from coded_aperture_ros.cli.command import Command, UsageError, argument
from coded_aperture_ros.cli.plane_pictures import pictures_in
from coded_aperture_ros.cli.reading import GammaArguments, read_numbers
from coded_aperture_ros.cli.results import Summary, input_files, print_summary
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.files import atomic_outputs, check_output
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text import rounded
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.io import read_image, write_image
from coded_aperture_ros.optics import PsfStack, load_camera, load_mask

_EXAMPLES = """examples:
  from pictures of a grid of dots, one for each depth, with the depth in the name:
    coded_aperture calibrate psf dots_2.3m.png dots_2.9m.png dots_4.0m.png \\
        --camera config/demo_camera.yaml -o psfs.npz --picture psfs.png
  from a folder of such pictures, with 20 levels between them:
    coded_aperture calibrate psf dots --mask levin --level-count 20 -o psfs.npz

Then: coded_aperture learn --psfs psfs.npz -o bank.npz
"""
_FAIR_SNR = 20.0
_UNEVEN = 0.1
_UNLIKE = 0.15
_WRONG_SIZE = 0.05
_DEPTH_IN_NAME = re.compile(r"(\d+(?:\.\d+)?)m$")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(GammaArguments):
    """Arguments of `calibrate psf`."""

    inputs: tuple[str, ...] = argument(
        "pictures of dots, or a folder of them", written="FOLDER|PICTURE"
    )
    depths: tuple[float, ...] | None = argument(
        "depth in m of each picture, by name in a folder (default: as the names end, such as "
        "a_1.25m.png)",
        None,
        written="--depths Z1,Z2,...",
        parse=read_numbers,
    )
    camera: str | None = argument(
        "camera file: its mask and its side; with depths, its blur sizes are compared",
        None,
        written="--camera YAML",
    )
    mask: str | None = argument(
        "the mask (default: the camera file's; without either, a PSF's centre of light is its "
        "centre, and blur sizes are right in proportion only)",
        None,
        written="--mask NAME|FILE",
    )
    level_count: int | None = argument(
        "PSFs to write (default: one for each picture)", None, written="--level-count N", minimum=1
    )
    output: str = argument("PSF stack (.npz)", written="-o --output FILE", is_output=True)
    picture: str | None = argument(
        "picture of the measured PSFs to write", None, written="--picture PNG", is_output=True
    )
    json: bool = argument("print the numbers as JSON", False)


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    names, depths_m = _checked(args)
    camera = None if args.camera is None else load_camera(args.camera)
    if camera is not None and camera.side == "both":
        raise InputError(
            f"{args.camera}: side: both: PSFs of one side are measured at a time, give a camera "
            "file with side: far or near"
        )
    mask = load_mask(args.mask) if args.mask is not None else camera.mask if camera else None
    sign = None if camera is None else 1.0 if camera.side == "far" else -1.0
    expected = None if camera is None or depths_m is None else camera.blur_size_px(depths_m)
    start = time.perf_counter()
    size: tuple[int, ...] | None = None
    measured: list[DotPsf] = []
    centred: list[CentredPsf] = []
    for name in progress(names, len(names), "picture"):
        picture = _picture(args, name, names[0], size)
        size = picture.shape[:2]
        with naming(name):
            measured.append(psf_from_dots(picture, mask, sign))
            centred.append(measured[-1].centred(mask, sign))
    stack = psf_stack(centred, args.level_count, depths_m, names)
    _write(args, stack, centred)
    rows = [
        {
            "picture": name,
            "depth_m": None if depths_m is None else depths_m[number],
            "blur_size_px": round(centred[number].blur_size_px, 4),
            "camera_blur_size_px": None if expected is None else round(float(expected[number]), 4),
            "mask_misfit": rounded(centred[number].misfit, 4),
            **_row(measured[number]),
        }
        for number, name in enumerate(names)
    ]
    warnings = [f"{row['picture']}: {warning}" for row in rows for warning in _warnings(row)]
    summary = {
        "output": args.output,
        "picture": args.picture,
        "levels": len(stack),
        "blur_sizes_px": [round(float(size), 4) for size in stack.blur_sizes_px],
        "psf_width_px": stack.psfs.shape[1],
        "pictures": rows,
        "warnings": warnings,
        "seconds": round(time.perf_counter() - start, 3),
    }
    return print_summary(summary, _text, as_json=args.json, warnings=warnings)


def _checked(args: Arguments) -> tuple[list[str], Sequence[float] | None]:
    """Return the pictures and their depths; refuse what does not go together."""
    depths_m = args.depths
    if depths_m is not None and not all(0 < depth < math.inf for depth in depths_m):
        raise UsageError("--depths: expected distances of more than 0 m")
    names = pictures_in(args.inputs)
    count, least = args.level_count, min(2, len(names))
    if count is not None and count > 1 and len(names) == 1:
        raise UsageError(
            "--level-count: one PSF cannot be interpolated, give pictures of more depths"
        )
    if count is not None and count < least:
        raise UsageError(f"--level-count: at least {least}, got {count}")
    given = [*map(Path, names), *input_files(args.mask, camera=args.camera)]
    check_output(args.output, given, [".npz"])
    if args.picture is not None:
        check_output(args.picture, given, [".png"])
    if depths_m is None:
        return names, _depths_in_names(names)
    if len(depths_m) != len(names):
        raise UsageError(f"--depths: {len(depths_m)} for {len(names)} pictures: give one for each")
    return names, depths_m


def _depths_in_names(names: Sequence[str]) -> list[float] | None:
    """Return the depths that all names end in, or None if none does."""
    found = [_DEPTH_IN_NAME.search(Path(name).stem) for name in names]
    if not any(found):
        return None
    for name, match in zip(names, found, strict=True):
        if match is None or not float(match[1]) > 0:
            raise InputError(
                f"{name}: no depth at the end of its name, as others have: rename it, such as "
                "a_1.25m.png, or give all with --depths"
            )
    return [float(match[1]) for match in found if match is not None]


def _picture(args: Arguments, name: str, first: str, size: tuple[int, ...] | None) -> FloatArray:
    picture = read_image(name, args.gamma)
    if size is not None and picture.shape[:2] != size:
        raise InputError(
            f"{name}: has {picture.shape[1]}x{picture.shape[0]} px, but {first} has "
            f"{size[1]}x{size[0]} px: take all pictures with one camera"
        )
    return picture


def _write(args: Arguments, stack: PsfStack, centred: Sequence[CentredPsf]) -> None:
    """Write the stack and the picture, or neither."""
    width = max(one.width_px for one in centred)
    with atomic_outputs() as output:
        if args.picture is not None:
            drawn = psf_picture([one.psf(width) for one in centred])
            write_image(output(args.picture), drawn, 8, 2.2)
        stack.save(output(args.output))


def _row(measured: DotPsf) -> dict[str, Any]:
    return {
        "snr": round(measured.snr, 2),
        "field_variation": rounded(measured.field_variation, 4),
        "spacing_px": round(measured.spacing_px, 3),
        **{
            f"dots_{name}": getattr(measured, name)
            for name in ("used", "saturated", "rejected", "missing")
        },
    }


def _warnings(row: dict[str, Any]) -> Iterator[str]:
    size, expected = row["blur_size_px"], row["camera_blur_size_px"]
    if row["snr"] < _FAIR_SNR:
        noise = 1 / row["snr"]
        yield f"noise is {noise:.0%} of the PSF: expose for longer, or average several pictures"
    if (row["field_variation"] or 0) > _UNEVEN:
        yield (
            f"the PSF differs by {row['field_variation']:.0%} over the picture: check that the "
            "grid is parallel to the sensor; else the lens is the cause"
        )
    if (row["mask_misfit"] or 0) > _UNLIKE:
        yield (
            f"the PSF differs from the mask's by {row['mask_misfit']:.0%}: check the mask, its "
            "orientation, and that the lights are small"
        )
    missing, saturated = row["dots_missing"], row["dots_saturated"]
    if missing or saturated:
        yield f"{missing} dots are missing, {saturated} saturated ones left out"
    if expected is not None and abs(size - expected) > max(_WRONG_SIZE * abs(expected), 0.2):
        yield (
            f"the blur is {size:.2f} px, by the camera file {expected:.2f} px: check depths, "
            "focus_distance_m and mask_extent_mm"
        )


def _text(summary: Summary) -> str:
    rows = summary["pictures"]
    columns = {
        "picture": ("picture", ""),
        "depth m": ("depth_m", ".3f"),
        "blur px": ("blur_size_px", ".2f"),
        "camera px": ("camera_blur_size_px", ".2f"),
        "misfit": ("mask_misfit", ".1%"),
        "SNR": ("snr", ".0f"),
        "field": ("field_variation", ".1%"),
        "dots": ("dots_used", ""),
        "saturated": ("dots_saturated", ""),
        "unlike": ("dots_rejected", ""),
        "missing": ("dots_missing", ""),
    }
    cells = [
        ["-" if row[key] is None else format(row[key], form) for key, form in columns.values()]
        for row in rows
    ]
    sizes, count = summary["blur_sizes_px"], summary["levels"]
    return (
        f"{table(list(columns), cells)}\n"
        f"{summary['output']}: {count} PSF{'s' if count > 1 else ''} of {sizes[0]:.2f} to "
        f"{sizes[-1]:.2f} px; {summary['seconds']:.1f} s"
    )


COMMAND = Command(
    Arguments,
    run,
    description="Measure the PSFs of a camera, for a stack of equally spaced blur sizes: from "
    "one picture for each depth of a square grid of equal small lights on black, parallel to "
    "the sensor. Pictures have to be linear. The middle of the mask's extent is that of the "
    "PSF; the mask is that of --camera or --mask.",
    examples=_EXAMPLES,
)
