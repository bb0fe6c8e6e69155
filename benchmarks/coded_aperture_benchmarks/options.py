"""Options of the benchmarks: how they are declared, and those that several suites share."""

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.arguments import at_least, noise_level
from coded_aperture_benchmarks.run import RESULTS as RESULTS_FILE
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.optics import load_mask

Args = argparse.Namespace
Add = Callable[[argparse.ArgumentParser], None]
# What the noise of a frame is made of.
OF_THE_MASK = "; a frame has S divided by the open fraction of the mask's square"

TEXTURES = ("natural", "random", "soft")


def option(
    name: str, what: str, default: Any = None, *, said: str | None = None, **described: Any
) -> Add:
    """Return an option of a suite, as `add_argument` takes it; its help says the default.

    Parameters
    ----------
    default
        A list lets the option have several values.
    said : str, optional
        The default in the help, where it is not written as it is; empty to say nothing.
    described
        Other arguments of `add_argument`.
    """
    if default is not None:
        several = {"nargs": "+"} if isinstance(default, list | tuple) else {}
        described = {**several, "default": default, **described}
        said = _written(default) if said is None else said
    text = f"{what} (default {said})" if said else what

    def add(parser: argparse.ArgumentParser) -> None:
        parser.add_argument(name, help=text.replace("%", "%%"), **described)

    return add


def _written(default: Any) -> str:
    if isinstance(default, list | tuple):
        return " ".join(map(_written, default))
    return f"{default:g}" if isinstance(default, float) else str(default)


def number(
    name: str, least: int, default: int | None, what: str, metavar: str = "N", **described: Any
) -> Add:
    """Return an option that is a whole number."""
    return option(name, what, default, type=at_least(least), metavar=metavar, **described)


def folders(what: str, least: str = "+") -> Add:
    """Return the folders that a benchmark reads; `least` as `nargs` of `add_argument`."""
    return option("folders", what, nargs=least, type=Path, metavar="FOLDER")


JSON = option("--json", "print the results as JSON", action="store_true")
OUTPUT = option("--output", f"write {RESULTS_FILE} and figures (PNG)", metavar="DIR")
JOBS = option(
    "--jobs",
    "processes",
    processors(),
    said="one for each processor",
    type=at_least(1),
    metavar="N",
)
PREDICTIONS = option(
    "--predictions", "keep depth maps in this folder, and take those that it has", metavar="DIR"
)
RESULTS = (JOBS, JSON, OUTPUT)
# Of benchmarks that predict depth of single frames.
DEPTH_RESULTS = (PREDICTIONS, *RESULTS)
IMAGES = option("--images", "pictures of this folder instead of the built-in ones", metavar="DIR")
PICTURES = (
    IMAGES,
    option(
        "--known-noise",
        "tell the methods of this project the noise; by default they estimate it in each frame",
        action="store_true",
    ),
)
TEXTURE_LIST = option(
    "--textures",
    "natural (unselected crops of photographs), soft (the same at half size) or random (white "
    "noise)",
    ["natural"],
    choices=TEXTURES,
    metavar="TEXTURE",
)
THREADS = option(
    "--threads",
    "threads of the processor",
    processors(),
    said=f"all, here {processors()}",
    type=at_least(1),
    metavar="N",
)
SEED = number("--seed", 0, 0, "of the first repeat")
NOISE_SEED = number("--seed", 0, 0, "of the noise")
STEP_SIDE = number("--side", 16, 125, "of a step", "PX")
SCENE_MASKS = option("--masks", "that the scenes were rendered with", ["levin"], metavar="MASK")
# None stands for the library's own way.
REGULARIZE = option(
    "--regularize",
    "none, graphcut and so on (default, and what there is: see the command depth)",
    [None],
    said="",
    metavar="HOW",
)
WINDOW_AS_LEARN = number(
    "--window", 16, None, "side of the bank's patches (default: as the command learn)", "PX"
)
STRIDE_AS_DEPTH = number(
    "--stride", 1, None, "distance between the bank's patches (default: as the command depth)", "PX"
)


def masks(*names: str) -> Add:
    """Return the masks to measure with."""
    return option("--masks", "names or files", list(names), metavar="MASK")


def sigmas(values: Sequence[float], what: str = OF_THE_MASK) -> Add:
    """Return the noises to measure at; `what` says to what they apply."""
    text = f"noise behind an open aperture{what}"
    return option("--sigmas", text, list(values), type=noise_level, metavar="S")


def added_noise(sigma: float) -> Add:
    """Return the noise that is added to rendered frames."""
    return option("--noise", "noise to add, linear light", sigma, type=noise_level, metavar="S")


def blur_levels(count: int, least: int = 2) -> Add:
    """Return the number of levels from 7 to 30 px."""
    return number("--levels", least, count, "blur sizes, equally spaced from 7 to 30 px")


