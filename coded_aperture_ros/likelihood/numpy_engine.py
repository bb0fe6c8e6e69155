"""Engine on NumPy: every array is allocated when a frame size is planned, none per frame."""

import dataclasses
from functools import partial

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, PerPatch
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.likelihood.plan import Plan
from coded_aperture_ros.likelihood.scoring import MIN_NOISE_SHARE, take_logarithm

# Rows of pixels that are transformed at a time, and patches whose hypotheses are compared: few
# large calls, but no more than a core's cache holds.
_PIXEL_ROWS = 24
_PATCHES = 128


def _by_loop(parts: FloatArray, paired: int, counts: IndexArray, products: FloatArray) -> None:
    half = parts.shape[1] // 2
    at = 0
    for v in range(paired):
        for i in range(counts[v]):
            cc, cs = parts[v, i], parts[v, half + i]
            sc, ss = parts[paired + v, i], parts[paired + v, half + i]
            products[at + i] = cc * cc + cs * cs + sc * sc + ss * ss
        at += counts[v]
    for v in range(paired):
        for i in range(counts[paired + v]):
            cc, cs = parts[v, i], parts[v, half + i]
            sc, ss = parts[paired + v, i], parts[paired + v, half + i]
            products[at + i] = cc * ss - cs * sc
        at += counts[paired + v]
    for v in range(2 * paired, len(parts)):
        for i in range(counts[v]):
            cc, cs = parts[v, i], parts[v, half + i]
            products[at + i] = cc * cc + cs * cs
        at += counts[v]


def _by_arrays(parts: FloatArray, paired: int, counts: IndexArray, products: FloatArray) -> None:
    half = parts.shape[1] // 2
    cosines, sines = parts[:paired], parts[paired : 2 * paired]
    crossed = cosines[:, :half] * sines[:, half:]
    crossed -= cosines[:, half:] * sines[:, :half]
    power = parts * parts
    power = power[:, :half] + power[:, half:]
    power[:paired] += power[paired : 2 * paired]
    power[paired : 2 * paired] = crossed
    np.compress((np.arange(half) < counts[:, None]).ravel(), power, out=products)


# Products of the transforms, see `plan`: from the cosine and sine parts of the sums over y, those
# of the sums over x side by side, `parts` [2 V + U, 2 n], to q and x of 1 to V cycles and the power
# of those without a sine. Of each the first `counts` [2 V + U] are written one after the other.
products_of_transforms = Compiled(_by_loop, _by_arrays)


