"""`coded_aperture calibrate psf`: PSFs from photographs of dots, or of a page sharp and coded."""

import argparse
import json
import logging
import math
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output, check_suffix, naming
from coded_aperture_ros.cli.options import add_gamma_option
from coded_aperture_ros.cli.progress import progress
from coded_aperture_ros.errors import InputError

_EPILOG = """examples:
  from pictures of a grid of dots, one for each depth:
    coded_aperture calibrate psf --dots near.png middle.png far.png --depths 2.3 2.9 4.0 \\
        --camera config/demo_camera.yaml -o psfs.npz --picture psfs.png
  without knowing depths, for the mask alone:
    coded_aperture calibrate psf --dots near.png middle.png far.png --mask levin -o psfs.npz
  from a sharp and a coded picture of one page:
    coded_aperture calibrate psf --pair sharp_page.png coded_page.png --depths 2.9 \\
        --camera config/demo_camera.yaml -o page.npz

Then: coded_aperture learn --psfs psfs.npz -o bank.npz
"""
_FAIR_SNR = 20.0
_UNEVEN = 0.1
_WRONG_SIZE = 0.05
_WIDEST_PX = 31.0


def add_parser(subparsers: Any) -> None:
    """Add the action to the sub-command's parser."""
    parser = subparsers.add_parser(
        "psf",
        help="measure PSFs from pictures of dots, or from a sharp and a coded picture",
        description="Measure the PSFs of a camera. Dots: one picture for each depth of a square "
        "grid of small bright dots on a dark background, or dark ones on a bright one, parallel to "
        "the sensor. A pair: a page with fine texture, once with a small aperture instead of the "
        "mask and once with the mask. Pictures have to be linear. A PSF's middle is that of the "
        "mask's extent, which the mask of --camera or --mask tells.",
        epilog=_EPILOG,
    )
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--dots", nargs="+", metavar="PICTURE", help="pictures of a grid of dots")
    source.add_argument(
        "--pair", nargs=2, metavar=("SHARP", "CODED"), help="two pictures of one textured plane"
    )
    parser.add_argument(
        "--depths", nargs="+", type=float, metavar="M", help="depth of each picture, in m"
    )
    parser.add_argument(
        "--camera", metavar="YAML", help="camera file: its mask, and with --depths the blur sizes"
    )
    parser.add_argument(
        "--mask",
        metavar="NAME",
        help="name or file (PNG, .npy) of the mask (default: the camera file's; without either, "
        "blur sizes are the width of what is seen)",
    )
    parser.add_argument(
        "--levels", type=int, metavar="N", help="PSFs to write (default: one for each picture)"
    )
    parser.add_argument(
        "--largest-blur-px",
        type=float,
        metavar="PX",
        help="widest PSF looked for (default: as the camera and the depths say, else as wide as "
        f"the dots leave room for, or {_WIDEST_PX:g} with --pair)",
    )
    add_gamma_option(parser)
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="PSF stack (.npz)")
    parser.add_argument("--picture", metavar="PNG", help="picture of the measured PSFs to write")
    parser.add_argument("--json", action="store_true", help="print a summary as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the action; return its exit status."""
    from coded_aperture_ros.calibration import centred_stack, expected_sizes_px
    from coded_aperture_ros.optics import load_camera

    _check_usage(args)
    files = args.dots or args.pair
    inputs = [Path(name) for name in (*files, args.camera, args.mask) if name]
    check_suffix(args.output, [".npz"])
    check_output(args.output, inputs)
    if args.picture is not None:
        check_suffix(args.picture, [".png"])
        check_output(args.picture, inputs)
    start = time.perf_counter()
    camera = load_camera(args.camera) if args.camera else None
    mask = _mask(args.mask)
    expected = expected_sizes_px(camera, args.depths)
    _check_depths(args, camera)
    widest = [args.largest_blur_px] * len(files)
    if args.largest_blur_px is None and expected is not None:
        # Somewhat more, as the camera file may be wrong.
        widest = [abs(float(size)) * 1.1 + 1 for size in expected]
    if args.dots:
        measured = _from_dots(args, widest)
        names = args.dots
    else:
        measured = [_from_pair(args, widest[0])]
        names = [args.pair[1]]
    found = centred_stack(
        [one.at for one in measured], names, camera, mask, args.depths, args.levels
    )
    _write(args, found)
    rows = [
        _row(args, number, name, one, found)
        for number, (name, one) in enumerate(zip(names, measured, strict=True))
    ]
    warnings = [warning for row in rows for warning in _warnings(row)]
    summary = {
        "output": args.output,
        "picture": args.picture,
        "levels": len(found.stack),
        "blur_sizes_px": [round(float(size), 4) for size in found.stack.blur_sizes_px],
        "psf_width_px": found.stack.psfs.shape[1],
        "pictures": rows,
        "warnings": warnings,
        "seconds": round(time.perf_counter() - start, 3),
    }
    for warning in warnings:
        logging.warning(warning)
    print(json.dumps(summary) if args.json else _table(summary))
    return 0


def _check_usage(args: argparse.Namespace) -> None:
    count = len(args.dots) if args.dots else 1
    if args.depths is not None and len(args.depths) != count:
        args.usage_error(
            f"--depths: {len(args.depths)} depths for {count} "
            f"{'pictures' if args.dots else 'pair'}: give one for each"
        )
    if args.levels is not None and args.levels < min(2, count):
        args.usage_error(f"--levels: expected at least {min(2, count)}, got {args.levels}")
    if args.levels is not None and args.levels > 1 and count == 1:
        args.usage_error("--levels: one PSF alone cannot be interpolated, measure more depths")
    widest = args.largest_blur_px
    if widest is not None and not 1 <= widest < math.inf:
        args.usage_error(f"--largest-blur-px: expected 1 px or more, got {widest:g}")


def _check_depths(args: argparse.Namespace, camera: Any) -> None:
    """Check that all depths lie on the side of the focus that the camera file has."""
    if camera is None or args.depths is None:
        return
    with naming(args.camera):
        if len(set(args.depths)) > 1:
            camera.blur_range_px(min(args.depths), max(args.depths))


def _mask(name: str | None) -> Any:
    from coded_aperture_ros.optics import MASK_NAMES, Mask

    if name is None:
        return None
    return (
        Mask.from_file(name) if name not in MASK_NAMES and Path(name).exists() else Mask.named(name)
    )


def _from_dots(args: argparse.Namespace, widest: list[float | None]) -> list[Any]:
    from coded_aperture_ros.calibration import psf_from_dots
    from coded_aperture_ros.images import read_image

    measured = []
    first: tuple[int, ...] | None = None
    pairs = list(zip(args.dots, widest, strict=True))
    for name, largest_px in progress(pairs, len(pairs), "picture"):
        picture = read_image(name, args.gamma)
        first = first or picture.shape[:2]
        if picture.shape[:2] != first:
            raise InputError(
                f"{name}: {picture.shape[1]}x{picture.shape[0]} px, but {args.dots[0]} has "
                f"{first[1]}x{first[0]} px: take all pictures with one camera"
            )
        with naming(name):
            measured.append(psf_from_dots(picture, largest_px))
    return measured


def _from_pair(args: argparse.Namespace, widest: float | None) -> Any:
    from coded_aperture_ros.calibration import psf_from_pair
    from coded_aperture_ros.images import read_image

    sharp, coded = (read_image(name, args.gamma) for name in args.pair)
    with naming(f"{args.pair[0]} and {args.pair[1]}"):
        return psf_from_pair(sharp, coded, _WIDEST_PX if widest is None else widest)


def _write(args: argparse.Namespace, found: Any) -> None:
    """Write the stack and the picture, or neither."""
    from coded_aperture_ros.calibration import psf_picture
    from coded_aperture_ros.files import atomic_output
    from coded_aperture_ros.images import write_image

    with ExitStack() as stack:
        target = stack.enter_context(atomic_output(args.output))
        if args.picture is not None:
            drawn = stack.enter_context(atomic_output(args.picture))
            write_image(drawn, psf_picture(list(found.stack.psfs)), bits=8, gamma=2.2)
        found.stack.save(target)


def _row(args: argparse.Namespace, number: int, name: str, one: Any, found: Any) -> dict[str, Any]:
    centred, expected = found.centred[number], found.expected_px
    row = {
        "picture": name,
        "depth_m": None if args.depths is None else args.depths[number],
        "blur_size_px": round(centred.blur_size_px, 4),
        "camera_blur_size_px": None if expected is None else round(float(expected[number]), 4),
        "mask_misfit": _number(centred.misfit),
        "snr": round(centred.snr, 2),
    }
    if args.dots:
        row |= {
            "field_variation": _number(one.field_variation),
            "spacing_px": round(one.spacing_px, 3),
            "scatter_px": round(one.scatter_px, 4),
            "dots_used": one.used,
            "dots_rejected": one.rejected,
            "dots_missing": one.missing,
            "dark_on_bright": one.dark,
        }
    else:
        row |= {"explained": round(one.agreement, 4), "shift_px": list(one.shift_px)}
    return row


def _number(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def _warnings(row: dict[str, Any]) -> list[str]:
    name, size, expected = row["picture"], row["blur_size_px"], row["camera_blur_size_px"]
    warnings = []
    if row["snr"] < _FAIR_SNR:
        warnings.append(
            f"{name}: noise is {1 / row['snr']:.0%} of the PSF: expose for longer, or use more dots"
        )
    if (row.get("field_variation") or 0) > _UNEVEN:
        warnings.append(
            f"{name}: the PSF differs by {row['field_variation']:.0%} over the picture: check that "
            "the grid is parallel to the sensor; else the lens is the cause"
        )
    if expected is not None and abs(size - expected) > max(_WRONG_SIZE * abs(expected), 0.2):
        warnings.append(
            f"{name}: the blur is {size:.2f} px, by the camera file {expected:.2f} px: check "
            "depths, focus_distance_m and mask_extent_mm"
        )
    return warnings


def _table(summary: dict[str, Any]) -> str:
    rows = summary["pictures"]
    dots = "dots_used" in rows[0]
    width = max(7, *(len(row["picture"]) for row in rows))
    last = "  field  dots used  rejected  missing" if dots else "  explained  shift px"
    lines = [f"{'picture':{width}}  depth m  blur px  camera px  misfit    SNR{last}"]
    for row in rows:
        line = (
            f"{row['picture']:{width}}{_cell(row['depth_m'], 9, '.3f')}"
            f"{_cell(row['blur_size_px'], 9, '.2f')}"
            f"{_cell(row['camera_blur_size_px'], 11, '.2f')}"
            f"{_cell(row['mask_misfit'], 8, '.1%')}{_cell(row['snr'], 7, '.0f')}"
        )
        if dots:
            line += (
                f"{_cell(row['field_variation'], 7, '.1%')}{row['dots_used']:11}"
                f"{row['dots_rejected']:10}{row['dots_missing']:9}"
            )
        else:
            down, right = row["shift_px"]
            line += f"{_cell(row['explained'], 11, '.1%')}{f'{down}, {right}':>10}"
        lines.append(line)
    sizes = summary["blur_sizes_px"]
    count = summary["levels"]
    lines.append(
        f"{summary['output']}: {count} PSF{'s' if count > 1 else ''} of {sizes[0]:.2f} to "
        f"{sizes[-1]:.2f} px; {summary['seconds']:.1f} s"
    )
    return "\n".join(lines)


def _cell(value: float | None, width: int, form: str) -> str:
    return f"{'-' if value is None else format(value, form):>{width}}"
