"""Pictures that calibration is done with: how they are given, and what is written beside."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.cli.command import argument
from coded_aperture_ros.cli.reading import GammaArguments, read_numbers
from coded_aperture_ros.cli.results import Summary, write_json
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.sources import open_files

MASK_FILE = "mask.npy"


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlanesArguments(GammaArguments):
    """Pictures of planes, and their depths."""

    inputs: tuple[str, ...] = argument(
        "folder with planes.json or planes.csv, or pictures with --depths", written="FOLDER|PICTURE"
    )
    depths: tuple[float, ...] | None = argument(
        "depth in m of each picture, by name in a folder",
        None,
        written="--depths Z1,Z2,...",
        parse=read_numbers,
    )


def pictures_in(inputs: Sequence[str]) -> list[str]:
    """Return the pictures, or those of the one folder."""
    if len(inputs) > 1 or not Path(inputs[0]).is_dir():
        return list(inputs)
    return [str(path) for path in open_files(inputs[0]).files]


def check_size(path: str, camera: Camera, planes: Planes) -> None:
    """Refuse pictures of another size than the camera file's."""
    height, width = planes.images[0].shape[:2]
    if (camera.image_width, camera.image_height) != (width, height):
        raise InputError(
            f"{path}: for images of {camera.image_width}x{camera.image_height}, the pictures have "
            f"{width}x{height}: set image_width and image_height"
        )


def write_report(
    output: Callable[[Path], Path], report: Path, summary: Summary, mask: Mask
) -> None:
    """Write a summary, and beside it the mask that was found, see `MASK_FILE`."""
    write_json(output(report), summary)
    with output(report.parent / MASK_FILE).open("wb") as file:
        np.save(file, mask.transmission)
