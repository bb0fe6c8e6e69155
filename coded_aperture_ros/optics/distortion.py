"""Distortion models of lenses under the names that programs give them, and the rays of pixels."""

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.polynomial import Polynomial

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError

# Numbers of coefficients that each distortion model of ROS may have.
COEFFICIENT_COUNTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}
_POLYNOMIAL_COUNTS = (4, 5, 8, 12, 14)
# Names of other programs, in small letters and without what separates words. OpenCV has one model
# for the first two, and goes by the number of coefficients.
_OTHER_NAMES = {
    "plumbbob": "plumb_bob",
    "radtan": "plumb_bob",
    "radialtangential": "plumb_bob",
    "brownconrady": "plumb_bob",
    "modifiedbrownconrady": "plumb_bob",
    "opencv": "plumb_bob",
    "pinhole": "plumb_bob",
    "rationalpolynomial": "rational_polynomial",
    "rational": "rational_polynomial",
    "thinprism": "rational_polynomial",
    "equidistant": "equidistant",
    "equi": "equidistant",
    "fisheye": "equidistant",
    "pinholeequi": "equidistant",
    "opencvfisheye": "equidistant",
    "kannalabrandt": "equidistant",
    "kannalabrandt4": "equidistant",
    "kb4": "equidistant",
}
# For undistortion: the five iterations of OpenCV's default leave errors of pixels.
_UNDISTORT_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-7)
# A ray counts if the lens sends it back to its pixel, to this many pixels.
_ROUND_TRIP_PX = 0.1
_NEGLIGIBLE = 1e-12


def distortion_model(name: str, coefficients: Sequence[float]) -> str:
    """Name of ROS for a distortion model.

    Parameters
    ----------
    name : str
        As ROS, OpenCV, Kalibr, COLMAP and drivers of cameras write it; capitals and what separates
        words do not matter.
    coefficients : sequence of float
        D. Without any, or with zeros only under a name that is not known, there is no distortion.

    Returns
    -------
    {"plumb_bob", "rational_polynomial", "equidistant"}

    Raises
    ------
    InputError
        If the name is not known, says nothing, or has another number of coefficients.

    Examples
    --------
    >>> distortion_model("Kannala_Brandt4", [0.1, 0.02, 0.0, 0.0])
    'equidistant'
    """
    known = _OTHER_NAMES.get("".join(filter(str.isalnum, name.lower())))
    count = len(coefficients)
    if count == 0 or (known is None and not any(coefficients)):
        return known or "plumb_bob"
    if known is None and not name and count > 4:  # with 4 it may be a fisheye lens
        known = "plumb_bob"
    if known is None and not name:
        raise InputError(
            f"distortion_model: it is empty, and {count} coefficients may be of several models: "
            f"say which, {', '.join(COEFFICIENT_COUNTS)}"
        )
    if known is None:
        raise InputError(
            f"distortion_model: {name!r} is not known, use one of {', '.join(COEFFICIENT_COUNTS)}"
        )
    if known != "equidistant":
        known = "plumb_bob" if count in COEFFICIENT_COUNTS["plumb_bob"] else "rational_polynomial"
    allowed = COEFFICIENT_COUNTS[known] if known == "equidistant" else _POLYNOMIAL_COUNTS
    if count not in allowed:
        raise InputError(
            f"distortion_coefficients: {name or known} has {' or '.join(map(str, allowed))} "
            f"numbers, got {count}"
        )
    return known


@lru_cache(maxsize=4)
def pixel_rays(
    model: str, k: tuple[float, ...], d: tuple[float, ...], rows: int, columns: int
) -> FloatArray:
    """Ray slopes x / z and y / z of the pixels, without distortion.

    Parameters
    ----------
    model : str
        Distortion model; see `distortion_model`.
    k : tuple of 9 float
        Camera matrix K of a `sensor_msgs/CameraInfo`, row by row.
    d : tuple of float
        Distortion coefficients D.
    rows, columns : int

    Returns
    -------
    ndarray, float32 [rows, columns, 2]
        NaN for a pixel without a ray: one that the lens model reaches from nowhere, or only behind
        where it folds back.

    Raises
    ------
    InputError
        If the model or its number of coefficients is not known.

    Examples
    --------
    >>> k = (400.0, 0.0, 319.5, 0.0, 400.0, 239.5, 0.0, 0.0, 1.0)
    >>> [round(float(slope), 3) for slope in pixel_rays("plumb_bob", k, (), 480, 640)[0, 0]]
    [-0.799, -0.599]
    """
    kind = distortion_model(model, d)
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(np.float64)
    plain = (pixels - [k[2], k[5]]) / [k[0], k[4]]
    if not len(d) or (kind != "equidistant" and not any(d)):
        return plain.astype(np.float32)
    undistorted = _fisheye_rays if kind == "equidistant" else _polynomial_rays
    slopes = undistorted(plain.reshape(-1, 2), np.array(d, np.float64), (k[0], k[4]))
    return slopes.reshape(pixels.shape).astype(np.float32)


