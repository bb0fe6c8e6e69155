"""The pinhole model of a camera, and its file (YAML) as ROS tools write it.

The format is that of `camera_calibration` and `camera_info_manager`: `image_width`, `image_height`,
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
from coded_aperture_ros.frames import View

_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
# Numbers of coefficients that each distortion model of ROS may have.
_COEFFICIENT_COUNTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}
# For undistortion: the five iterations of OpenCV's default leave errors of pixels.
_UNDISTORT_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-7)
_MATRICES = {"camera_matrix": (3, 3), "rectification_matrix": (3, 3), "projection_matrix": (3, 4)}


@dataclasses.dataclass(frozen=True)
class Intrinsics:
    """Pinhole model with distortion: the content of a `sensor_msgs/CameraInfo`.

    Parameters
    ----------
    image_width, image_height : int
        px.
    camera_matrix : tuple of 9 float
        K, row by row: focal lengths and principal point in px. Pixel centres are whole numbers.
    distortion_coefficients : tuple of float, optional
        D; empty if there is no distortion.
    distortion_model : {"plumb_bob", "rational_polynomial", "equidistant"}, optional
    rectification_matrix : tuple of 9 float, optional
        R.
    projection_matrix : tuple of 12 float, optional
        P, row by row; by default K.
    camera_name : str, optional

    Raises
    ------
    InputError
        Naming the value that no camera can have.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Intrinsics
    >>> Intrinsics.pinhole(500.0, 640, 480).camera_matrix
    (500.0, 0.0, 319.5, 0.0, 500.0, 239.5, 0.0, 0.0, 1.0)
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
        k = self.camera_matrix
        p = self.projection_matrix
        if not (k[0] > 0 and k[4] > 0 and p[0] > 0 and p[5] > 0):
            raise InputError("camera_matrix: the focal lengths have to be more than 0 px")
        d = self.distortion_coefficients
        expected = _COEFFICIENT_COUNTS.get(self.distortion_model)
        if expected is None:
            raise InputError(
                f"distortion_model: {self.distortion_model!r} is not known, use one of "
                f"{', '.join(_COEFFICIENT_COUNTS)}"
            )
        if (d and len(d) not in expected) or not all(map(math.isfinite, d)):
            counts = " or ".join(map(str, expected))
            raise InputError(
                f"distortion_coefficients: {self.distortion_model} has {counts} finite numbers, "
                f"got {len(d)}"
            )

    @classmethod
    def pinhole(cls, focal_length_px: float, image_width: int, image_height: int) -> "Intrinsics":
        """Model without distortion, with the principal point in the middle.

        Pixel centres have whole coordinates, so the middle of a row of w pixels is (w - 1) / 2.
        """
        f = float(focal_length_px)
        cx = (image_width - 1) / 2.0
        cy = (image_height - 1) / 2.0
        matrix = (f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0)
        return cls(image_width, image_height, matrix)

    def rays(self, rows: int, columns: int) -> FloatArray:
        """Ray slopes x / z and y / z of the whole view's pixels, float32 [rows, columns, 2]."""
        model = self.resized(columns, rows)
        distorted = model.distortion_model, model.camera_matrix, model.distortion_coefficients
        return pixel_rays(*distorted, rows, columns)

    def resized(self, width: int, height: int) -> "Intrinsics":
        """Model of the same view in another size; distortion acts on normalised coordinates."""
        return self._transformed(
            width, height, width / self.image_width, height / self.image_height
        )

    def for_view(self, view: View) -> "Intrinsics":
        """Model of frames that show a part of the view, of which this model is the whole."""
        return self._transformed(view.width, view.height, 1.0, 1.0, view.left, view.top)

    def _transformed(self, width: int, height: int, *transform: float) -> "Intrinsics":
        """Model of a picture of this size; `transform`: the last arguments of `scaled_matrix`."""
        return dataclasses.replace(
            self,
            image_width=width,
            image_height=height,
            camera_matrix=scaled_matrix(self.camera_matrix, *transform),
            projection_matrix=scaled_matrix(self.projection_matrix, *transform),
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the calibration file, whole or not at all.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        content = {
            "image_width": self.image_width,
            "image_height": self.image_height,
            "camera_name": self.camera_name,
            "camera_matrix": _matrix_entry(self.camera_matrix, 3),
            "distortion_model": self.distortion_model,
            "distortion_coefficients": _matrix_entry(self.distortion_coefficients, 1),
            "rectification_matrix": _matrix_entry(self.rectification_matrix, 3),
            "projection_matrix": _matrix_entry(self.projection_matrix, 3),
        }
        with atomic_output(path) as temporary:
            text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
            temporary.write_text(text, encoding="utf-8")


def scaled_matrix(
    matrix: Sequence[float], x: float, y: float, left: float = 0.0, top: float = 0.0
) -> tuple[float, ...]:
    """K or P, row by row, of a view that begins at `left` and `top` and is resized by x and y.

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
    """Ray slopes x / z and y / z of the pixels, float32 [rows, columns, 2], without distortion.

    `model`, `k` and `d` are those of a `sensor_msgs/CameraInfo`. Raises `InputError` if the number
    of coefficients does not suit the model.
    """
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(np.float64)
    matrix = np.reshape(k, (3, 3))
    shape = pixels.shape
    arguments = pixels.reshape(-1, 1, 2), matrix, np.array(d)
    try:
        if any(d) and model == "equidistant":
            pixels = cv2.fisheye.undistortPoints(*arguments, P=matrix)
        elif any(d):
            pixels = cv2.undistortImagePoints(*arguments, None, _UNDISTORT_CRITERIA)
    except cv2.error as error:
        raise InputError(f"camera_info: {len(d)} coefficients do not suit {model}") from error
    return np.asarray((pixels.reshape(shape) - [k[2], k[5]]) / [k[0], k[4]], np.float32)


def load_intrinsics(path: str | os.PathLike[str]) -> Intrinsics:
    """Pinhole model from a calibration file of ROS tools.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    Intrinsics

    Raises
    ------
    InputError
        One line with the file and the key.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from coded_aperture_ros.optics import Intrinsics, load_intrinsics
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "camera.yaml")
    ...     Intrinsics.pinhole(500.0, 640, 480).save(file)
    ...     load_intrinsics(file).image_width
    640
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
        values |= {
            k: _parse_matrix(k, content[k], *shape) for k, shape in shapes.items() if k in content
        }
        return Intrinsics(**values)


def read_yaml(path: str | os.PathLike[str], name: str) -> Any:
    """Content of a YAML file; raises `InputError` with `name` if it cannot be read."""
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read {name}: {error.strerror or error}") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # also dates, escapes and numbers
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        raise InputError(f"{name}: not valid YAML{line}") from error


def _parse_matrix(key: str, entry: Any, rows: int, columns: int | None) -> tuple[float, ...]:
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


def _matrix_entry(values: tuple[float, ...], rows: int) -> dict[str, Any]:
    return {"rows": rows, "cols": len(values) // rows, "data": [float(value) for value in values]}
