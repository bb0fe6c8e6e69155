"""`coded_aperture bench blind`: masks that are found from planes at unknown distances."""

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_options import (
    add_images_option,
    add_masks_option,
    add_result_options,
    add_size_option,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import add_numbers, folder_of, mask_of, noise_level, table

_MASKS = ("levin", "zhou", "four_hole")
_METHODS = ("fast", "cg")
_SIZE = (384, 384)
_EPILOG = """examples:
  three masks, 8 planes each, at the noise of 0.001:
    coded_aperture bench blind
  on pictures of a folder, with the found masks and spectra as pictures:
    coded_aperture bench blind --images pictures --size 640x448 --output blind
"""


def add_parser(subparsers: Any) -> None:
    """Add the benchmark to the parser of `bench`."""
    parser = subparsers.add_parser(
        "blind",
        help="masks found from planes at unknown distances, and what deblurring loses by them",
        description="Blur crops of photographs to 7 to 30 px in random order, with noise and in "
        "256 steps, and find mask and blur sizes from them as calibrate blind does. Reported are "
        "the correlation of found and true mask (the better of both orientations, which spectra do "
        "not tell apart), the error of the blur sizes, and the PSNR of the planes deblurred with "
        "the true and with the found PSFs.",
        epilog=_EPILOG,
    )
    add_masks_option(parser, _MASKS)
    parser.add_argument(
        "--sigma",
        type=noise_level,
        default=0.001,
        metavar="S",
        help="noise behind an open aperture (default 0.001)",
    )
    add_numbers(
        parser,
        ("planes", 4, 8, "pictures for each mask"),
        ("seed", 0, 0, "of the first repeat"),
        ("repeats", 1, 1, "other crops, orders and noise"),
    )
    add_size_option(parser, _SIZE)
    add_images_option(parser)
    add_result_options(parser)


@dataclasses.dataclass(frozen=True)
class _Cell:
    """One mask and one set of planes."""

    mask: str
    seed: int
    sigma: float
    planes: int
    size: tuple[int, int]
    images: str | None
    output: str | None


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    for mask in args.masks:
        mask_of(mask)
    check_result_options(args)
    cells = [
        _Cell(
            mask, args.seed + repeat, args.sigma, args.planes, args.size, args.images, args.output
        )
        for mask in args.masks
        for repeat in range(args.repeats)
    ]
    rows = measure_cells(_measured, cells, args.jobs)
    results = {
        "benchmark": "blind",
        "planes": args.planes,
        "sigma": args.sigma,
        "size": [args.size[1], args.size[0]],
        "images": args.images,
        "masks": rows,
    }
    report(args, results, lambda: _text(results))
    return 0


def _measured(cell: _Cell) -> dict[str, Any]:
    """Find the mask of one set of planes, and compare."""
    import numpy as np

    from coded_aperture_benchmarks.blind_planes import (
        deblurring_loss,
        make_blind_planes,
        mask_correlation,
    )
    from coded_aperture_ros.calibration.blind.find import find_mask
    from coded_aperture_ros.calibration.blind.picture import blind_picture
    from coded_aperture_ros.core.errors import InputError
    from coded_aperture_ros.core.files import atomic_output
    from coded_aperture_ros.io import write_image
    from coded_aperture_ros.io.textures import load_textures

    mask = mask_of(cell.mask)
    textures = load_textures("natural", folder_of(cell.images))
    planes = make_blind_planes(mask, textures, cell.sigma, cell.seed, cell.planes, cell.size)
    row: dict[str, Any] = {"mask": mask.name, "seed": cell.seed}
    start = time.perf_counter()
    try:
        found = find_mask(list(planes.coded), [f"plane {i}" for i in range(cell.planes)])
    except InputError as refusal:
        return {**row, "refused": str(refusal)}
    row["seconds"] = round(time.perf_counter() - start, 1)
    error = found.blur_sizes_px / planes.blur_sizes_px - 1
    row["correlation"] = round(mask_correlation(found.mask, mask), 4)
    row["cells"] = list(found.mask.transmission.shape)
    row["explained"] = round(found.explained, 4)
    row["largest_size_error"] = round(float(np.abs(error).max()), 4)
    for method in _METHODS:
        loss = deblurring_loss(planes, found.mask, found.blur_sizes_px, method)
        row[method] = {name: round(value, 3) for name, value in dataclasses.asdict(loss).items()}
    if cell.output is not None:
        name = f"{Path(mask.name).stem}_{cell.seed}.png"
        with atomic_output(Path(cell.output) / name) as path:
            write_image(path, blind_picture(found))
    return row


def _text(results: dict[str, Any]) -> str:
    header = ["mask", "seed", "correlation", "cells", "size error"]
    header += [
        f"{method} {what}" for method in _METHODS for what in ("true dB", "found dB", "loss")
    ]
    lines, refused = [], []
    for row in results["masks"]:
        first = [row["mask"], str(row["seed"])]
        if "refused" in row:
            lines.append([*first, *["-"] * (len(header) - 2)])
            refused.append(f"{' '.join(first)}: {row['refused']}")
            continue
        numbers = [
            f"{row[method][name]:.2f}"
            for method in _METHODS
            for name in ("true_db", "found_db", "largest_loss_db")
        ]
        lines.append(
            [
                *first,
                f"{row['correlation']:.3f}",
                "x".join(str(count) for count in row["cells"][::-1]),
                f"{row['largest_size_error']:.2%}",
                *numbers,
            ]
        )
    notes = "loss: of the plane that loses most, the better of both orientations of the mask"
    return "\n".join([table(header, lines), notes, *refused])
