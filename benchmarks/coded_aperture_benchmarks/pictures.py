"""Pictures of the benchmarks, side by side, for a person to look at."""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.frames import SRGB, pixels_from_linear
from coded_aperture_ros.io import depth_picture

WHITE = 255
_TITLE_HEIGHT_PX = 20
_GAP_PX = 6


def side_by_side(columns: Sequence[tuple[str, Sequence[NDArray[np.uint8]]]]) -> NDArray[np.uint8]:
    """Put columns of pictures beside each other, each below its title.

    Parameters
    ----------
    columns : sequence of (str, sequence of ndarray, uint8 [rows, columns, 3])
        Pictures of one row have one height, those of a column one width.

    Returns
    -------
    ndarray, uint8 [rows, columns, 3]
    """
    return np.hstack([_column(title, pictures) for title, pictures in columns])


def frames_and_depths(
    frames: Mapping[str, FloatArray],
    depths_m: Mapping[str, FloatArray],
    ends_m: tuple[float, float],
) -> NDArray[np.uint8]:
    """Put frames in linear light, and depth maps in one scale with its legend, beside each other.

    All by their titles, and of one size.
    """
    drawn = {title: depth_picture(depth_m, *ends_m, "m") for title, depth_m in depths_m.items()}
    height = max(len(picture) for picture in drawn.values())  # with the legend
    parts = []
    for title, frame in frames.items():
        picture = as_rgb(np.clip(frame, 0, 1), SRGB)
        gap = ((0, height - len(picture)), (0, 0), (0, 0))
        parts.append((title, [np.pad(picture, gap, constant_values=WHITE)]))
    return side_by_side([*parts, *((title, [picture]) for title, picture in drawn.items())])


def _column(title: str, pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    width = max(picture.shape[1] for picture in pictures)
    parts = []
    for picture in pictures:
        gaps = ((0, _GAP_PX), (0, width - picture.shape[1]), (0, 0))
        parts.append(np.pad(picture, gaps, constant_values=WHITE))
    column = titled(title, np.vstack(parts))
    return np.pad(column, ((0, 0), (0, _GAP_PX), (0, 0)), constant_values=WHITE)


def titled(title: str, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Put a line of text above a picture."""
    line = np.full((_TITLE_HEIGHT_PX, picture.shape[1], 3), WHITE, np.uint8)
    where = (2, _TITLE_HEIGHT_PX - 6)
    cv2.putText(line, title, where, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([line, picture])


def enlarged(picture: NDArray[np.uint8], times: int) -> NDArray[np.uint8]:
    """Return a picture with every pixel as a square: what rings can be seen, nothing is made up."""
    return np.repeat(np.repeat(picture, times, axis=0), times, axis=1)


def of_width(picture: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """Return a picture made smaller or larger to a width."""
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def as_rgb(image: NDArray[np.floating], gamma: Any = 1.0) -> NDArray[np.uint8]:
    """Return intensities [rows, columns] or [rows, columns, 3], 0 to 1, as 8-bit RGB."""
    pixels = np.asarray(pixels_from_linear(image, 8, gamma), np.uint8)
    return np.dstack([pixels] * 3) if pixels.ndim == 2 else pixels
