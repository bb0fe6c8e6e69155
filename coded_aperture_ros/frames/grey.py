"""From a camera frame to the grey image that the filter bank sees."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.core.errors import InputError

# Black is near 0, but for noise; what is as dark as this is no measurement.
_DARKEST = -1.0
# An unusable pixel is filled from a square of this size around it.
_FILL_FROM = (15, 15)


def check_frame(frame: NDArray[np.floating]) -> None:
    """Raise `InputError` if an array cannot be a frame.

    A frame is [rows, columns] or [rows, columns, 3], and of a floating type.
    """
    if frame.ndim not in (2, 3) or (frame.ndim == 3 and frame.shape[2] != 3) or frame.size == 0:
        raise InputError(
            f"frame: expected [rows, columns] or [rows, columns, 3], got {list(frame.shape)}"
        )
    if not np.issubdtype(frame.dtype, np.floating):
        raise InputError(f"frame: expected floating values in [0, 1], got {frame.dtype}")


def channel_mean(frame: NDArray[np.floating]) -> FloatArray:
    """Return the mean of the channels, float32 [rows, columns]; of a grey frame, itself."""
    frame = np.ascontiguousarray(frame, np.float32)
    return frame if frame.ndim == 2 else cv2.transform(frame, np.full((1, 3), 1 / 3, np.float32))


def grey_image(frame: FloatArray, saturation: float) -> tuple[FloatArray, BoolArray | None]:
    """Return the mean of the channels, with unusable pixels filled in, and where those are.

    The frame, float32 [rows, columns] or [rows, columns, 3], is linear light in [0, 1]. NaN,
    infinite, saturated and far too dark pixels are unusable, saturated ones where any channel is as
    bright as `saturation`. In the result each has the mean of the usable ones around it. The second
    result, bool [rows, columns], is None if every pixel is usable. Raises `InputError` if the frame
    has another shape or is not of a floating type.
    """
    check_frame(frame)
    frame = np.ascontiguousarray(frame, np.float32)
    grey = channel_mean(frame)
    with np.errstate(invalid="ignore"):  # NaN fails both comparisons
        if frame.max() < saturation and grey.min() > _DARKEST:
            return grey, None
    brightest = grey
    if frame.ndim == 3:
        brightest = np.maximum(np.maximum(frame[..., 0], frame[..., 1]), frame[..., 2])
    usable = brightest < saturation
    usable &= grey > _DARKEST
    return fill_unusable(grey, usable), ~usable


def resampled(image: FloatArray, scale: float) -> FloatArray:
    """Return an image enlarged by `scale`; smaller ones are means of pixels.

    Raises `InputError` if next to nothing would be left of it.
    """
    height, width = (round(scale * length) for length in image.shape[:2])
    if min(height, width) < 1:
        raise InputError(f"frame scale {scale:g}: nothing is left of {image.shape[:2]} pixels")
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, (width, height), interpolation=way), np.float32)


def fill_unusable(image: FloatArray, usable: BoolArray) -> FloatArray:
    """Return a grey image whose unusable pixels have the mean of the usable ones around them."""
    known = image.copy()
    known[~usable] = 0
    weight = usable.astype(np.float32)
    overall = known.sum() / max(weight.sum(), 1)
    # Borders of zero weight: pixels beyond the frame are unusable too.
    total, count = (
        cv2.boxFilter(values, -1, _FILL_FROM, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for values in (known, weight)
    )
    holes = np.nonzero(~usable)
    total, count = total[holes], count[holes]
    known[holes] = np.where(count > 0.5, total / np.maximum(count, 1), overall)
    return known
