"""Defocus, direction and length of motion on textured planes: thesis table 7.1."""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from coded_aperture_benchmarks.thesis.stair import area_psf_stack, crops_generator, with_noise
from coded_aperture_ros.depth.upsample import MapGrid
from coded_aperture_ros.design.fragmentation import (
    BLUR_SIZES_PX,
    DIRECTIONS,
    LENGTHS,
    LEVELS,
    Fragmentation,
    analyse_fragmentation,
    table_motions,
)
from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.frames.noise import NOISE_FLOOR
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank
from coded_aperture_ros.likelihood.motion import MotionConfig, blurred_psf, learn_motion_bank
from coded_aperture_ros.likelihood.motion.engine import MotionEngine
from coded_aperture_ros.optics import Mask, PsfStack

# Size of the images, numbers of levels, directions and lengths of thesis 7.6.1.
SIDE_PX = 70
# Holes in a grid, and the noise levels that the masks are the best for (thesis 7.4, figure 7.2).
GRID, HOLES = 3, 3
_RANGES = {"A": (0.01, 0.04), "B": (0.05, 0.08), "C": (0.09, 0.10)}
_STRIDE_PX = 8
# Mean error and accuracy of defocus, direction and length.
TABLE_7_1 = {
    "disc": ((2.53, 0.135), (0.22, 0.888), (1.48, 0.272)),
    "A": ((0.41, 0.808), (0.15, 0.940), (1.48, 0.310)),
    "B": ((0.63, 0.773), (0.24, 0.895), (1.53, 0.308)),
    "C": ((0.35, 0.850), (0.11, 0.950), (1.39, 0.332)),
}


@dataclasses.dataclass(frozen=True)
class Identification:
    """How well one parameter is identified.

    Attributes
    ----------
    mean_error : float
        In levels, directions (of 22.5 degrees) or lengths; over all pixels.
    accuracy : float
        Share of the pixels with the right one.
    """

    mean_error: float
    accuracy: float


def table_masks() -> tuple[dict[str, Mask], Fragmentation]:
    """Return the masks of the table, by name, and the analysis that three of them are from.

    A, B and C preserve most frequencies at low, middle and high noise. Where one placement is the
    best for two ranges, the second of them gets its next best.
    """
    analysis = analyse_fragmentation(GRID, HOLES, BLUR_SIZES_PX, table_motions())
    noise = np.array(analysis.noise_levels)
    masks = {"disc": analysis.disc}
    for name, (lowest, highest) in _RANGES.items():
        chosen = (noise > lowest - 1e-9) & (noise < highest + 1e-9)
        order = np.argsort(-analysis.preserved[:, chosen].sum(axis=1), kind="stable")
        taken = list(masks.values())
        masks[name] = next(
            analysis.masks[index] for index in order if analysis.masks[index] not in taken
        )
    return masks, analysis


def identify_motions(
    mask: Mask,
    textures: Textures,
    sigma: float,
    window_px: int = 48,
    config: MotionConfig | None = None,
    seed: int = 0,
) -> dict[str, Identification]:
    """Identify defocus and motion of images, one for every level and motion (thesis 7.6.1).

    Every window is judged by itself, all motions being alike; each pixel has the result of the
    nearest. The noise is known.

    Parameters
    ----------
    textures : Textures
        Random texture is the same in all images, as in the thesis; else each has its own crop.
    sigma : float
        Noise behind an open aperture; divided by the mask's open fraction.
    window_px : int, optional
        Side of the bank's patches.
    config : MotionConfig, optional
        Its rank and finalists are what frames are worked on with, by default. A rank of as many as
        there are frequencies, or more, is exact.
    seed : int, optional
        Of crops and noise.

    Returns
    -------
    dict
        `defocus`, `direction` and `length`.
    """
    motions, stack = table_motions(), area_psf_stack(mask, BLUR_SIZES_PX)
    engine = _engine(stack, window_px, config or MotionConfig())
    reach = (stack.psfs.shape[-1] + int(np.ceil(motions.longest_px))) // 2 + 1
    whole = SIDE_PX + 2 * reach
    random, random_texture = crops_generator(seed), textures.kind == "random"
    crop = textures.crops(1, whole, whole, random)[0]
    shape = (SIDE_PX, SIDE_PX)
    nearest = np.ix_(*MapGrid.for_map(engine.grid, shape, shape).patches)
    errors: dict[str, list[NDArray[np.intp]]] = {}
    for level, psf in enumerate(stack.psfs):
        for motion, vector in enumerate(motions.vectors_px):
            if not random_texture:
                crop = textures.crops(1, whole, whole, random)[0]
            blurred = fftconvolve(crop, blurred_psf(psf, (vector[0], vector[1])), mode="same")
            coded = blurred[reach : reach + SIDE_PX, reach : reach + SIDE_PX]
            coded, noise = with_noise(coded, mask, sigma, seed + level * len(motions) + motion)
            engine.project(coded)
            energies = engine.all_energies(max(noise, NOISE_FLOOR))
            best = energies.reshape(-1, *energies.shape[2:]).argmin(axis=0)[nearest]
            for name, off in _errors(best, level, motion).items():
                errors.setdefault(name, []).append(off)
    return {
        name: Identification(float(np.mean(values)), float(np.mean(np.array(values) == 0)))
        for name, values in errors.items()
    }


def _engine(stack: PsfStack, window_px: int, config: MotionConfig) -> MotionEngine:
    """Return what compares all motions of the table on frames of its size."""
    static = learn_bank(stack, LearnConfig(window_px=window_px, rank=1))
    return MotionEngine(
        learn_motion_bank(static, table_motions(), config.motion_rank),
        (SIDE_PX, SIDE_PX),
        _STRIDE_PX,
        finalists=config.finalists,
    )


def _errors(best: NDArray[np.intp], level: int, motion: int) -> dict[str, NDArray[np.intp]]:
    """Return how far off the best hypotheses are, in levels, directions and lengths."""
    found_motion, found_level = np.divmod(best, LEVELS)
    turn = np.abs(found_motion // LENGTHS - motion // LENGTHS)
    return {
        "defocus": np.abs(found_level - level),
        "direction": np.minimum(turn, DIRECTIONS - turn),
        "length": np.abs(found_motion % LENGTHS - motion % LENGTHS),
    }
