"""Correction of foreground fattening at occluding edges, as of windows in stereo."""

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.likelihood import LikelihoodModel

# Blur size, px: surfaces that differ by more within a window are separated by a depth edge.
DEPTH_EDGE_PX = 2.3

# From a map of levels and its scale (map pixels per frame pixel) to the corrected map.
EdgeCorrection = Callable[[FloatArray, float], FloatArray]


def edge_correction(model: LikelihoodModel, strength: float, workers: Workers) -> EdgeCorrection:
    """Function that undoes the foreground fattening of a model's windows.

    `strength` is the width that foregrounds lose, as a share of a Hann window. The function changes
    nothing if the model has levels in front of the focal plane: there the nearer surface is the
    more blurred one, and windows do not always take its level.
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
        # Two halves in parallel, each with the margin of the other that the filters reach.
        middle, beyond_px = len(level) // 2, 2 * reach_px + max(speck_px, 0)
        upper, lower = workers.both(
            *(
                partial(erode_foreground, part, reach_px, speck_px, jump_levels)
                for part in (level[: middle + beyond_px], level[max(middle - beyond_px, 0) :])
            )
        )
        corrected = np.concatenate([upper[:middle], lower[middle - len(level) :]])
        return corrected if behind > 0 else -corrected

    return correct


def erode_foreground(
    level: FloatArray, reach_px: int, speck_px: int, jump_levels: float
) -> FloatArray:
    """Level map [rows, columns] with foregrounds made narrower by what windows widened them.

    A window that sees a sharper and a more blurred surface takes the level of the sharper, whose
    high frequencies contradict the other's level, even where it covers little of the window. So
    beyond the focal plane every foreground is too wide by a known share of the window: the level
    map is, nearly, the true one after a morphological erosion. The matching dilation restores the
    edge. It is applied only where levels jump; slants stay as they are. A foreground narrower than
    the correction keeps its width: an obstacle must not vanish.

    Parameters
    ----------
    level : ndarray, float32 [rows, columns]
        Larger levels are more blurred, and behind.
    reach_px : int
        Width by which foregrounds are too wide on each side, pixels of the map.
    speck_px : int
        Backgrounds narrower than this do not narrow a foreground: they may be outliers.
    jump_levels : float
        Difference of levels that is a depth edge.
    """
    if reach_px < 1:
        return level
    reach = np.ones((2 * reach_px + 1,) * 2, np.uint8)
    # OpenCV's masked copies are several times as fast as `np.where`.
    background, corrected = level.copy(), level.copy()
    if speck_px > 1:
        opened = cv2.morphologyEx(level, cv2.MORPH_OPEN, np.ones((speck_px, speck_px), np.uint8))
        cv2.copyTo(opened, (level - opened > jump_levels).view(np.uint8), background)
    behind = cv2.dilate(background, reach)
    thin = cv2.erode(behind, reach, dst=background) - level > jump_levels
    far = (behind - level > jump_levels) & ~thin
    return np.asarray(cv2.copyTo(behind, far.view(np.uint8), corrected))
