"""Foreground fattening at occluding edges, as of windows in stereo, and how it is undone."""

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.likelihood import LikelihoodModel

# Surfaces whose blur sizes differ by more than this, within a window, are not one slant.
DEPTH_EDGE_PX = 2.3


# A map of levels and its scale, map pixels per frame pixel, to the corrected map.
EdgeCorrection = Callable[[FloatArray, float], FloatArray]


def edge_correction(model: LikelihoodModel, strength: float, workers: Workers) -> EdgeCorrection:
    """Return what takes the foreground fattening of a model's windows back.

    `strength` is the width that is taken off foregrounds, as a share of a Hann window. Where the
    model has levels in front of the focal plane nothing changes: there the nearer surface is the
    more blurred one, and which of two a window takes is another matter.
    """
    sizes = model.stack.blur_sizes_px
    if (sizes < 0).any() or not model.stack.in_pixels:
        return lambda level, scale: level
    steps = np.diff(sizes)
    behind = float(np.sign(steps[0]))
    share = min(model.fattening * strength, 1.0)
    jump_levels = DEPTH_EDGE_PX / float(np.abs(steps).mean())

    def correct(level: FloatArray, scale: float) -> FloatArray:
        window_px = model.window_px * scale
        speck_px = 2 * round(window_px / 4) - 1  # odd: centred on its pixel
        reach_px = round(share * window_px)
        level = level if behind > 0 else -level
        # In two halves, each with as much of the other as matters to it.
        middle, beyond_px = len(level) // 2, 2 * reach_px + max(speck_px, 0)
        upper, lower = workers.both(
            *(
                partial(slimmed_foreground, part, reach_px, speck_px, jump_levels)
                for part in (level[: middle + beyond_px], level[max(middle - beyond_px, 0) :])
            )
        )
        slimmed = np.concatenate([upper[:middle], lower[middle - len(level) :]])
        return slimmed if behind > 0 else -slimmed

    return correct


def slimmed_foreground(
    level: FloatArray, reach_px: int, speck_px: int, jump_levels: float
) -> FloatArray:
    """Undo foreground fattening: make foregrounds slimmer that windows have made too wide.

    A window that sees a sharper and a more blurred surface takes the level of the sharper, whose
    high frequencies the other's level forbids, even where it covers little of the window. So beyond
    the focal plane every foreground is too wide by a known share of the window: the level map is,
    nearly, the true one after a morphological erosion. The dilation that belongs to it restores the
    edge. It is applied only where levels jump; slants stay as they are. A foreground narrower than
    what would be taken off stays as wide as it was found: an obstacle must not vanish.

    Larger levels, float32 [rows, columns], are more blurred, and behind. Foregrounds are too wide
    by `reach_px` on each side, in pixels of the map; backgrounds narrower than `speck_px` do not
    push a foreground back, as they may be outliers; `jump_levels` make a depth edge.
    """
    if reach_px < 1:
        return level
    reach = np.ones((2 * reach_px + 1,) * 2, np.uint8)
    # By OpenCV's copies, which are several times as fast as a choice by NumPy.
    background, slimmed = level.copy(), level.copy()
    if speck_px > 1:
        opened = cv2.morphologyEx(level, cv2.MORPH_OPEN, np.ones((speck_px, speck_px), np.uint8))
        cv2.copyTo(opened, (level - opened > jump_levels).view(np.uint8), background)
    behind = cv2.dilate(background, reach)
    thin = cv2.erode(behind, reach, dst=background) - level > jump_levels
    far = (behind - level > jump_levels) & ~thin
    return np.asarray(cv2.copyTo(behind, far.view(np.uint8), slimmed))
