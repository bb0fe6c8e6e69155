"""Blended picture of a frame and its blur sizes."""

import numpy as np

from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.arrays import BoolArray, FloatArray, filters, namespace
from coded_aperture_ros.core.networks import network_of
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.blend.features import (
    CELL_PX,
    cell_maps,
    mean_and_contrast,
    pack_cells,
    unpack_cells,
)
from coded_aperture_ros.deblur.blend.hypotheses import (
    HYPOTHESES,
    InverseHypotheses,
    hypothesis_blur_sizes,
)
from coded_aperture_ros.deblur.inverse_filters import COLOUR_NOISE, OpponentFilters
from coded_aperture_ros.optics import PsfStack

WEIGHTS = "blend.npz"
SCHEMA = "coded-aperture deblurring network"
SCHEMA_VERSION = 1
# How far colours are averaged, px, and how much they may differ: 0.1 to 0.6 dB of the colours.
_FRINGE_PX = 5
_SAME_COLOUR = 0.06
_PIXELS = CELL_PX**2


# The most noise that it has seen, standard deviation; what asks for more is left to the filters.
_MAX_TRAINED_NOISE = 0.005
# Blur of which the network has seen pictures.
_MAX_TRAINED_BLUR_PX = 22.0


def unsupported_reason(stack: PsfStack) -> str:
    """Why PSFs are not such as the network was trained for; empty if they are."""
    if not stack.in_pixels:
        return "the blur sizes of its PSFs are not known in pixels"
    # To rounding: sizes are often the sums of steps.
    largest = round(float(np.abs(stack.blur_sizes_px).max()), 6)
    return f"its blur of {largest:.3g} px is above {_MAX_TRAINED_BLUR_PX:g} px" * (
        largest > _MAX_TRAINED_BLUR_PX
    )


class Blend(OpponentFilters[InverseHypotheses]):
    """Weighted sum of the hypotheses of each pixel, with a correction by the network.

    Not for several threads at once.
    """

    def __init__(self, stack: PsfStack, rank: int, workers: Workers, runtime: str) -> None:
        super().__init__(InverseHypotheses, stack, rank, workers)
        arrays = read_shipped(__file__, WEIGHTS, SCHEMA, SCHEMA_VERSION)
        self._network = network_of(arrays, "blend", runtime, workers.threads)

    def restore(
        self,
        channels: list[FloatArray],
        blur: FloatArray,
        known: BoolArray,
        noise: float,
        smoothness: float = 1.0,
    ) -> list[FloatArray]:
        """Deblurred `opponents` of a frame.

        `blur` has the signed blur size of each pixel [rows, columns], and `known` where it was
        measured. Closed forms and network allow for noise whose variance is `smoothness` times as
        large.
        """
        if not any(np.ptp(channel) for channel in channels):
            return channels  # nothing to divide by, and nothing to deblur
        return self._blended(channels, blur, known, noise, noise * float(np.sqrt(smoothness)))

    def _blended(
        self,
        channels: list[FloatArray],
        blur: FloatArray,
        known: BoolArray,
        noise: float,
        allowed: float,
    ) -> list[FloatArray]:
        """Deblurred `opponents`, for arrays and tensors."""
        xp, shape = namespace(blur), (blur.shape[0], blur.shape[1])
        sizes = hypothesis_blur_sizes(blur)
        steps = xp.stack([self._brightness.table_steps(each) for each in sizes])
        cells = pack_cells(self._brightness.compute(channels[0], steps, allowed))
        mean, scale = mean_and_contrast(cells[-_PIXELS:], noise)
        seen = min(allowed, max(noise, _MAX_TRAINED_NOISE))
        maps = cell_maps(sizes, known, scale, seen)
        shown = xp.concatenate([(cells - mean) / scale, maps])
        (output,) = self._network({"shown": shown[None]})
        output = output.reshape(HYPOTHESES + 1, _PIXELS, *scale.shape)
        weights = output[:-1]
        weights += (1 - weights.sum(axis=0)) / HYPOTHESES
        restored = [unpack_cells(_weighted_sum(cells, weights) + output[-1] * scale, shape)]
        for channel in channels[1:]:
            hypotheses = self._colour.compute(channel, steps, COLOUR_NOISE * allowed)
            restored.append(unpack_cells(_weighted_sum(pack_cells(hypotheses), weights), shape))
        return _suppress_fringes(restored) if len(restored) > 1 else restored


def _suppress_fringes(channels: list[FloatArray]) -> list[FloatArray]:
    """Brightness, and colour differences that are equal where brightness is."""
    image = namespace(channels[0]).stack(channels, -1)
    smooth = filters(image).bilateralFilter(image, _FRINGE_PX, _SAME_COLOUR, _FRINGE_PX / 2)
    return [channels[0], smooth[..., 1], smooth[..., 2]]


def _weighted_sum(cells: FloatArray, weights: FloatArray) -> FloatArray:
    xp = namespace(cells)
    weighted: FloatArray = xp.einsum("kprc,kprc->prc", cells.reshape(weights.shape), weights)
    return weighted
