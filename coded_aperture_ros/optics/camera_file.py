"""Camera files (YAML): reading, checks of keys, and the files that they name."""

import difflib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.text import short
from coded_aperture_ros.core.yaml_file import read_yaml
from coded_aperture_ros.optics.camera import Camera
from coded_aperture_ros.optics.field import FieldCurvature
from coded_aperture_ros.optics.intrinsics import load_intrinsics
from coded_aperture_ros.optics.lens import LENS_AND_PIXEL, NUMBERS, check_numbers
from coded_aperture_ros.optics.mask import Mask
from coded_aperture_ros.optics.sensor import Sensor
from coded_aperture_ros.optics.wavefront import Wavefront

_OPTIONAL = (
    "lens_mask_distance_mm",
    "lens_f_number",
    "side",
    "calibrated",
    "camera_info",
    "noise",
    "noise_gain",
    "wavelength_nm",
    "diffraction",
    "field_curvature",
    "wavefront",
    "sensor",
    "reference",
)
_KEYS = (*NUMBERS, "side", "calibrated", "mask", "camera_info", "diffraction", *_OPTIONAL[-4:])


def load_camera(path: str | os.PathLike[str]) -> Camera:
    """Camera described by a YAML file; `config/example_camera.yaml` explains the keys.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    Camera

    Raises
    ------
    InputError
        One line with the file, the key and what is allowed.

    Examples
    --------
    >>> from coded_aperture_ros.optics import load_camera
    >>> camera = load_camera("config/example_camera.yaml")  # doctest: +SKIP
    """
    content = read_yaml(path, f"camera file {path}")
    return camera_from_mapping(content, f"camera file {path}", Path(path).parent)


def camera_files(path: str | os.PathLike[str]) -> list[Path]:
    """Paths of a camera file and of the files that it names, whether they exist or not."""
    content = read_yaml(path, f"camera file {path}")
    entries = content if isinstance(content, Mapping) else {}
    mask = entries.get("mask")
    named = entries.get("camera_info"), mask.get("file") if isinstance(mask, Mapping) else None
    return [Path(path), *(Path(path).parent / name for name in named if isinstance(name, str))]


def camera_entries(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Entries of a valid camera file with absolute names of files, to copy to another folder."""
    entries = dict(read_yaml(path, f"camera file {path}"))
    folder = Path(path).resolve().parent
    if "camera_info" in entries:
        entries["camera_info"] = str((folder / entries["camera_info"]).resolve())
    if "file" in entries["mask"]:
        entries["mask"] = {"file": str((folder / entries["mask"]["file"]).resolve())}
    return entries


def camera_from_mapping(
    mapping: Any, where: str = "camera", folder: str | os.PathLike[str] = "."
) -> Camera:
    """Camera from the keys and values of a camera file.

    Parameters
    ----------
    mapping : mapping
        `focal_length_mm` and `pixel_pitch_um`, or `focal_length_px`; `focus_distance_m`,
        `image_width`, `image_height`, `mask` (`{name: ...}` or `{file: ...}`), `mask_extent_mm`.
        Optional: `lens_mask_distance_mm`, `lens_f_number`, `side`, `calibrated`, `noise`,
        `noise_gain`, `wavelength_nm`, `diffraction`, `field_curvature` (two numbers), `wavefront`,
        `sensor` (see `Sensor`), `reference`, and `camera_info`, the name of a calibration file,
        see `load_intrinsics`.
    where : str, optional
        Name of the source, for messages.
    folder : str or path-like, optional
        Folder that file names are relative to.

    Returns
    -------
    Camera

    Raises
    ------
    InputError
        One line with the source, the key and what is allowed.

    Examples
    --------
    >>> camera = camera_from_mapping({
    ...     "focal_length_px": 1000.0, "focus_distance_m": 2.0, "image_width": 640,
    ...     "image_height": 480, "mask": {"name": "levin"}, "mask_extent_mm": 10.0,
    ... })
    >>> camera.mask.name, camera.side
    ('levin', 'far')
    """
    with naming(where):
        _check_keys(mapping)
        values = dict(mapping)
        values.pop("reference", None)  # what a reference camera is known for, see `design`
        if "sensor" in values:
            _check_sensor(values.pop("sensor"), values)
        values["mask"] = _mask_from(values["mask"], Path(folder))
        if "field_curvature" in values:
            values["field_curvature"] = FieldCurvature.from_entry(values["field_curvature"])
        if "wavefront" in values:
            values["wavefront"] = Wavefront.from_entry(values["wavefront"])
        info = values.pop("camera_info", None)
        if info is not None:
            if not isinstance(info, str):
                raise InputError(f"camera_info: expected the name of a file, got {short(info)}")
            values["measured"] = load_intrinsics(Path(folder) / info)
        if "focal_length_px" in values:
            return Camera(**values)
        return Camera.from_lens(**values)


def load_sensor(path: str | os.PathLike[str]) -> Sensor | None:
    """Sensor of a camera file; None if it does not describe one."""
    with naming(f"camera file {path}"):
        entries = read_yaml(path, "")
        known = isinstance(entries, Mapping) and "sensor" in entries
        return Sensor.from_entry(entries["sensor"]) if known else None


def _check_sensor(entry: Any, values: Mapping[str, Any]) -> None:
    numbers: dict[str, Any] = {
        name: values.get(name) for name in ("image_width", "image_height", "pixel_pitch_um")
    }
    check_numbers({name: value for name, value in numbers.items() if value is not None})
    Sensor.from_entry(entry).check_frame(**numbers)


def _check_keys(mapping: Any) -> None:
    if not isinstance(mapping, Mapping):
        raise InputError("expected keys and values, such as focal_length_mm: 50")
    for key in mapping:
        if key not in _KEYS:
            close = difflib.get_close_matches(str(key), _KEYS, 1)
            hint = f"did you mean {close[0]}?" if close else "use " + ", ".join(_KEYS)
            raise InputError(f"unknown key {short(key)}: {hint}")
    described_twice = [
        key for key in LENS_AND_PIXEL if key in mapping and "focal_length_px" in mapping
    ]
    if described_twice:
        raise InputError(
            f"{described_twice[0]}: focal_length_px already says it, give either focal_length_px "
            "or focal_length_mm with pixel_pitch_um"
        )
    other_form = LENS_AND_PIXEL if "focal_length_px" in mapping else ("focal_length_px",)
    needed = set(_KEYS) - {*_OPTIONAL, *other_form}
    missing = [key for key in _KEYS if key in needed and key not in mapping]
    if missing:
        hint = " (or focal_length_px)" if set(missing) & set(LENS_AND_PIXEL) else ""
        raise InputError(f"missing {', '.join(missing)}{hint}")


def _mask_from(entry: Any, folder: Path) -> Mask:
    if not isinstance(entry, Mapping) or len(entry) != 1 or not set(entry) <= {"name", "file"}:
        raise InputError(
            f"mask: expected {{name: levin}} or {{file: mask.png}}, got {short(entry)}"
        )
    (kind, value), *_ = entry.items()
    if not isinstance(value, str):
        raise InputError(f"mask: expected the {kind} as text, got {short(value)}")
    return Mask.named(value) if kind == "name" else Mask.from_file(folder / value)
