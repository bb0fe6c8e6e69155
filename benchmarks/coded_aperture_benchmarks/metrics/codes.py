"""Reads AprilTags and QR codes, and how far away a tag is."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.datasets.tag_cards import QR, TAG, Card
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import Gamma, pixels_from_linear
from coded_aperture_ros.optics import Camera

# A code whose middle is farther off is another one.
_LARGEST_OFF_PX = 10.0


@dataclasses.dataclass(frozen=True, eq=False)
class Code:
    """A code that was read.

    Attributes
    ----------
    kind, says : str
        As of `Card`.
    corners_px : ndarray, float64 [4, 2]
        Right and down, in turn from its upper left.
    """

    kind: str
    says: str
    corners_px: DoubleArray


class CodeReader:
    """Tags by OpenCV, QR codes by zxing-cpp.

    `gamma` encodes frames before they are read. Without it, in the middle of an edge between
    black and white light is half of both: that is where readers look for it.
    """

    def __init__(self, gamma: Gamma = 1.0) -> None:
        self._gamma, self._zxing, aruco = gamma, _zxing(), _aruco()
        dictionary = aruco.getPredefinedDictionary(aruco.DICT_APRILTAG_36h11)
        self._ways = []
        # The first way has exact corners, the second one finds more where there is noise. The
        # first counts from the corner of the first pixel, not from its middle.
        for refinement, begins in (
            (aruco.CORNER_REFINE_APRILTAG, 0.5),
            (aruco.CORNER_REFINE_SUBPIX, 0.0),
        ):
            parameters = aruco.DetectorParameters()
            parameters.cornerRefinementMethod = refinement
            self._ways.append((aruco.ArucoDetector(dictionary, parameters), begins))

    @staticmethod
    def check() -> None:
        """Refuse to begin without the libraries."""
        _aruco()
        _zxing()

    def read(self, frame: FloatArray) -> list[Code]:
        """Return what is read of a frame [rows, columns], linear light.

        A tag that is found in two ways is there twice, the one with the better corners first.
        """
        pixels = np.asarray(pixels_from_linear(frame, 8, self._gamma), np.uint8)
        codes = [code for way in self._ways for code in _tags(*way, pixels)]
        bars = self._zxing.read_barcodes(pixels, formats=self._zxing.BarcodeFormat.QRCode)
        return codes + [Code(QR, bar.text, _corners(bar.position)) for bar in bars if bar.valid]


def code_of(card: Card, codes: Sequence[Code]) -> Code | None:
    """Return the code that was read of a card; None if it says something else, or elsewhere."""
    for code in codes:
        off_px = np.hypot(*(code.corners_px.mean(axis=0) - card.middle_px))
        if (code.kind, code.says) == (card.kind, card.says) and off_px < _LARGEST_OFF_PX:
            return code
    return None


def distance_error(card: Card, code: Code, camera: Camera) -> float:
    """Return by what part of its distance a tag of known size is taken for nearer or farther."""
    side_m = card.side_px * card.distance_m / camera.focal_length_px
    # In the order that OpenCV asks for, y upwards.
    plane = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * side_m / 2
    matrix = np.reshape(camera.intrinsics.camera_matrix, (3, 3))
    _, _, place = cv2.solvePnP(plane, code.corners_px, matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    return abs(float(place[2, 0]) / card.distance_m - 1)


def _tags(detector: Any, begins: float, pixels: NDArray[np.uint8]) -> list[Code]:
    corners, numbers, _ = detector.detectMarkers(pixels)
    return [
        Code(TAG, str(number), np.reshape(each, (4, 2)).astype(np.float64) - begins)
        for each, number in zip(corners, np.ravel(numbers if corners else []), strict=True)
    ]


def _corners(position: Any) -> DoubleArray:
    names = ("top_left", "top_right", "bottom_right", "bottom_left")
    points = [getattr(position, name) for name in names]
    return np.array([(point.x, point.y) for point in points], float)


def _aruco() -> Any:
    aruco = getattr(cv2, "aruco", None)
    if not hasattr(aruco, "ArucoDetector"):
        raise InputError("tags need OpenCV 4.7 or newer: pip install 'opencv-python-headless>=4.7'")
    return aruco


def _zxing() -> Any:
    try:
        import zxingcpp
    except (ImportError, OSError) as error:
        raise InputError(f"QR codes need zxing-cpp: pip install zxing-cpp ({error})") from error
    return zxingcpp
