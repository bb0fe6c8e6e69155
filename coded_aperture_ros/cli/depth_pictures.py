"""Scales and pictures of depth that `depth` makes on demand."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth import DepthEstimator
from coded_aperture_ros.frames import SRGB, encode
from coded_aperture_ros.io import confidence_picture, depth_picture, write_image
from coded_aperture_ros.io.display import display_path

# Both ends, and the unit.
Scale = tuple[float, float, str]
# Beyond so many times the nearest depth hardly any are told apart: scales end there.
_FARTHEST = 10


def depth_scale(estimator: DepthEstimator, *, as_levels: bool) -> Scale:
    """Ends and unit of the scale that all pictures of a video have: depths, or levels."""
    depths_m = estimator.depths_m
    if as_levels or depths_m is None:
        return 0.0, len(estimator.model.stack) - 1.0, ""
    nearest_m = float(np.nanmin(depths_m))
    farthest_m = float(np.nanmax(depths_m))
    return nearest_m, min(farthest_m, _FARTHEST * nearest_m), "m"


def frame_beside_depth(picture: FloatArray, values: FloatArray, scale: Scale) -> NDArray[np.uint8]:
    """A frame, of any size, and its depth side by side, uint8 [h + strip, 2 w, RGB]."""
    depth = depth_picture(values, *scale)
    light = cv2.resize(picture, values.shape[::-1], interpolation=cv2.INTER_AREA)
    light = light if light.ndim == 3 else cv2.cvtColor(light, cv2.COLOR_GRAY2RGB)
    frame = np.full_like(depth, 255)
    frame[: len(light)] = np.rint(255 * encode(np.clip(light, 0, 1), SRGB))
    return np.hstack([frame, depth])


def picture_files(path: Path) -> tuple[Path, Path]:
    """Files of the pictures of a depth map and of its confidence."""
    return display_path(path), display_path(path.with_suffix(".confidence.npy"))


def comparison_file(path: Path) -> Path:
    """File of the comparison of a depth map with the truth."""
    return path.with_suffix(".comparison.png")


def write_pictures(
    path: Path, values: FloatArray, confidence: FloatArray, scale: Scale | tuple[()] = ()
) -> None:
    """Write pictures of a depth map and its confidence beside the map; see `depth_picture`."""
    of_depth, of_confidence = picture_files(path)
    write_image(of_depth, depth_picture(values, *scale))
    write_image(of_confidence, confidence_picture(confidence))
