"""Masks that are found from planes at unknown distances."""

import dataclasses
import time
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.arguments import noise_level
from coded_aperture_benchmarks.datasets.blind_planes import (
    deblurring_loss,
    make_blind_planes,
    mask_correlation,
)
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.calibration.blind import find
from coded_aperture_ros.calibration.pictures import blind_picture
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import load_mask

_METHODS = ("fast", "cg")
_COLUMNS = {
    "mask": "{mask}",
    "seed": "{seed}",
    "correlation": "{correlation:.3f}",
    "cells": "{cells[1]}x{cells[0]}",
    "size error": "{largest_size_error:.2%}",
    "doubtful": "{doubtful}",
    **{
        f"{method} {title}": f"{{{method}[{name}]:.2f}}"
        for method in _METHODS
        for title, name in (
            ("true dB", "true_db"),
            ("found dB", "found_db"),
            ("loss", "largest_loss_db"),
        )
    },
}


@dataclasses.dataclass(frozen=True)
class Cell:
    """One mask and one set of planes."""

    mask: str
    seed: int
    sigma: float
    planes: int
    size: tuple[int, int]
    images: Path | None
    output: str | None


def _cells(args: options.Args) -> list[Cell]:
    options.check_masks(args)
    how = (args.sigma, args.planes, args.size, options.images_of(args), args.output)
    return [Cell(mask, seed, *how) for mask in args.masks for seed in options.seeds_of(args)]


def measure(cell: Cell) -> Row:
    """Find the mask of one set of planes, and compare."""
    mask = load_mask(cell.mask)
    textures = load_textures("natural", cell.images)
    planes = make_blind_planes(mask, textures, cell.sigma, cell.seed, cell.planes, cell.size)
    row: Row = {"mask": mask.name, "seed": cell.seed}
    start = time.perf_counter()
    try:
        found = find.find_mask(list(planes.coded), [f"plane {i}" for i in range(cell.planes)])
    except InputError as refusal:
        return {**row, "refused": str(refusal)}
    row["seconds"] = round(time.perf_counter() - start, 1)
    error = found.blur_sizes_px / planes.blur_sizes_px - 1
    row["correlation"] = round(mask_correlation(found.mask, mask), 4)
    row["cells"] = list(found.mask.transmission.shape)
    row["explained"] = round(found.explained, 4)
    row["doubtful"] = found.doubtful
    row["largest_size_error"] = round(float(np.abs(error).max()), 4)
    for method in _METHODS:
        loss = deblurring_loss(planes, found.mask, found.blur_sizes_px, method)
        row[method] = {name: round(value, 3) for name, value in dataclasses.asdict(loss).items()}
    if cell.output is not None:
        name = f"{Path(mask.name).stem}_{cell.seed}.png"
        with atomic_output(Path(cell.output) / name) as path:
            write_image(path, blind_picture(found))
    return row


def _results(args: options.Args, rows: list[Row]) -> Row:
    return {"size": [args.size[1], args.size[0]], "masks": rows}


def _text(results: Row) -> str:
    rows = results["masks"]
    described = {
        title: lambda row, form=form, title=title: (
            "-" if "refused" in row and title not in ("mask", "seed") else form.format_map(row)
        )
        for title, form in _COLUMNS.items()
    }
    notes = "loss: of the plane that loses most, the better of both orientations of the mask"
    refused = ["{mask} {seed}: {refused}".format_map(row) for row in rows if "refused" in row]
    return "\n".join([columns(rows, described), notes, *refused])


SUITE = Suite(
    name="blind",
    said=("planes", "sigma", "images"),
    description="Blur crops of photographs to 7 to 30 px in random order, with noise and in 256 "
    "steps, and find mask and blur sizes from them as calibrate blind does. Reported are the "
    "correlation of found and true mask (the better of both orientations, which spectra do not "
    "tell apart), the error of the blur sizes, and the PSNR of the planes deblurred with the true "
    "and with the found PSFs.",
    examples="""examples:
  three masks, 8 planes each, at the noise of 0.001:
    python -m coded_aperture_benchmarks blind
  on pictures of a folder, with the found masks and spectra as pictures:
    python -m coded_aperture_benchmarks blind --images pictures --size 640x448 --output blind
""",
    options=(
        options.masks("levin", "zhou", "four_hole"),
        options.option(
            "--sigma", "noise behind an open aperture", 0.001, type=noise_level, metavar="S"
        ),
        options.number("--planes", 4, 8, "pictures for each mask"),
        options.number("--seed", 0, 0, "of the first repeat"),
        options.number("--repeats", 1, 1, "other crops, orders and noise"),
        options.frame_size(384, 384),
        options.IMAGES,
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
