"""Pictures of planes with their depths: a folder that several sessions may add to."""

import contextlib
import csv
import json
import os
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.options import has_type
from coded_aperture_ros.frames import Gamma
from coded_aperture_ros.io import picture_files, read_image, write_image

PLANES_JSON = "planes.json"
PLANES_CSV = "planes.csv"


def load_planes(
    inputs: Sequence[str | os.PathLike[str]],
    depths_m: Sequence[float] | None = None,
    gamma: Gamma = 1.0,
) -> Planes:
    """Planes from pictures.

    Parameters
    ----------
    inputs : sequence of path-like
        One folder, or the pictures themselves.
    depths_m : sequence of float, optional
        Depth of each picture, m, those of a folder sorted by name. Without it the folder has a
        list, see `load_folder`.
    gamma : float or "srgb", optional
        Encoding of 8-bit pictures.

    Returns
    -------
    Planes

    Raises
    ------
    InputError
        With the file or the entry, and what to do; see also `Planes`.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for depth_m in (1.0, 1.5, 2.0, 3.0):
    ...         _ = add_plane(folder, np.full((8, 8), 0.5, np.float32), depth_m)
    ...     load_planes([folder]).depths_m.tolist()
    [1.0, 1.5, 2.0, 3.0]
    """
    paths = [Path(given) for given in inputs]
    folder = paths[0] if len(paths) == 1 and paths[0].is_dir() else None
    if depths_m is None:
        if folder is None:
            raise InputError(
                f"{paths[0]}: say how far each picture's plane is with depths, or name a folder "
                f"with {PLANES_JSON} or {PLANES_CSV}"
            )
        return load_folder(folder, gamma)
    pictures = picture_files(folder) if folder is not None else paths
    if len(pictures) != len(depths_m):
        raise InputError(
            f"{folder or paths[0]}: {len(pictures)} pictures but {len(depths_m)} depths: give one "
            "for each, in the order of the names"
        )
    return _planes(sorted(zip(pictures, depths_m, strict=True), key=itemgetter(1)), gamma)


def load_folder(folder: str | os.PathLike[str], gamma: Gamma = 1.0) -> Planes:
    """Planes of a folder with a list: `planes.json`, or else `planes.csv`.

    The one is ``[{"file": "a.png", "depth_m": 1.5}, ...]``, in order of depth, the other has the
    columns `file` and `depth_m`. Raises `InputError` with the file or the entry, and what to do;
    see also `Planes`.
    """
    json_file = Path(folder) / PLANES_JSON
    csv_file = Path(folder) / PLANES_CSV
    if csv_file.exists() and not json_file.exists():
        return _planes(sorted(_read_csv(csv_file), key=itemgetter(1)), gamma)
    return _planes(_read_json(json_file), gamma)


def _planes(listed: Sequence[tuple[Path, float]], gamma: Gamma) -> Planes:
    return Planes(
        images=tuple(read_image(path, gamma) for path, _ in listed),
        depths_m=np.array([depth for _, depth in listed]),
        names=tuple(str(path) for path, _ in listed),
    )


def _read_json(path: Path) -> list[tuple[Path, float]]:
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror}: the folder needs a list of its "
            'pictures, [{"file": "a.png", "depth_m": 1.5}, ...]'
        ) from error
    except ValueError as error:
        raise InputError(f"{path}: not JSON: {error}") from error
    if not isinstance(entries, list):
        raise InputError(f'{path}: expected a list [{{"file": ..., "depth_m": ...}}, ...]')
    return [_entry(path, f"entry {number}", entry) for number, entry in enumerate(entries)]


def _read_csv(path: Path) -> list[tuple[Path, float]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows: list[dict[str, Any]] = list(csv.DictReader(file))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a table of comma-separated values: {error}") from error
    listed = []
    for number, row in enumerate(rows, 2):  # line 1 has the names of the columns
        given = {key: value for key, value in row.items() if value}
        with contextlib.suppress(KeyError, ValueError):
            given["depth_m"] = float(given["depth_m"])
        listed.append(_entry(path, f"line {number}", given))
    return listed


def _entry(path: Path, where: str, entry: Any) -> tuple[Path, float]:
    """File and depth of an entry of a list; raises `InputError` if they cannot be used."""
    if not isinstance(entry, dict):
        raise InputError(f"{path}: {where}: expected file and depth_m, got {entry!r}")
    for key, kind in (("file", str), ("depth_m", float)):
        if key not in entry:
            raise InputError(f"{path}: {where} has no {key}")
        if not has_type(entry[key], kind):
            raise InputError(f"{path}: {where}: {key} cannot be {entry[key]!r}")
    return path.parent / entry["file"], float(entry["depth_m"])


def listed_depths_m(folder: str | os.PathLike[str]) -> list[float]:
    """Depths of the pictures in a folder, m, nearest first."""
    return sorted(float(entry["depth_m"]) for entry in _entries(Path(folder)))


def add_plane(
    folder: str | os.PathLike[str], image: FloatArray, depth_m: float, frames: int = 1
) -> Path:
    """Add a picture to a folder, in place of one of the same depth.

    The folder is created if it does not exist. The image is linear light in [0, 1], float32 [rows,
    columns] or [rows, columns, 3], the mean of so many `frames`; it is stored as 16-bit PNG.
    Picture and list are each written whole or not at all, the picture first: an interrupted session
    leaves a folder that the next one goes on with. Raises `InputError` if the depth is not a
    positive distance, the folder cannot be written to, or its list cannot be read.
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
        for number, entry in enumerate(entries):  # what could not be loaded later
            _entry(path, f"entry {number}", entry)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except InputError as error:
        raise InputError(f"{error}: correct it, or begin in another folder") from error
    except (ValueError, TypeError) as error:
        raise InputError(
            f"{path}: not a list of planes: correct it, or begin in another folder"
        ) from error
    return list(entries)