def window(side_px: int, what: str = "side of the bank's patches") -> Add:
    """Return the window of the bank."""
    return number("--window", 16, side_px, what, "PX")


def rank(count: int) -> Add:
    """Return the rank of the bank."""
    return number("--rank", 1, count, "vectors in the bank's common basis", "R")


def frame_size(rows: int, columns: int, what: str = "the frames") -> Add:
    """Return the size of frames; parsed to rows and columns."""
    text = f"of {what}, px"
    default = (rows, columns)
    return option(
        "--size", text, default, said=f"{columns}x{rows}", nargs=None, type=size, metavar="WxH"
    )


def size(text: str) -> tuple[int, int]:
    """Return rows and columns of a text such as 640x480."""
    width, times, height = text.lower().partition("x")
    if not (times and width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"expected a size like 640x480, got {text!r}")
    return int(height), int(width)


def cases(values: Sequence[tuple[str, float]], share: str) -> Add:
    """Return pairs of texture and noise; `share` is the part of the light that masks let pass."""
    return option(
        "--cases",
        f"texture ({', '.join(TEXTURES)}) and noise behind an open aperture, which is divided by "
        f"the {share}",
        list(values),
        said=" ".join(f"{texture},{sigma:g}" for texture, sigma in values),
        type=_case,
        metavar="TEXTURE,S",
    )


def _case(text: str) -> tuple[str, float]:
    texture, _, sigma = text.partition(",")
    if texture not in TEXTURES:
        raise argparse.ArgumentTypeError(f"expected one of {', '.join(TEXTURES)}, got {texture!r}")
    return texture, noise_level(sigma)


_case.__name__ = "texture and noise"  # argparse says "invalid texture and noise value"


def generated(
    noises: Sequence[float], repeats: int, methods: Sequence[str], window_px: int, basis: int
) -> tuple[Add, ...]:
    """Return the options of the benchmarks that make their own frames to identify blur in."""
    return (
        masks("four_hole", "levin"),
        sigmas(noises),
        option(
            "--methods",
            "bank (not regularised), bank-tv and so on (see --regularize of the command depth), "
            "plain-48 (bank with a bare window of 48 px), subspace (the thesis' own), two_pixel "
            "and two_pixel-tv and so on (masks of a few equal holes), conditional (their data term "
            "in the thesis), wiener, levin and other reference methods; an unknown name lists "
            "them all",
            list(methods),
            metavar="METHOD",
        ),
        number("--repeats", 1, repeats, "frames with other crops and noise to take the mean over"),
        SEED,
        blur_levels(39),
        window(window_px),
        rank(basis),
        STRIDE_AS_DEPTH,
        *PICTURES,
        *RESULTS,
    )


def check_masks(args: Args) -> None:
    """Refuse masks that are unknown or unreadable."""
    for mask in args.masks:
        load_mask(mask)


def check_window(args: Args) -> None:
    """Refuse windows that have no middle."""
    if args.window % 2:
        args.usage_error(f"--window: expected an even number, got {args.window}")


def check_textures(args: Args, textures: Iterable[str]) -> None:
    """Refuse pictures that are missing before anything is measured."""
    from coded_aperture_benchmarks.datasets.textures import load_textures

    for texture in textures:
        load_textures(texture, images_of(args))


def check_known(args: Args, name: str, values: Iterable[str], known: Sequence[str]) -> None:
    """Refuse, as wrong usage of an option, values that are not known."""
    for value in values:
        if value not in known:
            args.usage_error(
                f"--{name}: unknown method {value!r}, use some of {', '.join(known)}"
                if name == "methods"
                else f"--{name}: unknown {value!r}, use some of {', '.join(known)}"
            )


def check_names(paths: Sequence[Path], what: str) -> None:
    """Refuse folders of one name: rows and pictures are named after it."""
    names = [path.resolve().name for path in paths]
    for path, name in zip(paths, names, strict=True):
        if names.count(name) > 1:
            raise InputError(f"{path}: another {what}'s folder has this name too")


def images_of(args: Args) -> Path | None:
    """Return the folder of `--images`."""
    return None if args.images is None else Path(args.images)


def seeds_of(args: Args) -> tuple[int, ...]:
    """Return the seeds of all repeats."""
    return tuple(range(args.seed, args.seed + args.repeats))


def folders_behind_masks(args: Args) -> list[tuple[Path, str]]:
    """Return the ray-traced scenes that are asked for, each with every mask that it has.

    An `InputError` if folders have one name, or none has a picture behind such a mask.
    """
    check_names(args.folders, "scene")
    found = [
        (folder, mask)
        for folder in args.folders
        for mask in args.masks
        if (folder / f"coded_{mask}_linear.png").is_file()
    ]
    if args.folders and not found:
        raise InputError(f"{args.folders[0]}: no coded_MASK_linear.png behind such a mask")
    return found
