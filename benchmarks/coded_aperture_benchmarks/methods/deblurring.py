"""The methods of deblurring that the benchmarks compare, by name, and how they are run."""

import argparse
import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_benchmarks.metrics.restoration import missing_scikit_image
from coded_aperture_benchmarks.options import Add, Args, check_known, option
from coded_aperture_benchmarks.rows import place
from coded_aperture_benchmarks.run import Row
from coded_aperture_benchmarks.thesis.reference.deblurring import (
    DEBLURRING_METHODS,
    PLANE_METHODS,
    best_strength,
    deblur_by_planes,
)
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import options_of
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer, Uncertainty
from coded_aperture_ros.frames.noise import NOISE_FLOOR
from coded_aperture_ros.optics import PsfStack

# What no method has touched, to compare with.
CODED = "coded"
TRUE, ESTIMATED, CLASSICAL = "true", "estimated", "classical"
# Of the frames that reference methods find their strength on; the seed decides the noise too, and
# has to be another one than in any test.
PRACTICE_SEED = 1_000_000_007

Picture = NDArray[np.float32]


@dataclasses.dataclass(frozen=True, eq=False)
class Practice:
    """A frame that is not scored, on which reference methods find their strength.

    Attributes
    ----------
    coded, sharp : ndarray of float32, shape [rows, columns]
    level : ndarray of integer, shape [rows, columns]
        True level.
    """

    coded: Picture
    sharp: Picture
    level: NDArray[np.integer]
    stack: PsfStack


@dataclasses.dataclass(frozen=True, eq=False)
class Deblurred:
    """What a method made of a frame, and how long that took without preparations.

    Our own say how far it can be relied on; that is not in the time.
    """

    sharp: Picture
    seconds: float
    uncertainty: Uncertainty | None = None


def own_methods() -> tuple[str, ...]:
    """Return the names of this package's methods."""
    return options_of(DeblurConfig)["method"][1].choices or ("fast",)


def _seed(text: str) -> int:
    value = int(text)
    if not 0 <= value < PRACTICE_SEED:
        raise argparse.ArgumentTypeError(f"expected 0 to {PRACTICE_SEED - 1}, got {text}")
    return value


# The options of everything that deblurs.
METHOD_OPTIONS: tuple[Add, ...] = (
    option(
        "--methods",
        "fast and so on (see the command deblur), and the reference methods richardson_lucy, "
        "wiener (both scikit-image's) and levin (sparse prior); an unknown name lists them all "
        "(default: all)",
        nargs="+",
        metavar="METHOD",
    ),
    option("--seed", "of crops and noise", 0, type=_seed, metavar="N"),
)


def chosen_methods(args: Args, scikit_image_for: str = "") -> tuple[str, ...]:
    """Return the methods to compare, before anything is measured.

    Parameters
    ----------
    args : argparse.Namespace
        With `methods`, None for all.
    scikit_image_for : str, optional
        What needs scikit-image whatever the methods are.
    """
    known = (*own_methods(), *DEBLURRING_METHODS)
    methods = tuple(dict.fromkeys(args.methods or known))
    check_known(args, "methods", methods, known)
    needed_for = scikit_image_for or next(
        (f"the method {method}" for method in methods if method in DEBLURRING_METHODS), ""
    )
    if needed_for and find_spec("skimage") is None:
        raise missing_scikit_image(needed_for)
    return methods


def best_strengths(
    method: str,
    practice: Callable[[], Practice],
    errors: Mapping[str, Callable[[Picture, Picture], float]],
) -> dict[str, float | None]:
    """Return the strengths of a reference method that are the best for a practice frame.

    Parameters
    ----------
    practice : callable
        Returns the frame; our own methods need none.
    errors : mapping of str to callable
        What the benchmark measures of a deblurred and the sharp picture, by names.

    Returns
    -------
    dict of str to float or None
        One for each of `errors`; None for our own methods, whose strength follows from the noise.
    """
    if method in own_methods():
        return dict.fromkeys(errors)
    frame = practice()

    @cache
    def deblurred(strength: float) -> Picture:
        return deblur_by_planes(method, frame.coded, frame.level, frame.stack, strength)

    def best(error: Callable[[Picture, Picture], float]) -> float:
        return best_strength(method, lambda strength: error(deblurred(strength), frame.sharp))

    return {name: best(error) for name, error in errors.items()}


