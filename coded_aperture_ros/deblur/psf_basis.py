"""PSFs of all blur sizes as combinations of a few kernels."""

import dataclasses
from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray, Shape
from coded_aperture_ros.frames import transfer_function
from coded_aperture_ros.likelihood.bank import power_spectrum
from coded_aperture_ros.optics import PsfStack

# What the missing kernels may leave out of a blurred photograph, as a share of its contrast.
_TOLERANCE = 0.002
_SLOPE = 2.4
# Blur sizes are looked up at so many steps between two levels of the stack.
_STEPS = 16


@dataclasses.dataclass(frozen=True, eq=False)
class PsfBasis:
    """Kernels whose combinations are the PSFs of all blur sizes, fractional ones too."""

    kernels: FloatArray  # [R, k, k]
    # How much of each there is in the PSFs [R, steps] of these signed sizes, which ascend, equally
    # many between all levels of the stack.
    table: FloatArray
    table_sizes_px: DoubleArray
    in_pixels: bool = True  # and not mere indices of levels

    @classmethod
    def from_stack(cls, stack: PsfStack, tolerance: float = _TOLERANCE) -> "PsfBasis":
        """Smallest basis of a stack for blurred photographs.

        Between two levels PSFs are interpolated linearly. The error of a blurred photograph has a
        standard deviation of at most `tolerance`, relative to that of the sharp one.
        """
        order = np.argsort(stack.blur_sizes_px)
        psfs = stack.psfs[order]
        side = scipy.fft.next_fast_len(4 * psfs.shape[-1], real=True)
        spectrum = power_spectrum(_SLOPE, (side, side))
        seen = np.array([transfer_function(psf, (side, side)) for psf in psfs]) * np.sqrt(spectrum)
        seen = seen.reshape(len(psfs), -1).astype(np.complex128).view(np.float64)
        # What is seen of the PSFs in photographs, against each other [L, L].
        gram = seen @ seen.T * 2 / side**2
        powers, directions = np.linalg.eigh(gram)
        powers = powers[::-1]
        directions = directions[:, ::-1]
        left_out = (
            np.max(directions[:, rank:] ** 2 @ np.maximum(powers[rank:], 0))
            for rank in range(1, len(psfs) + 1)
        )
        rank = next(n for n, share in enumerate(left_out, start=1) if share <= tolerance**2)
        mixture = directions[:, :rank]
        kernels = np.tensordot(mixture.T, psfs.astype(np.float64), axes=1)
        levels = mixture / (mixture @ kernels.sum(axis=(1, 2)))[:, None]  # unit sums
        at = np.arange(len(psfs))
        fine = np.linspace(0, len(psfs) - 1, _STEPS * (len(psfs) - 1) + 1)
        table = np.array([np.interp(fine, at, kernel_row) for kernel_row in levels.T])
        return cls(
            kernels.astype(np.float32),
            table.astype(np.float32),
            np.interp(fine, at, stack.blur_sizes_px[order]),
            stack.in_pixels,
        )

    @lru_cache(maxsize=2)  # noqa: B019 - as many sizes of frames as a camera has
    def transforms(self, shape: Shape) -> list[NDArray[np.complex64]]:
        """Transforms of the kernels for images of a shape; see `transfer_function`."""
        return [transfer_function(kernel, shape) for kernel in self.kernels]

    @property
    def margin_px(self) -> int:
        """Half width of a PSF, px."""
        return self.kernels.shape[-1] // 2

    def table_steps(self, blur_size_px: FloatArray) -> IndexArray:
        """Column of `table` for each blur size; sizes beyond get the last ones."""
        steps = np.arange(len(self.table_sizes_px))
        return np.rint(np.interp(blur_size_px, self.table_sizes_px, steps)).astype(np.intp)

    def ranges(self, steps: IndexArray, count: int) -> list[tuple[FloatArray, FloatArray]]:
        """Shares and powers of at most `count` ranges of blur sizes in a scene with these `steps`.

        Each range has a share [rows, columns], the square root of a pixel's membership, so that the
        squares sum to one; and a power, as by ``rfft2``, the mean of ``|H|^2`` over its pixels.
        """
        shape = (steps.shape[0], steps.shape[1])
        # Powers are the transforms of autocorrelations, which are small images.
        reach = self.kernels.shape[-1] - 1
        side = scipy.fft.next_fast_len(2 * reach + 1, real=True)
        transforms = np.array([transfer_function(kernel, (side, side)) for kernel in self.kernels])
        middles = np.linspace(steps.min(), steps.max(), count) if np.ptp(steps) else steps[:1, 0]
        width = max(float(middles[-1] - middles[0]) / max(len(middles) - 1, 1), 1e-3)
        divided = []
        for middle in middles:
            share = np.maximum(1 - np.abs(steps - np.float32(middle)) / np.float32(width), 0)
            share = share.astype(np.float32)
            if not share.any():
                continue
            weight = np.bincount(steps.ravel(), share.ravel(), minlength=self.table.shape[1])
            together = ((self.table * (weight / weight.sum())) @ self.table.T).astype(np.float32)
            mixed = np.tensordot(together, transforms, axes=1)
            power = np.sum(mixed.real * transforms.real + mixed.imag * transforms.imag, axis=0)
            correlation = scipy.fft.fftshift(scipy.fft.irfft2(power, (side, side)))
            inside = slice(side // 2 - reach, side // 2 + reach + 1)
            power = transfer_function(correlation[inside, inside], shape).real
            divided.append((np.sqrt(share), np.maximum(power, 0)))
        return divided

    def psfs(self) -> FloatArray:
        """PSFs of all `table_sizes_px` [steps, k, k]."""
        return np.tensordot(self.table.T, self.kernels, axes=1)
