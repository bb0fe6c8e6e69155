"""Methods `cg` and `sparse`: the scene that explains the whole frame best, thesis eq. 6.27."""

from typing import Any

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.deblur.blur_map import MODEL_ERROR
from coded_aperture_ros.deblur.iterative import (
    RANGES,
    Fit,
    Iterative,
    Linear,
    conjugate_gradients,
    preconditioner,
)
from coded_aperture_ros.deblur.operator import BlurOperator, frame_within, scene_around
from coded_aperture_ros.deblur.prior import (
    difference_powers,
    differences,
    differences_adjoint,
    quadratic_power,
    sparse_weights,
)

# alpha of colour differences relative to that of brightness, with the quadratic and the sparse
# prior: they have less texture.
_COLOUR_OF_QUADRATIC, _COLOUR_OF_SPARSE = 4.0, 2.0
# Of the quadratic prior: the variance of photographs in linear light. That of most places, which is
# less than that of all, edges included. From the best of several on ray-traced scenes.
_CONTRAST = 0.0025
# Of the sparse one: alpha relative to the standard deviation of what the model leaves unexplained.
# It was best like this from 0.001 to 0.01, not proportional to the variance: the weights of a
# sparse prior already follow the noise that is left in the solution.
_ALPHA = 4.5
# Iterations between two updates of the prior's weights, and the tolerance for one set of weights,
# relative to the configured one.
_INNER, _OF_ONE_SET = 8, 0.01
# Residual, in units of the noise, from which a pixel's depth is taken for wrong, and how far around
# a pixel it is looked at, px.
_MISFIT, _MISFIT_OF_EXACT_DEPTH, _MISFIT_REACH_PX = 2.0, 2.8, 1.2
# Discrepancy principle: while more is left unexplained than so many times the noise, alpha is too
# large, and becomes so much smaller with every set of weights, as far as the noise alone asks for.
_DISCREPANCY, _LESS = 1.2, 0.7
# Rounding of a frame to 8 bits, about: the least noise that is reckoned with.
_LEAST_NOISE = 0.0002
# Turns the median absolute value of a normal distribution into its standard deviation.
_MEDIAN_TO_STD = 1.4826


class ConjugateGradients(Iterative):
    """The quadratic prior: one linear system for each channel; see `Method`."""

    runs_on_torch = True
    # Occlusion would take 1.7 times as long for nothing: the iterations stop early.

    def minimise(self, fit: Fit) -> list[FloatArray]:
        """Return the channels of the sharp scene within the frame."""
        return restore_quadratic(fit)[0]


def restore_quadratic(fit: Fit) -> tuple[list[FloatArray], int]:
    """Minimise ``||g - H_d f||^2 + alpha ||Sigma f||^2`` by conjugate gradients.

    ``alpha`` is the variance of the noise, and of the model's error, over that of photographs. The
    preconditioner solves the problem in the Fourier domain, for each of some ranges of blur sizes.
    Returns the channels, and the most iterations that one took.
    """
    operator = fit.operator
    alpha = float(fit.config.smoothness * (fit.noise**2 + MODEL_ERROR**2) / _CONTRAST)
    power = operator.array(quadratic_power(operator.scene_shape))
    ranges, trusted = operator.ranges(RANGES), operator.array(fit.weight)
    restored, most = [], 0
    for number, (coded, begin) in enumerate(zip(fit.channels, fit.start, strict=True)):
        penalty = (_COLOUR_OF_QUADRATIC if number else 1.0) * alpha * power
        scene, needed = conjugate_gradients(
            _system(operator, trusted, _smoothness(operator.fft, penalty)),
            operator.adjoint(trusted * operator.array(coded)),
            operator.array(scene_around(begin, operator)),
            preconditioner(fit, ranges, float(fit.weight.mean()), penalty),
            fit.config.tolerance,
            fit.config.iterations,
        )
        restored.append(frame_within(operator.to_numpy(scene), operator))
        most = max(most, needed)
    return restored, most


