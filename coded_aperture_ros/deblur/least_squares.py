"""Methods `cg` and `sparse`: the scene that explains the whole frame best, thesis eq. 6.27."""

import dataclasses
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.deblur.blur_map import MODEL_ERROR
from coded_aperture_ros.deblur.iterative import (
    RANGES,
    Fit,
    Linear,
    conjugate_gradients,
    preconditioner,
)
from coded_aperture_ros.deblur.operator import BlurOperator, crop_to_frame
from coded_aperture_ros.deblur.prior import SparsePrior

# alpha of colour differences relative to that of brightness: they have less texture.
_COLOUR_ALPHA_FACTOR = 3.0
# alpha relative to the standard deviation of what the model leaves unexplained.
# It was best like this from 0.001 to 0.01, not proportional to the variance: the weights of a
# sparse prior already follow the noise that is left in the solution. More with occlusion, where the
# depth is estimated: from the best on random scenes.
_ALPHA = 4.5
_ALPHA_WITH_OCCLUSION = 5.5
# Smallest noise: about the rounding of a frame to 8 bits, linear light.
_MIN_NOISE = 0.0002
# Discrepancy principle, where the PSFs are all that the model has: while more is left unexplained
# than so many times the noise, alpha is too large, and becomes so much smaller with every set of
# weights. Not before the larger alpha has nearly been solved, which takes fewer iterations.
_DISCREPANCY = 1.2
_ALPHA_REDUCTION = 0.7
# Turns the median absolute value of a normal distribution into its standard deviation.
_MEDIAN_TO_STD = 1.4826
# Iterations between two updates of the prior's weights, and in all: of `cg`, of `sparse`, and of
# `sparse` without occlusion in the model, which has to find alpha.
_CG_ITERATIONS = (4, 8)
_SPARSE_ITERATIONS = (8, 32)
_SEARCH_ITERATIONS = (8, 112)
# The tolerance for one set of weights, relative to the configured one.
_INNER_TOLERANCE = 0.01
# Residual, in units of the noise, from which a pixel's depth is taken for wrong, and how far around
# a pixel it is looked at, px.
_MISFIT = 2.5
_MISFIT_REACH_PX = 1.2
# Factor of `_MISFIT` for the start of `cg`: what few steps would explain by ringing, such as rods
# that the depth misses, is to be excluded before. `sparse` finds out by itself.
_START_MISFIT_FACTOR = 4.0
# Mean weight of a frame without usable pixels, so that nothing is divided by 0.
_MIN_WEIGHT = 1e-3
# Strength that holds a scene near what is expected around unexplained pixels, relative to that of
# the data of a pixel without blur; and the radius around them, px.
_HOLD_STRENGTH = np.float32(0.003)
_HOLD_RADIUS_PX = 9


def solve_least_squares(fit: Fit) -> list[FloatArray]:
    """Channels of the sharp scene [rows, columns], after few steps from the closed forms."""
    interval, iterations = _CG_ITERATIONS
    check_start = fit.operator.hidden is not None
    return restore_sparse(fit, fit.config.iterations or iterations, interval, check_start)


def solve_sparse(fit: Fit) -> list[FloatArray]:
    """Channels of the sharp scene [rows, columns] that the sparse prior prefers."""
    with_occlusion = fit.operator.hidden is not None
    interval, iterations = _SPARSE_ITERATIONS if with_occlusion else _SEARCH_ITERATIONS
    return restore_sparse(fit, fit.config.iterations or iterations, interval)


