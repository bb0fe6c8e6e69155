"""`coded_aperture calibrate blind`: an unknown mask from planes at unknown distances."""

import argparse
import time
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output
from coded_aperture_ros.cli.measuring import (
    MASK_FILE,
    add_level_count_option,
    checked_config,
    pictures_in,
    tell,
    write_report,
)
from coded_aperture_ros.cli.options import add_gamma_option, add_options, settings_of
from coded_aperture_ros.core.progress import progress

_EPILOG = """examples:
  the mask, and a bank for the blur sizes of the pictures:
    coded_aperture calibrate blind planes --output found -o bank.npz
  pictures blurred by 16 px at most, of a mask of 5 to 9 cells a side:
    coded_aperture calibrate blind a.png b.png c.png d.png --largest-blur-px 16 \\
        --least-cells 5 --most-cells 9 --output found

Take 8 planes or more, parallel to the sensor, all on one side of the focus, at different distances
that need not be known, with fine texture all over. Whether the mask is as found or turned by 180
degrees, spectra do not tell: if deblurred pictures look worse than blurred ones, turn it.
"""
_REPORT, _PICTURE_OF_MASK, _PICTURE = "calibrate_blind.json", "mask.png", "spectra.png"
_LEVEL_COUNT = 40


def add_parser(subparsers: Any) -> None:
    """Add the action to the parser of `calibrate`."""
    parser = subparsers.add_parser(
        "blind",
        help="find an unknown mask from pictures of planes at unknown distances",
        description="Find the mask and the blur size of every picture from their power spectra "
        "alone (thesis 10.2). The mask is taken to be of square cells, open or closed. It is found "
        "up to a rotation by 180 degrees.",
        epilog=_EPILOG,
    )
    what = "pictures, or a folder of them"
    parser.add_argument("inputs", nargs="+", metavar="FOLDER|PICTURE", help=what)
    add_gamma_option(parser)
    results = f"folder for {MASK_FILE}, {_PICTURE_OF_MASK}, {_PICTURE} and {_REPORT}"
    add_options(parser, {"--output DIR": results})
    add_options(parser, {"-o FILE": "bank (.npz) from the least to the largest blur"}, dest="bank")
    add_level_count_option(parser, _LEVEL_COUNT, f"levels of the bank (default {_LEVEL_COUNT})")
    add_options(parser, {"--json": "print the numbers as JSON"})
    settings = {"calibration.blind.config.BlindConfig": "search"}
    settings |= {"likelihood.bank.LearnConfig": "filters of the bank"}
    parser.add_late_options = settings_of(settings)


def run(args: argparse.Namespace) -> int:
    """Run the action; return its exit status."""
    from coded_aperture_ros.calibration.blind.config import BlindConfig
    from coded_aperture_ros.calibration.blind.find import find_mask
    from coded_aperture_ros.io import read_image
    from coded_aperture_ros.likelihood.bank import LearnConfig

    if args.bank is None and args.output is None:
        args.usage_error("say where the results go with --output DIR or -o bank.npz, or both")
    config, filters = checked_config(args, BlindConfig), checked_config(args, LearnConfig)
    names = pictures_in(args.inputs)
    if args.bank is not None:
        check_output(args.bank, map(Path, names), [".npz"])
        if 0 < filters.window_px < config.largest_blur_px:
            args.usage_error(
                f"--window-px: blur of --largest-blur-px {config.largest_blur_px} does not fit "
                f"patches of {filters.window_px} px"
            )
    if args.output is not None:
        results = (_REPORT, MASK_FILE, _PICTURE_OF_MASK, _PICTURE)
        check_output((Path(args.output, name) for name in results), map(Path, names))
    start = time.perf_counter()
    images = [read_image(name, args.gamma) for name in names]
    found = find_mask(images, names, config, progress)
    summary = _summary(args, names, found, round(time.perf_counter() - start, 3))
    _write_files(args, found, filters, summary)
    warning = f"the blur is larger than {config.largest_blur_px} px: try a larger --largest-blur-px"
    warnings = [warning] if found.reaches_limit else []
    if found.doubtful:
        warnings.append("this may not be the mask: try more --starts, or pictures of more planes")
    return tell(args, summary, _text, warnings)


def _summary(
    args: argparse.Namespace, names: list[str], found: Any, seconds: float
) -> dict[str, Any]:
    cells = found.mask.transmission
    return {
        "bank": args.bank,
        "output": args.output,
        "mask": ["".join("#" if cell else "." for cell in row) for row in cells],
        "light": round(found.mask.open_fraction, 4),
        "explained": round(found.explained, 4),
        "orientation": "as found or turned by 180 degrees",
        "reaches_limit": found.reaches_limit,
        "doubtful": found.doubtful,
        "planes": [
            {"file": name, "blur_size_px": round(float(size), 3)}
            for name, size in zip(names, found.blur_sizes_px, strict=True)
        ],
        "seconds": seconds,
    }


def _write_files(args: argparse.Namespace, found: Any, filters: Any, summary: Any) -> None:
    """Write the bank and all files of the output folder, or none."""
    import numpy as np

    from coded_aperture_ros.calibration.pictures import blind_picture, enlarged
    from coded_aperture_ros.core.files import atomic_outputs
    from coded_aperture_ros.io import write_image
    from coded_aperture_ros.likelihood.bank import learn_bank, save_bank
    from coded_aperture_ros.optics import render_psf_stack

    with atomic_outputs() as output:
        if args.output is not None:
            folder = Path(args.output)
            write_report(output, folder / _REPORT, summary, found.mask)
            write_image(output(folder / _PICTURE_OF_MASK), enlarged(found.mask.transmission, 512))
            write_image(output(folder / _PICTURE), blind_picture(found))
        if args.bank is not None:
            sizes = found.blur_sizes_px
            levels = np.linspace(sizes.min(), sizes.max(), args.level_count)
            learned_from = f"mask found in {len(sizes)} planes at unknown distances"
            stack = render_psf_stack(found.mask, levels)
            save_bank(learn_bank(stack, filters, learned_from=learned_from), output(args.bank))


def _text(summary: Any) -> str:
    planes = sorted(summary["planes"], key=lambda plane: float(plane["blur_size_px"]))
    rows = summary["mask"]
    lines = [
        f"mask of {len(rows[0])}x{len(rows)} cells, {summary['light']:.0%} of the square open; "
        f"{summary['explained']:.0%} of the structure of the spectra explained",
        *(f"  {row}" for row in rows),
        "as it was found; spectra do not tell it from the same mask turned by 180 degrees",
        f"  {'':40}{'blur px':>8}",
        *(f"  {plane['file'][-40:]:40}{plane['blur_size_px']:8.2f}" for plane in planes),
    ]
    wrote = [str(place) for place in (summary["output"], summary["bank"]) if place]
    return "\n".join([*lines, f"{', '.join(wrote)}; {summary['seconds']:.0f} s"])
