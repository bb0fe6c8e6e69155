"""Masks drawn at random, and sharp patches with the seams of a stair, to test predictions on."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.design.search.grids import SYMMETRIES, random_grids
from coded_aperture_ros.optics import Mask


def random_masks(count: int, seed: int) -> list[Mask]:
    """Draw masks of 7 to 13 cells, with openings of 1 to 3 cells, with and without symmetry.

    Those of one seed begin with those of a smaller count.
    """
    random = np.random.default_rng(seed)
    masks = []
    for number in range(count):
        cells, opening = int(random.integers(7, 14)), int(random.integers(1, 4))
        symmetry = SYMMETRIES[random.integers(0, 2)]
        (grid,) = random_grids(1, cells, opening, symmetry, random)
        masks.append(Mask(f"random_{number}", grid.astype(np.float32)))
    return masks


def patches_of_columns(
    textures: Textures, count: int, side_px: int, step_px: int, seed: int = 0
) -> NDArray[np.float32]:
    """Cut patches as a stair has them: crops above each other, with seams where they meet.

    Parameters
    ----------
    side_px : int
        Side of the patches; see `coded_aperture_ros.design.scores.pictures.patch_side_px`.
    step_px : int
        Rows of a crop.

    Returns
    -------
    ndarray, float32 [count, side_px, side_px]
        The middle of a patch lies anywhere in a crop, from its first to its last row.
    """
    random = np.random.default_rng(seed)
    # So many that a patch fits in wherever in the first whole step it begins.
    steps = 1 + -(-side_px // step_px)
    patches = np.empty((count, side_px, side_px), np.float32)
    for start in range(0, count, 64):  # no more memory than needed
        here = patches[start : start + 64]
        crops = textures.crops(len(here) * steps, step_px, side_px, random)
        columns = crops.reshape(len(here), steps * step_px, side_px)
        tops = random.integers(step_px, size=len(here))
        for patch, column, top in zip(here, columns, tops, strict=True):
            patch[:] = column[top : top + side_px]
    return patches
