"""The pinhole model of a camera, and its file (YAML) as ROS tools write it.

The format is that of `camera_calibration` and `camera_info_manager`: `image_width`, `image_height`,
`camera_name`, `distortion_model`, and matrices with `rows`, `cols` and `data`.
"""

import dataclasses
import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import yaml

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.options import has_type
from coded_aperture_ros.core.text import short
from coded_aperture_ros.core.yaml_file import read_yaml
from coded_aperture_ros.frames import View
from coded_aperture_ros.optics.distortion import distortion_model, pixel_rays

_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
# The sides of pixels differ by less; a matrix whose focal lengths do is one of other pixels.
_LARGEST_ASPECT = 1.5
# P may have another focal length than K, but not in another unit.
_OTHER_UNIT = 10.0
# A model for a part of a sensor has its principal point beside the picture, but in its unit; in
# sides of the picture.
_FARTHEST_CENTRE = 10.0
# How far R may be from a rotation.
_ROTATION_ERROR = 0.01
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
        Or a name of another program, which becomes one of these; see `distortion_model`.
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
                raise InputError(f"{name}: expected a whole number of pixels, got {short(value)}")
        if not self.projection_matrix:
            k = self.camera_matrix
            rows = (*k[:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0)
            object.__setattr__(self, "projection_matrix", rows)
        for name, (rows_, columns) in _MATRICES.items():
            values = getattr(self, name)
            if len(values) != rows_ * columns or not all(map(math.isfinite, values)):
                raise InputError(f"{name}: expected {rows_ * columns} finite numbers")
        self._check_matrices()
        d = self.distortion_coefficients
        if not all(map(math.isfinite, d)):
            raise InputError("distortion_coefficients: expected finite numbers")
        object.__setattr__(self, "distortion_model", distortion_model(self.distortion_model, d))

    def check_measured(self) -> None:
        """Check a model that somebody has measured; one of a region, or resized, is computed.

        Raises
        ------
        InputError
            If the principal point is at 0, where nobody has set it, or far outside the picture, or
            the two focal lengths are of different pixels.
        """
        k = self.camera_matrix
        if max(k[0] / k[4], k[4] / k[0]) > _LARGEST_ASPECT:
            raise InputError(f"camera_matrix: focal lengths of {k[0]:g} and {k[4]:g} px")
        for name, centre_px, length in (
            ("cx", k[2], self.image_width),
            ("cy", k[5], self.image_height),
        ):
            if centre_px == 0 or abs(centre_px) > _FARTHEST_CENTRE * length:
                raise InputError(f"camera_matrix: {name} of {centre_px:g} in {length} px")

    def _check_matrices(self) -> None:
        """Raise `InputError` for values of finite matrices that no camera has."""
        k, p = self.camera_matrix, self.projection_matrix
        if min(k[0], k[4], p[0], p[5]) <= 0:
            raise InputError("camera_matrix: the focal lengths have to be more than 0 px")
        if k[3] or k[6] or k[7] or k[8] != 1:
            raise InputError("camera_matrix: expected f 0 cx, 0 f cy, 0 0 1, row by row")
        if not all(1 / _OTHER_UNIT < scaled < _OTHER_UNIT for scaled in (p[0] / k[0], p[5] / k[4])):
            raise InputError(
                f"projection_matrix: focal lengths of {p[0]:g} and {p[5]:g} px, those of the "
                f"camera_matrix are {k[0]:g} and {k[4]:g} px"
            )
        rotation = np.reshape(self.rectification_matrix, (3, 3))
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=_ROTATION_ERROR):
            raise InputError("rectification_matrix: it is no rotation (1 0 0, 0 1 0, 0 0 1 is one)")

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

    def check_size(self, width: int, height: int) -> None:
        """Raise `InputError` unless they are for images of a size, px."""
        if (self.image_width, self.image_height) != (width, height):
            raise InputError(
                f"camera_info: for images of {self.image_width}x{self.image_height}, this "
                f"camera's have {width}x{height}"
            )

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
        # Older calibration programs of ROS write the model of a fisheye lens under another key.
        for key, keys in (("camera_name", ()), ("distortion_model", ("camera_model",))):
            given = [content[name] for name in (key, *keys) if content.get(name)]
            values |= {key: str(given[0])} if given else {}
        shapes = {**_MATRICES, "distortion_coefficients": (1, None)}
        values |= {
            k: _parse_matrix(k, content[k], *shape) for k, shape in shapes.items() if k in content
        }
        model = Intrinsics(**values)
        model.check_measured()
        return model


def _parse_matrix(key: str, entry: Any, rows: int, columns: int | None) -> tuple[float, ...]:
    if not isinstance(entry, dict):
        raise InputError(f"{key}: expected rows, cols and data, got {short(entry)}")
    for part in ("rows", "cols", "data"):
        if part not in entry:
            raise InputError(f"{key}: missing {part}")
    shape = entry["rows"], entry["cols"]
    if shape[0] != rows or (columns is not None and shape[1] != columns):
        wanted = f"{rows} rows" + ("" if columns is None else f" and {columns} cols")
        raise InputError(f"{key}: expected {wanted}, got {short(shape[0])} and {short(shape[1])}")
    data = entry["data"]
    numbers = isinstance(data, list) and all(has_type(value, float) for value in data)
    if not numbers or len(data) != rows * shape[1]:
        raise InputError(f"{key}: data: expected {rows} x {shape[1]} numbers, got {short(data)}")
    return tuple(float(value) for value in data)


def _matrix_entry(values: tuple[float, ...], rows: int) -> dict[str, Any]:
    return {"rows": rows, "cols": len(values) // rows, "data": [float(value) for value in values]}
