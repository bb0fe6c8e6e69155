"""Defocus, direction and length of motion, table 7.1."""

import dataclasses
import itertools

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.rows import tables
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.thesis.motion_images import TABLE_7_1, identify_motions, table_masks
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.likelihood.motion import MotionConfig

_MASKS = ("disc", "A", "B", "C")
_PARAMETERS = ("defocus", "direction", "length")
_EXACT = 4096


@dataclasses.dataclass(frozen=True)
class Cell:
    """One mask with one texture and noise."""

    mask: str
    texture: str
    sigma: float
    window_px: int
    exact: bool
    seed: int


def _cells(args: options.Args) -> list[Cell]:
    options.check_window(args)
    return [
        Cell(mask, texture, sigma, args.window, args.exact, args.seed)
        for (texture, sigma), mask in itertools.product(args.cases, args.masks)
    ]


def measure(cell: Cell) -> Row:
    """Measure one mask with one texture and noise."""
    mask = table_masks()[0][cell.mask]
    config = MotionConfig(motion_rank=_EXACT) if cell.exact else MotionConfig()
    found = identify_motions(
        mask, load_textures(cell.texture), cell.sigma, cell.window_px, config, cell.seed
    )
    return {
        "mask": cell.mask,
        "pattern": mask.name,
        "texture": cell.texture,
        "sigma": cell.sigma,
        **{
            name: {
                "mean_error": round(found[name].mean_error, 3),
                "accuracy": round(found[name].accuracy, 4),
                "thesis": thesis if cell.texture == "random" else None,
            }
            for name, thesis in zip(_PARAMETERS, TABLE_7_1[cell.mask], strict=True)
        },
    }


def _text(results: Row) -> str:
    described = {
        "mask": "{mask} {pattern}",
        **{name: lambda row, name=name: _found_text(row[name]) for name in _PARAMETERS},
    }
    return tables(
        "mean error / accuracy [thesis, table 7.1]",
        results["cells"],
        ("texture", "sigma"),
        "{texture} texture, sigma {sigma:g}",
        lambda rows: columns(rows, described),
    )


def _found_text(found: Row) -> str:
    text = f"{found['mean_error']:.2f} / {100 * found['accuracy']:.1f} %"
    if found["thesis"] is None:
        return text
    error, accuracy = found["thesis"]
    return f"{text} [{error:.2f} / {100 * accuracy:.1f} %]"


SUITE = Suite(
    name="motion table",
    description="Mean error and accuracy of defocus, direction and length of motion on 640 "
    "images of 70x70 px: 10 blur sizes, 8 directions, 8 lengths (M. Martinello, Coded Aperture "
    "Imaging, PhD thesis, 2012, table 7.1), with a disc, and with the masks A, B and C that the "
    "analysis of fragmentation finds (see mask motion).",
    examples="""examples:
  the table of the thesis, and natural texture:
    python -m coded_aperture_benchmarks motion table
  two masks, all hypotheses exact, which takes twice as long as frames can:
    python -m coded_aperture_benchmarks motion table --masks disc C --cases random,0.0005 --exact
""",
    options=(
        options.option(
            "--masks",
            f"some of {', '.join(_MASKS)}",
            list(_MASKS),
            said="all",
            choices=_MASKS,
            metavar="MASK",
        ),
        options.cases(
            (("random", 0.0), ("random", 0.0005), ("natural", 0.0), ("natural", 0.0005)),
            "open third of the masks",
        ),
        options.number("--window", 40, 48, "side of the windows, px"),
        options.option(
            "--exact",
            "no common basis: all motions under all textures (default: as frames are worked on)",
            action="store_true",
        ),
        options.number("--seed", 0, 0, "of crops and noise"),
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    text=_text,
)
