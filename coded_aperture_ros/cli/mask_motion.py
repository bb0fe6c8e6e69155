"""`coded_aperture mask motion`: how an aperture is best cut up, if things move (thesis 7.4)."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.cli.command import Command, argument
from coded_aperture_ros.cli.results_folder import RESULTS, check_results_folder, write_results
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.design import fragmentation as design
from coded_aperture_ros.design.mask_figures import draw_fragmented_responses

_EXAMPLES = """examples:
  the 84 ways to place 3 holes in a 3x3 grid, for a 50 mm lens at F/7.1:
    coded_aperture mask motion --grid 3 --holes 3 --output fragmentation
  4 holes in a 4x4 grid:
    coded_aperture mask motion --grid 4 --holes 4
"""
_NOISE_RANGES = ((0.01, 0.04), (0.05, 0.08), (0.09, 0.10))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments:
    """Arguments of `mask motion`."""

    grid: int = argument("cells along a side of the grid", 3, written="--grid N", minimum=2)
    holes: int = argument("open cells", 3, written="--holes N", minimum=1)
    best: int = argument("how many placements to show", 5, written="--best N", minimum=1)
    seed: int = argument("of the placements that are drawn", 0, written="--seed N", minimum=0)
    focal_length_mm: float = argument("of the lens", 50.0, written="--focal-length-mm F")
    f_number: float = argument(
        "of the disc with the light of all holes", 7.1, written="--f-number N"
    )
    json: bool = argument("print the results as JSON", False)
    output: Path | None = argument(
        f"write {RESULTS}, the masks (.npy) and a figure (.png) into this folder",
        None,
        written="--output DIR",
    )


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    side_mm = design.hole_side_mm(args.focal_length_mm, args.f_number, args.holes)
    check_results_folder(args.output)
    analysis = design.analyse_fragmentation(
        args.grid,
        args.holes,
        design.BLUR_SIZES_PX,
        design.table_motions(),
        progress=lambda items: progress(items, unit="placement"),
        seed=args.seed,
    )
    results = {
        "benchmark": "motion-fragmentation",
        "placements": analysis.placements,
        "different": len(analysis.masks),
        "exhaustive": analysis.exhaustive,
        "hole_side_mm": round(side_mm, 3),
        "extent_mm": round(side_mm * args.grid, 3),
        "most_holes": design.most_holes(args.focal_length_mm, args.f_number),
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
    return write_results(
        results, _text, lambda folder: _draw(args, analysis, folder), args.output, as_json=args.json
    )


def _rounded(values: Iterable[float], digits: int = 4) -> list[float]:
    return [round(float(value), digits) for value in values]


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


def _draw(args: Arguments, analysis: design.Fragmentation, folder: Path) -> None:
    for mask in analysis.masks[: args.best]:
        np.save(folder / f"{mask.name}.npy", mask.transmission)
    draw_fragmented_responses(analysis, _NOISE_RANGES, folder / "fragmentation.png")


COMMAND = Command(
    Arguments,
    run,
    description="Count the spatial frequencies that stay above the noise behind every way to "
    "place square holes in a grid, over blur sizes of 7 to 25 px and 64 motions of up to 12 px "
    "(M. Martinello, Coded Aperture Imaging, PhD thesis, 2012, section 7.4), beside a disc of "
    "equal light. With more placements than can be tried, some are drawn and improved.",
    examples=_EXAMPLES,
)
