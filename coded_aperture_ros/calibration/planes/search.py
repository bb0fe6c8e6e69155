"""Search for the mask and the focus that explain pictures of planes, coarse to fine."""

import dataclasses
import logging
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.mask.cells import retrieve_masks
from coded_aperture_ros.calibration.mask.fit import MaskFit, normalised, random_parts
from coded_aperture_ros.calibration.mask.likelihood import MaskLikelihood
from coded_aperture_ros.calibration.mask.sizes import LensSizes
from coded_aperture_ros.calibration.mask.spectra import window_powers
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.bank import LearnedPattern, WindowedFourierBasis
from coded_aperture_ros.optics import Mask

# Masks are sought up to this part of the window: a wider blur leaves too few independent
# frequencies in it.
_MAX_EXTENT_SHARE = 0.5
_COARSE_CELL_PX = 2.0
_FINE_CELL_PX = 1.0
_COARSE_PARTS = 2
_FINE_PARTS = 3
_FIRST_STEPS = 12
_COARSE_STEPS = 18
_FINE_STEPS = 100
_FINE_ROUNDS = 3
_LEFT_OUT_STEPS = 50
# Of the first guesses so many are worth more than the first steps.
_N_REFINED = 3
_NEAREST_TO_FOCUS = (0.03, 0.15, 0.35, 0.6)
# The best of the masks from phase retrieval are worth some steps each.
_CANDIDATES = 4
_SINGLE_STEPS = 60

_logger = logging.getLogger(__name__)

LensFit = MaskFit[LensSizes]


class MaskSearch:
    """Search for masks that explain pictures of planes.

    The window has to be twice as wide as the largest blur, or wider. `progress` wraps the
    iterations over the steps.
    """

    def __init__(self, planes: Planes, window_px: int, progress: Progress = iter) -> None:
        fourier = WindowedFourierBasis(window_px)
        self.inverse_depths = 1 / planes.depths_m
        powers = [window_powers(image, fourier) for image in planes.images]
        self.likelihood = MaskLikelihood(powers, fourier, _MAX_EXTENT_SHARE * window_px)
        self.progress = progress

    def mixture(self) -> LensFit:
        """Likeliest mask, as a mixture, and focus.

        Coarse masks first, from several focus distances on both sides of the planes; the likelier
        ones go on, and the likeliest is refined.
        """
        starts = [(sign, ratio) for sign in (1, -1) for ratio in _NEAREST_TO_FOCUS]
        coarse: list[LensFit] = []
        best: LensFit | None = None
        for step in self.progress([*starts, *range(_FINE_ROUNDS)]):
            if isinstance(step, tuple):
                start = self.start(_COARSE_PARTS, _COARSE_CELL_PX, *step)
                coarse.append(start.optimise(self.likelihood, _FIRST_STEPS))
                continue
            if best is None:
                # The finer masks start afresh: the coarse ones' cells would stay visible.
                found = self._most_promising(coarse).sizes
                best = self.start(_FINE_PARTS, _FINE_CELL_PX, found.sign, found.near_ratio)
            best = best.optimise(self.likelihood, _FINE_STEPS)
        return self._most_promising(coarse) if best is None else best

    def _most_promising(self, coarse: list[LensFit]) -> LensFit:
        coarse = sorted(coarse, key=lambda fit: fit.score)[:_N_REFINED]
        further = [fit.optimise(self.likelihood, _COARSE_STEPS) for fit in coarse]
        return min(further, key=lambda fit: fit.score)

    def start(self, parts: int, cell_px: float, sign: int, near_ratio: float) -> LensFit:
        """First estimate: random masks."""
        extent_px = self.likelihood.widest_px
        return MaskFit(
            random_parts(parts, round(extent_px / cell_px)),
            LensSizes(near_ratio, sign, extent_px, self.inverse_depths),
            self.likelihood.first_log_noise,
        )

    def without(self, left_out: Collection[int], mixture: LensFit) -> LensFit:
        """Likeliest mask, as a mixture, and focus by the planes that are not left out.

        Random masks to start from: the cells of the `mixture` of all planes are theirs, too.
        """
        kept = [plane for plane in range(len(mixture.sizes_px)) if plane not in left_out]
        sizes_px = mixture.sizes_px[kept]
        extent_px = float(sizes_px.max())
        start = MaskFit(
            random_parts(_FINE_PARTS, round(extent_px / _FINE_CELL_PX)),
            LensSizes(
                float(sizes_px.min()) / extent_px,
                mixture.sizes.sign,
                extent_px,
                mixture.sizes.inverse_depths[kept],
            ),
            mixture.log_noise[kept],
        )
        return start.optimise(self.likelihood.of_planes(kept), _LEFT_OUT_STEPS)

    def single(self, mixture: LensFit) -> tuple[Mask, float]:
        """Likeliest single mask near a mixture, and its extent at the most blurred plane, px.

        The mask is cropped to where it is open. Logs a warning if it fills the grid: then the blur
        may be wider than that.
        """
        candidates = [
            dataclasses.replace(mixture, parts=normalised(mask[None])).optimise(
                self.likelihood, _SINGLE_STEPS
            )
            for mask in self.progress(retrieve_masks(mixture.parts, _CANDIDATES))
        ]
        opening = _cropped(min(candidates, key=lambda candidate: candidate.score).parts[0])
        cells = mixture.parts.shape[-1]
        if len(opening) == cells:
            _logger.warning(
                "the blur reaches %.0f px, half the window of %.0f px, or more: depths are more "
                "trustworthy with a larger window_px",
                *(mixture.sizes.extent_px, mixture.sizes.extent_px / _MAX_EXTENT_SHARE),
            )
        extent_px = mixture.sizes.extent_px * len(opening) / cells
        return Mask("learned from planes", opening / opening.max()), extent_px


def learned_pattern(fit: LensFit, mask: Mask, extent_px: float, image_width: int) -> LearnedPattern:
    """Mask, of an extent at the most blurred plane, with the lens of a fit."""
    scale = extent_px / fit.sizes.extent_px
    lens = fit.sizes.lens
    return LearnedPattern(
        slope_px_m=lens.slope_px_m * scale,
        inverse_focus=lens.inverse_focus,
        mask=mask,
        parts=fit.parts,
        parts_extent=1 / scale,
        image_width=image_width,
    )


def _cropped(mask: NDArray) -> NDArray:
    """Square around the rows and columns with more than a fifth of the brightest."""
    profiles = mask.sum(axis=1), mask.sum(axis=0)
    rows, columns = (np.flatnonzero(each > 0.2 * each.max()) for each in profiles)
    inside = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    side = max(inside.shape)
    return np.pad(inside, [((side - n) // 2, (side - n + 1) // 2) for n in inside.shape])
