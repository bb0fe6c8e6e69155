"""Energies of blur levels and motions: of all of them, or of those that are expected."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank.bank import LEAST_EXCESS, OWN_NOISE
from coded_aperture_ros.engine import NumpyEngine
from coded_aperture_ros.motion.bank import MotionBank

# Patches whose hypotheses are tried at a time: what a product of matrices gives for one motion
# should stay in a core's cache until the least is found.
_PATCHES = 256


class MotionEngine(NumpyEngine):
    """Computes the energies of pairs of motion and level for frames of one size; see `Engine`.

    Parameters
    ----------
    bank : MotionBank
    shape : (int, int)
        Rows and columns of the frames.
    stride_px : int
        Distance between patches, px.
    threads : int, optional
        Of the processor.

    Raises
    ------
    InputError
        If the frame is smaller than a patch, or there are fewer processors than threads.
    """

    name = "motion"

    def __init__(
        self, bank: MotionBank, shape: tuple[int, ...], stride_px: int, threads: int = 1
    ) -> None:
        super().__init__(bank.product, shape, stride_px, threads)
        self._motions, self._levels = len(bank.motions), bank.levels
        ratios = len(bank.product.ratios)
        # Motion by motion: [M, ratios, slopes * L, R + 1].
        hypotheses = self._plan.hypotheses.reshape(
            ratios, -1, self._motions, self._levels, self.size
        )
        by_motion = np.ascontiguousarray(np.moveaxis(hypotheses, 2, 0))
        self._by_motion = by_motion.reshape(self._motions, ratios, -1, self.size)
        self._of_all = np.empty(
            (self._motions, self._levels, self.grid.rows * self.grid.columns), np.float32
        )
        tried = len(bank.product.prior.contrasts) * self._by_motion.shape[2]
        self._excess = [np.empty(tried * _PATCHES, np.float32) for _ in range(threads)]

    @property
    def size(self) -> int:
        """How many numbers a patch is known by: the vectors of the basis, and a constant."""
        return int(self._plan.hypotheses.shape[1])

    def energies(self, noise: float | NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the least energy of every level under any motion [rows, columns, L]."""
        return np.moveaxis(self.of_all(noise).min(axis=0), 0, -1)

    def of_all(self, noise: float | NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the energies of all motions and levels [M, L, rows, columns].

        Of the frame that `project` took last; overwritten by the next. For a standard deviation of
        the noise, > 0, of the frame or of each patch.
        """
        work = partial(self._try_motions, self._measured(noise), self._tried(noise), self._of_all)
        every = np.arange(self._of_all.shape[2])
        some = [every[start : start + _PATCHES] for start in range(0, len(every), _PATCHES)]
        self._workers.each(work, [(range(self._motions), patches) for patches in some])
        return self._of_all.reshape(*self._of_all.shape[:2], *self._precision.shape)

    def of_some(
        self, noise: float | NDArray[np.float32], candidates: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """Return the energies of some motions for each patch [k, L, rows, columns].

        Parameters
        ----------
        noise : float, or ndarray, float32 [rows, columns]
            See `of_all`.
        candidates : ndarray of int [rows, columns, k]
            Which motions. The fewer different sets of them there are, the faster.
        """
        rows, columns, count = candidates.shape
        energies = np.empty((count, self._levels, rows * columns), np.float32)
        sets, which = np.unique(candidates.reshape(-1, count), axis=0, return_inverse=True)
        which = which.ravel()  # NumPy 2.0 gives it the shape of the rows
        tasks = []
        for number, motions in enumerate(sets):
            members = np.flatnonzero(which == number)
            tasks += [
                (motions, members[start : start + _PATCHES])
                for start in range(0, len(members), _PATCHES)
            ]
        work = partial(self._try_motions, self._measured(noise), self._tried(noise), energies)
        self._workers.each(work, tasks)
        return energies.reshape(count, self._levels, rows, columns)

    def _tried(self, noise: float | NDArray[np.float32]) -> slice:
        return self._bank.plausible_ratios(float(np.median(noise)))

    def _measured(self, noise: float | NDArray[np.float32]) -> NDArray[np.float32]:
        """Return what all patches are known by, in units of the noise, and what noise explains.

        ndarray, float32 [R + 2, patches]: a constant is the last but one.
        """
        self._precision[:] = 1 / (self._plan.count * np.square(noise))
        functions = self._functions.reshape(len(self._functions), -1) * self._precision.ravel()
        constant = np.ones_like(functions[:1])
        return np.concatenate([functions[:-1], constant, functions[-1:] + OWN_NOISE])

    def _try_motions(
        self,
        measured: NDArray[np.float32],
        tried: slice,
        energies: NDArray[np.float32],
        task: tuple[NDArray[np.intp], NDArray[np.intp]],
        thread: int,
    ) -> None:
        """Find the energies of some patches under some motions; see `FilterBank`."""
        motions, patches = task
        seen = measured[:, patches]
        textureless = np.maximum(seen[-1], LEAST_EXCESS)
        found = np.empty((len(motions), self._levels, len(patches)), np.float32)
        for motion, out in zip(motions, found, strict=True):
            hypotheses = self._by_motion[motion, tried].reshape(-1, self.size)
            excess = self._excess[thread][: len(hypotheses) * len(patches)]
            excess = excess.reshape(len(hypotheses), len(patches))
            np.matmul(hypotheses, seen[:-1], out=excess)
            np.minimum.reduce(excess.reshape(-1, *out.shape), axis=0, out=out)
        np.clip(found, LEAST_EXCESS, textureless, out=found)
        np.log(found, out=found)
        found *= np.float32(self._plan.count)
        energies[..., patches] = found
