"""The engine on NumPy: every array is allocated when a frame size is planned, none per frame."""

import dataclasses
from functools import partial

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, PerPatch
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.likelihood.plan import Plan
from coded_aperture_ros.likelihood.scoring import OWN_NOISE, take_logarithm

# Rows of pixels that are transformed, and patches whose hypotheses are tried, at a time: few
# large calls, but no more than a core's cache holds.
_PIXEL_ROWS = 24
_PATCHES = 128


def _loop(parts: FloatArray, paired: int, used: IndexArray, products: FloatArray) -> None:
    half = parts.shape[1] // 2
    at = 0
    for v in range(paired):
        for i in range(used[v]):
            cc, cs = parts[v, i], parts[v, half + i]
            sc, ss = parts[paired + v, i], parts[paired + v, half + i]
            products[at + i] = cc * cc + cs * cs + sc * sc + ss * ss
        at += used[v]
    for v in range(paired):
        for i in range(used[paired + v]):
            cc, cs = parts[v, i], parts[v, half + i]
            sc, ss = parts[paired + v, i], parts[paired + v, half + i]
            products[at + i] = cc * ss - cs * sc
        at += used[paired + v]
    for v in range(2 * paired, len(parts)):
        for i in range(used[v]):
            cc, cs = parts[v, i], parts[v, half + i]
            products[at + i] = cc * cc + cs * cs
        at += used[v]


def _plain(parts: FloatArray, paired: int, used: IndexArray, products: FloatArray) -> None:
    half = parts.shape[1] // 2
    cosines, sines = parts[:paired], parts[paired : 2 * paired]
    crossed = cosines[:, :half] * sines[:, half:]
    crossed -= cosines[:, half:] * sines[:, :half]
    power = parts * parts
    power = power[:, :half] + power[:, half:]
    power[:paired] += power[paired : 2 * paired]
    power[paired : 2 * paired] = crossed
    np.compress((np.arange(half) < used[:, None]).ravel(), power, out=products)


# From the cosine and sine parts of the sums over y, of those over x side by side [2 V + U, 2 n], to
# q and x of 1 to V cycles and the power of those without a sine, the first so many `used`
# [2 V + U] of each, which it writes to one after the other.
products_of_transforms = Compiled(_loop, _plain)


@dataclasses.dataclass(frozen=True, eq=False)
class _Scratch:
    """What one thread needs for its part of a frame."""

    windows: FloatArray
    parts: FloatArray
    power: FloatArray
    functions: FloatArray
    patches: FloatArray
    hypotheses: FloatArray
    energies: FloatArray


class NumpyEngine:
    """Energies of every patch of frames of one size; see `Engine`."""

    name = "numpy"

    def __init__(self, plan: Plan, threads: int = 1) -> None:
        grid, n = plan.grid, plan.grid.window_px
        self.plan, self.grid = plan, plan.grid
        self._workers = Workers(threads)
        width = len(plan.horizontal) * grid.columns  # both parts of all frequencies and columns
        self._horizontal = np.empty((plan.pixel_rows, width), np.float32)
        self._functions = np.empty((len(plan.features), grid.rows, grid.columns), np.float32)
        self._energies = np.empty((plan.levels, grid.rows * grid.columns), np.float32)
        self._precision = np.empty((grid.rows, grid.columns), np.float32)
        # Only of the products that they look at.
        looked_at = np.arange(len(plan.horizontal) // 2) < plan.used[:, None]
        self._features = np.ascontiguousarray(plan.features[:, looked_at.ravel()])
        self._used = plan.used * grid.columns
        self._shares = list(plan.shares(_PATCHES))
        tried = len(plan.hypotheses) // len(plan.ratios) * len(plan.contrasts)
        rank = plan.hypotheses.shape[1]
        self._scratch = [
            _Scratch(
                windows=np.empty((_PIXEL_ROWS, grid.columns, n), np.float32),
                parts=np.empty((len(plan.vertical), width), np.float32),
                power=np.empty(self._used.sum(), np.float32),
                functions=np.empty((len(plan.features), grid.columns), np.float32),
                patches=np.empty(rank * _PATCHES, np.float32),
                hypotheses=np.empty(tried * _PATCHES, np.float32),
                energies=np.empty(plan.levels * _PATCHES, np.float32),
            )
            for _ in range(threads)
        ]

    def project(self, grey: FloatArray) -> None:
        """Take a frame: project every patch onto the common basis."""
        overlapping = np.lib.stride_tricks.sliding_window_view(
            self.plan.covered(grey), self.grid.window_px, axis=1
        )[:, :: self.grid.stride_px]
        starts = range(0, self.plan.pixel_rows, _PIXEL_ROWS)
        self._workers.each(partial(self._transform_rows, overlapping), starts)
        self._workers.each(self._project_row, range(self.grid.rows))

    def take_products(self, products: FloatArray) -> None:
        """Take a frame as the products of transforms [patches, (2 V + U) H]; see `Plan`."""
        functions = self._functions.reshape(len(self._functions), -1)
        np.matmul(self.plan.features, products.T, out=functions)

    def energies(self, noise: PerPatch) -> FloatArray:
        """Return the energies of the frame taken last [rows, columns, L]."""
        plan = self.plan
        tried = plan.hypotheses_of(plan.tried(noise))
        self._precision[:] = 1 / (plan.count * np.square(noise))
        functions = self._functions.reshape(len(self._functions), -1)
        self._workers.each(partial(self._try_hypotheses, functions, tried), self._shares)
        return np.moveaxis(self._energies.reshape(plan.levels, *self._precision.shape), 0, -1)

    def close(self) -> None:
        """End the engine's threads."""
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
        products_of_transforms(scratch.parts, plan.paired, self._used, scratch.power)
        power = scratch.power.reshape(-1, grid.columns)
        np.matmul(self._features, power, out=scratch.functions)
        self._functions[:, row] = scratch.functions

    def _try_hypotheses(
        self,
        functions: FloatArray,
        tried: slice,
        share: tuple[FloatArray, slice | IndexArray],
        thread: int,
    ) -> None:
        """Find the energies of some patches; see `FilterBank` for what they are."""
        plan, scratch, (hypotheses, some) = self.plan, self._scratch[thread], share
        precision = self._precision.reshape(-1)[some]
        coefficients, count = hypotheses[tried], len(precision)
        patches = scratch.patches[: coefficients.shape[1] * count].reshape(-1, count)
        np.multiply(functions[:-1, some], precision, out=patches[:-1])
        patches[-1] = 1
        excess = scratch.hypotheses[: len(coefficients) * count].reshape(-1, count)
        np.matmul(coefficients, patches, out=excess)
        energies = scratch.energies[: plan.levels * count].reshape(-1, count)
        np.minimum.reduce(excess.reshape(-1, *energies.shape), axis=0, out=energies)
        take_logarithm(energies, functions[-1, some] * precision + OWN_NOISE, plan.count)
        self._energies[:, some] = energies
