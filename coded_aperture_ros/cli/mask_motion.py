"""`coded_aperture mask motion`: how an aperture is best cut up, if things move."""

import argparse
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output
from coded_aperture_ros.cli.measuring import tell
from coded_aperture_ros.cli.options import add_numbers, add_options, table
from coded_aperture_ros.cli.progress import progress

_EPILOG = """examples:
  the 84 ways to place 3 holes in a 3x3 grid, for a 50 mm lens at F/7.1:
    coded_aperture mask motion --grid 3 --holes 3 --output fragmentation
  4 holes in a 4x4 grid:
    coded_aperture mask motion --grid 4 --holes 4
"""
_BEST = 5
_NOISE_RANGES = ((0.01, 0.04), (0.05, 0.08), (0.09, 0.10))


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "motion",
        help="find the placement of holes that preserves most under defocus and motion",
        description="Count the spatial frequencies that stay above the noise behind every way to "
        "place square holes in a grid, over blur sizes of 7 to 25 px and 64 motions of up to 12 px "
        "(M. Martinello, Coded Aperture Imaging, PhD thesis, 2012, section 7.4), beside a disc of "
        "equal light. With more placements than can be tried, some are drawn and improved.",
        epilog=_EPILOG,
    )
    add_numbers(
        parser,
        ("grid", 2, 3, "cells along a side of the grid"),
        ("holes", 1, 3, "open cells"),
        ("best", 1, _BEST, "how many placements to show"),
        ("seed", 0, 0, "of the placements that are drawn"),
    )
    of_lens = {"--focal-length-mm F": "of the lens (default 50)"}
    of_disc = {"--f-number N": "of the disc with the light of all holes (default 7.1)"}
    add_options(parser, of_lens, type=float, default=50.0)
    add_options(parser, of_disc, type=float, default=7.1)
    results = "write the masks (.npy) and a figure (.png) into this folder"
    add_options(parser, {"--output DIR": results, "--json": "print the results as JSON"})


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    from coded_aperture_ros.mask_design.fragmentation import (
        BLUR_SIZES_PX,
        analyse_fragmentation,
        hole_side_mm,
        most_holes,
        table_motions,
    )

    if args.output is not None:
        check_output(Path(args.output) / "fragmentation.png")
    side_mm = hole_side_mm(args.focal_length_mm, args.f_number, args.holes)
    analysis = analyse_fragmentation(
        args.grid,
        args.holes,
        BLUR_SIZES_PX,
        table_motions(),
        progress=lambda items: progress(items, unit="placement"),
        seed=args.seed,
    )
    results = {
        "placements": analysis.placements,
        "different": len(analysis.masks),
        "exhaustive": analysis.exhaustive,
        "hole_side_mm": round(side_mm, 3),
        "extent_mm": round(side_mm * args.grid, 3),
        "most_holes": most_holes(args.focal_length_mm, args.f_number),
        "noise_levels": _rounded(analysis.noise_levels, 3),
        "best_for_noise": {
            f"{low:g} to {high:g}": analysis.masks[analysis.best(low, high)].name
            for low, high in _NOISE_RANGES
        },
        "disc": _rounded(analysis.disc_preserved),
        "masks": [
            {"mask": mask.name, "preserved": _rounded(shares)}
            for mask, shares in zip(analysis.masks[: args.best], analysis.preserved, strict=False)
        ],
    }
    if args.output is not None:
        _write(Path(args.output), analysis, args.best)
    return tell(args, results, _text)


def _rounded(values: Any, digits: int = 4) -> list[float]:
    return [round(float(value), digits) for value in values]


def _write(folder: Path, analysis: Any, count: int) -> None:
    import numpy as np

    from coded_aperture_ros.mask_design.figures import fragmentation

    folder.mkdir(parents=True, exist_ok=True)
    for mask in analysis.masks[:count]:
        np.save(folder / f"{mask.name}.npy", mask.transmission)
    fragmentation(analysis, _NOISE_RANGES, folder / "fragmentation.png")


def _text(results: dict[str, Any]) -> str:
    levels = results["noise_levels"]
    shown = [index for index in (0, 3, 6, 9) if index < len(levels)]
    rows = [
        [row["mask"], *(f"{100 * row['preserved'][index]:.1f}" for index in shown)]
        for row in [*results["masks"], {"mask": "disc", "preserved": results["disc"]}]
    ]
    how = "all tried" if results["exhaustive"] else "some tried, the best improved"
    return (
        f"{results['placements']} placements, {results['different']} of them different ({how})\n"
        f"holes of {results['hole_side_mm']:.2f} mm in a grid of {results['extent_mm']:.2f} mm; "
        f"diffraction allows {results['most_holes']} holes of this light\n\n"
        "frequencies above the noise, %\n"
        + table(["mask", *(f"noise {levels[index]:g}" for index in shown)], rows)
        + "\n"
        + "".join(
            f"\nbest for noise {noise}: {mask}" for noise, mask in results["best_for_noise"].items()
        )
    )
