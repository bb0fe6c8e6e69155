"""A flat page, whose PSF was measured."""

import dataclasses
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from coded_aperture_benchmarks.datasets.textures import training_textures
from coded_aperture_benchmarks.methods import deblurring
from coded_aperture_benchmarks.metrics.restoration import noise_of, residual_rms
from coded_aperture_benchmarks.options import RESULTS, Args, option
from coded_aperture_benchmarks.pictures import as_rgb, enlarged, side_by_side
from coded_aperture_benchmarks.rows import or_dash
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.thesis.reference.deblurring import deblur_by_planes
from coded_aperture_ros.core.archive import read_archive
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import PsfStack

_FILE = "levin_letters.npz"
_PRACTICE_SIDE_PX = 280
# Weak enough to leave little, strong enough that a wrong PSF cannot explain the picture.
_ORIENTATION_STRENGTH = 1e-5
# Of the picture: the middle so large is shown so many times enlarged.
_CROP_PX = 123
_ENLARGED = 3
# The darkest and the brightest pixels of the coded picture are shown black and white.
_SHOWN_PERCENTILES = (0.5, 99.5)
_COLUMNS = {
    "method": "{method}",
    "residual": "{residual_rms:.5f}",
    "over noise": lambda row: or_dash(row["ratio"], "{:.2f}"),
    "time": lambda row: or_dash(row["seconds"], "{:.2f} s"),
}


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

    image: deblurring.Picture
    psf: deblurring.Picture
    rotated: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a method, for JSON, and the sharp picture [rows, columns]."""

    row: Row
    sharp: deblurring.Picture


def _cells(args: Args) -> list[Cell]:
    methods = deblurring.chosen_methods(args)
    photograph(args.folder)
    return [Cell(args.folder, method, args.seed) for method in (deblurring.CODED, *methods)]


@lru_cache(maxsize=1)
def photograph(folder: Path) -> Photograph:
    """Read the photograph and its PSF."""
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


def _unexplained(image: deblurring.Picture, psf: deblurring.Picture) -> float:
    """Return what a plausible sharp picture leaves of the photograph."""
    level = np.zeros(image.shape, int)
    sharp = deblur_by_planes("levin", image, level, _stack(psf), _ORIENTATION_STRENGTH)
    return residual_rms(sharp, image, psf)


def _stack(psf: deblurring.Picture) -> PsfStack:
    """Return the one level that there is. Its size is not known, and does not matter."""
    return PsfStack(np.zeros(1), psf[None], in_pixels=False)


def measure(cell: Cell) -> Measured:
    """Deblur the photograph with one method."""
    page = photograph(cell.folder)
    image, psf = page.image, page.psf
    strength, sharp, seconds = None, image, None
    if cell.method != deblurring.CODED:
        practice = partial(_practice, cell.folder, cell.seed)
        strength = deblurring.best_strengths(cell.method, practice, {"all": _mean_square})["all"]
        done = deblurring.deblur(cell.method, image, np.zeros(image.shape), _stack(psf), strength)
        sharp, seconds = done.sharp, round(done.seconds, 3)
    noise, residual = noise_of(image), residual_rms(sharp, image, psf)
    row = {
        "method": cell.method,
        "residual_rms": round(residual, 6),
        "noise": round(noise, 6),
        "ratio": round(residual / noise, 3) if noise > 0 else None,
        "parameter": deblurring.parameter_of(cell.method),
        "strength": strength,
        "seconds": seconds,
    }
    return Measured(row, sharp)


@lru_cache(maxsize=1)
def _practice(folder: Path, seed: int) -> deblurring.Practice:
    """Return another picture with the photograph's PSF, brightness, contrast and noise."""
    page = photograph(folder)
    image, psf = page.image, page.psf
    random = np.random.default_rng([deblurring.PRACTICE_SEED, seed])
    reach = len(psf) // 2
    (crop,) = training_textures().crops(1, _PRACTICE_SIDE_PX, _PRACTICE_SIDE_PX, random)
    blurred = fftconvolve(crop, psf, mode="valid")
    scale, mean = float(image.std() / blurred.std()), float(blurred.mean())
    sharp = (crop[reach:-reach, reach:-reach] - mean) * scale + image.mean()
    coded = (blurred - mean) * scale + image.mean()
    coded += noise_of(image) * random.standard_normal(coded.shape)
    return deblurring.Practice(
        coded=coded.astype(np.float32),
        sharp=sharp.astype(np.float32),
        level=np.zeros(coded.shape, int),
        stack=_stack(psf),
    )


def _mean_square(image: deblurring.Picture, truth: deblurring.Picture) -> float:
    return float(((image - truth) ** 2).mean())


def _results(args: Args, measured: list[Measured]) -> Row:
    page = photograph(args.folder)
    rows = [cell.row for cell in measured]
    return {
        "file": _FILE,
        "size": list(page.image.shape),
        "psf_width_px": len(page.psf),
        "psf_rotated": page.rotated,
        "noise": rows[0]["noise"],
        "seed": args.seed,
        "cells": rows,
    }


def _text(results: Row) -> str:
    return (
        "root mean square of what is left of the photograph, g - h * f, and its ratio to the "
        f"noise, {results['noise']:.5f}\n{columns(results['cells'], _COLUMNS)}"
    )


def _draw(_: Args, measured: list[Measured], folder: Path) -> None:
    """Write one picture: the photograph and all sharp pictures, and their middle enlarged."""
    darkest, brightest = np.percentile(measured[0].sharp, _SHOWN_PERCENTILES)
    top, left = (max(side - _CROP_PX, 0) // 2 for side in measured[0].sharp.shape)
    crop = (slice(top, top + _CROP_PX), slice(left, left + _CROP_PX))

    def shown(sharp: deblurring.Picture) -> list[NDArray[np.uint8]]:
        # Room above and below the coded picture's range, where sharp pictures go.
        values = 0.1 + 0.8 * (sharp - darkest) / (brightest - darkest)
        return [as_rgb(values, SRGB), enlarged(as_rgb(values[crop], SRGB), _ENLARGED)]

    titles = [
        cell.row["method"] + ("" if cell.row["ratio"] is None else f" {cell.row['ratio']:.2f}")
        for cell in measured
    ]
    pictures = [shown(cell.sharp) for cell in measured]
    write_image(folder / "photograph.png", side_by_side(list(zip(titles, pictures, strict=True))))


SUITE = Suite(
    name="deblur photograph",
    description="What the sharp picture, blurred again with the PSF, leaves unexplained of a "
    "photograph without known truth: the root mean square of g - h * f over the pixels whose "
    "whole PSF is in the picture, beside the noise. A ratio of 1 is noise alone; above, something "
    "of the picture is lost or invented; below, noise is taken for texture.",
    examples="""examples:
  all methods, with pictures:
    coded_aperture bench deblur photograph real_photo/ --output results/
the folder has levin_letters.npz with the photograph, image [rows, columns], in linear light, and
the PSF that was measured at the same distance, psf [k, k]
""",
    options=(
        option("folder", f"with {_FILE}", type=Path, metavar="FOLDER"),
        *deblurring.METHOD_OPTIONS,
        *RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
