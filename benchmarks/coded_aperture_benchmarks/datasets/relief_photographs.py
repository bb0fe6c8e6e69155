"""Photographs with measured disparity, as scenes that are put into a range."""

from pathlib import Path

import cv2
import numpy as np

from coded_aperture_ros.design.relief import SUPERSAMPLING, ReliefScene
from coded_aperture_ros.io import read_image

_LARGEST_PX = (448, 368)
# Disparities beyond these quantiles are cut off: few pixels would shrink the relief of all others.
_ENDS = (0.01, 0.99)


def folders_in(folder: Path) -> list[Path]:
    """Folders with `sharp_srgb.png` and `disparity.npz`."""
    return sorted(path.parent for path in folder.glob("*/disparity.npz"))


def photographed_scene(folder: Path, largest_px: tuple[int, int] = _LARGEST_PX) -> ReliefScene:
    """Middle of a photograph with measured disparity; places go with the disparity.

    Each pixel of the photograph is one of the frame.
    """
    picture = read_image(folder / "sharp_srgb.png", "srgb").mean(axis=2)
    with np.load(folder / "disparity.npz") as stored:
        disparity = stored["disparity"].astype(np.float32)
    height, width = disparity.shape
    top, left = max(0, height - largest_px[1]) // 2, max(0, width - largest_px[0]) // 2
    cut = slice(top, top + largest_px[1]), slice(left, left + largest_px[0])
    low, high = np.nanquantile(disparity[cut], _ENDS)
    place = 1 - np.clip((disparity[cut] - low) / (high - low), 0, 1)
    size = SUPERSAMPLING * place.shape[1], SUPERSAMPLING * place.shape[0]
    samples = cv2.resize(picture[cut], size, interpolation=cv2.INTER_CUBIC)
    return ReliefScene(
        np.clip(samples, 0, 1).astype(np.float32),
        cv2.resize(place.astype(np.float32), size, interpolation=cv2.INTER_NEAREST),
    )
