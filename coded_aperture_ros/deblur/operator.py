"""Blur of a whole frame, by depth and motion, as a linear operator with its adjoint."""

import abc
import dataclasses
from typing import Any

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray, Shape
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.frames import periodic_shape, transfer_function
from coded_aperture_ros.likelihood.motion import motion_kernel

# Motions that a frame is divided among, at most; rarer ones are taken for the nearest of these.
_MAX_MOTIONS = 8
# Motions are rounded to steps of this, px.
_STEP_PX = 0.25


class BlurOperator(abc.ABC):
    """``H_d`` of thesis eq. 3.27: from a sharp scene to the coded frame without noise.

    The scene is larger than the frame by a margin on every side, for light that comes from beyond
    the frame's border. The frame has only measured pixels: nothing wraps around. Scenes have one
    plane, or a second one with what is `hidden` behind foregrounds [planes, *scene_shape].
    """

    hidden: BoolArray | None = None  # where the second plane has something [*scene_shape]
    _steps: IndexArray  # of the scene, see `PsfBasis.table_steps`

    def __init__(
        self, basis: PsfBasis, shape: tuple[int, ...], margin_px: int, workers: Workers | None
    ) -> None:
        self.shape: Shape = (shape[0], shape[1])
        self.scene_shape = periodic_shape(self.shape, 2 * margin_px)
        self.margin_px = margin_px
        self.workers = workers or Workers()
        self._basis = basis

    @abc.abstractmethod
    def forward(self, scene: FloatArray) -> FloatArray:
        """Frame, float32 of `shape`, of a scene, float32 [planes, *scene_shape]."""

    @abc.abstractmethod
    def adjoint(self, frame: FloatArray) -> FloatArray:
        """Scene [planes, *scene_shape]: the transpose of `forward` applied to a frame."""

    def extend(self, frame: FloatArray) -> FloatArray:
        """Scene [planes, *scene_shape] from a frame, continued beyond its borders."""
        return extend_to_scene(frame, self)[None]

    def ranges(self, count: int) -> list[tuple[FloatArray, FloatArray]]:
        """Shares and powers of ranges of blur sizes; see `PsfBasis.ranges`."""
        return self._basis.ranges(self._steps, count)


def extend_to_scene(
    frame: FloatArray, operator: BlurOperator, border: int = cv2.BORDER_REPLICATE
) -> FloatArray:
    """One plane of a scene [*scene_shape] from a frame, continued beyond its borders."""
    margin = operator.margin_px
    below = operator.scene_shape[0] - operator.shape[0] - margin
    right = operator.scene_shape[1] - operator.shape[1] - margin
    scene = cv2.copyMakeBorder(frame, margin, below, margin, right, borderType=border)
    return np.asarray(scene, np.float32)


def crop_to_frame(scene: Any, operator: BlurOperator) -> Any:
    """Part of a plane, or of each, that the frame shows."""
    margin, (rows, columns) = operator.margin_px, operator.shape
    return scene[..., margin : margin + rows, margin : margin + columns]


@dataclasses.dataclass(frozen=True, eq=False)
class MotionParts:
    """M motions of a frame, right and down, and which of them each pixel has."""

    vectors_px: FloatArray  # [M, 2]
    labels: IndexArray  # [rows, columns]

    def traces(self) -> list[FloatArray]:
        """PSF of each motion."""
        return [motion_kernel((right, down)) for right, down in self.vectors_px]


def motion_parts(motion_px: FloatArray) -> MotionParts:
    """Most frequent motions of a map [rows, columns, 2]; no motion where it is not finite."""
    known = np.isfinite(motion_px).all(axis=2, keepdims=True)
    coarse = np.rint(np.where(known, motion_px, 0) / _STEP_PX)
    # Blur is the same for both directions along a line.
    right = coarse[..., 0]
    down = coarse[..., 1]
    back = (right < 0) | ((right == 0) & (down < 0))
    coarse = np.where(back[..., None], -coarse, coarse) + 0.0
    found, labels, counts = np.unique(
        coarse.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True
    )
    kept = np.argsort(-counts, kind="stable")[:_MAX_MOTIONS]
    apart = np.minimum(
        *(np.linalg.norm(found[:, None] - sign * found[kept], axis=2) for sign in (1, -1))
    )
    labels = apart.argmin(axis=1)[labels.ravel()].reshape(motion_px.shape[:2])
    return MotionParts((found[kept] * _STEP_PX).astype(np.float32), labels)


