"""`coded_aperture bench deblur photograph`: a flat page, whose PSF was measured."""

import argparse
import dataclasses
import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_deblur_methods import (
    CODED,
    PRACTICE_SEED,
    Practice,
    add_method_options,
    best_strengths,
    check_methods,
    deblur,
    own_methods,
    parameter_of,
)
from coded_aperture_benchmarks.commands.bench_deblur_pictures import as_rgb, enlarged, side_by_side
from coded_aperture_benchmarks.commands.bench_options import (
    add_result_options,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import table
from coded_aperture_ros.core.errors import InputError

_FILE = "levin_letters.npz"
_PRACTICE_SIDE_PX = 280
# Weak enough to leave little, strong enough that a wrong PSF cannot explain the picture.
_ORIENTATION_STRENGTH = 1e-5
# Of the picture: the middle so large is shown so many times enlarged.
_CROP_PX = 123
_ENLARGED = 3
# The darkest and the brightest pixels of the coded picture are shown black and white.
_SHOWN_PERCENTILES = (0.5, 99.5)
_EPILOG = """examples:
  all methods, with pictures:
    coded_aperture bench deblur photograph real_photo/ --output results/
the folder has levin_letters.npz with the photograph, image [rows, columns], in linear light, and
the PSF that was measured at the same distance, psf [k, k]
"""


@dataclasses.dataclass(frozen=True)
class Cell:
    """A photograph and a method; CODED for the photograph itself."""

    folder: Path
    method: str
    seed: int


@dataclasses.dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph and its PSF.

    Attributes
    ----------
    image : ndarray of float32, shape [rows, columns]
        Linear light.
    psf : ndarray of float32, shape [k, k]
        Unit sum; the photograph is the sharp picture convolved with it.
    rotated : bool
        Whether the file has it the other way round, to be correlated with. A file does not say:
        it is what explains the photograph better.
    """

    image: Any
    psf: Any
    rotated: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a method, for JSON, and the sharp picture [rows, columns]."""

    row: dict[str, Any]
    sharp: Any


def add_parser(subparsers: Any) -> None:
    """Add this frame to the parser of `bench deblur`."""
    parser = subparsers.add_parser(
        "photograph",
        help="a photograph of a flat page, with its measured PSF",
        description="What the sharp picture, blurred again with the PSF, leaves unexplained of a "
        "photograph without known truth: the root mean square of g - h * f over the pixels whose "
        "whole PSF is in the picture, beside the noise. A ratio of 1 is noise alone; above, "
        "something of the picture is lost or invented; below, noise is taken for texture.",
        epilog=_EPILOG,
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help=f"with {_FILE}")
    add_method_options(parser)
    add_result_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    methods = check_methods(args)
    check_result_options(args)
    photograph = _photograph(args.folder)
    cells = [Cell(args.folder, method, args.seed) for method in (CODED, *methods)]
    start = time.perf_counter()
    measured = measure_cells(measure_cell, cells, args.jobs)
    rows = [cell.row for cell in measured]
    report(
        args,
        {
            "benchmark": "deblur photograph",
            "file": _FILE,
            "size": list(photograph.image.shape),
            "psf_width_px": len(photograph.psf),
            "psf_rotated": photograph.rotated,
            "noise": rows[0]["noise"],
            "seed": args.seed,
            "seconds": round(time.perf_counter() - start, 1),
            "cells": rows,
        },
        lambda: _table(rows),
        lambda folder: _draw(measured, folder),
    )
    return 0


@lru_cache(maxsize=1)
def _photograph(folder: Path) -> Photograph:
    """Read the photograph and its PSF.

    Raises
    ------
    InputError
        Naming the file, and what is wrong with it.
    """
    import numpy as np

    from coded_aperture_ros.core.archive import read_archive

    path = folder / _FILE
    arrays = read_archive(path, "coded photograph", 1, foreign=True)
    for name in ("image", "psf"):
        if name not in arrays:
            raise InputError(f"{path}: has no array named {name}")
        array = arrays[name]
        if array.ndim != 2 or array.dtype.kind != "f" or not np.isfinite(array).all():
            raise InputError(f"{path}: {name}: expected [rows, columns] of finite floats")
    image, psf = (arrays[name].astype(np.float32) for name in ("image", "psf"))
    square = psf.shape[0] == psf.shape[1] and psf.shape[0] % 2 == 1
    if not square or min(image.shape) <= len(psf) or not psf.sum() > 0:
        raise InputError(
            f"{path}: psf: expected an odd square, smaller than the image, of positive sum, got "
            f"the shapes {list(psf.shape)} and {list(image.shape)}"
        )
    psf /= psf.sum()
    turned = np.ascontiguousarray(psf[::-1, ::-1])
    rotated = _unexplained(image, turned) < _unexplained(image, psf)
    return Photograph(image, turned if rotated else psf, rotated)


def _unexplained(image: Any, psf: Any) -> float:
    """Return what a plausible sharp picture leaves of the photograph."""
    import numpy as np

    from coded_aperture_benchmarks.reference.deblurring import deblur_by_planes
    from coded_aperture_benchmarks.restoration import residual_rms

    level = np.zeros(image.shape, int)
    sharp = deblur_by_planes("levin", image, level, _stack(psf), _ORIENTATION_STRENGTH)
    return residual_rms(sharp, image, psf)


def _stack(psf: Any) -> Any:
    """Return the one level that there is. Its size is not known, and does not matter."""
    import numpy as np

    from coded_aperture_ros.optics import PsfStack

    return PsfStack(np.zeros(1), psf[None], in_pixels=False)


def measure_cell(cell: Cell) -> Measured:
    """Deblur the photograph with one method."""
    import numpy as np

    from coded_aperture_benchmarks.restoration import noise_of, residual_rms

    photograph = _photograph(cell.folder)
    image, psf = photograph.image, photograph.psf
    strength, sharp, seconds = None, image, None
    if cell.method != CODED:
        own = cell.method in own_methods()
        practice = None if own else _practice(cell.folder, cell.seed)
        strength = best_strengths(cell.method, practice, {"all": _mean_square})["all"]
        done = deblur(cell.method, image, np.zeros(image.shape), _stack(psf), strength)
        sharp, seconds = done.sharp, round(done.seconds, 3)
    noise, residual = noise_of(image), residual_rms(sharp, image, psf)
    row = {
        "method": cell.method,
        "residual_rms": round(residual, 6),
        "noise": round(noise, 6),
        "ratio": round(residual / noise, 3) if noise > 0 else None,
        "parameter": parameter_of(cell.method),
        "strength": strength,
        "seconds": seconds,
    }
    return Measured(row, sharp)


@lru_cache(maxsize=1)
def _practice(folder: Path, seed: int) -> Practice:
    """Return another picture with the photograph's PSF, brightness, contrast and noise."""
    import numpy as np
    from scipy.signal import fftconvolve

    from coded_aperture_benchmarks.restoration import noise_of
    from coded_aperture_ros.io.textures import training_textures

    photograph = _photograph(folder)
    image, psf = photograph.image, photograph.psf
    random = np.random.default_rng([PRACTICE_SEED, seed])
    reach = len(psf) // 2
    (crop,) = training_textures().crops(1, _PRACTICE_SIDE_PX, _PRACTICE_SIDE_PX, random)
    blurred = fftconvolve(crop, psf, mode="valid")
    scale, mean = float(image.std() / blurred.std()), float(blurred.mean())
    sharp = (crop[reach:-reach, reach:-reach] - mean) * scale + image.mean()
    coded = (blurred - mean) * scale + image.mean()
    coded += noise_of(image) * random.standard_normal(coded.shape)
    return Practice(
        coded=coded.astype(np.float32),
        sharp=sharp.astype(np.float32),
        level=np.zeros(coded.shape, int),
        stack=_stack(psf),
    )


def _mean_square(image: Any, truth: Any) -> float:
    return float(((image - truth) ** 2).mean())


def _table(rows: Sequence[dict[str, Any]]) -> str:
    lines = [
        [
            row["method"],
            f"{row['residual_rms']:.5f}",
            "-" if row["ratio"] is None else f"{row['ratio']:.2f}",
            "-" if row["seconds"] is None else f"{row['seconds']:.2f} s",
        ]
        for row in rows
    ]
    return (
        "root mean square of what is left of the photograph, g - h * f, and its ratio to the "
        f"noise, {rows[0]['noise']:.5f}\n"
        + table(["method", "residual", "over noise", "time"], lines)
    )


def _draw(measured: Sequence[Measured], folder: Path) -> None:
    """Write one picture: the photograph and all sharp pictures, and their middle enlarged."""
    import numpy as np

    from coded_aperture_ros.imaging import SRGB
    from coded_aperture_ros.io import write_image

    darkest, brightest = np.percentile(measured[0].sharp, _SHOWN_PERCENTILES)
    top, left = (max(side - _CROP_PX, 0) // 2 for side in measured[0].sharp.shape)
    crop = (slice(top, top + _CROP_PX), slice(left, left + _CROP_PX))
    columns = []
    for cell in measured:
        # Room above and below the coded picture's range, where sharp pictures go.
        shown = 0.1 + 0.8 * (cell.sharp - darkest) / (brightest - darkest)
        ratio = "" if cell.row["ratio"] is None else f" {cell.row['ratio']:.2f}"
        columns.append(
            (
                f"{cell.row['method']}{ratio}",
                [as_rgb(shown, SRGB), enlarged(as_rgb(shown[crop], SRGB), _ENLARGED)],
            )
        )
    write_image(folder / "photograph.png", side_by_side(columns))
