"""Pictures and plots of the report, as PNG."""

from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bags.frame_log import Sample
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.figures import new_figure, save_figure
from coded_aperture_ros.frames import SRGB, pixels_from_linear
from coded_aperture_ros.io import confidence_picture, depth_picture, grey_picture
from coded_aperture_ros.metrics.figures import reliability_diagram
from coded_aperture_ros.metrics.reliability import Reliability

_WIDTH_INCHES = 8.0
_ROW_INCHES = 1.7
# Width of the pictures; full size would make the page several times as large.
_PICTURE_PX = 320
# Relative error that is drawn white.
_WHITE_ERROR = 0.2
_NO_ERROR_RGB = (40, 40, 90)
# Keys of the values, and titles; a row of the plot for each.
_SERIES = {
    "coverage": "share of pixels with depth",
    "median_depth_m": "median depth, m",
    "median_relative_error": "median relative error",
    "within_10_percent": "share within 10 %",
}


def series_plot(series: Sequence[Mapping[str, Any]]) -> bytes:
    """Plot of the values of every frame over time, as PNG."""
    names = [name for name in _SERIES if any(row.get(name) is not None for row in series)]
    first = series[0]["stamp_ns"]
    seconds = [1e-9 * (row["stamp_ns"] - first) for row in series]
    figure = new_figure(_WIDTH_INCHES, _ROW_INCHES * len(names))
    for axes, name in zip(
        figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0], names, strict=True
    ):
        values = [np.nan if row.get(name) is None else row[name] for row in series]
        axes.plot(seconds, values, "o-", markersize=2, linewidth=1)
        axes.set_ylabel(_SERIES[name].replace(" ", "\n", 1), fontsize=8)
        axes.grid(alpha=0.3)
        if name in ("coverage", "within_10_percent"):
            axes.set_ylim(0, 1.02)
        else:
            axes.set_ylim(0)
        axes.tick_params(labelsize=8)
    figure.axes[-1].set_xlabel("seconds after the first frame", fontsize=8)
    return _png(lambda file: save_figure(figure, file))


def reliability_plot(reliability: Reliability) -> bytes:
    """Reliability diagram of the confidence, as PNG."""
    curves = {"depth": reliability}
    return _png(lambda file: reliability_diagram(curves, file, "within 5 % of the reference"))


def depth_range(samples: Sequence[Sample]) -> tuple[float, float]:
    """Nearest and farthest depth of the colours of all samples, m."""
    depths = [sample.maps.depth_m for sample in samples]
    depths += [sample.score.reference_m for sample in samples if sample.score is not None]
    known = np.concatenate([depth[np.isfinite(depth)] for depth in depths])
    if not known.size:
        return 0.0, 1.0
    near, far = np.percentile(known, [1, 99])
    return float(near), float(far)


def sample_pictures(sample: Sample, range_m: tuple[float, float]) -> dict[str, NDArray[np.uint8]]:
    """Pictures of a frame and its results, uint8 [rows, columns(, RGB)], by their titles."""
    pictures = {"coded frame": _light(sample.frame)}
    pictures["depth"] = depth_picture(_small(sample.maps.depth_m), *range_m)
    pictures["confidence"] = confidence_picture(_small(sample.maps.confidence))
    if sample.sharp is not None:
        pictures["all in focus"] = _light(sample.sharp)
    if sample.score is not None:
        reference = sample.score.reference_m
        pictures["reference"] = depth_picture(_small(reference), *range_m)
        error = np.abs(sample.maps.depth_m - reference) / reference
        pictures[f"error, white: {100 * _WHITE_ERROR:.0f} %"] = _error_picture(_small(error))
    return pictures


def encode_png(picture: NDArray[np.uint8]) -> bytes:
    """PNG of a grey or RGB picture."""
    stored = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    return bytes(cv2.imencode(".png", stored)[1])


def _light(frame: FloatArray) -> NDArray[np.uint8]:
    """Frame as a display wants it, small."""
    return np.asarray(pixels_from_linear(_small(frame), 8, SRGB), np.uint8)


def _small(values: FloatArray) -> FloatArray:
    if values.shape[1] <= _PICTURE_PX:
        return values
    size = _PICTURE_PX, max(1, round(values.shape[0] * _PICTURE_PX / values.shape[1]))
    # Depth is not mixed across edges, and NaN does not spread.
    smooth = values.ndim == 3 or np.isfinite(values).all()
    how = cv2.INTER_AREA if smooth else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(values, size, interpolation=how), np.float32)


def _error_picture(error: FloatArray) -> NDArray[np.uint8]:
    """Picture of relative errors from black to white; blue where unknown."""
    picture = np.repeat(grey_picture(error / _WHITE_ERROR)[..., None], 3, axis=2)
    picture[~np.isfinite(error)] = _NO_ERROR_RGB
    return picture


def _png(draw: Callable[[BytesIO], object]) -> bytes:
    file = BytesIO()
    draw(file)
    return file.getvalue()
