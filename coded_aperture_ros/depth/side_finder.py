"""Which side of the focal plane the scene is on, from the phase of its spectrum (thesis 9.3).

A power spectrum is the same before and behind the focal plane, where the PSF is the mask and the
mask turned by 180 degrees. Only the phase differs: deconvolved with the PSF of the right side a
patch is a photograph, whose gradients are few and large. With the other side's, which has the same
gain at every frequency, its phases are scrambled, and the same power is spread over all pixels.
"""

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.bank import image_prior
from coded_aperture_ros.imaging import PatchGrid, periodic, periodic_shape, transfer_function
from coded_aperture_ros.imaging.patches import mean_at
from coded_aperture_ros.optics import PsfStack

# What one blur size for the whole frame leaves unexplained, as a share of the texture at every
# frequency.
_MODEL_ERROR = 0.1
# Gradients below this share of their surroundings' are taken to be of one size.
_FLOOR = 0.1
_TINY = 1e-12
# Natural logarithm of the odds for a difference of one in the mean logarithm of the squared
# gradients, on planes with photographs. No patch is surer than the second.
_GAIN = 15.0
MOST_LOG_ODDS = 6.0
# Frames are extended by this, or by the width of the PSFs; it is what a gradient's surroundings
# are, too.
_AROUND_PX = 32


class SideFinder:
    """Tells the two sides of the focal plane apart, for frames of one size.

    Parameters
    ----------
    stack : PsfStack
        L levels; their blur sizes are signed.
    shape : (int, int)
        Rows and columns of the frames.
    """

    def __init__(self, stack: PsfStack, shape: tuple[int, ...]) -> None:
        self._stack = stack
        self._shape = shape
        self._around_px = max(_AROUND_PX, stack.psfs.shape[-1] - 1)
        self._periodic = periodic_shape(shape, self._around_px)
        self._prior = image_prior(self._periodic)
        self._transfers: dict[int, NDArray[np.complex64]] = {}

    def log_odds(
        self,
        grey: NDArray[np.float32],
        grid: PatchGrid,
        level: NDArray[np.intp],
        noise: float,
    ) -> NDArray[np.float32]:
        """Return how much likelier it is that each patch lies beyond the focal plane.

        Parameters
        ----------
        grey : ndarray, float32 [height, width]
            Linear light, without NaN.
        grid : PatchGrid
            Where the patches lie, rows by columns.
        level : ndarray of int [rows, columns]
            A level with each patch's blur size, of either side.
        noise : float
            Standard deviation.

        Returns
        -------
        ndarray, float32 [rows, columns]
            Natural logarithm of the odds of the far side, against the near one; 0 where the two
            PSFs are the same.
        """
        spectrum = scipy.fft.rfft2(periodic(grey - grey.mean(), self._periodic))
        found = np.zeros(level.shape, np.float32)
        for one in np.unique(level):
            clearer = self._clearer(spectrum, int(one), noise)
            own_side = np.float32(np.sign(self._stack.blur_sizes_px[one]))
            here = level == one
            found[here] = own_side * _GAIN * mean_at(clearer, grid, grid.window_px)[here]
        return np.clip(found, -MOST_LOG_ODDS, MOST_LOG_ODDS)

    def _clearer(
        self, spectrum: NDArray[np.complex64], level: int, noise: float
    ) -> NDArray[np.float32]:
        """Return by how much clearer the frame is by a level's PSF than by that turned around.

        The logarithm of the ratio of the squared gradients, of every pixel [height, width].
        """
        transfer = self._transfer(level)
        passed = transfer.real**2 + transfer.imag**2
        power = (passed + np.float32(_MODEL_ERROR**2)) * self._prior + np.float32(noise**2)
        filtered = spectrum * (self._prior / power)
        own = self._gradients(filtered * np.conj(transfer))
        other = self._gradients(filtered * transfer)  # the transform of the PSF turned around
        logarithm = np.zeros(self._shape, np.float32)
        for mine, others in zip(own, other, strict=True):
            side = (self._around_px | 1,) * 2
            floor = _FLOOR**2 / 2 * cv2.blur(mine + others, side) + _TINY
            logarithm += cv2.log((others + floor) / (mine + floor))
        return logarithm

    def _gradients(self, transform: NDArray[np.complex64]) -> list[NDArray[np.float32]]:
        """Return the squared differences to the right and down, within the frame."""
        sharp = scipy.fft.irfft2(transform, self._periodic)
        height, width = self._shape
        here = sharp[:height, :width]
        right, below = sharp[:height, 1 : width + 1], sharp[1 : height + 1, :width]
        return [np.square(right - here), np.square(below - here)]

    def _transfer(self, level: int) -> NDArray[np.complex64]:
        if level not in self._transfers:
            self._transfers[level] = transfer_function(self._stack.psfs[level], self._periodic)
        return self._transfers[level]