def restore_sparse(
    fit: Fit, iterations: int, interval: int, check_start: bool = False
) -> list[FloatArray]:
    """Channels [rows, columns] of the minimum of ``||g - H_d f||^2 + alpha sum |D f|^0.7``.

    By iteratively reweighted least squares. After each `interval` iterations the prior's weights
    follow the solution (see `SparsePrior`), and pixels that no sharp scene can explain, because
    their depth is wrong, lose their weight: the scene is held near `Fit.expected` there; with
    `check_start`, before the first iteration too. The channels share their edges.
    """
    operator = fit.operator
    # What is seen of brightness in all channels together has less noise than each of them.
    mean_noise = fit.noise / float(np.sqrt(len(fit.channels)))
    unexplained = float(np.hypot(mean_noise, MODEL_ERROR))
    least = float(np.hypot(mean_noise, _MIN_NOISE))
    misfit_limit = _MISFIT * float(np.hypot(mean_noise, MODEL_ERROR))
    ranges = operator.ranges(RANGES)
    scenes = [operator.extend(begin) for begin in fit.start]
    expected = [operator.extend(each) for each in fit.expected]
    # Without occlusion in the model it is that of one plane, or of known motion: exact.
    exact = operator.hidden is None
    hold = np.float32(0) if exact else _HOLD_STRENGTH
    trusted = fit.weight
    steps = iter(fit.progress(range(iterations * len(fit.channels))))
    for done in range(0, iterations, interval):
        if done or check_start or fit.clipped is not None:
            residuals, trusted = _residuals(fit, scenes)
        if done or check_start:
            limit = misfit_limit if done else _START_MISFIT_FACTOR * misfit_limit
            explained = _explained_share(residuals, fit.noise, limit)
            trusted = trusted * (explained if exact else explained**2)
        if done:
            found = _MEDIAN_TO_STD * float(np.median(np.abs(residuals[0])))
            if not exact:  # the model may be better than it usually is
                unexplained = max(least, min(unexplained, found))
            elif found > _DISCREPANCY * fit.noise and done >= iterations // 2:
                unexplained = max(least, _ALPHA_REDUCTION * unexplained)
        radius = (_HOLD_RADIUS_PX, _HOLD_RADIUS_PX)
        held = operator.extend(cv2.blur(hold * (1 - trusted), radius))
        sparse = SparsePrior(scenes, operator.hidden)
        alpha = fit.config.smoothness * (_ALPHA if exact else _ALPHA_WITH_OCCLUSION) * unexplained
        quadratic = _Quadratic(fit, sparse, alpha, trusted, held, ranges)
        count = min(interval, iterations - done)
        for channel, scene in enumerate(scenes):
            scenes[channel] = quadratic.minimum(channel, scene, expected[channel], count, steps)
    return [crop_to_frame(scene, operator)[0] for scene in scenes]


def _residuals(fit: Fit, scenes: list[FloatArray]) -> tuple[list[FloatArray], FloatArray]:
    """Residual of each channel [rows, columns], and the weight of the pixels [rows, columns]."""
    pairs = zip(fit.channels, scenes, strict=True)
    residuals = [coded - fit.operator.forward(scene) for coded, scene in pairs]
    if fit.clipped is None:
        return residuals, fit.weight
    # Of saturated pixels only this is known: the scene must not be too dark for them.
    too_dark = fit.clipped & (residuals[0] > 0)
    weight = np.where(too_dark, np.float32(1), fit.weight)
    return [np.where(fit.clipped & ~too_dark, 0, part) for part in residuals], weight


@dataclasses.dataclass(frozen=True, eq=False)
class _Quadratic:
    """Quadratic function of one set of weights; see `restore_sparse`."""

    fit: Fit
    sparse: SparsePrior
    alpha: float  # of brightness
    weight: FloatArray  # of the frame's pixels [rows, columns]
    held: FloatArray  # strength towards what is expected [planes, *scene_shape]
    ranges: list[tuple[FloatArray, FloatArray]]  # see `BlurOperator.ranges`

    @cached_property
    def _usual_weight(self) -> float:
        return max(float(self.weight.mean()), _MIN_WEIGHT)

    @cached_property
    def _penalty(self) -> FloatArray:
        return self.sparse.power(self.fit.operator.scene_shape)

    @cached_property
    def _hidden_diagonal(self) -> FloatArray | float:
        return self.sparse.hidden_diagonal() if self.fit.operator.hidden is not None else 1.0

    def minimum(
        self,
        channel: int,
        start: FloatArray,
        expected: FloatArray,
        iterations: int,
        steps: Iterator[int],
    ) -> FloatArray:
        """Scene [planes, *scene_shape] of a channel, after so many iterations from `start`."""
        operator = self.fit.operator
        factor = _COLOUR_ALPHA_FACTOR if channel else 1.0
        strength = np.float32(self.alpha * factor)
        right_side = operator.adjoint(self.weight * self.fit.channels[channel])
        right_side += self.held * expected

        def prior(scene: FloatArray) -> FloatArray:
            return strength * self.sparse(scene) + self.held * scene

        near_inverse = preconditioner(
            self.fit,
            self.ranges,
            self._usual_weight,
            strength * self._penalty,
            strength * self._hidden_diagonal,
        )
        scene, _ = conjugate_gradients(
            _normal_operator(operator, self.weight, prior),
            right_side,
            start,
            near_inverse,
            self.fit.config.tolerance * _INNER_TOLERANCE,
            iterations,
            steps,
        )
        return np.asarray(scene)


def _normal_operator(operator: BlurOperator, weight: Any, prior: Linear) -> Linear:
    """Gradient (thesis eq. 6.28) of data and prior, without its constant part."""
    return lambda scene: operator.adjoint(weight * operator.forward(scene)) + prior(scene)


def _explained_share(residuals: list[FloatArray], noise: float, misfit_limit: float) -> FloatArray:
    """Share of the frame that is explained at each pixel, 0 to 1."""
    squared = np.mean([residual**2 for residual in residuals], axis=0)
    misfit = cv2.GaussianBlur(squared, (0, 0), _MISFIT_REACH_PX)
    return 1 / (1 + np.maximum(misfit - np.float32(noise**2), 0) / np.float32(misfit_limit**2))
