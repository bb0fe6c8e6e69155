"""The methods of deblurring that the benchmarks compare, by name, and how they are run."""

import argparse
import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from coded_aperture_ros.optics import PsfStack

# What no method has touched, to compare with.
CODED = "coded"
TRUE, ESTIMATED = "true", "estimated"
# Of the frames that reference methods find their strength on; the seed decides the noise too, and
# has to be another one than in any test.
PRACTICE_SEED = 1_000_000_007


@dataclasses.dataclass(frozen=True, eq=False)
class Practice:
    """A frame that is not scored, on which reference methods find their strength.

    Attributes
    ----------
    coded, sharp : ndarray of float32, shape [rows, columns]
    level : ndarray of integer, shape [rows, columns]
        True level.
    stack : PsfStack
    """

    coded: "NDArray[np.float32]"
    sharp: "NDArray[np.float32]"
    level: "NDArray[np.integer]"
    stack: "PsfStack"


@dataclasses.dataclass(frozen=True, eq=False)
class Deblurred:
    """What a method made of a frame, and how long that took without preparations."""

    sharp: "NDArray[np.float32]"
    seconds: float


def own_methods() -> tuple[str, ...]:
    """Return the names of this package's methods."""
    from coded_aperture_ros.core.options import options_of
    from coded_aperture_ros.deblur import DeblurConfig

    options = options_of(DeblurConfig)
    choices = options["method"][1].choices if "method" in options else None
    return choices or ("fast",)


def reference_methods() -> tuple[str, ...]:
    """Return the names of the reference methods."""
    from coded_aperture_benchmarks.reference.deblurring import DEBLURRING_METHODS

    return DEBLURRING_METHODS