def parameter_of(method: str) -> str | None:
    """Return what the strength of a reference method is called; None for our own."""
    return PLANE_METHODS[method].parameter if method in PLANE_METHODS else None


def deblur(
    method: str,
    coded: Picture,
    blur_size_px: NDArray[np.floating],
    stack: PsfStack,
    strength: float | None = None,
    noise: float | None = None,
) -> Deblurred:
    """Deblur a frame.

    Parameters
    ----------
    method : str
        One of `own_methods` or `DEBLURRING_METHODS`.
    coded : ndarray of float32, shape [rows, columns] or [rows, columns, 3]
    blur_size_px : ndarray of float, shape [rows, columns]
        Blur size of every pixel, not finite where it is unknown. Reference methods take the level
        that comes nearest, and the nearest known pixel.
    strength : float, optional
        Of a reference method, see `best_strengths`.
    noise : float, optional
        The noise, which our own methods estimate otherwise.
    """
    if method in own_methods():
        deblurrer = _own(method, stack, noise)
        deblurrer.prepare(coded.shape[:2])
        blur = np.asarray(blur_size_px, np.float32)
        start = time.perf_counter()
        sharp = deblurrer.deblur(coded, blur)
        seconds = time.perf_counter() - start
        return Deblurred(sharp, seconds, deblurrer.uncertainty(coded, sharp, blur))
    if strength is None:
        raise ValueError(f"{method} needs a strength")
    level = nearest_level(blur_size_px, stack)
    start = time.perf_counter()
    sharp = deblur_by_planes(method, coded, level, stack, strength)
    return Deblurred(sharp, time.perf_counter() - start)


def nearest_level(blur_size_px: NDArray[np.floating], stack: PsfStack) -> NDArray[np.integer]:
    """Return the level [rows, columns] whose blur size comes nearest.

    Raises `InputError` if no blur size is known; else unknown ones are those of the nearest pixel.
    """
    unknown = ~np.isfinite(blur_size_px)
    if unknown.all():
        raise InputError("no pixel of the scene has a known depth")
    if unknown.any():
        row, column = ndimage.distance_transform_edt(
            unknown, return_distances=False, return_indices=True
        )
        blur_size_px = blur_size_px[row, column]
    order = np.argsort(stack.blur_sizes_px)
    at = np.interp(blur_size_px, stack.blur_sizes_px[order], np.arange(len(order)))
    return np.asarray(order[np.rint(at).astype(np.intp)])


def _own(method: str, stack: PsfStack, noise: float | None) -> Deblurrer:
    # In no frame of the benchmarks is anything clipped, however bright.
    settings: dict[str, Any] = {"method": method, "saturation": 2.0}
    if noise is not None:
        # To the deblurring, 0 means that it is not known.
        settings["noise"] = max(noise, NOISE_FLOOR)
    return Deblurrer(stack, DeblurConfig(**settings))


def ahead(rows: Sequence[Row], names: Sequence[str], score: Callable[[Row], float]) -> list[Row]:
    """Return where a reference method is better than the best of our own.

    Parameters
    ----------
    rows : sequence of dict
        With `method`, and the names.
    names : sequence of str
        What has to agree for two rows to be compared.
    score : callable
        Of a row: less is better.
    """
    own: dict[tuple[Any, ...], Row] = {}
    for row in rows:
        key = place(row, *names)
        if row["method"] in own_methods() and (key not in own or score(row) < score(own[key])):
            own[key] = row
    found = []
    for row in rows:
        best = own.get(place(row, *names))
        is_reference = row["method"] in DEBLURRING_METHODS
        if is_reference and best is not None and score(row) < score(best):
            where = {name: row[name] for name in names}
            found.append({**where, "method": row["method"], "own": best["method"]})
    return found


def ahead_text(found: Sequence[Row], cells: int) -> str:
    """Say in words what `ahead` has found in so many cells of a table."""
    if not found:
        return "no reference method is better than the best of ours"
    count = Counter(entry["method"] for entry in found)
    return "\n".join(
        f"{method} is better than the best of ours in {number} of {cells} cells"
        for method, number in count.items()
    )


def compared_cells(rows: Sequence[Row]) -> int | None:
    """Return in how many cells methods are compared; None if all are ours, or none is."""
    methods = [row["method"] for row in rows if row["depth"] is not None]
    own = {method in own_methods() for method in methods}
    return methods.count(methods[0]) if len(own) == 2 else None
