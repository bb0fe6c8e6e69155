#!/usr/bin/env python3
"""Draw docs/images/first_steps.jpg: coded frame, depth and all-in-focus picture of the sample.

    python scripts/draw_first_steps.py SAMPLE [OUTPUT]

SAMPLE is the folder of `coded_aperture sample` after steps 3 to 5 of docs/start.md. Needs the
folder `benchmarks` on the path (make puts it there).
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from coded_aperture_benchmarks.pictures import side_by_side

_WIDTH_PX = 400
_PICTURE_QUALITY = 80
_PANELS = {
    "coded frame": "coded.picture.png",
    "depth (hatched: unknown)": "depth.picture.png",
    "all in focus": "all_in_focus.picture.png",
}


def main() -> None:
    """Write the picture."""
    sample = Path(sys.argv[1])
    output = sys.argv[2] if len(sys.argv) > 2 else "docs/images/first_steps.jpg"
    columns = []
    for title, name in _PANELS.items():
        picture = cv2.imread(str(sample / name))
        if picture is None:
            raise SystemExit(f"{sample / name}: no picture; run steps 3 to 5 of docs/start.md")
        scale = _WIDTH_PX / picture.shape[1]
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        columns.append((title, [small[..., ::-1]]))
    height = max(len(pictures[0]) for _, pictures in columns)  # depth has a colour bar below
    for _, pictures in columns:
        pictures[0] = np.pad(
            pictures[0], ((0, height - len(pictures[0])), (0, 0), (0, 0)), constant_values=255
        )
    picture = side_by_side(columns)
    cv2.imwrite(output, picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _PICTURE_QUALITY])


if __name__ == "__main__":
    main()
