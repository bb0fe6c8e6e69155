"""Methods that solve for the whole frame at once, by conjugate gradients."""

import dataclasses
from collections.abc import Callable, Iterable
from itertools import repeat
from typing import Any

import cv2
import numpy as np
import scipy.fft

from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.blend import Blend
from coded_aperture_ros.deblur.blur_map import filled_blur_map, model_weight
from coded_aperture_ros.deblur.config import DeblurConfig
from coded_aperture_ros.deblur.fast import ClosedForm
from coded_aperture_ros.deblur.occlusion import OccludedBlur
from coded_aperture_ros.deblur.operator import BlurOperator, SpreadingBlur, motion_parts
from coded_aperture_ros.deblur.problem import Problem, VideoState, from_opponents
from coded_aperture_ros.deblur.psf_basis import PsfBasis

# Largest memory of the weights of occlusion with `auto`, bytes.
_MAX_OCCLUSION_BYTES = 512 * 2**20
# How much of what is hidden is seen, about.
_HIDDEN_VISIBILITY = 0.02
# How much of the blend there is in the result, where the depth is known and where it is not, and
# how far around that is looked at, px. They are wrong in other places: the mean gains up to
# 0.4 dB with estimated depth, and loses nothing with the true one.
_BLEND_SHARE = 0.1
_BLEND_SHARE_IN_GAPS = 0.6
_GAP_PX = 9
# Number of ranges of blur sizes in the preconditioners.
RANGES = 4
# From an array to one of its shape.
Linear = Callable[[Any], Any]


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """Frame to be explained by a sharp scene: ``min ||g - H_d f||^2 + alpha prior(f)``."""

    operator: BlurOperator  # H_d
    channels: list[FloatArray]  # g [rows, columns]: brightness and colour differences
    weight: FloatArray  # how much every pixel of the frame counts, 0 to 1
    start: list[FloatArray]  # where to begin, such as the last frame's result
    expected: list[FloatArray]  # what the scene is about
    noise: float  # standard deviation
    config: DeblurConfig  # with a factor of alpha, and when to stop
    progress: Progress = iter
    clipped: BoolArray | None = None  # pixels whose brightness is at least g's, if any


class Iterative:
    """`Method` that minimises thesis eq. 6.27, beginning with the closed form.

    `minimise` returns the channels of the sharp scene within the frame.
    """

    reduction = 1
    edge_reach_px = 0
    removes_motion = True

    def __init__(
        self,
        minimise: Callable[[Fit], list[FloatArray]],
        config: DeblurConfig,
        closed_form: ClosedForm,
        blend: Blend | None,
        basis: Callable[[], PsfBasis],  # it takes time to make the first time
        workers: Workers,
    ) -> None:
        self._minimise = minimise
        self._basis = basis
        self._workers = workers
        self._config = config
        self._closed_form = closed_form
        self._blend = blend

    def restore(self, problem: Problem, video: VideoState) -> FloatArray:
        """All-in-focus frame; see `Method`."""
        count = problem.frame_count
        most = float(np.max(count))
        noise = problem.noise / float(np.sqrt(most))
        blur = problem.blur_size_px
        motion = problem.motion_px
        operator = blur_operator(self._basis(), blur, self._workers, self._config.occlusion, motion)
        weight = problem.measured * (count / np.float32(most))
        if operator.hidden is None:
            weight = weight * model_weight(problem.blur_size_px, noise)
        closed_forms = self._closed_forms(problem, noise)
        restored = self._minimise(
            Fit(
                operator,
                problem.channels,
                weight,
                video.start(closed_forms, np.broadcast_to(count, operator.shape)),
                closed_forms,
                noise,
                self._config,
                problem.progress,
                problem.clipped if problem.clipped.any() else None,
            )
        )
        video.keep(restored)
        if self._blend_for(problem) is not None:
            known = cv2.blur(problem.known.astype(np.float32), (_GAP_PX, _GAP_PX))
            share = _BLEND_SHARE_IN_GAPS + np.float32(_BLEND_SHARE - _BLEND_SHARE_IN_GAPS) * known
            pairs = zip(restored, closed_forms, strict=True)
            restored = [each + share * (blend - each) for each, blend in pairs]
        return from_opponents(restored)

    def _closed_forms(self, problem: Problem, noise: float) -> list[FloatArray]:
        """Closed-form estimate of each channel."""
        blur = problem.blur_size_px
        channels = problem.channels
        if (blend := self._blend_for(problem)) is not None:
            return blend.restore(channels, blur, problem.known, noise)
        # Edges that are too sharp are found and lost again more easily than blurred ones.
        small = filled_blur_map(blur, channels[0], self._closed_form.reduction)
        return self._closed_form.restore(channels, small, noise / 3)

    def _blend_for(self, problem: Problem) -> Blend | None:
        return self._blend if problem.motion_px is None else None


