"""Energies of blur levels and motions: of all of them, or of those that are expected."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.engine import NumpyEngine
from coded_aperture_ros.engine.numpy_engine import PATCHES
from coded_aperture_ros.motion.bank import MotionBank


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

    def of_all(self, noise: float | NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the energies of all motions and levels [M, L, rows, columns].

        Of the frame that `project` took last; overwritten by the next. For a standard deviation of
        the noise, > 0, of the frame or of each patch.
        """
        self.energies(noise)
        return self._energies.reshape(self._motions, self._levels, *self._precision.shape)

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
        bank, plan = self._bank, self._plan
        tried = bank.plausible_ratios(float(np.median(noise)))
        self._precision[:] = 1 / (plan.count * np.square(noise))
        precision = self._precision.ravel()
        functions = self._functions.reshape(len(self._functions), -1)
        rows, columns, count = candidates.shape
        hypotheses = plan.hypotheses.reshape(
            len(bank.ratios), -1, self._motions, self._levels, len(functions)
        )[tried]
        energies = np.empty((count * self._levels, rows * columns), np.float32)
        sets, which = np.unique(candidates.reshape(-1, count), axis=0, return_inverse=True)
        which = which.ravel()  # NumPy 2.0 gives it the shape of the rows
        for number, motions in enumerate(sets):
            chosen = hypotheses[:, :, motions].reshape(-1, len(functions))
            members = np.flatnonzero(which == number)
            for start in range(0, len(members), PATCHES):
                some = members[start : start + PATCHES]
                found = np.empty((len(energies), len(some)), np.float32)
                self._evaluate(chosen, functions[:, some], precision[some], found, 0)
                energies[:, some] = found
        return energies.reshape(count, self._levels, rows, columns)
