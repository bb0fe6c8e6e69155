"""Pictures of planes with their depths: a folder that several sessions may add to."""

import csv
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.imaging import Gamma
from coded_aperture_ros.io import open_sequence, read_image, write_image

PLANES_JSON, PLANES_CSV = "planes.json", "planes.csv"


def load_planes(
    inputs: Sequence[str | os.PathLike[str]],
    depths_m: Sequence[float] | None = None,
    gamma: Gamma = 1.0,
) -> Planes:
    """Read pictures of planes.

    Parameters
    ----------
    inputs : sequence of path-like
        One folder, or the pictures themselves.
    depths_m : sequence of float, optional
        Depth of each picture, those of a folder in the order of their names. Without it the folder
        has a list: `planes.json`, ``[{"file": "a.png", "depth_m": 1.5}, ...]``, or `planes.csv`,
        with the columns `file` and `depth_m`.
    gamma : float or "srgb", optional
        How 8-bit pictures are encoded.

    Raises
    ------
    InputError
        Naming the file or the entry, and what to do; see also `Planes`.
    """
    paths = [Path(given) for given in inputs]
    folder = paths[0] if len(paths) == 1 and paths[0].is_dir() else None
    if depths_m is None:
        if folder is None:
            raise InputError(
                f"{paths[0]}: say how far each picture's plane is with depths, or name a folder "
                f"with {PLANES_JSON} or {PLANES_CSV}"
            )
        if not (folder / PLANES_JSON).exists() and (folder / PLANES_CSV).exists():
            return _planes(_read_csv(folder / PLANES_CSV), gamma)
        return Planes.load(folder, gamma)
    pictures = list(open_sequence(folder).pictures) if folder is not None else paths
    if len(pictures) != len(depths_m):
        raise InputError(
            f"{folder or paths[0]}: {len(pictures)} pictures but {len(depths_m)} depths: give one "
            "for each, in the order of the names"
        )
    return _planes(list(zip(pictures, depths_m, strict=True)), gamma)


def _planes(listed: Sequence[tuple[Path, float]], gamma: Gamma) -> Planes:
    """Read the pictures, from the nearest to the farthest in whatever order they are listed."""
    images = tuple(read_image(path, gamma) for path, _ in listed)
    depths = np.array([depth for _, depth in listed])
    order = np.argsort(depths, kind="stable")
    return Planes(
        tuple(images[i] for i in order), depths[order], tuple(str(listed[i][0]) for i in order)
    )


def _read_csv(path: Path) -> list[tuple[Path, float]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a table of comma-separated values: {error}") from error
    listed = []
    for number, row in enumerate(rows, 2):  # line 1 has the names of the columns
        for column in ("file", "depth_m"):
            if not row.get(column):
                raise InputError(f"{path}: line {number} has no {column}")
        try:
            listed.append((path.parent / row["file"], float(row["depth_m"])))
        except ValueError as error:
            raise InputError(
                f"{path}: line {number}: depth_m cannot be {row['depth_m']!r}"
            ) from error
    return listed


def listed_depths_m(folder: str | os.PathLike[str]) -> list[float]:
    """Return the depths that a folder has pictures of so far, nearest first.

    Raises
    ------
    InputError
        If its list cannot be read.
    """
    return sorted(float(entry["depth_m"]) for entry in _entries(Path(folder)))


def add_plane(
    folder: str | os.PathLike[str], image: NDArray[np.float32], depth_m: float, frames: int = 1
) -> Path:
    """Add a picture to a folder; a picture of the same depth that was there is replaced.

    Picture and list are each written whole or not at all, the picture first: an interrupted
    session leaves a folder that the next one goes on with.

    Parameters
    ----------
    folder : path-like
        Created if it does not exist.
    image : ndarray, float32 [rows, columns] or [rows, columns, 3]
        Linear light in [0, 1]; stored as 16-bit PNG.
    depth_m : float
    frames : int, optional
        How many frames the picture is the mean of, kept in the list.

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    InputError
        If the depth is not a positive distance, the folder cannot be written to, or its list
        cannot be read.
    """
    folder = Path(folder)
    if not 0 < depth_m < np.inf:
        raise InputError(f"depth {depth_m:g} is not a positive distance in metres")
    entries = [entry for entry in _entries(folder) if float(entry["depth_m"]) != depth_m]
    picture = folder / f"plane_{depth_m:08.4f}m.png"
    write_image(picture, image)
    entries.append({"file": picture.name, "depth_m": depth_m, "frames": frames})
    entries.sort(key=lambda entry: float(entry["depth_m"]))
    with atomic_output(folder / PLANES_JSON) as temporary:
        temporary.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
    return picture


def _entries(folder: Path) -> list[dict[str, Any]]:
    path = folder / PLANES_JSON
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
        for entry in entries:
            float(entry["depth_m"]), str(entry["file"])
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"{path}: not a list of planes: correct it, or begin in another folder"
        ) from error
    return list(entries)