def blur_operator(
    basis: PsfBasis,
    blur_size_px: FloatArray,
    workers: Workers,
    occlusion: str = "auto",
    motion_px: FloatArray | None = None,
) -> BlurOperator:
    """Blur operator of a scene with these blur sizes; see `DeblurConfig` for `occlusion`."""
    if motion_px is not None:
        return SpreadingBlur(basis, blur_size_px, workers, motion_parts(motion_px))
    # It needs to know what is in front, and memory.
    fits = basis.in_pixels and basis.kernels[0].size * blur_size_px.size <= _MAX_OCCLUSION_BYTES
    modelled = {"yes": True, "no": False, "auto": fits}
    if modelled[occlusion]:
        return OccludedBlur(basis, blur_size_px, workers)
    return SpreadingBlur(basis, blur_size_px, workers)


def preconditioner(
    fit: Fit, ranges: list[tuple[Any, Any]], weight: float, penalty: Any, hidden_diagonal: Any
) -> Linear:
    """Approximate inverse of a system.

    In each range of blur sizes it is one Fourier transform; the second plane, of which little is
    seen, is divided by its diagonal.
    """
    operator = fit.operator
    inverses = [(share, 1 / (weight * power + penalty)) for share, power in ranges]

    def solve(scene: Any) -> Any:
        sums = [0 * scene[0] for _ in range(operator.workers.threads)]

        def add(one_range: tuple[Any, Any], thread: int) -> None:
            share, inverse = one_range
            spectrum = scipy.fft.rfft2(share * scene[0])
            solved = scipy.fft.irfft2(inverse * spectrum, scene[0].shape)
            sums[thread] += share * solved

        operator.workers.each(add, inverses, sums=True)
        front = sum(sums[1:], sums[0])
        if operator.hidden is None:
            return front[None]
        return np.stack(
            [front, operator.hidden * scene[1] / (_HIDDEN_VISIBILITY + hidden_diagonal)]
        )

    return solve


def conjugate_gradients(
    system: Linear,
    right_side: Any,
    start: Any,
    preconditioner: Linear,
    tolerance: float,
    iterations: int,
    steps: Iterable[Any] = repeat(None),
) -> tuple[Any, int]:
    """Solution of ``system(x) = right_side``, and the number of iterations.

    Stops when the gradient (thesis eq. 6.28) is below `tolerance` times the right side's norm, or
    after so many iterations. `system`, and its approximate inverse `preconditioner`, are linear,
    symmetric and positive definite. Arrays are float32. Each iteration takes one of `steps`.
    """
    solution = start + 0
    residual = right_side - system(solution)
    enough = tolerance**2 * _inner_product(right_side, right_side)
    direction = 0 * solution
    last = 1.0
    for iteration, _ in zip(range(iterations), steps, strict=False):
        if _inner_product(residual, residual) <= enough:
            return solution, iteration
        conditioned = preconditioner(residual)
        product = _inner_product(residual, conditioned)
        direction *= product / last if iteration else 0
        direction += conditioned
        last = product
        image = system(direction)
        step = product / _inner_product(direction, image)
        solution += step * direction
        residual -= step * image
    return solution, iterations


def _inner_product(first: Any, second: Any) -> float:
    return float((first * second).sum())
