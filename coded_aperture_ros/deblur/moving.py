"""The blur of a frame in which things move, as a linear operator: thesis eq. 7.1 and 7.2."""

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.operator import OnProcessor, fast_shape, frame_within, scene_around
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.imaging import transfer_function
from coded_aperture_ros.methods.motion import motion_kernel

# Motions that a frame is divided among, at most; rarer ones are taken for the nearest of these.
_MOST_MOTIONS = 8
# Motions are told apart in steps of this, px.
_STEP_PX = 0.25


class MovingBlur(OnProcessor):
    """Every point of the scene spreads its light by the PSF of its depth and of its motion.

    The motion is piecewise constant: each of the M motions that occur has its pixels ``S_m``, and
    its kernel ``h_m``. With the R kernels of `PsfBasis`::

        H f = sum_m h_m * sum_r k_r * (c_r(d) S_m f)  /  (the same of f = 1)

    so it takes R Fourier transforms for each motion.

    Parameters
    ----------
    basis : PsfBasis
    blur_size_px : ndarray, float32 [rows, columns]
        Signed blur size of every pixel, finite.
    motion_px : ndarray, float32 [rows, columns, 2]
        Way of every pixel during the exposure, to the right, and down; none where not finite.
    workers : Workers, optional
        Threads to share the work with.

    Raises
    ------
    InputError
        If the motion has another size than the blur.
    """

    def __init__(
        self,
        basis: PsfBasis,
        blur_size_px: NDArray[np.float32],
        motion_px: NDArray[np.float32],
        workers: Workers | None = None,
    ) -> None:
        rows, columns = blur_size_px.shape
        check_motion(motion_px)
        if motion_px.shape[:2] != (rows, columns):
            raise InputError(
                f"motion of {motion_px.shape[1]}x{motion_px.shape[0]} px: expected the size of the "
                f"blur, {columns}x{rows}"
            )
        vectors, labels = segments(motion_px)
        traces = [motion_kernel((vector[0], vector[1])) for vector in vectors]
        self.shape = rows, columns
        self.margin_px = basis.margin_px + max(len(trace) // 2 for trace in traces)
        self.scene_shape = fast_shape(self.shape, self.margin_px)
        self.workers = workers or Workers()
        self._basis = basis
        self._transforms = basis.transforms(self.scene_shape)
        self._traces = [transfer_function(trace, self.scene_shape) for trace in traces]
        steps = scene_around(basis.steps_of(blur_size_px).astype(np.float32), self)
        self._steps = steps.astype(np.intp)
        around = scene_around(labels.astype(np.float32), self)
        self._where = [(around == label).astype(np.float32) for label in range(len(vectors))]
        self._shares = [np.take(of_kernel, self._steps) for of_kernel in basis.table]
        self._tasks = [
            (motion, kernel)
            for motion in range(len(vectors))
            for kernel in range(len(self._shares))
        ]
        self._scale = np.ones(self.shape, np.float32)
        self._scale /= self.forward(np.ones(self.scene_shape, np.float32))

    def forward(self, scene: NDArray[np.float32]) -> NDArray[np.float32]:
        """Blur a scene."""
        like = self._transforms[0]
        sums = [np.zeros_like(like) for _ in range(self.workers.threads)]

        def add(task: tuple[int, int], thread: int) -> None:
            motion, kernel = task
            spectrum = scipy.fft.rfft2(self._shares[kernel] * self._where[motion] * scene)
            spectrum *= self._transforms[kernel]
            spectrum *= self._traces[motion]
            sums[thread] += spectrum

        self.workers.each(add, self._tasks)
        blurred = scipy.fft.irfft2(np.sum(sums, axis=0), self.scene_shape)
        return frame_within(blurred, self) * self._scale

    def adjoint(self, frame: NDArray[np.float32]) -> NDArray[np.float32]:
        """Apply the transpose."""
        spectrum = scipy.fft.rfft2(scene_around(frame * self._scale, self, cv2.BORDER_CONSTANT))
        sums = [np.zeros(self.scene_shape, np.float32) for _ in range(self.workers.threads)]

        def add(task: tuple[int, int], thread: int) -> None:
            motion, kernel = task
            passed = spectrum * self._transforms[kernel].conj() * self._traces[motion].conj()
            part = scipy.fft.irfft2(passed, self.scene_shape)
            cv2.accumulateProduct(part, self._shares[kernel] * self._where[motion], sums[thread])

        self.workers.each(add, self._tasks)
        return np.sum(sums, axis=0)

    def ranges(self, count: int) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Divide the scene among motions and ranges of blur sizes."""
        return [
            (share * where, power * np.abs(trace) ** 2)
            for share, power in self._basis.ranges(self._steps, count)
            for where, trace in zip(self._where, self._traces, strict=True)
        ]


def check_motion(motion_px: NDArray[np.floating]) -> None:
    """Check that an array can be a map of motion.

    Raises
    ------
    InputError
        If it is not [rows, columns, 2], or not of a floating type.
    """
    if motion_px.ndim != 3 or motion_px.shape[2] != 2 or not motion_px.size:
        raise InputError(f"motion: expected [rows, columns, 2], got {list(motion_px.shape)}")
    if not np.issubdtype(motion_px.dtype, np.floating):
        raise InputError(f"motion: expected floating values in px, got {motion_px.dtype}")


def segments(
    motion_px: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Divide a map among the motions that occur most.

    Parameters
    ----------
    motion_px : ndarray, float32 [rows, columns, 2]
        None where not finite.

    Returns
    -------
    vectors : ndarray, float32 [M, 2]
    labels : ndarray of int [rows, columns]
        Which of them each pixel has.
    """
    known = np.isfinite(motion_px).all(axis=2, keepdims=True)
    coarse = np.rint(np.where(known, motion_px, 0) / _STEP_PX)
    # Blur does not tell one way along a line from the other.
    right, down = coarse[..., 0], coarse[..., 1]
    back = (right < 0) | ((right == 0) & (down < 0))
    coarse = np.where(back[..., None], -coarse, coarse) + 0.0
    found, labels, counts = np.unique(
        coarse.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True
    )
    kept = np.argsort(-counts, kind="stable")[:_MOST_MOTIONS]
    apart = np.minimum(
        *(np.linalg.norm(found[:, None] - sign * found[kept], axis=2) for sign in (1, -1))
    )
    labels = apart.argmin(axis=1)[labels.ravel()].reshape(motion_px.shape[:2])
    return (found[kept] * _STEP_PX).astype(np.float32), labels
