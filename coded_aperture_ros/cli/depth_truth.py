"""Depth maps beside true ones: errors, and a picture for comparison."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.cli.depth_pictures import comparison_file
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.text import rounded
from coded_aperture_ros.deblur import covers_frame
from coded_aperture_ros.depth import DepthEstimate, range_complaint
from coded_aperture_ros.frames import SRGB, pixels_from_linear
from coded_aperture_ros.io import (
    confidence_picture,
    depth_picture,
    error_picture,
    read_depth,
    write_image,
)
from coded_aperture_ros.io.panels import panels
from coded_aperture_ros.metrics.errors import RelativeError

# Where the scale of relative errors ends.
_LARGEST_ERROR = 0.1


@dataclasses.dataclass(frozen=True, eq=False)
class TrueDepth:
    """True depth of frames of one view.

    Attributes
    ----------
    name : str
        File that it comes from.
    depth_m : ndarray, float32 [rows, columns]
        NaN where unknown.
    """

    name: str
    depth_m: FloatArray

    @classmethod
    def from_file(cls, name: str, range_m: tuple[float, float] | None) -> "TrueDepth":
        """True depth of a file; an `InputError` if hardly any is within the range of levels, m."""
        depth_m = read_depth(name)
        if not np.isfinite(depth_m).any():
            raise InputError(f"{name}: no pixel has a known depth")
        complaint = "" if range_m is None else range_complaint(depth_m, range_m)
        if complaint:
            raise InputError(f"{name}: {complaint}")
        return cls(name, depth_m)

    def compare(self, output: Path, picture: FloatArray, estimate: DepthEstimate) -> dict[str, Any]:
        """Write the comparison beside a depth map; return the errors, ready for JSON.

        Parameters
        ----------
        output : Path
            File of the depth map.
        picture : ndarray, float32 [rows, columns] or [rows, columns, RGB]
            Frame, linear light.
        estimate : DepthEstimate

        Raises
        ------
        InputError
            If the true depth does not have the proportions of the depth map, or that has no metres.
        """
        found = estimate.depth_m
        if found is None:
            raise InputError("there is no depth in m to compare: give --camera")
        with naming(self.name):
            truth = self._resized(found.shape)
        error = np.abs(found - truth) / truth
        error[~np.isfinite(error)] = np.nan
        write_image(comparison_file(output), _panels(picture, estimate, found, truth, error))
        errors = error[np.isfinite(error)]
        summary = RelativeError.from_errors(errors, int(np.isfinite(truth).sum()))
        return {
            "file": self.name,
            "median_relative_error": _number(summary.median),
            "mean_relative_error": _number(summary.mean),
            "within_10_percent": _number(summary.within_10_percent),
            "coverage": _number(summary.coverage),
            "comparison": str(comparison_file(output)),
        }

    def _resized(self, shape: tuple[int, ...]) -> FloatArray:
        rows, columns = shape
        if self.depth_m.shape == (rows, columns):
            return self.depth_m
        if not covers_frame(self.depth_m.shape, (rows, columns)):
            raise InputError(
                f"true depth of {self.depth_m.shape[1]}x{self.depth_m.shape[0]} does not have the "
                f"proportions of the depth map, {columns}x{rows}"
            )
        size = columns, rows
        return np.asarray(cv2.resize(self.depth_m, size, interpolation=cv2.INTER_NEAREST_EXACT))


def truth_text(errors: dict[str, Any]) -> str:
    """Errors in words, for the line of a depth map."""
    if errors["median_relative_error"] is None:
        return "no pixel to compare"
    return (
        f"error median {errors['median_relative_error']:.1%}, "
        f"{errors['within_10_percent']:.0%} within 10 %"
    )


def _panels(
    picture: FloatArray,
    estimate: DepthEstimate,
    found: FloatArray,
    truth: FloatArray,
    error: FloatArray,
) -> NDArray[np.uint8]:
    known = truth[np.isfinite(truth)]
    near_m, far_m = float(known.min()), float(known.max())
    rows, columns = found.shape
    light = cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA)
    pixels: Any = pixels_from_linear(light, 8, SRGB)
    coded: NDArray[np.uint8] = (
        pixels if pixels.ndim == 3 else cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB)
    )
    return panels(
        [
            [
                ("coded frame", coded),
                ("depth; hatched: unknown", depth_picture(found, near_m, far_m)),
                ("confidence", confidence_picture(estimate.confidence)),
            ],
            [
                (_caption(error), error_picture(error, _LARGEST_ERROR)),
                ("true depth", depth_picture(truth, near_m, far_m)),
                ("", np.full_like(coded, 255)),
            ],
        ]
    )


def _caption(error: FloatArray) -> str:
    known = error[np.isfinite(error)]
    if not known.size:
        return "no pixel has both depths"
    return f"error: median {np.median(known):.1%}, {np.mean(known <= 0.1):.0%} within 10 %"


def _number(value: float) -> float | None:
    return rounded(value, 4) if math.isfinite(value) else None