@dataclasses.dataclass(frozen=True, eq=False)
class _Scratch:
    """Buffers of one thread."""

    windows: FloatArray
    parts: FloatArray
    power: FloatArray
    functions: FloatArray
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
        grid, n = plan.grid, plan.grid.window_px
        self.plan = plan
        self.grid = grid
        self._workers = Workers(threads)
        width = len(plan.horizontal) * grid.columns  # both parts of all frequencies and columns
        self._horizontal = np.empty((plan.pixel_rows, width), np.float32)
        self._functions = np.empty((len(plan.features), grid.rows, grid.columns), np.float32)
        self._energies = np.empty((plan.levels, grid.rows * grid.columns), np.float32)
        self._precision = np.empty((grid.rows, grid.columns), np.float32)
        # Products without a weight are left out.
        has_weight = np.arange(len(plan.horizontal) // 2) < plan.horizontal_counts[:, None]
        self._features = np.ascontiguousarray(plan.features[:, has_weight.ravel()])
        self._counts = plan.horizontal_counts * grid.columns
        self._patch_groups = list(plan.patch_groups(_PATCHES))
        compared = len(plan.hypotheses) // len(plan.ratios) * len(plan.contrasts)
        rank = plan.hypotheses.shape[1]
        self._scratch = [
            _Scratch(
                windows=np.empty((_PIXEL_ROWS, grid.columns, n), np.float32),
                parts=np.empty((len(plan.vertical), width), np.float32),
                power=np.empty(self._counts.sum(), np.float32),
                functions=np.empty((len(plan.features), grid.columns), np.float32),
                patches=np.empty(rank * _PATCHES, np.float32),
                hypotheses=np.empty(compared * _PATCHES, np.float32),
                energies=np.empty(plan.levels * _PATCHES, np.float32),
            )
            for _ in range(threads)
        ]

    def project(self, grey: FloatArray) -> None:
        """Take a frame [rows, columns]: project every patch onto the common basis."""
        overlapping = np.lib.stride_tricks.sliding_window_view(
            self.plan.crop(grey), self.grid.window_px, axis=1
        )[:, :: self.grid.stride_px]
        starts = range(0, self.plan.pixel_rows, _PIXEL_ROWS)
        self._workers.each(partial(self._transform_rows, overlapping), starts)
        self._workers.each(self._project_row, range(self.grid.rows))

    def take_products(self, products: FloatArray) -> None:
        """Take a frame as the products of transforms [patches, (2 V + U) H]; see `Plan`."""
        functions = self._functions.reshape(len(self._functions), -1)
        np.matmul(self.plan.features, products.T, out=functions)

    def energies(self, noise: PerPatch) -> FloatArray:
        """Energies of the last projected frame [rows, columns, L]."""
        plan = self.plan
        compared = plan.hypothesis_rows(plan.plausible_ratios(noise))
        self._precision[:] = 1 / (plan.count * np.square(noise))
        functions = self._functions.reshape(len(self._functions), -1)
        self._workers.each(partial(self._compare, functions, compared), self._patch_groups)
        return np.moveaxis(self._energies.reshape(plan.levels, *self._precision.shape), 0, -1)

    def close(self) -> None:
        """Stop the engine's threads."""
        self._workers.close()

    def _transform_rows(self, windows_of_rows: FloatArray, start: int, thread: int) -> None:
        """Transform the windows of some pixel rows horizontally."""
        plan, grid = self.plan, self.grid
        rows = windows_of_rows[start : start + _PIXEL_ROWS]
        windows = self._scratch[thread].windows[: len(rows)]
        np.copyto(windows, rows)
        out = self._horizontal[start : start + len(rows)]
        np.matmul(
            plan.horizontal,
            windows.swapaxes(1, 2),
            out=out.reshape(len(rows), len(plan.horizontal), grid.columns),
        )

    def _project_row(self, row: int, thread: int) -> None:
        """Transform a row of windows vertically, and project its powers."""
        plan, grid, scratch = self.plan, self.grid, self._scratch[thread]
        first = row * grid.stride_px
        np.matmul(
            plan.vertical, self._horizontal[first : first + grid.window_px], out=scratch.parts
        )
        products_of_transforms(scratch.parts, plan.paired, self._counts, scratch.power)
        power = scratch.power.reshape(-1, grid.columns)
        np.matmul(self._features, power, out=scratch.functions)
        self._functions[:, row] = scratch.functions

    def _compare(
        self,
        functions: FloatArray,
        compared: slice,
        group: tuple[FloatArray, slice | IndexArray],
        thread: int,
    ) -> None:
        """Compute the energies of a group of patches; see `FilterBank`."""
        plan, scratch = self.plan, self._scratch[thread]
        hypotheses, indices = group
        precision = self._precision.reshape(-1)[indices]
        coefficients, count = hypotheses[compared], len(precision)
        patches = scratch.patches[: coefficients.shape[1] * count].reshape(-1, count)
        np.multiply(functions[:-1, indices], precision, out=patches[:-1])
        patches[-1] = 1
        excess = scratch.hypotheses[: len(coefficients) * count].reshape(-1, count)
        np.matmul(coefficients, patches, out=excess)
        energies = scratch.energies[: plan.levels * count].reshape(-1, count)
        np.minimum.reduce(excess.reshape(-1, *energies.shape), axis=0, out=energies)
        take_logarithm(energies, functions[-1, indices] * precision + MIN_NOISE_SHARE, plan.count)
        self._energies[:, indices] = energies