class Sparse(Iterative):
    """The prior of sharp edges, and occlusion; see `Method`."""

    gains_by_occlusion = True

    def minimise(self, fit: Fit) -> list[FloatArray]:
        """Return the channels of the sharp scene within the frame."""
        return restore_sparse(fit)


def restore_sparse(fit: Fit) -> list[FloatArray]:
    """Minimise ``||g - H_d f||^2 + alpha sum |D f|^0.7`` by reweighted least squares.

    Every few iterations the prior's weights follow the solution (see `sparse_weights`), and pixels
    that no sharp scene can explain, because their depth is wrong, lose their weight. The channels
    share their edges. A hundredth of the tolerance is for one set of weights, which begins near its
    solution.
    """
    operator, channels, noise, config = fit.operator, fit.channels, fit.noise, fit.config
    # What is seen of brightness in all channels together has less noise than each of them.
    together = noise / float(np.sqrt(len(channels)))
    alpha = config.smoothness * _ALPHA * float(np.hypot(together, MODEL_ERROR))
    least = config.smoothness * _ALPHA * float(np.hypot(together, _LEAST_NOISE))
    misfit = _MISFIT if config.edge_reach else _MISFIT_OF_EXACT_DEPTH
    allowed = misfit * float(np.hypot(together, MODEL_ERROR / np.sqrt(2)))
    ranges, powers = operator.ranges(RANGES), difference_powers(operator.scene_shape)
    scenes = [scene_around(begin, operator) for begin in fit.start]
    trusted = fit.weight
    for done in range(0, config.iterations, _INNER):
        if done:
            pairs = zip(channels, scenes, strict=True)
            left = [coded - operator.forward(scene) for coded, scene in pairs]
            trusted = fit.weight * _explained(left, noise, allowed)
            # Not before the larger alpha has nearly been solved, which takes fewer iterations.
            unexplained = _MEDIAN_TO_STD * np.median(np.abs(left[0])) > _DISCREPANCY * noise
            if unexplained and done >= config.iterations // 2:
                alpha = max(least, _LESS * alpha)
        edges = sparse_weights(scenes)
        # The weights' typical size: between the arithmetic mean, of smooth areas, and the harmonic
        # one, of edges.
        typical = [np.sqrt(of_filter.mean() / (1 / of_filter).mean()) for of_filter in edges]
        penalty = sum(size * power for size, power in zip(typical, powers, strict=True))
        for channel, coded in enumerate(channels):
            strength = np.float32(alpha * (_COLOUR_OF_SPARSE if channel else 1.0))
            scenes[channel], _ = conjugate_gradients(
                _system(operator, trusted, _sparseness([strength * each for each in edges])),
                operator.adjoint(trusted * coded),
                scenes[channel],
                preconditioner(fit, ranges, float(trusted.mean()), strength * penalty),
                _OF_ONE_SET * config.tolerance,
                min(_INNER, config.iterations - done),
            )
    return [frame_within(scene, operator) for scene in scenes]


def _system(operator: BlurOperator, weight: Any, prior: Linear) -> Linear:
    """Return the gradient (thesis eq. 6.28), with that of the prior, less its constant part."""
    return lambda scene: operator.adjoint(weight * operator.forward(scene)) + prior(scene)


def _smoothness(fft: Any, penalty: Any) -> Linear:
    return lambda scene: fft.irfft2(penalty * fft.rfft2(scene), scene.shape)


def _sparseness(edges: list[FloatArray]) -> Linear:
    def prior(scene: FloatArray) -> FloatArray:
        parts = [each * part for each, part in zip(edges, differences(scene), strict=True)]
        return differences_adjoint(parts)

    return prior


def _explained(residuals: list[FloatArray], noise: float, allowed: float) -> FloatArray:
    """Return how far the frame is explained at every pixel, 0 to 1."""
    squared = np.mean([residual**2 for residual in residuals], axis=0)
    misfit = cv2.GaussianBlur(squared, (0, 0), _MISFIT_REACH_PX)
    return 1 / (1 + np.maximum(misfit - np.float32(noise**2), 0) / np.float32(allowed**2))
