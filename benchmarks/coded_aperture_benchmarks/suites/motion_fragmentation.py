"""`coded_aperture mask motion`: how an aperture is best cut up, if things move (thesis 7.4)."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.figures import fragmented_responses
from coded_aperture_benchmarks.fragmentation import (
    BLUR_SIZES_PX,
    Fragmentation,
    analyse_fragmentation,
    hole_side_mm,
    most_holes,
    table_motions,
)
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.cli.options import table
from coded_aperture_ros.cli.progress import progress

_BEST = 5
_NOISE_RANGES = ((0.01, 0.04), (0.05, 0.08), (0.09, 0.10))


@dataclasses.dataclass(frozen=True)
class Cell:
    """One grid and so many holes."""

    grid: int
    holes: int
    seed: int


def _cells(args: options.Args) -> list[Cell]:
    hole_side_mm(args.focal_length_mm, args.f_number, args.holes)  # refuses what no lens has
    return [Cell(args.grid, args.holes, args.seed)]


def measure(cell: Cell) -> Fragmentation:
    """Count what every placement of the holes preserves."""
    return analyse_fragmentation(
        cell.grid,
        cell.holes,
        BLUR_SIZES_PX,
        table_motions(),
        progress=lambda items: progress(items, unit="placement"),
        seed=cell.seed,
    )


def _results(args: options.Args, measured: list[Fragmentation], _: float) -> Row:
    (analysis,) = measured
    side_mm = hole_side_mm(args.focal_length_mm, args.f_number, args.holes)
    return {
        "benchmark": "motion-fragmentation",
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


def _rounded(values: Iterable[float], digits: int = 4) -> list[float]:
    return [round(float(value), digits) for value in values]


def _text(results: Row) -> str:
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


def _draw(args: options.Args, measured: list[Fragmentation], folder: Path) -> None:
    for mask in measured[0].masks[: args.best]:
        np.save(folder / f"{mask.name}.npy", mask.transmission)
    fragmented_responses(measured[0], _NOISE_RANGES, folder / "fragmentation.png")


SUITE = Suite(
    description="Count the spatial frequencies that stay above the noise behind every way to place "
    "square holes in a grid, over blur sizes of 7 to 25 px and 64 motions of up to 12 px (M. "
    "Martinello, Coded Aperture Imaging, PhD thesis, 2012, section 7.4), beside a disc of equal "
    "light. With more placements than can be tried, some are drawn and improved.",
    examples="""examples:
  the 84 ways to place 3 holes in a 3x3 grid, for a 50 mm lens at F/7.1:
    coded_aperture mask motion --grid 3 --holes 3 --output fragmentation
  4 holes in a 4x4 grid:
    coded_aperture mask motion --grid 4 --holes 4
""",
    options=(
        options.number("--grid", 2, 3, "cells along a side of the grid"),
        options.number("--holes", 1, 3, "open cells"),
        options.number("--best", 1, _BEST, "how many placements to show"),
        options.number("--seed", 0, 0, "of the placements that are drawn"),
        options.option("--focal-length-mm", "of the lens", 50.0, type=float, metavar="F"),
        options.option(
            "--f-number", "of the disc with the light of all holes", 7.1, type=float, metavar="N"
        ),
        options.JSON,
        options.option(
            "--output", "write the masks (.npy) and a figure (.png) into this folder", metavar="DIR"
        ),
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