def add_method_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of everything that deblurs."""
    parser.add_argument(
        "--methods",
        nargs="+",
        metavar="METHOD",
        help="fast and so on (see the command deblur), and the reference methods richardson_lucy, "
        "wiener (both scikit-image's) and levin (sparse prior); an unknown name lists them all "
        "(default: all)",
    )
    parser.add_argument(
        "--seed", type=_seed, default=0, metavar="N", help="of crops and noise (default 0)"
    )


def _seed(text: str) -> int:
    value = int(text)
    if not 0 <= value < PRACTICE_SEED:
        raise argparse.ArgumentTypeError(f"expected 0 to {PRACTICE_SEED - 1}, got {text}")
    return value


def check_methods(args: argparse.Namespace, scikit_image_for: str = "") -> tuple[str, ...]:
    """Return the methods to compare, before anything is measured.

    Parameters
    ----------
    args : argparse.Namespace
        With `methods`, None for all.
    scikit_image_for : str, optional
        What needs scikit-image whatever the methods are.

    Raises
    ------
    InputError
        If scikit-image is needed and missing.
    """
    from importlib.util import find_spec

    from coded_aperture_benchmarks.restoration import missing_scikit_image

    known = (*own_methods(), *reference_methods())
    methods = tuple(dict.fromkeys(args.methods or known))
    for method in methods:
        if method not in known:
            args.usage_error(
                f"--methods: unknown method {method!r}, use some of {', '.join(known)}"
            )
    needed_for = scikit_image_for or next(
        (f"the method {method}" for method in methods if method in reference_methods()), ""
    )
    if needed_for and find_spec("skimage") is None:
        raise missing_scikit_image(needed_for)
    return methods


def best_strengths(
    method: str,
    practice: Practice | None,
    errors: "Mapping[str, Callable[[NDArray[np.float32], NDArray[np.float32]], float]]",
) -> dict[str, float | None]:
    """Return the strengths of a reference method that are the best for a practice frame.

    Parameters
    ----------
    method : str
    practice : Practice or None
        Only our own methods need none.
    errors : mapping of str to callable
        What the benchmark measures of a deblurred and the sharp picture, by names.

    Returns
    -------
    dict of str to float or None
        One for each of `errors`; None for our own methods, whose strength follows from the noise.
    """
    if method in own_methods():
        return dict.fromkeys(errors)
    from coded_aperture_benchmarks.reference.deblurring import best_strength, deblur_by_planes

    if practice is None:
        raise ValueError(f"{method} needs a frame to find its strength on")
    frame = practice

    @cache
    def deblurred(strength: float) -> Any:
        return deblur_by_planes(method, frame.coded, frame.level, frame.stack, strength)

    return {
        name: best_strength(method, lambda at, error=error: error(deblurred(at), frame.sharp))  # type: ignore[misc]
        for name, error in errors.items()
    }


def parameter_of(method: str) -> str | None:
    """Return what the strength of a reference method is called; None for our own."""
    from coded_aperture_benchmarks.reference.deblurring import PLANE_METHODS

    return PLANE_METHODS[method].parameter if method in PLANE_METHODS else None


def deblur(
    method: str,
    coded: "NDArray[np.float32]",
    blur_size_px: "NDArray[np.floating]",
    stack: "PsfStack",
    strength: float | None = None,
    noise: float | None = None,
    exact_depth: bool = False,
) -> Deblurred:
    """Deblur a frame.

    Parameters
    ----------
    method : str
        One of `own_methods` or `reference_methods`.
    coded : ndarray of float32, shape [rows, columns] or [rows, columns, 3]
    blur_size_px : ndarray of float, shape [rows, columns]
        Blur size of every pixel. Reference methods take the level that comes nearest.
    stack : PsfStack
    strength : float, optional
        Of a reference method, see `best_strengths`.
    noise : float, optional
        Tells our own methods the noise, which they estimate otherwise.
    exact_depth : bool, optional
        Whether our own methods may rely on the blur sizes near depth edges.

    Returns
    -------
    Deblurred
    """
    import numpy as np

    if method in own_methods():
        deblurrer = _own(method, stack, noise, exact_depth)
        deblurrer.prepare(coded.shape[:2])
        blur = np.asarray(blur_size_px, np.float32)
        start = time.perf_counter()
        sharp = deblurrer.deblur(coded, blur)
        return Deblurred(sharp, time.perf_counter() - start)
    from coded_aperture_benchmarks.reference.deblurring import deblur_by_planes

    if strength is None:
        raise ValueError(f"{method} needs a strength")
    level = nearest_level(blur_size_px, stack)
    start = time.perf_counter()
    sharp = deblur_by_planes(method, coded, level, stack, strength)
    return Deblurred(sharp, time.perf_counter() - start)


def nearest_level(blur_size_px: "NDArray[np.floating]", stack: "PsfStack") -> "NDArray[np.integer]":
    """Return the level [rows, columns] whose blur size comes nearest."""
    import numpy as np

    order = np.argsort(stack.blur_sizes_px)
    at = np.interp(blur_size_px, stack.blur_sizes_px[order], np.arange(len(order)))
    return np.asarray(order[np.rint(at).astype(np.intp)])


def _own(method: str, stack: "PsfStack", noise: float | None, exact_depth: bool) -> Any:
    from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
    from coded_aperture_ros.imaging.noise import NOISE_FLOOR

    # In no frame of the benchmarks is anything clipped, however bright.
    settings: dict[str, Any] = {"method": method, "saturation": 2.0}
    if exact_depth:
        settings["edge_reach"] = 0
    if noise is not None:
        # To the deblurring, 0 means that it is not known.
        settings["noise"] = max(noise, NOISE_FLOOR)
    return Deblurrer(stack, DeblurConfig(**settings))


def ahead(
    rows: Sequence[dict[str, Any]],
    place: Sequence[str],
    score: Callable[[dict[str, Any]], float],
) -> list[dict[str, Any]]:
    """Return where a reference method is better than the best of our own.

    Parameters
    ----------
    rows : sequence of dict
        With `method`, and the names of `place`.
    place : sequence of str
        What has to agree for two rows to be compared.
    score : callable
        Of a row: less is better.
    """
    own: dict[tuple[Any, ...], dict[str, Any]] = {}
    for row in rows:
        key = tuple(row[name] for name in place)
        if row["method"] in own_methods() and (key not in own or score(row) < score(own[key])):
            own[key] = row
    found = []
    for row in rows:
        best = own.get(tuple(row[name] for name in place))
        is_reference = row["method"] in reference_methods()
        if is_reference and best is not None and score(row) < score(best):
            names = {name: row[name] for name in place}
            found.append({**names, "method": row["method"], "own": best["method"]})
    return found


def ahead_text(found: Sequence[dict[str, Any]], cells: int) -> str:
    """Say in words what `ahead` has found in so many cells of a table."""
    if not found:
        return "no reference method is better than the best of ours"
    count = Counter(entry["method"] for entry in found)
    return "\n".join(
        f"{method} is better than the best of ours in {number} of {cells} cells"
        for method, number in count.items()
    )
