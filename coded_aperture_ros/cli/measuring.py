"""What `learn`, `calibrate ACTION` and other commands with one result have in common."""

import argparse
import json
import logging
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.options import add_options, config_from
from coded_aperture_ros.core.arguments import at_least, checked
from coded_aperture_ros.core.errors import InputError

MASK_FILE = "mask.npy"


def above(least: float, what: str) -> Callable[[str], float]:
    """Return a parser of finite numbers of more than `least`; `what` names them in messages."""
    return checked(float, lambda value: least < value < math.inf, what)


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"expected numbers with commas between, got {text!r}"
        ) from error


def add_level_count_option(
    parser: argparse.ArgumentParser, default: int | None, what: str, least: int = 2
) -> None:
    """Add `--level-count`."""
    written = {"--level-count N": what}
    add_options(parser, written, type=at_least(least), default=default)


def add_depths_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Add `--depths`, a depth for each picture or PSF."""
    parser.add_argument("--depths", type=_numbers, metavar="Z1,Z2,...", help=what)


def add_planes_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the pictures of planes, and their depths."""
    where = "folder with planes.json or planes.csv, or pictures with --depths"
    parser.add_argument("inputs", nargs="+", metavar="FOLDER|PICTURE", help=where)
    add_depths_option(parser, "depth in m of each picture, by name in a folder")


def checked_config(args: argparse.Namespace, config: type) -> Any:
    """Return `config_from` the command line; values that do not go together are wrong usage."""
    try:
        return config_from(args, config)
    except InputError as error:
        args.usage_error(f"--{error}".replace("_", "-"))


def rounded(value: float, digits: int) -> float | None:
    """Return a number for JSON, None where it is not finite."""
    return round(float(value), digits) if math.isfinite(value) else None


def check_size(path: str, camera: Any, planes: Any) -> None:
    """Refuse pictures of another size than the camera file's."""
    height, width = planes.images[0].shape[:2]
    if (camera.image_width, camera.image_height) != (width, height):
        raise InputError(
            f"{path}: for images of {camera.image_width}x{camera.image_height}, the pictures have "
            f"{width}x{height}: set image_width and image_height"
        )


def pictures_in(inputs: list[str]) -> list[str]:
    """Return the pictures, or those of the one folder."""
    from coded_aperture_ros.sources import open_files

    if len(inputs) > 1 or not Path(inputs[0]).is_dir():
        return inputs
    return [str(path) for path in open_files(inputs[0]).files]


def write_report(output: Callable[[Path], Path], report: Path, summary: Any, mask: Any) -> None:
    """Write a summary, and beside it the mask that was found, see `MASK_FILE`."""
    import numpy as np

    text = json.dumps(summary, indent=1, allow_nan=False)
    output(report).write_text(text + "\n", encoding="utf-8")
    with output(report.parent / MASK_FILE).open("wb") as file:
        np.save(file, mask.transmission)


def tell(
    args: argparse.Namespace, summary: Any, text: Callable[[Any], str], warnings: Iterable[str] = ()
) -> int:
    """Log warnings, print the summary as JSON or as text, and return the exit status."""
    for warning in warnings:
        logging.warning(warning)
    print(json.dumps(summary, allow_nan=False) if args.json else text(summary))
    return 0
