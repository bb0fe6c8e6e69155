"""`coded_aperture calibrate blind`: an unknown mask from planes at unknown distances."""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.calibration.blind.config import BlindConfig
from coded_aperture_ros.calibration.blind.find import BlindMask, find_mask
from coded_aperture_ros.calibration.pictures import blind_picture, enlarged
from coded_aperture_ros.calibration.psf.optics_limits import with_optics_limits
from coded_aperture_ros.cli.command import Command, UsageError, argument, group
from coded_aperture_ros.cli.plane_pictures import MASK_FILE, pictures_in, write_report
from coded_aperture_ros.cli.reading import GammaArguments
from coded_aperture_ros.cli.results import Summary, print_summary
from coded_aperture_ros.cli.rules import required
from coded_aperture_ros.core.files import atomic_outputs, check_output
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.io import read_image, write_image
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank, save_bank
from coded_aperture_ros.optics import render_psf_stack

_EXAMPLES = """examples:
  the mask, and a bank for the blur sizes of the pictures:
    coded_aperture calibrate blind planes --output found -o bank.npz
  pictures blurred by 16 px at most, of a mask of 5 to 9 cells a side:
    coded_aperture calibrate blind a.png b.png c.png d.png --largest-blur-px 16 \\
        --least-cells 5 --most-cells 9 --output found

Take 8 planes or more, parallel to the sensor, all on one side of the focus, at different distances
that need not be known, with fine texture all over. Whether the mask is as found or turned by 180
degrees, spectra do not tell: if deblurred pictures look worse than blurred ones, turn it.
"""
_REPORT = "calibrate_blind.json"
_PICTURE_OF_MASK = "mask.png"
_PICTURE = "spectra.png"
_LEVEL_COUNT = 40


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(GammaArguments):
    """Arguments of `calibrate blind`."""

    inputs: tuple[str, ...] = argument("pictures, or a folder of them", written="FOLDER|PICTURE")
    output: Path | None = argument(
        f"folder for {MASK_FILE}, {_PICTURE_OF_MASK}, {_PICTURE} and {_REPORT}",
        None,
        written="--output DIR",
    )
    bank: str | None = argument(
        "bank (.npz) from the least to the largest blur", None, written="-o FILE", is_output=True
    )
    level_count: int = argument(
        "levels of the bank", _LEVEL_COUNT, written="--level-count N", minimum=2
    )
    json: bool = argument("print the numbers as JSON", False)
    search: BlindConfig = group("search", BlindConfig())
    filters: LearnConfig = group("filters of the bank", LearnConfig())


_RULES = (required("--output", "-o", note="where the results go"),)


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    config = args.search
    filters = args.filters
    names = pictures_in(args.inputs)
    if args.bank is not None:
        check_output(args.bank, map(Path, names), [".npz"])
        if 0 < filters.window_px < config.largest_blur_px:
            raise UsageError(
                f"--window-px: blur of --largest-blur-px {config.largest_blur_px} does not fit "
                f"patches of {filters.window_px} px"
            )
    if args.output is not None:
        results = (_REPORT, MASK_FILE, _PICTURE_OF_MASK, _PICTURE)
        check_output((args.output / name for name in results), map(Path, names))
    start = time.perf_counter()
    images = [read_image(name, args.gamma) for name in names]
    found = find_mask(images, names, config, progress)
    summary = _summary(args, names, found, round(time.perf_counter() - start, 3))
    _write_files(args, found, summary)
    warning = f"the blur is larger than {config.largest_blur_px} px: try a larger --largest-blur-px"
    warnings = [warning] if found.reaches_limit else []
    if found.doubtful:
        warnings.append("this may not be the mask: try more --starts, or pictures of more planes")
    return print_summary(summary, _text, as_json=args.json, warnings=warnings)


def _summary(
    args: Arguments, names: Sequence[str], found: BlindMask, seconds: float
) -> dict[str, Any]:
    cells = found.mask.transmission
    return {
        "bank": args.bank,
        "output": None if args.output is None else str(args.output),
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


def _write_files(args: Arguments, found: BlindMask, summary: Summary) -> None:
    """Write the bank and all files of the output folder, or none."""
    with atomic_outputs() as output:
        if args.output is not None:
            folder = args.output
            write_report(output, folder / _REPORT, summary, found.mask)
            write_image(output(folder / _PICTURE_OF_MASK), enlarged(found.mask.transmission, 512))
            write_image(output(folder / _PICTURE), blind_picture(found))
        if args.bank is not None:
            sizes = found.blur_sizes_px
            levels = np.linspace(sizes.min(), sizes.max(), args.level_count)
            learned_from = f"mask found in {len(sizes)} planes at unknown distances"
            stack = render_psf_stack(found.mask, levels)
            bank = learn_bank(stack, args.filters, learned_from=learned_from)
            save_bank(with_optics_limits(bank, progress), output(args.bank))


def _text(summary: Summary) -> str:
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


COMMAND = Command(
    Arguments,
    run,
    description="Find the mask and the blur size of every picture from their power spectra "
    "alone (thesis 10.2). The mask is taken to be of square cells, open or closed. It is found "
    "up to a rotation by 180 degrees.",
    examples=_EXAMPLES,
    rules=_RULES,
)
