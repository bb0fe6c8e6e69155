"""Closed forms of a frame for a pixel's own blur size, and for those of its neighbours."""

import numpy as np
import scipy.fft

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, filters, namespace
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.deblur.inverse_basis import MODEL_ERRORS
from coded_aperture_ros.deblur.inverse_filters import InverseFilters
from coded_aperture_ros.frames import extend_periodically, periodic_shape

# Of the closed forms: whose blur size is taken (see `hypothesis_blur_sizes`), and which model error
# bounds their gain. The frame itself is one more: that nothing is gained by changing it.
OWN, NEARER, FARTHER, LARGER = range(4)
HYPOTHESIS_PAIRS = np.array(((OWN, 0), (OWN, 2), (NEARER, 1), (FARTHER, 1), (LARGER, 1)))
HYPOTHESES = len(HYPOTHESIS_PAIRS) + 1
# How far around a pixel the nearest and the farthest surface are looked for: about as far as light
# of the largest blur comes from.
_NEIGHBOURHOOD_PX = 9
# Increment of the larger blur size, px: its effect shows how to correct an error of the depth.
_INCREMENT_PX = 0.8


def hypothesis_blur_sizes(blur: FloatArray) -> list[FloatArray]:
    """Blur sizes of a map by `OWN`, `NEARER`, `FARTHER` and `LARGER`, signed, px."""
    beside = np.ones((2 * _NEIGHBOURHOOD_PX + 1,) * 2, np.uint8)
    cv, increment = filters(blur), namespace(blur).ones_like(blur) * _INCREMENT_PX
    more = blur + namespace(blur).where(blur < 0, -increment, increment)
    return [blur, cv.erode(blur, beside), cv.dilate(blur, beside), more]


class InverseHypotheses(InverseFilters):
    """`InverseFilters` of a camera, combined for several blur sizes at each pixel."""

    reduction = 1
    model_errors = np.array([MODEL_ERRORS[0], 0.11, 0.2])
    steps_per_error = 1

    def compute(self, channel: FloatArray, steps: IndexArray, noise: float) -> FloatArray:
        """Hypotheses [HYPOTHESES, rows, columns] of a channel; the last is itself.

        `steps` are the `table_steps` of `hypothesis_blur_sizes` [4, rows, columns].
        """
        rows, columns = channel.shape
        shape = periodic_shape(channel.shape, self._extension_px)
        transforms, lookup = self._filters(channel.shape, noise)
        table = np.ascontiguousarray(lookup.T).reshape(-1, len(self.model_errors), len(lookup))
        spectrum = scipy.fft.rfft2(
            extend_periodically(channel, shape), workers=self._workers.threads
        )
        filtered = np.empty((len(transforms), rows, columns), np.float32)

        def filter_by(kernel: int, _: int) -> None:
            whole = scipy.fft.irfft2(spectrum * transforms[kernel], shape, overwrite_x=True)
            filtered[kernel] = whole[:rows, :columns]

        self._workers.each(filter_by, range(len(transforms)))
        found = np.empty((HYPOTHESES, rows, columns), np.float32)
        found[-1] = channel

        def combine(top: int, _: int) -> None:
            band = slice(top, top + _BAND_ROWS)
            # All kernels of a pixel side by side, as all are needed at once.
            pixel_kernels = np.ascontiguousarray(np.moveaxis(filtered[:, band], 0, -1))
            combine_hypotheses(
                pixel_kernels, steps[:, band], table, HYPOTHESIS_PAIRS, found[:-1, band]
            )

        self._workers.each(combine, range(0, rows, _BAND_ROWS))
        return found


# Rows that a thread works on at once.
_BAND_ROWS = 64


def _loop(
    filtered: FloatArray, steps: IndexArray, table: FloatArray, taken: IndexArray, found: FloatArray
) -> None:
    rows, columns, rank = filtered.shape
    for y in range(rows):
        for h in range(len(taken)):
            of = taken[h, 0]
            error = taken[h, 1]
            for x in range(columns):
                weights = table[steps[of, y, x], error]
                kernels = filtered[y, x]
                total = np.float32(0)
                for r in range(rank):
                    total += weights[r] * kernels[r]
                found[h, y, x] = total


def _plain(
    filtered: FloatArray, steps: IndexArray, table: FloatArray, taken: IndexArray, found: FloatArray
) -> None:
    for h, (of, error) in enumerate(taken):
        np.einsum("yxr,yxr->yx", table[steps[of], error], filtered, out=found[h])


# From kernels' pictures [rows, columns, R], steps [4, rows, columns], a table [steps, errors, R]
# and `HYPOTHESIS_PAIRS` to hypotheses, which it writes to.
combine_hypotheses = Compiled(_loop, _plain)
