"""The pinhole model of a camera, and the YAML file in which ROS tools keep it.

That is the format of `camera_calibration` and `camera_info_manager`: `image_width`, `image_height`,
`camera_name`, `distortion_model`, and matrices with `rows`, `cols` and `data`.
"""

import dataclasses
import math
import os
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.options import has_type
from coded_aperture_ros.optics.view import View

_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
# How many coefficients the models of ROS have.
_COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}
# Of undoing distortion: OpenCV's five leave pixels.
_ITERATIONS = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-7)
_MATRICES = {"camera_matrix": (3, 3), "rectification_matrix": (3, 3), "projection_matrix": (3, 4)}


@dataclasses.dataclass(frozen=True)
class Intrinsics:
    """What `sensor_msgs/CameraInfo` says about a camera.

    Attributes
    ----------
    image_width, image_height : int
    camera_matrix : tuple of 9 float
        K, row by row: focal lengths and principal point in px. Pixel centres are whole numbers.
    distortion_coefficients : tuple of float
        D; empty if there is no distortion.
    distortion_model : str
    rectification_matrix : tuple of 9 float
        R.
    projection_matrix : tuple of 12 float
        P, row by row.
    camera_name : str

    Raises
    ------
    InputError
        Naming the value that no camera can have.
    """

    image_width: int
    image_height: int
    camera_matrix: tuple[float, ...]
    distortion_coefficients: tuple[float, ...] = (0.0,) * 5
    distortion_model: str = "plumb_bob"
    rectification_matrix: tuple[float, ...] = _IDENTITY
    projection_matrix: tuple[float, ...] = ()
    camera_name: str = "camera"

    def __post_init__(self) -> None:
        for name in ("image_width", "image_height"):
            value = getattr(self, name)
            if not has_type(value, int) or value < 1:
                raise InputError(f"{name}: expected a whole number of pixels, got {value!r}")
        if not self.projection_matrix:
            k = self.camera_matrix
            rows = (*k[:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0)
            object.__setattr__(self, "projection_matrix", rows)
        for name, (rows_, columns) in _MATRICES.items():
            values = getattr(self, name)
            if len(values) != rows_ * columns or not all(map(math.isfinite, values)):
                raise InputError(f"{name}: expected {rows_ * columns} finite numbers")
        k, p = self.camera_matrix, self.projection_matrix
        if not (k[0] > 0 and k[4] > 0 and p[0] > 0 and p[5] > 0):
            raise InputError("camera_matrix: the focal lengths have to be more than 0 px")
        d = self.distortion_coefficients
        expected = _COEFFICIENTS.get(self.distortion_model)
        if expected is None:
            raise InputError(
                f"distortion_model: {self.distortion_model!r} is not known, use one of "
                f"{', '.join(_COEFFICIENTS)}"
            )
        if (d and len(d) not in expected) or not all(map(math.isfinite, d)):
            counts = " or ".join(map(str, expected))
            raise InputError(
                f"distortion_coefficients: {self.distortion_model} has {counts} finite numbers, "
                f"got {len(d)}"
            )

    @classmethod
    def pinhole(cls, focal_length_px: float, image_width: int, image_height: int) -> "Intrinsics":
        """Return the model without distortion, with the principal point in the middle.

        Pixel centres have whole coordinates, so the middle of a row of w pixels is (w - 1) / 2.
        """
        f = float(focal_length_px)
        cx, cy = (image_width - 1) / 2.0, (image_height - 1) / 2.0
        matrix = (f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0)
        return cls(image_width, image_height, matrix)

    def rays(self, rows: int, columns: int) -> FloatArray:
        """Return `rays` through the pixels of the same view in a picture of this size."""
        model = self.resized(columns, rows)
        distorted = model.distortion_model, model.camera_matrix, model.distortion_coefficients
        return pixel_rays(*distorted, rows, columns)

    def resized(self, width: int, height: int) -> "Intrinsics":
        """Return the model of the same view resized; distortion acts on normalised coordinates."""
        return self._placed(width, height, width / self.image_width, height / self.image_height)

    def for_view(self, view: View) -> "Intrinsics":
        """Return the model of a part of the view, of which this is the whole."""
        return self._placed(view.width, view.height, 1.0, 1.0, view.left, view.top)

    def _placed(self, width: int, height: int, *place: float) -> "Intrinsics":
        """Return the model of a picture of this size; for its place see `scaled_matrix`."""
        return dataclasses.replace(
            self,
            image_width=width,
            image_height=height,
            camera_matrix=scaled_matrix(self.camera_matrix, *place),
            projection_matrix=scaled_matrix(self.projection_matrix, *place),
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file, which appears whole or not at all; an `InputError` if it cannot be."""
        content = {
            "image_width": self.image_width,
            "image_height": self.image_height,
            "camera_name": self.camera_name,
            "camera_matrix": _matrix(self.camera_matrix, 3),
            "distortion_model": self.distortion_model,
            "distortion_coefficients": _matrix(self.distortion_coefficients, 1),
            "rectification_matrix": _matrix(self.rectification_matrix, 3),
            "projection_matrix": _matrix(self.projection_matrix, 3),
        }
        with atomic_output(path) as temporary:
            text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
            temporary.write_text(text, encoding="utf-8")


def scaled_matrix(
    matrix: Sequence[float], x: float, y: float, left: float = 0.0, top: float = 0.0
) -> tuple[float, ...]:
    """Return K or P, row by row, of a view from `left` and `top` on that is resized by x and y.

    Pixel centres have whole coordinates: a scale s moves x to s (x - left + 1/2) - 1/2.
    """
    columns = len(matrix) // 3
    scales = (x,) * columns + (y,) * columns + (1.0,) * columns
    values = [float(value) * scale for value, scale in zip(matrix, scales, strict=True)]
    values[2] = x * (float(matrix[2]) - left + 0.5) - 0.5
    values[columns + 2] = y * (float(matrix[columns + 2]) - top + 0.5) - 0.5
    return tuple(values)


@lru_cache(maxsize=4)
def pixel_rays(
    model: str, k: tuple[float, ...], d: tuple[float, ...], rows: int, columns: int
) -> FloatArray:
    """Return x / z and y / z of what every pixel sees, float32 [rows, columns, 2].

    The arguments are those of `sensor_msgs/CameraInfo`; its distortion is undone. An `InputError`
    if it has too many or too few coefficients.
    """
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(np.float64)
    matrix, shape = np.reshape(k, (3, 3)), pixels.shape
    arguments = pixels.reshape(-1, 1, 2), matrix, np.array(d)
    try:
        if any(d) and model == "equidistant":
            pixels = cv2.fisheye.undistortPoints(*arguments, P=matrix)
        elif any(d):
            pixels = cv2.undistortImagePoints(*arguments, None, _ITERATIONS)
    except cv2.error as error:
        raise InputError(f"camera_info: {len(d)} coefficients do not suit {model}") from error
    return np.asarray((pixels.reshape(shape) - [k[2], k[5]]) / [k[0], k[4]], np.float32)


def load_intrinsics(path: str | os.PathLike[str]) -> Intrinsics:
    """Read a camera calibration as ROS tools write it.

    An `InputError` is one line that names the file and the key.
    """
    content = read_yaml(path, str(path))
    with naming(path):
        if not isinstance(content, dict):
            raise InputError("expected the keys of a camera calibration, such as image_width: 640")
        for key in ("image_width", "image_height", "camera_matrix", "distortion_coefficients"):
            if key not in content:
                raise InputError(f"missing {key}")
        values = {key: content[key] for key in ("image_width", "image_height")}
        names = ("camera_name", "distortion_model")
        values |= {key: str(content[key]) for key in names if key in content}
        shapes = {**_MATRICES, "distortion_coefficients": (1, None)}
        values |= {k: _data(k, content[k], *shape) for k, shape in shapes.items() if k in content}
        return Intrinsics(**values)


def read_yaml(path: str | os.PathLike[str], name: str) -> Any:
    """Return the content of a YAML file; an `InputError` that calls it `name`, if there is none."""
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read {name}: {error.strerror or error}") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # also dates, escapes and numbers
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        raise InputError(f"{name}: not valid YAML{line}") from error


def _data(key: str, entry: Any, rows: int, columns: int | None) -> tuple[float, ...]:
    if not isinstance(entry, dict):
        raise InputError(f"{key}: expected rows, cols and data, got {entry!r}")
    for part in ("rows", "cols", "data"):
        if part not in entry:
            raise InputError(f"{key}: missing {part}")
    shape = entry["rows"], entry["cols"]
    if shape[0] != rows or (columns is not None and shape[1] != columns):
        wanted = f"{rows} rows" + ("" if columns is None else f" and {columns} cols")
        raise InputError(f"{key}: expected {wanted}, got {shape[0]!r} and {shape[1]!r}")
    data = entry["data"]
    numbers = isinstance(data, list) and all(has_type(value, float) for value in data)
    if not numbers or len(data) != rows * shape[1]:
        raise InputError(f"{key}: data: expected {rows} x {shape[1]!r} numbers, got {data!r}")
    return tuple(float(value) for value in data)


def _matrix(values: tuple[float, ...], rows: int) -> dict[str, Any]:
    return {"rows": rows, "cols": len(values) // rows, "data": [float(value) for value in values]}
