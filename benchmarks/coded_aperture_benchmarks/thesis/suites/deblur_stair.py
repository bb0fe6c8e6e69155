"""The error of deblurring of thesis 6.3.1."""

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.textures import load_textures, training_textures
from coded_aperture_benchmarks.methods import deblurring
from coded_aperture_benchmarks.methods.identification import BANK, MethodOnFrames, Setting
from coded_aperture_benchmarks.metrics.restoration import deblurring_error
from coded_aperture_benchmarks.pictures import as_rgb, enlarged, side_by_side
from coded_aperture_benchmarks.rows import grouped, mean_of, tables, unique
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.thesis.stair import (
    LEVELS,
    SIDE_PX,
    Stair,
    level_error,
    make_stair,
    with_middle,
)
from coded_aperture_benchmarks.thesis.tables import (
    IN_WORDS,
    OUR_METHOD,
    mask_with_letter,
    thesis_deblurring_error,
)
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import load_mask

# Of the stair that reference methods find their strength on: it covers all blur sizes.
_PRACTICE_LEVELS = 10
# A picture without any texture, which the error of everything else has to be seen beside.
_GREY = "grey"
# The steps that are drawn, as shares of the way up the stair.
_SHOWN_STEPS = (0.1, 0.5, 0.9)
_ENLARGED = 2
_IN_THESIS = {
    "richardson_lucy": "lucy_richardson",
    "wiener": "wiener",
    "levin": "levin",
    **dict.fromkeys(deblurring.own_methods(), OUR_METHOD),
}

# A method and the depth that it was given; the frame itself has none.
Key = tuple[str, str | None]
Picture = NDArray[np.float32]


@dataclasses.dataclass(frozen=True)
class Cell(MethodOnFrames):
    """One number of each method's table: a texture, a mask and a noise; `method` finds the blur."""

    texture: str
    side_px: int
    methods: tuple[str, ...]

    def stair(self, seed: int) -> Stair:
        """Return one of the stairs that are scored."""
        setting, textures = self.setting, load_textures(self.texture, self.images)
        mask = load_mask(setting.mask)
        return make_stair(mask, textures, setting.sigma, seed, setting.levels, self.side_px)

    def practice(self) -> deblurring.Practice:
        """Return a stair of pictures that are not scored, of the same mask and noise."""
        setting = self.setting
        textures = load_textures("random") if self.texture == "random" else training_textures()
        levels = min(setting.levels, _PRACTICE_LEVELS)
        mask = load_mask(setting.mask)
        stair = make_stair(
            mask, textures, setting.sigma, deblurring.PRACTICE_SEED, levels, self.side_px
        )
        return deblurring.Practice(stair.coded, stair.sharp, stair.level.astype(int), stair.stack)


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """What was measured for a cell.

    Attributes
    ----------
    rows : list of dict
        The numbers of each method and depth, for JSON.
    steps : dict
        Of the first repeat: for each method and depth (the coded and the true picture have none)
        the steps that are drawn, [steps, side, side].
    """

    rows: list[Row]
    steps: dict[Key, Picture]


def _cells(args: options.Args) -> list[Cell]:
    methods = deblurring.chosen_methods(args)
    options.check_window(args)
    options.check_masks(args)
    options.check_textures(args, args.textures)
    # The depth that is estimated is that of the benchmark of blur identification.
    how = DepthConfig().regularize
    return [
        Cell(
            BANK if how == "none" else f"{BANK}-{how}",
            Setting(mask, sigma, None, args.levels, args.window, args.rank),
            options.images_of(args),
            options.seeds_of(args),
            args.known_noise,
            texture,
            args.side,
            methods,
        )
        # Masks vary slowest, so that a process learns few banks.
        for mask, sigma, texture in itertools.product(args.masks, args.sigmas, args.textures)
    ]


@dataclasses.dataclass(frozen=True, eq=False)
class _Repeat:
    """One stair, deblurred.

    Attributes
    ----------
    pictures : dict
        The picture [rows, columns] of every method and depth, and of the baselines.
    seconds : dict
        What each took; baselines took none.
    level_error : float
        Mean error of the estimated levels.
    """

    stair: Stair
    pictures: dict[Key, Picture]
    seconds: dict[Key, float]
    level_error: float