def _fisheye_rays(
    distorted: DoubleArray, d: DoubleArray, focal_px: tuple[float, float]
) -> DoubleArray:
    """Slopes [n, 2] of rays whose distorted slopes are given, through an equidistant lens.

    ``theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8)``, with theta the angle to the axis.
    """
    angle_d = np.linalg.norm(distorted, axis=1)
    scale = Polynomial([1.0, *d])
    fold = _smallest_root(Polynomial([1.0, *(d * [3, 5, 7, 9])]))
    farthest = min(np.sqrt(fold), np.pi / 2)
    angles = np.linspace(0.0, farthest, 2000)[:-1]
    angle = np.interp(angle_d, angles * scale(angles**2), angles, right=np.nan)
    for _ in range(5):  # Newton's, from what is right to a thousandth of the field
        value, slope = angle * scale(angle**2) - angle_d, _fisheye_slope(angle, d)
        angle = angle - value / slope
    off = np.abs(angle * scale(angle**2) - angle_d) * max(focal_px)
    valid = (angle < farthest) & (off < _ROUND_TRIP_PX)
    ratio = np.where(angle_d > 0, np.tan(angle) / np.where(angle_d > 0, angle_d, 1), 1.0)
    return np.where(valid[:, None], distorted * ratio[:, None], np.nan)


def _fisheye_slope(angle: DoubleArray, d: DoubleArray) -> DoubleArray:
    return np.asarray(Polynomial([1.0, *(d * [3, 5, 7, 9])])(angle**2))


def _polynomial_rays(
    distorted: DoubleArray, d: DoubleArray, focal_px: tuple[float, float]
) -> DoubleArray:
    """The same through a lens of `plumb_bob` or `rational_polynomial`."""
    matrix = np.eye(3)
    scaled = np.diag([*focal_px, 1.0])
    slopes = cv2.undistortImagePoints(
        distorted.reshape(-1, 1, 2), matrix, d, None, _UNDISTORT_CRITERIA
    ).reshape(-1, 2)
    finite = np.nan_to_num(slopes, posinf=0.0, neginf=0.0)
    points = np.column_stack([finite, np.ones(len(finite))]).reshape(-1, 1, 3)
    back = cv2.projectPoints(points, np.zeros(3), np.zeros(3), scaled, d)[0].reshape(-1, 2)
    off = np.linalg.norm(back - distorted * focal_px, axis=1)
    valid = (off < _ROUND_TRIP_PX) & (np.sum(finite**2, axis=1) < _fold(d))
    return np.where(valid[:, None], slopes, np.nan)


def _fold(d: DoubleArray) -> float:
    """Square of the slope where the radial distortion ``r A(r^2) / B(r^2)`` turns back."""
    k = np.zeros(8)
    k[: min(len(d), 8)] = d[:8]
    above = Polynomial([1.0, k[0], k[1], k[4]])
    below = Polynomial([1.0, k[5], k[6], k[7]])
    square = Polynomial([0.0, 1.0])
    rises = (above + 2 * square * above.deriv()) * below - 2 * square * above * below.deriv()
    return min(_smallest_root(rises), _smallest_root(below))


def _smallest_root(polynomial: Polynomial) -> float:
    """Smallest positive real root; infinity if there is none."""
    # Smaller ones fold nothing, and their roots would overflow.
    roots = np.asarray(polynomial.trim(_NEGLIGIBLE).roots(), np.complex128)
    real = roots.real[np.abs(roots.imag) < 1e-9 * np.maximum(np.abs(roots), 1e-12)]
    return float(min(real[real > 0], default=np.inf))