class SpreadingBlur(BlurOperator):
    """Blur where each point spreads its light by the PSF of its own depth, and of its motion.

    The columns of the thesis' ``H_d`` (eq. 3.26) are those PSFs. They are combinations ``h_d =
    sum_r c_r(d) k_r`` of R kernels (see `PsfBasis`). Where things move, each part ``S_m`` of the
    scene is convolved with the trace ``t_m`` of its motion too (eq. 7.1 and 7.2)::

        H_d f = sum_m t_m * sum_r k_r * (c_r(d) S_m f)  /  (the same of f = 1)

    with one Fourier transform for each kernel and motion, whatever the number of levels and the
    relief. The denominator, which is 1 on a plane, keeps the brightness near depth edges, where
    light from behind a foreground is missing and that of others takes its place.

    `blur_size_px` [rows, columns] is signed and finite. `motion` has the same size; by default
    nothing moves.
    """

    def __init__(
        self,
        basis: PsfBasis,
        blur_size_px: FloatArray,
        workers: Workers | None = None,
        motion: MotionParts | None = None,
    ) -> None:
        traces = [] if motion is None else motion.traces()
        reach_px = max((len(trace) // 2 for trace in traces), default=0)
        super().__init__(basis, blur_size_px.shape, basis.margin_px + reach_px, workers)
        self._transforms = basis.transforms(self.scene_shape)
        self._steps = basis.table_steps(extend_to_scene(blur_size_px, self))
        self._shares = [np.take(kernel_row, self._steps) for kernel_row in basis.table]
        self._traces = [transfer_function(trace, self.scene_shape) for trace in traces]
        self._parts: list[FloatArray] = []
        if motion is not None:
            labels = extend_to_scene(motion.labels.astype(np.float32), self)
            self._parts = [(labels == part).astype(np.float32) for part in range(len(traces))]
        self._terms = list(np.ndindex(max(len(traces), 1), len(self._shares)))
        self._scale = np.ones(self.shape, np.float32)
        self._scale /= self.forward(np.ones((1, *self.scene_shape), np.float32))

    def _share(self, part: int, kernel: int) -> FloatArray:
        share = self._shares[kernel]
        return share * self._parts[part] if self._parts else share

    def _transform(self, part: int, kernel: int) -> NDArray[np.complex64]:
        transform = self._transforms[kernel]
        return transform * self._traces[part] if self._traces else transform

    def forward(self, scene: FloatArray) -> FloatArray:
        """Frame of a scene."""
        sums = [np.zeros_like(self._transforms[0]) for _ in range(self.workers.threads)]

        def add(term: tuple[int, int], thread: int) -> None:
            spectrum = scipy.fft.rfft2(self._share(*term) * scene[0])
            spectrum *= self._transform(*term)
            sums[thread] += spectrum

        self.workers.each(add, self._terms, sums=True)
        blurred = scipy.fft.irfft2(np.sum(sums, axis=0), self.scene_shape)
        return crop_to_frame(blurred, self) * self._scale

    def adjoint(self, frame: FloatArray) -> FloatArray:
        """Transpose of `forward` applied to a frame."""
        spectrum = scipy.fft.rfft2(extend_to_scene(frame * self._scale, self, cv2.BORDER_CONSTANT))
        sums = [np.zeros(self.scene_shape, np.float32) for _ in range(self.workers.threads)]

        def add(term: tuple[int, int], thread: int) -> None:
            passed = scipy.fft.irfft2(spectrum * self._transform(*term).conj(), self.scene_shape)
            cv2.accumulateProduct(passed, self._share(*term), sums[thread])

        self.workers.each(add, self._terms, sums=True)
        return np.sum(sums, axis=0)[None]

    def ranges(self, count: int) -> list[tuple[FloatArray, FloatArray]]:
        """Shares and powers of ranges of blur sizes, and of motions."""
        ranges = super().ranges(count)
        moving = list(zip(self._parts, self._traces, strict=True))
        return [
            (share * part, power * np.abs(trace) ** 2)
            for share, power in ranges
            for part, trace in moving
        ] or ranges