def measure(cell: Cell) -> Measured:
    """Deblur the stairs of one cell with every method, by both depths."""
    strengths = {
        method: deblurring.best_strengths(method, cell.practice, {"error": deblurring_error})[
            "error"
        ]
        for method in cell.methods
    }
    repeats = [_repeat(cell, seed, strengths) for seed in cell.seeds]
    rows = [_row(cell, key, repeats, strengths) for key in repeats[0].pictures]
    first = repeats[0]
    shown = {key: picture for key, picture in first.pictures.items() if key[0] != _GREY}
    shown[deblurring.TRUE, None] = first.stair.sharp
    levels = cell.setting.levels
    return Measured(rows, {key: _shown_steps(each, levels) for key, each in shown.items()})


def _repeat(cell: Cell, seed: int, strengths: dict[str, float | None]) -> _Repeat:
    stair, levels = cell.stair(seed), cell.setting.levels
    estimated = with_middle(cell.identify(stair.coded, stair.noise).level, levels)
    noise = stair.noise if cell.known_noise else None
    pictures: dict[Key, Picture] = {
        (deblurring.CODED, None): stair.coded,
        (_GREY, None): np.full_like(stair.sharp, stair.sharp.mean()),
    }
    seconds: dict[Key, float] = {}
    levels_by: dict[str, NDArray[np.floating]] = {
        deblurring.TRUE: stair.level,
        deblurring.ESTIMATED: estimated,
    }
    for method, (depth, level) in itertools.product(cell.methods, levels_by.items()):
        blur = np.interp(level, np.arange(levels), stair.stack.blur_sizes_px)
        done = deblurring.deblur(method, stair.coded, blur, stair.stack, strengths[method], noise)
        pictures[method, depth], seconds[method, depth] = done.sharp, done.seconds
    mistaken = level_error(np.rint(estimated), stair.level, levels)
    return _Repeat(stair, pictures, seconds, mistaken.mean)


def _row(cell: Cell, key: Key, repeats: list[_Repeat], strengths: dict[str, float | None]) -> Row:
    method, depth = key
    pairs = [(repeat.pictures[key], repeat.stair.sharp) for repeat in repeats]
    rms = [np.sqrt(np.mean((image - truth) ** 2, dtype=np.float64)) for image, truth in pairs]
    levels = [repeat.level_error if depth == deblurring.ESTIMATED else 0.0 for repeat in repeats]
    seconds = [repeat.seconds[key] for repeat in repeats if key in repeat.seconds]
    return {
        "texture": cell.texture,
        "mask": cell.setting.mask,
        "sigma": cell.setting.sigma,
        "noise": round(repeats[0].stair.noise, 6),
        "method": method,
        "depth": depth,
        "error": mean_of((deblurring_error(*pair) for pair in pairs), 5),
        "rms": mean_of(rms, 5),
        "thesis_error": _thesis_error(cell, method),
        "level_error": None if depth is None else mean_of(levels, 3),
        "parameter": deblurring.parameter_of(method),
        "strength": strengths.get(method),
        "seconds": mean_of(seconds, 3) if seconds else None,
    }


def _thesis_error(cell: Cell, method: str) -> float | None:
    """Return what the thesis reports for a cell; None if it has none or the stair is another."""
    setting, beside = cell.setting, _IN_THESIS.get(method)
    if (setting.levels, cell.side_px) != (LEVELS, SIDE_PX) or beside is None:
        return None
    return thesis_deblurring_error(cell.texture, setting.sigma, beside, setting.mask)


def _shown_steps(picture: Picture, levels: int) -> Picture:
    steps = picture.reshape(levels, -1, picture.shape[1])
    return steps[np.unique([round(share * (levels - 1)) for share in _SHOWN_STEPS])]


def _results(args: options.Args, measured: list[Measured]) -> Row:
    rows = [row for cell in measured for row in cell.rows]
    return {
        "known_noise": args.known_noise,
        "cells": rows,
        "references_ahead": deblurring.ahead(
            rows, ("texture", "mask", "sigma", "depth"), lambda row: row["error"]
        ),
    }


def _text(results: Row) -> str:
    parts = [tables_of(results["cells"])]
    cells = deblurring.compared_cells(results["cells"])
    if cells is not None:
        parts.append(deblurring.ahead_text(results["references_ahead"], cells))
    return "\n\n".join(parts)


