"""Method `sparse`: the scene with sharp edges that explains the whole frame best."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.deblur.blur_map import MODEL_ERROR
from coded_aperture_ros.deblur.conjugate import Linear, conjugate_gradients
from coded_aperture_ros.deblur.iterative import RANGES, Fit, Iterative, preconditioner
from coded_aperture_ros.deblur.operator import BlurOperator, frame_within, scene_around
from coded_aperture_ros.deblur.prior import (
    difference_powers,
    differences,
    differences_adjoint,
    sparse_weights,
)

# alpha relative to the standard deviation of what the model leaves unexplained. It was best like
# this from 0.001 to 0.01, not proportional to the variance: the weights of a sparse prior already
# follow the noise that is left in the solution.
_ALPHA = 4.5
# alpha of colour differences relative to that of brightness: they have less texture.
_OF_COLOUR = 2.0
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


class Sparse(Iterative):
    """The prior of sharp edges, and occlusion; see `Method`."""

    gains_by_occlusion = True

    def minimise(self, fit: Fit) -> list[NDArray[np.float32]]:
        """Return the channels of the sharp scene within the frame."""
        return restore_sparse(fit)


def restore_sparse(fit: Fit) -> list[NDArray[np.float32]]:
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
            strength = np.float32(alpha * (_OF_COLOUR if channel else 1.0))
            scenes[channel], _ = conjugate_gradients(
                _system(operator, trusted, [strength * of_filter for of_filter in edges]),
                operator.adjoint(trusted * coded),
                scenes[channel],
                preconditioner(fit, ranges, float(trusted.mean()), strength * penalty),
                _OF_ONE_SET * config.tolerance,
                min(_INNER, config.iterations - done),
            )
    return [frame_within(scene, operator) for scene in scenes]


def _system(
    operator: BlurOperator, weight: NDArray[np.float32], edges: list[NDArray[np.float32]]
) -> Linear:
    """Return the gradient (thesis eq. 6.28), for one set of weights, less its constant part."""

    def system(scene: NDArray[np.float32]) -> NDArray[np.float32]:
        data = operator.adjoint(weight * operator.forward(scene))
        parts = [each * part for each, part in zip(edges, differences(scene), strict=True)]
        return data + differences_adjoint(parts)

    return system


def _explained(
    residuals: list[NDArray[np.float32]], noise: float, allowed: float
) -> NDArray[np.float32]:
    """Return how far the frame is explained at every pixel, 0 to 1."""
    squared = np.mean([residual**2 for residual in residuals], axis=0)
    misfit = cv2.GaussianBlur(squared, (0, 0), _MISFIT_REACH_PX)
    return 1 / (1 + np.maximum(misfit - np.float32(noise**2), 0) / np.float32(allowed**2))
