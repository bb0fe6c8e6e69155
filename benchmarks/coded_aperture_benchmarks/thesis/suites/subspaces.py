"""How far apart the subspaces of levels lie (thesis 9.1)."""

import dataclasses
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.thesis.figures import distance_matrices
from coded_aperture_benchmarks.thesis.reference.subspace_distances import (
    LETTER_OF_MASK,
    THESIS_L1,
    SubspaceDistances,
    subspace_distances,
)
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.optics import MASK_NAMES, load_mask

_SMALLEST_PX, _LARGEST_PX = 7.0, 30.0


@dataclasses.dataclass(frozen=True)
class Cell:
    """A mask, and how many blur sizes are compared."""

    mask: str
    levels: int


def _cells(args: options.Args) -> list[Cell]:
    options.check_masks(args)
    return [Cell(mask, args.levels) for mask in args.masks]


def measure(cell: Cell) -> SubspaceDistances:
    """Compare the subspaces of one mask."""
    sizes = np.linspace(_SMALLEST_PX, _LARGEST_PX, cell.levels)
    return subspace_distances(load_mask(cell.mask), sizes)


def _results(args: options.Args, measured: list[SubspaceDistances]) -> Row:
    rows = [
        {
            "mask": mask,
            "l1": round(found.l1_fit, 3),
            "l1_relative": round(found.relative_fit, 4),
            "rank": found.rank,
            "thesis_l1": THESIS_L1.get(LETTER_OF_MASK.get(mask, "")),
        }
        for mask, found in zip(args.masks, measured, strict=True)
    ]
    return {"masks": rows}


def _text(results: Row) -> str:
    return columns(
        results["masks"],
        {
            "mask": "{mask}",
            "L1 fit": "{l1:.2f}",
            "share of the largest": "{l1_relative:.2f}",
            "rank": "{rank}",
            "in the thesis": lambda row: "-" if row["thesis_l1"] is None else f"{row['thesis_l1']}",
        },
    )


def _draw(args: options.Args, measured: list[SubspaceDistances], folder: Path) -> None:
    shares = [found.matrix / np.sqrt(found.rank) for found in measured]
    distance_matrices(dict(zip(args.masks, shares, strict=True)), folder / "distances.png")


SUITE = Suite(
    name="subspaces",
    said=("levels",),
    description="Compare the subspaces that patches of natural texture lie in after each blur (M. "
    "Martinello, Coded Aperture Imaging, PhD thesis, 2012, sections 9.1 and 9.2): the L1 fit of "
    "their distances to the ideal, in which all are orthogonal. Less is better.",
    examples="""examples:
  all masks with names, next to table 9.1 of the thesis, with figure 9.5:
    python -m coded_aperture_benchmarks subspaces --output subspaces/
""",
    options=(options.masks(*MASK_NAMES), options.blur_levels(16), *options.RESULTS),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
