"""Energies of pairs of motion and blur level: of all motions, or of expected ones."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray, PerPatch
from coded_aperture_ros.likelihood import NumpyEngine, Plan, take_logarithm
from coded_aperture_ros.likelihood.motion.bank import MotionBank
from coded_aperture_ros.likelihood.motion.exact import (
    ExactEnergies,
    group_equal_rows,
    most_likely_motion,
)
from coded_aperture_ros.likelihood.scoring import MIN_NOISE_SHARE

# Patches whose hypotheses are compared at a time: the residuals of one motion should stay in a
# core's cache until the least is found.
_PATCHES = 256
# Every so many motions are compared to find the texture of a patch.
_EVERY_MOTION = 4
# Indices of motions, and of the patches that they are compared on.
_Task = tuple[Sequence[int], IndexArray]


class _ProductsEngine(NumpyEngine):
    """Engine of frames whose transforms another engine has computed."""

    def take_products(self, products: FloatArray) -> None:
        """Take a frame as the products of transforms [patches, (2 V + U) H]; see `Plan`."""
        functions = self._functions.reshape(len(self._functions), -1)
        np.matmul(self.plan.features, products.T, out=functions)


class MotionEngine(NumpyEngine):
    """Energies of pairs of motion and level for frames of one size; an `Engine`.

    With `finalists`, so many motions of each patch are compared under several textures, no motion
    among them, and the bank's common basis only finds the texture of each patch; see
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
        super().__init__(
            _with_all_products(Plan.for_frames(bank.product, shape, stride_px)), threads
        )
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
        self._all_energies = np.empty((self._motions, self._levels, patches), np.float32)
        # The bank of defocus has contrasts in smaller steps, which no motion is compared under.
        defocus_plan = Plan.for_frames(bank.defocus, shape, stride_px)
        self._defocus_engine = _ProductsEngine(defocus_plan, threads)
        self._static = np.hypot(*bank.motions.vectors_px.T) == 0
        self._finalists = finalists
        self._exact: ExactEnergies | None = None
        if finalists and not bank.exact:
            self._exact = ExactEnergies(bank, self.plan, self._workers)
        # Products of the transforms, and 1.
        self._products = np.ones((patches, self.plan.features.shape[1] + 1), np.float32)
        compared = len(self.plan.contrasts) * self._by_motion.shape[2]
        self._excess = [np.empty(compared * _PATCHES, np.float32) for _ in range(threads)]

    @property
    def size(self) -> int:
        """Numbers that describe a patch: one for each vector of the basis, and a constant."""
        return int(self.plan.hypotheses.shape[1])

    def energies(self, noise: PerPatch) -> FloatArray:
        """Least energy of every level under any motion [rows, columns, L]."""
        return np.moveaxis(self.all_energies(noise).min(axis=0), 0, -1)

    def static_energies(self, noise: PerPatch) -> FloatArray:
        """Energies of all levels if nothing moves [L, rows, columns]; see `all_energies`."""
        self._defocus_engine.take_products(self._products[:, :-1])
        return np.moveaxis(self._defocus_engine.energies(noise), -1, 0)

    def all_energies(self, noise: PerPatch) -> FloatArray:
        """Energies of all motions and levels [M, L, rows, columns]; overwritten by the next frame.

        Parameters
        ----------
        noise : float, or ndarray, float32 [rows, columns]
            Standard deviation, linear light, > 0, of the frame or of each patch.
        """
        patches = np.arange(self._all_energies.shape[2])
        groups = [patches[start : start + _PATCHES] for start in range(0, len(patches), _PATCHES)]
        if self._exact is None:
            self._compete(
                noise, self._all_energies, [(range(self._motions), group) for group in groups]
            )
        else:
            motions = range(0, self._motions, _EVERY_MOTION)
            self._take_textures(self._exact, noise, [(motions, group) for group in groups])
            self._exact.all_energies(self._all_energies)
            index = np.broadcast_to(
                np.arange(self._motions)[:, None], (self._motions, len(patches))
            )
            static = self._static[index]
            self._exact.compare_best(self._all_energies, index, static, self._finalists)
        return self._all_energies.reshape(*self._all_energies.shape[:2], *self._precision.shape)

    def energies_for(self, noise: PerPatch, candidates: IndexArray) -> FloatArray:
        """Energies of candidate motions for each patch [k, L, rows, columns].

        Each patch has one texture: there are no finalists.

        Parameters
        ----------
        noise : float, or ndarray, float32 [rows, columns]
            See `all_energies`.
        candidates : ndarray, int [rows, columns, k]
            Indices of motions; the fewer different sets, the faster.
        """
        rows, columns, count = candidates.shape
        energies = np.empty((count, self._levels, rows * columns), np.float32)
        sets = candidates.reshape(-1, count)
        groups = group_equal_rows(sets, _PATCHES)
        tasks = [(sets[group[0]].tolist(), group) for group in groups]
        if self._exact is None:
            self._compete(noise, energies, tasks)
        else:
            self._take_textures(
                self._exact, noise, [(motions[:1], group) for motions, group in tasks]
            )
            energies[:] = self._exact.energies_for(sets.T)
        return energies.reshape(count, self._levels, rows, columns)

    def project(self, grey: FloatArray) -> None:
        """Take a frame [rows, columns]: project every patch onto the common basis."""
        super().project(grey)
        products = self._sliding.products
        self._products[:, :-1] = products.reshape(len(products), -1).T

    def _compete(self, noise: PerPatch, energies: FloatArray, tasks: list[_Task]) -> None:
        """Compute the energies of patches under motions; see `FilterBank`."""
        described, ratios = self._describe(noise), self.plan.plausible_ratios(noise)

        def compete(task: _Task, thread: int) -> None:
            motions, patches = task
            group = described[:, patches]
            least = np.empty((len(motions), self._levels, len(patches)), np.float32)
            for motion, out in zip(motions, least, strict=True):
                self._compute_excess(motion, ratios, group[:-1], thread).min(axis=0, out=out)
            energies[..., patches] = take_logarithm(least, group[-1], self.plan.count)

        self._workers.each(compete, tasks)

    def _take_textures(self, exact: ExactEnergies, noise: PerPatch, tasks: list[_Task]) -> None:
        """Find the texture of each patch under motions, and pass it to the exact energies."""
        described, ratios = self._describe(noise), self.plan.plausible_ratios(noise)
        texture = np.empty(self._precision.size, np.intp)

        def find(task: _Task, thread: int) -> None:
            motions, patches = task
            group = described[:-1, patches]
            least = [
                self._compute_excess(motion, ratios, group, thread).min(axis=1)
                for motion in motions
            ]
            texture[patches] = np.min(least, axis=0).argmin(axis=0)

        self._workers.each(find, tasks)
        exact.take(self._spectra(), texture, ratios)

    def _spectra(self) -> FloatArray:
        """Products of the transforms in units of the noise, and 1 [patches, F + 1]."""
        spectra = self._products * self._precision.reshape(-1, 1)
        spectra[:, -1] = 1
        return spectra

    def refine_motion(
        self, noise: PerPatch, patches: BoolArray, start_px: DoubleArray, tolerance_px: float
    ) -> DoubleArray:
        """Likeliest motion of all `patches` [rows, columns], px [2]; see `most_likely_motion`.

        The frame and the noise are those of the last call of `all_energies`.
        """
        spectra = self._spectra()[patches.ravel()]
        ratios = self.plan.plausible_ratios(noise)
        return most_likely_motion(
            self._motion_bank, self.plan, spectra, ratios, start_px, tolerance_px
        )

    def _compute_excess(
        self, motion: int, ratios: slice, described: FloatArray, thread: int
    ) -> FloatArray:
        """Residual of patches under each hypothesis of a motion [textures, L, n]; a buffer."""
        hypotheses = self._by_motion[motion, ratios].reshape(-1, self.size)
        count = described.shape[1]
        excess = self._excess[thread][: len(hypotheses) * count].reshape(len(hypotheses), count)
        np.matmul(hypotheses, described, out=excess)
        return excess.reshape(-1, self._levels, count)

    def _describe(self, noise: PerPatch) -> FloatArray:
        """Functions of all patches, in units of the noise, float32 [R + 2, patches].

        The last but one is a constant, the last is the residual without texture.
        """
        self._precision[:] = 1 / (self.plan.count * np.square(noise))
        functions = self._functions.reshape(len(self._functions), -1) * self._precision.ravel()
        constant = np.ones_like(functions[:1])
        return np.concatenate([functions[:-1], constant, functions[-1:] + MIN_NOISE_SHARE])


def _with_all_products(plan: Plan) -> Plan:
    """Plan whose engine computes all products of transforms, also those without a weight."""
    counts = np.full_like(plan.horizontal_counts, len(plan.horizontal) // 2)
    return dataclasses.replace(plan, horizontal_counts=counts)
