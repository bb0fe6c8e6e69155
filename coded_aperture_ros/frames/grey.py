"""Grey image of a camera frame, with unusable pixels filled in."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, filters, namespace
from coded_aperture_ros.core.errors import InputError

# Lower values are no measurement: black is 0, but for noise.
_MIN_LIGHT = -1.0
# Square around an unusable pixel that it is filled from, px.
_FILL_WINDOW_PX = (15, 15)


def check_frame(frame: NDArray[np.floating]) -> None:
    """Check that an array is a frame.

    Parameters
    ----------
    frame : ndarray, float [rows, columns] or [rows, columns, 3]

    Raises
    ------
    InputError
        If its shape or type is another one.

    Examples
    --------
    >>> check_frame(np.zeros((48, 64), np.float32))
    """
    if frame.ndim not in (2, 3) or (frame.ndim == 3 and frame.shape[2] != 3) or 0 in frame.shape:
        raise InputError(
            f"frame: expected [rows, columns] or [rows, columns, 3], got {list(frame.shape)}"
        )
    if "float" not in str(frame.dtype):
        raise InputError(f"frame: expected floating values in [0, 1], got {frame.dtype}")


def channel_mean(frame: NDArray[np.floating]) -> FloatArray:
    """Mean of the channels, float32 [rows, columns]; a grey frame itself.

    Examples
    --------
    >>> channel_mean(np.float32([[[0.0, 0.25, 0.5]]])).tolist()
    [[0.25]]
    """
    xp = namespace(frame)
    if xp is not np and frame.ndim == 3:
        return frame.mean(-1)
    frame = xp.asarray(xp.ascontiguousarray(frame), dtype=xp.float32)
    return frame if frame.ndim == 2 else cv2.transform(frame, np.full((1, 3), 1 / 3, np.float32))


def grey_image(frame: FloatArray, saturation: float) -> tuple[FloatArray, BoolArray | None]:
    """Mean of the channels, and the mask of its unusable pixels, which are filled in.

    Unusable are NaN, infinite, saturated and far too dark pixels; each is filled with the mean of
    the usable ones around it.

    Parameters
    ----------
    frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
        Linear light in [0, 1].
    saturation : float
        A pixel is saturated if any channel is not below this.

    Returns
    -------
    grey : ndarray, float32 [rows, columns]
    unusable : ndarray, bool [rows, columns], or None
        None if every pixel is usable.

    Raises
    ------
    InputError
        If the frame has another shape or is not of a floating type.

    Examples
    --------
    >>> grey, unusable = grey_image(np.float32([[0.25, 0.5, 1.0]]), saturation=0.98)
    >>> grey.tolist(), unusable.tolist()
    ([[0.25, 0.5, 0.375]], [[False, False, True]])
    """
    check_frame(frame)
    xp = namespace(frame)
    frame = xp.asarray(xp.ascontiguousarray(frame), dtype=xp.float32)
    grey = channel_mean(frame)
    with np.errstate(invalid="ignore"):  # NaN fails both comparisons
        if (frame.max() < saturation) & (grey.min() > _MIN_LIGHT):  # waits for a device
            return grey, None
    brightest = grey
    if frame.ndim == 3:
        brightest = xp.maximum(xp.maximum(frame[..., 0], frame[..., 1]), frame[..., 2])
    usable = brightest < saturation
    usable &= grey > _MIN_LIGHT
    return fill_unusable(grey, usable), ~usable


def resampled(image: FloatArray, scale: float) -> FloatArray:
    """Image enlarged by a factor, float32; a reduced one has means of pixels.

    Raises
    ------
    InputError
        If not a single pixel is left.

    Examples
    --------
    >>> resampled(np.zeros((48, 64), np.float32), 0.5).shape
    (24, 32)
    """
    height, width = (round(scale * length) for length in image.shape[:2])
    if min(height, width) < 1:
        raise InputError(f"frame scale {scale:g}: nothing is left of {image.shape[:2]} pixels")
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, (width, height), interpolation=interpolation), np.float32)


def fill_unusable(image: FloatArray, usable: BoolArray) -> FloatArray:
    """Grey image whose unusable pixels have the mean of the usable ones around them.

    Examples
    --------
    >>> fill_unusable(np.float32([[0.25, 9.0]]), np.array([[True, False]])).tolist()
    [[0.25, 0.25]]
    """
    xp, cv = namespace(image), filters(image)
    known: FloatArray = xp.where(usable, image, 0)
    weight = xp.asarray(usable, dtype=xp.float32)
    overall = known.sum() / xp.maximum(weight.sum(), 1)
    # Borders of zero weight: pixels beyond the frame are unusable too.
    total, count = (
        cv.boxFilter(values, -1, _FILL_WINDOW_PX, normalize=False, borderType=cv.BORDER_CONSTANT)
        for values in (known, weight)
    )
    # A device is not asked where they are.
    holes = np.nonzero(~usable) if xp is np else ...
    total, count = total[holes], count[holes]
    around = xp.where(count > 0.5, total / xp.maximum(count, 1), overall)
    known[holes] = around if xp is np else xp.where(usable, known, around)
    return known