def tables_of(rows: list[Row]) -> str:
    """Return a table for every texture and method, masks down and noise across."""
    return tables(
        "error of deblurring by the true / by the estimated blur [thesis, same cell, by the blur "
        "that each of its\nmethods identified; ~ similar mask]; coded and grey: of the frame "
        "itself, and of a picture without texture",
        [{**row, "title": _method_text(row["method"])} for row in rows],
        ("texture", "method"),
        "{texture} texture, {title}",
        _table,
    )


def _table(rows: list[Row]) -> str:
    levels_of_noise = sorted(unique(rows, "sigma"))
    lines = []
    for (mask,), here in grouped(rows, "mask").items():
        cells = [[row for row in here if row["sigma"] == sigma] for sigma in levels_of_noise]
        times = [row["seconds"] for row in here if row["seconds"] is not None]
        taken = f"{sum(times) / len(times):.1f} s" if times else "-"
        lines.append([mask_with_letter(mask), *map(_cell_text, cells), taken])
    return table(["mask", *(f"sigma {sigma:g}" for sigma in levels_of_noise), "time"], lines)


def _method_text(method: str) -> str:
    if method in (deblurring.CODED, _GREY):
        return method
    return f"{method} [thesis: {IN_WORDS[_IN_THESIS[method]]}]"


def _cell_text(rows: list[Row]) -> str:
    errors = " / ".join(f"{row['error']:.3f}" for row in rows)
    thesis = rows[0]["thesis_error"]
    if rows[0]["depth"] is None:
        return errors
    return f"{errors} [{'-' if thesis is None else f'{thesis:.2f}'}]"


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    """Write a picture for every cell and depth: steps of three blur sizes, method by method."""
    for cell, depth in itertools.product(measured, (deblurring.TRUE, deblurring.ESTIMATED)):
        first = cell.rows[0]
        name = f"{first['texture']}_{Path(first['mask']).stem}_{first['sigma']:g}_{depth}"
        picture = side_by_side(list(_columns(cell, depth)))
        write_image(folder / f"stair_{name}.png", picture)


def _columns(cell: Measured, depth: str) -> Iterator[tuple[str, list[NDArray[np.uint8]]]]:
    """Yield for the frame, the truth and every method a title with the error, and its steps."""
    errors = {(row["method"], row["depth"]): row["error"] for row in cell.rows}
    keys: list[tuple[str, Key]] = [
        (deblurring.CODED, (deblurring.CODED, None)),
        ("truth", (deblurring.TRUE, None)),
    ]
    keys += [(method, (method, by)) for method, by in cell.steps if by == depth]
    for title, key in keys:
        steps = [enlarged(as_rgb(step), _ENLARGED) for step in cell.steps[key]]
        yield f"{title} {errors[key]:.3f}" if key in errors else title, steps


SUITE = Suite(
    name="deblur stair",
    said=("textures", "images", "levels", "side", "window", "repeats", "seed"),
    description="Error sqrt(|f - f*|^2 + |grad f - grad f*|^2), root mean square, of the sharp "
    "picture that is made of a column of crops, each blurred with the next of 39 sizes from 7 to "
    "30 px (M. Martinello, Coded Aperture Imaging, PhD thesis, 2012, tables 6.5 to 6.8), by the "
    "true blur and by the blur that a filter bank estimates.",
    examples="""examples:
  two masks, four noise levels, all methods, next to the numbers of the thesis:
    coded_aperture bench deblur stair
  one mask and noise, both textures of the thesis, with pictures:
    coded_aperture bench deblur stair --masks levin --sigmas 0.001 --textures natural random \\
        --output results/
  a stair of 9 small steps, closed form against the sparse prior of Levin et al.:
    coded_aperture bench deblur stair --levels 9 --side 64 --window 48 --methods fast levin
""",
    options=(
        options.TEXTURE_LIST,
        options.masks("four_hole", "levin"),
        options.sigmas((0.0, 0.001, 0.002, 0.005)),
        *deblurring.METHOD_OPTIONS,
        options.number(
            "--repeats", 1, 1, "stairs with other crops and noise to take the mean over"
        ),
        options.blur_levels(LEVELS),
        options.STEP_SIDE,
        options.window(96, "side of the patches that depth is estimated from"),
        options.rank(400),
        *options.PICTURES,
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
