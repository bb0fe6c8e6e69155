"""Engine on NumPy: every array is allocated when a frame size is planned, none per frame."""

import dataclasses
from functools import partial

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, PerPatch, as_floats
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.likelihood.plan import PatchGroup, Plan
from coded_aperture_ros.likelihood.scoring import MIN_NOISE_SHARE, take_logarithm
from coded_aperture_ros.likelihood.sliding import SlidingTransform

# Rows of pixels that are transformed at a time, and patches whose hypotheses are compared: few
# large calls, but no more than a core's cache holds.
_PIXEL_ROWS = 24
_PATCHES = 128
# Patches that are projected at a time.
_PROJECTED = 512


@dataclasses.dataclass(frozen=True, eq=False)
class _Scratch:
    """Buffers of one thread."""

    windows: FloatArray
    patches: FloatArray
    hypotheses: FloatArray
    energies: FloatArray


class NumpyEngine:
    """Energies of every patch of frames of one size; an `Engine`.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.likelihood import Plan
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("disc"), [3.0, 5.0, 7.0]))
    >>> engine = NumpyEngine(Plan.for_frames(bank, (64, 64), stride_px=8))
    >>> engine.project(np.random.default_rng(0).random((64, 64), np.float32))
    >>> engine.energies(noise=0.01).shape
    (3, 3, 3)
    """

    name = "numpy"

    def __init__(self, plan: Plan, threads: int = 1) -> None:
        self.plan = plan
        self.grid = grid = plan.grid
        self._workers = Workers(threads)
        self._sliding = SlidingTransform(plan, threads)
        self._functions = np.empty((len(plan.features), grid.rows, grid.columns), np.float32)
        self._energies = np.zeros((plan.levels, grid.rows * grid.columns), np.float32)
        self._precision = np.empty((grid.rows, grid.columns), np.float32)
        # Products without a weight are left out.
        has_weight = np.arange(len(plan.horizontal) // 2) < plan.horizontal_counts[:, None]
        self._features = np.ascontiguousarray(plan.features[:, has_weight.ravel()])
        self._patch_groups = list(plan.patch_groups(_PATCHES))
        compared = len(plan.hypotheses) // len(plan.ratios) * len(plan.contrasts)
        rank = plan.hypotheses.shape[1]
        self._scratch = [
            _Scratch(
                windows=self._sliding.new_buffer(_PIXEL_ROWS),
                patches=np.empty(rank * _PATCHES, np.float32),
                hypotheses=np.empty(compared * _PATCHES, np.float32),
                energies=np.empty(plan.levels * _PATCHES, np.float32),
            )
            for _ in range(threads)
        ]

    def project(self, grey: FloatArray) -> None:
        """Take a frame [rows, columns]: project every patch onto the common basis."""
        pixels = as_floats(self.plan.crop(grey))
        starts = range(0, self.plan.pixel_rows, _PIXEL_ROWS)
        self._workers.each(partial(self._transform_rows, pixels), starts)
        self._workers.each(self._sliding.slide_down, self._sliding.frequencies)
        self._workers.each(self._project, range(0, self._precision.size, _PROJECTED))

    def energies(self, noise: PerPatch) -> FloatArray:
        """Energies of the last projected frame [rows, columns, L]; see `Engine`."""
        plan = self.plan
        compared = plan.plausible_ratios(noise)
        self._precision[:] = 1 / (plan.count * np.square(noise))
        functions = self._functions.reshape(len(self._functions), -1)
        self._workers.each(partial(self._compare, functions, compared), self._patch_groups)
        return np.moveaxis(self._energies.reshape(plan.levels, *self._precision.shape), 0, -1)

    def close(self) -> None:
        """Stop the engine's threads."""
        self._workers.close()

    def _transform_rows(self, pixels: FloatArray, start: int, thread: int) -> None:
        """Transform the windows of some pixel rows horizontally."""
        some = pixels[start : start + _PIXEL_ROWS]
        self._sliding.transform_rows(some, start, self._scratch[thread].windows)

    def _project(self, start: int, _: int) -> None:
        """Project the products of some patches onto the common basis."""
        some = slice(start, start + _PROJECTED)
        products, functions = (
            array.reshape(len(array), -1)[:, some]
            for array in (self._sliding.products, self._functions)
        )
        np.matmul(self._features, products, out=functions)

    def _compare(
        self, functions: FloatArray, compared: slice, group: PatchGroup, thread: int
    ) -> None:
        """Compute the energies of a group of patches; see `FilterBank`."""
        plan, scratch, indices = self.plan, self._scratch[thread], group.indices
        precision = self._precision.reshape(-1)[indices]
        hypotheses = group.hypotheses[compared]
        levels, size, count = *hypotheses.shape[2:], len(precision)
        patches = scratch.patches[: size * count].reshape(-1, count)
        np.multiply(functions[:-1, indices], precision, out=patches[:-1])
        patches[-1] = 1
        excess = scratch.hypotheses[: hypotheses.size // size * count].reshape(-1, count)
        np.matmul(hypotheses.reshape(-1, size), patches, out=excess)
        energies = scratch.energies[: levels * count].reshape(-1, count)
        np.minimum.reduce(excess.reshape(-1, *energies.shape), axis=0, out=energies)
        take_logarithm(energies, functions[-1, indices] * precision + MIN_NOISE_SHARE, plan.count)
        self._energies[group.levels, indices] = energies
