"""What the closed form makes of a frame if a pixel has its own blur, or that of what is beside."""

from functools import lru_cache

import cv2
import numpy as np
import scipy.fft

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.inverse_basis import MODEL_ERRORS, InverseBasis
from coded_aperture_ros.imaging import periodic, periodic_shape
from coded_aperture_ros.optics import PsfStack

# Of the closed forms: whose blur size is taken (see `sizes_of`), and the model error that bounds
# their gain. The frame itself is one more hypothesis: that nothing is gained by changing it.
OWN, NEARER, FARTHER, MORE = range(4)
_TAKEN = ((OWN, 0), (OWN, 2), (NEARER, 1), (FARTHER, 1), (MORE, 1))
HYPOTHESES = len(_TAKEN) + 1
# How far around a pixel the nearest and the farthest surface are looked for: about as far as light
# of the largest blur comes from.
_BESIDE_PX = 9
# How much larger a blur size is tried: what it changes tells how to correct an error of the depth.
_MORE_PX = 0.8
_STEPS_PER_LEVEL = 8
_EXTENSION_PX = 32
# There is a basis for each of these noises; the nearest one is used.
_NOISES = (0.001, 0.003, 0.01, 0.03)


def sizes_of(blur: FloatArray) -> list[FloatArray]:
    """Return blur sizes of a map by `OWN`, `NEARER`, `FARTHER` and `MORE`, signed, px."""
    beside = np.ones((2 * _BESIDE_PX + 1,) * 2, np.uint8)
    more = blur + np.where(blur < 0, np.float32(-_MORE_PX), np.float32(_MORE_PX))
    return [blur, cv2.erode(blur, beside), cv2.dilate(blur, beside), more]


class Hypotheses:
    """The closed forms of a camera. Its filters are in `InverseBasis`."""

    def __init__(self, stack: PsfStack, rank: int, workers: Workers) -> None:
        self._stack, self._workers, self._rank = stack, workers, rank
        self._extension_px = max(_EXTENSION_PX, stack.psfs.shape[-1] - 1)
        self._order = np.argsort(stack.blur_sizes_px)
        self._basis = lru_cache(maxsize=len(_NOISES))(
            lambda noise: InverseBasis.learn(stack, noise, rank)
        )
        self._transforms = lru_cache(maxsize=len(_NOISES))(
            lambda noise, shape: self._basis(noise).transforms(shape)
        )
        self._table = lru_cache(maxsize=32)(self._new_table)

    def prepare(self, shape: tuple[int, int]) -> None:
        """Compute beforehand what the first frame of `shape` (rows, columns) would wait for."""
        for noise in _NOISES[:-1]:
            self._transforms(noise, periodic_shape(shape, self._extension_px))

    def steps(self, blur: FloatArray) -> IndexArray:
        """Return the rows of the table for `sizes_of` a signed map [4, rows, columns]."""
        sizes = self._stack.blur_sizes_px[self._order]
        at = np.arange(len(sizes)) * _STEPS_PER_LEVEL
        steps = [np.interp(each, sizes, at) for each in sizes_of(blur)]
        return np.rint(steps).astype(np.uint16)

    def of(self, channel: FloatArray, steps: IndexArray, noise: float) -> FloatArray:
        """Return the hypotheses [HYPOTHESES, rows, columns] of a channel; the last is itself."""
        basis_noise = min(_NOISES, key=lambda known: abs(np.log(known / noise)))
        shape = periodic_shape(channel.shape, self._extension_px)
        transforms = self._transforms(basis_noise, shape)
        table = self._table(basis_noise, round(10 * np.log10(noise)))
        spectrum = scipy.fft.rfft2(periodic(channel, shape), workers=self._workers.threads)
        height, width = channel.shape
        filtered = np.empty((len(transforms), height, width), np.float32)

        def filter_by(kernel: int, _: int) -> None:
            whole = scipy.fft.irfft2(spectrum * transforms[kernel], shape, overwrite_x=True)
            filtered[kernel] = whole[:height, :width]

        self._workers.each(filter_by, range(len(transforms)))
        found = np.empty((HYPOTHESES, height, width), np.float32)
        found[-1] = channel
        bands = np.array_split(np.arange(height), self._workers.threads)

        def combine(band: int, _: int) -> None:
            rows = slice(int(bands[band][0]), int(bands[band][-1]) + 1)
            combined(filtered[:, rows], steps[:, rows], table, _WHICH, found[:-1, rows])

        self._workers.each(combine, range(len(bands)))
        return found

    def _new_table(self, basis_noise: float, tenths: int) -> FloatArray:
        """Coefficients [steps, model errors, R], interpolated between levels."""
        table = self._basis(basis_noise).coefficients(_errors(), 10 ** (tenths / 10))[self._order]
        at = np.arange(_STEPS_PER_LEVEL * (len(table) - 1) + 1) / _STEPS_PER_LEVEL
        lower = np.minimum(at.astype(np.intp), len(table) - 2)
        above = (at - lower).astype(np.float32)[:, None, None]
        return np.ascontiguousarray(table[lower] * (1 - above) + table[lower + 1] * above)


def _errors() -> DoubleArray:
    return np.array([MODEL_ERRORS[0], 0.11, 0.2])


_WHICH = np.array(_TAKEN, np.int64)


def _loop(
    filtered: FloatArray, steps: IndexArray, table: FloatArray, which: IndexArray, found: FloatArray
) -> None:
    rank, rows, columns = filtered.shape
    for y in range(rows):
        for h in range(len(which)):
            of, error = which[h, 0], which[h, 1]
            for x in range(columns):
                found[h, y, x] = 0
            for r in range(rank):
                for x in range(columns):
                    found[h, y, x] += table[steps[of, y, x], error, r] * filtered[r, y, x]


def _plain(
    filtered: FloatArray, steps: IndexArray, table: FloatArray, which: IndexArray, found: FloatArray
) -> None:
    for h, (of, error) in enumerate(which):
        weights = table[:, error].T
        found[h] = sum(np.take(w, steps[of]) * f for w, f in zip(weights, filtered, strict=True))


# From kernels' pictures [R, rows, columns], steps [4, rows, columns], a table [steps, errors, R]
# and `_TAKEN` to hypotheses, which it writes to.
combined = Compiled(_loop, _plain)
