"""The search for the mask and the focus that explain pictures of planes, coarse to fine."""

import dataclasses
import logging
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.calibration.mask.fit import MaskFit, normalised
from coded_aperture_ros.calibration.mask.likelihood import MaskLikelihood
from coded_aperture_ros.calibration.mask.phase_retrieval import retrieved_masks
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.calibration.planes.spectra import plane_spectra
from coded_aperture_ros.optics import Mask

# Masks are sought up to this part of the window: a wider blur leaves too few independent
# frequencies in it.
_WIDEST = 0.5
_COARSE_CELL_PX, _FINE_CELL_PX = 2.0, 1.0
_COARSE_PARTS, _FINE_PARTS = 2, 3
_FIRST_STEPS, _COARSE_STEPS, _FINE_STEPS, _FINE_ROUNDS = 12, 18, 100, 3
# Of the first guesses so many are worth more than the first steps.
_PROMISING = 3
_NEAREST_TO_FOCUS = (0.03, 0.15, 0.35, 0.6)
# The best of the masks from phase retrieval are worth some steps each.
_CANDIDATES, _SINGLE_STEPS = 4, 60

_logger = logging.getLogger(__name__)

Progress = Callable[[Iterable[Any]], Iterable[Any]]


class MaskSearch:
    """Finds masks for pictures of planes.

    Parameters
    ----------
    planes : Planes
    window_px : int
        Twice as wide as the largest blur, or wider.
    progress : callable, optional
        Wraps the iterations over the steps.

    Raises
    ------
    InputError
        See `plane_spectra`.
    """

    def __init__(self, planes: Planes, window_px: int, progress: Progress = iter) -> None:
        fourier = WindowedFourierBasis(window_px)
        self.inverse_depths = 1 / planes.depths_m
        self.likelihood = MaskLikelihood(
            plane_spectra(planes, fourier), fourier, _WIDEST * window_px
        )
        self.progress = progress

    def mixture(self) -> MaskFit:
        """Find the mask (as a mixture) and the focus under which the planes are likeliest.

        Coarse masks first, from several focus distances on both sides of the planes; the
        likelier ones go on, and the likeliest is refined.
        """
        starts = [(sign, ratio) for sign in (1, -1) for ratio in _NEAREST_TO_FOCUS]
        coarse: list[MaskFit] = []
        best: MaskFit | None = None
        for step in self.progress([*starts, *range(_FINE_ROUNDS)]):
            if isinstance(step, tuple):
                start = self.start(_COARSE_PARTS, _COARSE_CELL_PX, *step)
                coarse.append(start.climb(self.likelihood, _FIRST_STEPS))
            elif best is None:
                # The finer masks start afresh: the coarse ones' cells would stay visible.
                found = self._most_promising(coarse)
                best = self.start(_FINE_PARTS, _FINE_CELL_PX, found.sign, found.near_ratio)
                best = best.climb(self.likelihood, _FINE_STEPS)
            else:
                best = best.climb(self.likelihood, _FINE_STEPS)
        return self._most_promising(coarse) if best is None else best

    def _most_promising(self, coarse: list[MaskFit]) -> MaskFit:
        coarse = sorted(coarse, key=lambda fit: fit.score)[:_PROMISING]
        further = [fit.climb(self.likelihood, _COARSE_STEPS) for fit in coarse]
        return min(further, key=lambda fit: fit.score)

    def start(self, parts: int, cell_px: float, sign: int, near_ratio: float) -> MaskFit:
        """Return a first guess: random masks."""
        extent_px = self.likelihood.widest_px
        return MaskFit(
            parts=normalised(_blobs(parts, round(extent_px / cell_px))),
            near_ratio=near_ratio,
            sign=sign,
            extent_px=extent_px,
            inverse_depths=self.inverse_depths,
            log_noise=self.likelihood.first_log_noise,
            score=np.inf,
        )

    def single(self, mixture: MaskFit) -> tuple[Mask, float]:
        """Find one mask instead of a mixture: the likeliest of several that come close to it.

        Logs a warning if it fills the grid: then the blur may be wider than that.

        Returns
        -------
        mask : Mask
            Cropped to where it is open.
        extent_px : float
            Its extent at the most blurred plane.
        """
        candidates = [
            dataclasses.replace(mixture, parts=normalised(mask[None])).climb(
                self.likelihood, _SINGLE_STEPS
            )
            for mask in self.progress(retrieved_masks(mixture.parts, _CANDIDATES))
        ]
        opening = _cropped(min(candidates, key=lambda candidate: candidate.score).parts[0])
        cells = mixture.parts.shape[-1]
        if len(opening) == cells:
            _logger.warning(
                "the blur reaches %.0f px, half the window of %.0f px, or more: depths are more "
                "trustworthy with a larger window_px",
                *(mixture.extent_px, mixture.extent_px / _WIDEST),
            )
        extent_px = mixture.extent_px * len(opening) / cells
        return Mask("learned from planes", opening / opening.max()), extent_px


def _blobs(count: int, cells: int) -> NDArray[np.float64]:
    """Return random masks, brightest in their middle [count, cells, cells]."""
    x = (np.arange(cells) + 0.5) / cells - 0.5
    blob = np.exp(-(x[:, None] ** 2 + x**2) / (2 * 0.3**2))
    return blob * np.random.default_rng(0).uniform(size=(count, cells, cells)) ** 2


def _cropped(mask: NDArray[np.float64], darkest: float = 0.2) -> NDArray[np.float64]:
    """Crop to the square around the rows and columns with more than `darkest` of the brightest."""
    ranges = []
    for axis in (0, 1):
        profile = mask.sum(axis=axis)
        light = np.flatnonzero(profile > darkest * profile.max())
        ranges.append((light[0], light[-1] + 1))
    (left, right), (top, bottom) = ranges
    side = max(right - left, bottom - top)
    square = np.zeros((side, side))
    above, before = (side - (bottom - top)) // 2, (side - (right - left)) // 2
    inside = mask[top:bottom, left:right]
    square[above : above + inside.shape[0], before : before + inside.shape[1]] = inside
    return square
