"""Rays of a camera on a coarse grid, from which a page knows where pixels lie in space."""

import dataclasses
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from coded_aperture_ros.optics import Intrinsics

# Distortion is smooth: rays between those of so many columns and rows are interpolated.
_COLUMNS = 33
_ROWS = 25


def ray_grid(intrinsics: Intrinsics) -> dict[str, Any]:
    """Slopes x / z and y / z of the rays of a frame, from corner to corner, ready for JSON.

    Parameters
    ----------
    intrinsics : Intrinsics
        Of the frame.

    Returns
    -------
    dict
        `columns`, `rows`: size of the grid, whose first and last rays are those of the outermost
        pixels' centres; `slopes`: row by row, None where there is no ray.

    Examples
    --------
    >>> grid = ray_grid(Intrinsics.pinhole(500.0, 641, 481))
    >>> grid["columns"], grid["rows"], grid["slopes"][:2]
    (33, 25, [-0.64, -0.48])
    """
    # A camera's name and where it is published change no ray.
    return _ray_grid(dataclasses.replace(intrinsics, camera_name="camera"))


@lru_cache(maxsize=8)
def _ray_grid(intrinsics: Intrinsics) -> dict[str, Any]:
    width = intrinsics.image_width
    height = intrinsics.image_height
    across = np.linspace(0, width - 1, _COLUMNS, dtype=np.float32)
    down = np.linspace(0, height - 1, _ROWS, dtype=np.float32)
    places = np.meshgrid(across, down)
    sampled = cv2.remap(intrinsics.rays(height, width), *places, cv2.INTER_LINEAR)
    slopes = [round(float(slope), 6) if np.isfinite(slope) else None for slope in sampled.ravel()]
    return {"columns": _COLUMNS, "rows": _ROWS, "slopes": slopes}
