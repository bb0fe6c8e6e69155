#!/usr/bin/env python3
"""Draw docs/images/masks.png: the masks with names, white where they are open.

    python scripts/draw_masks.py [OUTPUT]

Needs the folder `benchmarks` on the path (make puts it there).
"""

import sys

import cv2
import numpy as np
from coded_aperture_benchmarks.pictures import side_by_side

from coded_aperture_ros.optics import MASK_NAMES, Mask

_SIDE_PX = 132
_GAP_PX = 10
_COLUMNS = 6


def main() -> None:
    """Write the picture."""
    output = sys.argv[1] if len(sys.argv) > 1 else "docs/images/masks.png"
    columns = [(name, [drawn(Mask.named(name))]) for name in MASK_NAMES]
    columns += [("", [np.full_like(columns[0][1][0], 255)])] * (-len(columns) % _COLUMNS)
    rows = [columns[start : start + _COLUMNS] for start in range(0, len(columns), _COLUMNS)]
    picture = np.vstack([side_by_side(row) for row in rows])
    cv2.imwrite(output, picture[..., ::-1])


def drawn(mask: Mask) -> np.ndarray:
    """Picture of a mask in a black frame, uint8 [row, column, 3]."""
    grey = np.rint(255 * mask.transmission).astype(np.uint8)
    large = cv2.resize(grey, (_SIDE_PX, _SIDE_PX), interpolation=cv2.INTER_NEAREST)
    framed = cv2.copyMakeBorder(large, *[_GAP_PX] * 4, cv2.BORDER_CONSTANT, value=0)
    return np.repeat(framed[..., None], 3, 2)


if __name__ == "__main__":
    main()
