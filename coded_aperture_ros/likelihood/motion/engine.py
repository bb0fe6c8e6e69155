"""Energies of blur levels and motions: of all of them, or of those that are expected."""

from collections.abc import Sequence

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray, PerPatch
from coded_aperture_ros.likelihood import NumpyEngine, Plan, take_logarithm
from coded_aperture_ros.likelihood.motion.bank import MotionBank
from coded_aperture_ros.likelihood.motion.exact import ExactEnergies, alike, most_likely_motion
from coded_aperture_ros.likelihood.scoring import OWN_NOISE

# Patches whose hypotheses are tried at a time: what a product of matrices gives for one motion
# should stay in a core's cache until the least is found.
_PATCHES = 256
# Every so many motions are enough to find the texture of a patch.
_EVERY_MOTION = 4
# Motions, and the patches that they are tried on.
_Task = tuple[Sequence[int], IndexArray]


class MotionEngine(NumpyEngine):
    """Computes the energies of pairs of motion and level for frames of one size; see `Engine`.

    With `finalists`, so many motions of each patch are compared under several textures, no motion
    among them, and the bank's common basis only says which texture suits each patch; see
    `ExactEnergies`. With 0 the common basis decides, as it does where it is exact.
    """

    name = "motion"

    def __init__(
        self,
        bank: MotionBank,
        shape: tuple[int, ...],
        stride_px: int,
        threads: int = 1,
        finalists: int = 0,
    ) -> None:
        super().__init__(Plan.of(bank.product, shape, stride_px).with_all_products(), threads)
        self._motion_bank = bank
        self._motions, self._levels = len(bank.motions), bank.defocus.levels
        ratios = len(bank.product.ratios)
        # Motion by motion: [M, ratios, slopes * L, R + 1].
        hypotheses = self.plan.hypotheses.reshape(
            ratios, -1, self._motions, self._levels, self.size
        )
        by_motion = np.ascontiguousarray(np.moveaxis(hypotheses, 2, 0))
        self._by_motion = by_motion.reshape(self._motions, ratios, -1, self.size)
        patches = self.grid.rows * self.grid.columns
        self._of_all = np.empty((self._motions, self._levels, patches), np.float32)
        # The bank of defocus alone has contrasts in smaller steps: it says what no motion explains.
        self._alone = NumpyEngine(Plan.of(bank.defocus, shape, stride_px), threads)
        self._static = np.hypot(*bank.motions.vectors_px.T) == 0
        self._finalists = finalists
        self._exact: ExactEnergies | None = None
        if finalists and not bank.exact:
            self._exact = ExactEnergies(bank, self.plan, self._workers)
        # Of the transforms, and 1.
        self._products = np.ones((patches, self.plan.features.shape[1] + 1), np.float32)
        tried = len(self.plan.contrasts) * self._by_motion.shape[2]
        self._excess = [np.empty(tried * _PATCHES, np.float32) for _ in range(threads)]

    @property
    def size(self) -> int:
        """How many numbers a patch is known by: the vectors of the basis, and a constant."""
        return int(self.plan.hypotheses.shape[1])

    def energies(self, noise: PerPatch) -> FloatArray:
        """Return the least energy of every level under any motion [rows, columns, L]."""
        return np.moveaxis(self.of_all(noise).min(axis=0), 0, -1)

    def of_static(self, noise: PerPatch) -> FloatArray:
        """Return the energies of all levels if nothing moves [L, rows, columns]; see `of_all`."""
        self._alone.take_products(self._products[:, :-1])
        return np.moveaxis(self._alone.energies(noise), -1, 0)

    def of_all(self, noise: PerPatch) -> FloatArray:
        """Return the energies of all motions and levels [M, L, rows, columns].

        Of the frame that `project` took last; overwritten by the next. For a standard deviation of
        the noise, > 0, of the frame or of each patch.
        """
        every = np.arange(self._of_all.shape[2])
        some = [every[start : start + _PATCHES] for start in range(0, len(every), _PATCHES)]
        if self._exact is None:
            self._compete(noise, self._of_all, [(range(self._motions), part) for part in some])
        else:
            motions = range(0, self._motions, _EVERY_MOTION)
            self._take_textures(self._exact, noise, [(motions, part) for part in some])
            self._exact.of_all(self._of_all)
            index = np.broadcast_to(np.arange(self._motions)[:, None], (self._motions, len(every)))
            static = self._static[index]
            self._exact.compare_best(self._of_all, index, static, self._finalists)
        return self._of_all.reshape(*self._of_all.shape[:2], *self._precision.shape)

    def of_some(self, noise: PerPatch, candidates: IndexArray) -> FloatArray:
        """Return the energies of some motions for each patch [k, L, rows, columns].

        Under one texture each: there are no finalists. The fewer different sets there are among the
        `candidates`, which are indices of motions [rows, columns, k], the faster.
        """
        rows, columns, count = candidates.shape
        energies = np.empty((count, self._levels, rows * columns), np.float32)
        sets = candidates.reshape(-1, count).T
        tasks = [(sets[:, part[0]].tolist(), part) for part in alike(sets, _PATCHES)]
        if self._exact is None:
            self._compete(noise, energies, tasks)
        else:
            self._take_textures(self._exact, noise, [(some[:1], part) for some, part in tasks])
            energies[:] = self._exact.of_some(sets)
        return energies.reshape(count, self._levels, rows, columns)

    def _project_row(self, row: int, thread: int) -> None:
        """Transform a row of windows vertically, and project its powers."""
        super()._project_row(row, thread)
        columns = self.grid.columns
        products = self._products[row * columns : (row + 1) * columns, :-1]
        products[:] = self._scratch[thread].power.reshape(-1, columns).T

    def _compete(self, noise: PerPatch, energies: FloatArray, tasks: list[_Task]) -> None:
        """Find the energies of some patches under some motions; see `FilterBank`."""
        measured, tried = self._measured(noise), self.plan.tried(noise)

        def compete(task: _Task, thread: int) -> None:
            motions, patches = task
            seen = measured[:, patches]
            found = np.empty((len(motions), self._levels, len(patches)), np.float32)
            for motion, out in zip(motions, found, strict=True):
                self._excess_of(motion, tried, seen[:-1], thread).min(axis=0, out=out)
            energies[..., patches] = take_logarithm(found, seen[-1], self.plan.count)

        self._workers.each(compete, tasks)

    def _take_textures(self, exact: ExactEnergies, noise: PerPatch, tasks: list[_Task]) -> None:
        """Find which texture suits each patch under some motions, and go on with it."""
        measured, tried = self._measured(noise), self.plan.tried(noise)
        texture = np.empty(self._precision.size, np.intp)

        def find(task: _Task, thread: int) -> None:
            motions, patches = task
            seen = measured[:-1, patches]
            least = [self._excess_of(motion, tried, seen, thread).min(axis=1) for motion in motions]
            texture[patches] = np.min(least, axis=0).argmin(axis=0)

        self._workers.each(find, tasks)
        exact.take(self._spectra(), texture, tried)

    def _spectra(self) -> FloatArray:
        """Return the products of the transforms in units of the noise, and 1 [patches, F + 1]."""
        spectra = self._products * self._precision.reshape(-1, 1)
        spectra[:, -1] = 1
        return spectra

    def refined(
        self, noise: PerPatch, patches: BoolArray, start_px: DoubleArray, tolerance_px: float
    ) -> DoubleArray:
        """Return the likeliest motion of some patches [rows, columns]; see `most_likely_motion`.

        Of the frame, and with the noise, that `of_all` took last.
        """
        spectra = self._spectra()[patches.ravel()]
        tried = self.plan.tried(noise)
        return most_likely_motion(
            self._motion_bank, self.plan, spectra, tried, start_px, tolerance_px
        )

    def _excess_of(self, motion: int, tried: slice, seen: FloatArray, thread: int) -> FloatArray:
        """Return what each hypothesis leaves of some patches [textures, L, n]; a buffer."""
        hypotheses = self._by_motion[motion, tried].reshape(-1, self.size)
        count = seen.shape[1]
        excess = self._excess[thread][: len(hypotheses) * count].reshape(len(hypotheses), count)
        np.matmul(hypotheses, seen, out=excess)
        return excess.reshape(-1, self._levels, count)

    def _measured(self, noise: PerPatch) -> FloatArray:
        """Return what all patches are known by, in units of the noise, and what noise explains.

        ndarray, float32 [R + 2, patches]: a constant is the last but one.
        """
        self._precision[:] = 1 / (self.plan.count * np.square(noise))
        functions = self._functions.reshape(len(self._functions), -1) * self._precision.ravel()
        constant = np.ones_like(functions[:1])
        return np.concatenate([functions[:-1], constant, functions[-1:] + OWN_NOISE])
