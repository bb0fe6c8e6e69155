"""Pictures of depth and confidence for display."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError

# Unknown is hatched: no single colour is unlike all depths.
UNKNOWN_RGB = (225, 225, 225)
_HATCH_RGB = (170, 170, 170)
_HATCH_PX = 6
_BAR_HEIGHT = 14
_STRIP_HEIGHT = 40
_MARGIN = 12
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_FONT_SCALE = 0.4
_STROKE = 1


def depth_picture(
    depth_m: NDArray, near_m: float | None = None, far_m: float | None = None, unit: str = "m"
) -> NDArray[np.uint8]:
    """Coloured depth map with a scale bar, RGB, uint8 [h + strip, w, 3]; near red, far blue.

    Parameters
    ----------
    depth_m : ndarray [h, w]
        m; NaN is unknown, and hatched in grey.
    near_m, far_m : float, optional
        Ends of the scale; by default those of the finite depths, less 1 % outliers on each side.
    unit : str, optional
        Unit of the scale's numbers, if the map is not in metres.

    Raises
    ------
    InputError
        If the map is not two-dimensional, or empty.

    Examples
    --------
    >>> import numpy as np
    >>> depth_picture(np.linspace(1, 3, 20000).reshape(100, 200)).shape
    (140, 200, 3)
    """
    if depth_m.ndim != 2 or not depth_m.size:
        raise InputError(f"depth: expected [row, column], got the shape {list(depth_m.shape)}")
    near_m, far_m = _range(depth_m, near_m, far_m)
    nearness = (far_m - np.nan_to_num(depth_m, nan=far_m, posinf=far_m)) / (far_m - near_m)
    picture = _turbo(nearness)
    _hatch(picture, np.isnan(depth_m))
    return np.vstack([picture, _scale_strip(depth_m.shape[1], near_m, far_m, unit)])


def error_picture(error: NDArray, largest: float) -> NDArray[np.uint8]:
    """Coloured relative errors with a scale bar in per cent, RGB, uint8 [h + strip, w, 3].

    Parameters
    ----------
    error : ndarray [h, w]
        Shares; NaN is unknown, and hatched in grey.
    largest : float
        Error at the end of the scale.

    Examples
    --------
    >>> import numpy as np
    >>> error_picture(np.zeros((10, 200)), largest=0.2).shape
    (50, 200, 3)
    """
    picture = _turbo(np.nan_to_num(error, posinf=largest) / largest)
    _hatch(picture, np.isnan(error))
    strip = _scale_strip(error.shape[1], 0.0, 100 * largest, "%", rising=True)
    return np.vstack([picture, strip])


def confidence_picture(confidence: NDArray) -> NDArray[np.uint8]:
    """Confidence 0 to 1 from black to white with a scale bar, uint8 [h + strip, w, 3].

    Unknown (NaN) is black.

    Examples
    --------
    >>> import numpy as np
    >>> confidence_picture(np.full((10, 200), 0.5)).shape
    (50, 200, 3)
    """
    strip = _scale_strip(confidence.shape[1], 0.0, 1.0, "", rising=True, colours=_greys)
    return np.vstack([_greys(confidence), strip])


def grey_picture(values: NDArray) -> NDArray[np.uint8]:
    """Values 0 to 1 from black to white, uint8, shape of `values`; NaN is black.

    Examples
    --------
    >>> import numpy as np
    >>> grey_picture(np.array([[0.0, 0.5, np.nan, 2.0]])).tolist()
    [[0, 128, 0, 255]]
    """
    return np.rint(np.clip(np.nan_to_num(values), 0.0, 1.0) * 255.0).astype(np.uint8)


def _greys(values: NDArray) -> NDArray[np.uint8]:
    return cv2.cvtColor(grey_picture(values), cv2.COLOR_GRAY2RGB)


def _hatch(picture: NDArray[np.uint8], unknown: NDArray) -> None:
    rows, columns = np.nonzero(unknown)
    striped = (rows + columns) // 2 % _HATCH_PX == 0
    picture[rows, columns] = np.where(striped[:, None], _HATCH_RGB, UNKNOWN_RGB)


def _range(depth_m: NDArray, near_m: float | None, far_m: float | None) -> tuple[float, float]:
    known = depth_m[np.isfinite(depth_m)]
    lower, upper = np.percentile(known, [1, 99]) if known.size else (0.0, 1.0)
    near_m = float(lower) if near_m is None else near_m
    far_m = float(upper) if far_m is None else far_m
    # A plane has one depth; the bar still needs two ends.
    return near_m, max(far_m, near_m * (1 + 1e-3) + 1e-6)


def _turbo(values: NDArray) -> NDArray[np.uint8]:
    coloured = cv2.applyColorMap(grey_picture(values), cv2.COLORMAP_TURBO)
    return cv2.cvtColor(coloured, cv2.COLOR_BGR2RGB)


def _scale_strip(
    width: int,
    near_m: float,
    far_m: float,
    unit: str,
    rising: bool = False,
    colours: Callable[[NDArray], NDArray[np.uint8]] | None = None,
) -> NDArray[np.uint8]:
    strip = np.full((_STRIP_HEIGHT, width, 3), 255, dtype=np.uint8)
    length = width - 2 * _MARGIN
    if length < 40:
        # Too narrow for a legible scale: the strip keeps its size, so that pictures line up.
        return strip
    ends = (0.0, 1.0) if rising else (1.0, 0.0)
    bar = (colours or _turbo)(np.linspace(*ends, length)[None, :].repeat(_BAR_HEIGHT, axis=0))
    strip[4 : 4 + _BAR_HEIGHT, _MARGIN : _MARGIN + length] = bar
    for tick_m in _ticks(near_m, far_m, max(2, length // 70)):
        column = _MARGIN + round((tick_m - near_m) / (far_m - near_m) * (length - 1))
        cv2.line(strip, (column, 4 + _BAR_HEIGHT), (column, 8 + _BAR_HEIGHT), (0, 0, 0))
        label = f"{tick_m + 0.0:.4g} {unit}".strip()  # never "-0"
        (text_width, text_height), _ = cv2.getTextSize(label, _FONT, _FONT_SCALE, _STROKE)
        left = int(np.clip(column - text_width // 2, 0, width - text_width))
        origin = (left, 12 + _BAR_HEIGHT + text_height)
        cv2.putText(strip, label, origin, _FONT, _FONT_SCALE, (0, 0, 0), _STROKE, cv2.LINE_AA)
    return strip


def _ticks(near_m: float, far_m: float, count: int) -> DoubleArray:
    """About `count` or fewer round numbers (1, 2 or 5 times a power of ten) in the range."""
    raw = (far_m - near_m) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * (1 - 1e-9))
    first = np.ceil(near_m / step - 1e-9)
    last = np.floor(far_m / step + 1e-9)
    return np.arange(first, last + 0.5) * step
