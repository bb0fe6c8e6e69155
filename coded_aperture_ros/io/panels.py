"""Pictures side by side with titles."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

_TITLE_HEIGHT = 28
_GAP = 6
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_FONT_SCALE = 0.5
_WHITE = 255


def panels(rows: Sequence[Sequence[tuple[str, NDArray[np.uint8]]]]) -> NDArray[np.uint8]:
    """One picture, uint8 [h, w, 3], of rows of titled pictures.

    Every row has the same number of pictures, uint8 [h, w, 3]; smaller ones get a white border.
    """
    shapes = np.array([picture.shape[:2] for row in rows for _, picture in row])
    height, width = shapes.max(axis=0)
    return np.vstack([np.hstack([_titled(*one, height, width) for one in row]) for row in rows])


def _titled(title: str, picture: NDArray[np.uint8], height: int, width: int) -> NDArray[np.uint8]:
    whole = np.full((_TITLE_HEIGHT + height + _GAP, width + _GAP, 3), _WHITE, np.uint8)
    rows, columns = picture.shape[:2]
    whole[_TITLE_HEIGHT : _TITLE_HEIGHT + rows, :columns] = picture
    cv2.putText(whole, title, (4, 19), _FONT, _FONT_SCALE, (0, 0, 0), 1, cv2.LINE_AA)
    return whole
