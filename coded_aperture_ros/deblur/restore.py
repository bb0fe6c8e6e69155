"""The sharp scene that explains a coded frame best: thesis eq. 6.27, solved exactly."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.deblur.blur_map import MODEL_ERROR
from coded_aperture_ros.deblur.conjugate import Linear, conjugate_gradients
from coded_aperture_ros.deblur.operator import BlurOperator, frame_within, scene_around
from coded_aperture_ros.deblur.prior import (
    difference_powers,
    differences,
    differences_adjoint,
    quadratic_power,
    sparse_weights,
)

# Variance of photographs in linear light, for the quadratic prior: that of most places, which is
# less than that of all, edges included. From the best of several on ray-traced scenes.
_CONTRAST = 0.0025
# alpha of the sparse prior, relative to the standard deviation of what the model leaves
# unexplained.
# It was best like this from 0.001 to 0.01, not proportional to the variance: the weights of a
# sparse prior already follow the noise that is left in the solution.
_SPARSE_ALPHA = 4.5
# alpha of colour differences relative to that of brightness: they have less texture. A quadratic
# prior needs more, since it does not know from the brightness where edges are.
_OF_COLOUR, _OF_COLOUR_QUADRATIC = 2.0, 4.0
# Iterations between two updates of the sparse prior's weights.
_INNER = 8
# Tolerance for one set of weights, relative to the configured one.
_OF_ONE_SET = 0.01
# Ranges of blur sizes that the preconditioners tell apart.
_RANGES = 4
# How far around a pixel its residual is looked at, px.
_MISFIT_REACH_PX = 1.2
# Discrepancy principle: while more is left unexplained than so many times the noise, alpha is too
# large, and becomes so much smaller with every set of weights, as far as the noise alone asks for.
_DISCREPANCY, _LESS = 1.2, 0.7
# Rounding of a frame to 8 bits, about: the least noise that is reckoned with.
_LEAST_NOISE = 0.0002
# Turns the median absolute value of a normal distribution into its standard deviation.
_MEDIAN_TO_STD = 1.4826


def restore_quadratic(
    operator: BlurOperator,
    channels: list[NDArray[np.float32]],
    weight: NDArray[np.float32],
    start: list[NDArray[np.float32]],
    noise: float,
    smoothness: float,
    tolerance: float,
    iterations: int,
) -> tuple[list[NDArray[np.float32]], int]:
    """Minimise ``||g - H_d f||^2 + alpha ||Sigma f||^2`` by conjugate gradients.

    ``alpha`` is the variance of the noise, and of the model's error, over that of photographs. The
    preconditioner solves the problem in the Fourier domain, for each of some ranges of blur sizes.

    Parameters
    ----------
    operator : BlurOperator
        ``H_d``.
    channels : list of ndarray, float32 [rows, columns]
        ``g``; independent of each other here.
    weight : ndarray, float32 [rows, columns]
        How much every pixel of the frame counts, 0 to 1.
    start : list of ndarray, float32 [rows, columns]
        Where to begin, such as the last frame's result.
    noise : float
        Standard deviation.
    smoothness : float
        Factor of ``alpha``.
    tolerance : float
        Norm of the gradient (eq. 6.28) at which to stop, relative to that of ``H_d^T g``.
    iterations : int
        At most so many for each channel.

    Returns
    -------
    channels : list of ndarray, float32 [rows, columns]
    iterations : int
        The most that a channel took.
    """
    alpha = float(smoothness * (noise**2 + MODEL_ERROR**2) / _CONTRAST)
    power = operator.array(quadratic_power(operator.scene_shape))
    ranges, trusted = operator.ranges(_RANGES), operator.array(weight)
    restored, most = [], 0
    for number, (coded, begin) in enumerate(zip(channels, start, strict=True)):
        prior = (_OF_COLOUR_QUADRATIC if number else 1.0) * alpha * power
        scene, needed = conjugate_gradients(
            _quadratic_system(operator, trusted, prior),
            operator.adjoint(trusted * operator.array(coded)),
            operator.array(scene_around(begin, operator)),
            _preconditioner(ranges, float(weight.mean()), prior, operator),
            tolerance,
            iterations,
        )
        restored.append(frame_within(operator.to_numpy(scene), operator))
        most = max(most, needed)
    return restored, most


def _quadratic_system(operator: BlurOperator, weight: Any, prior: Any) -> Linear:
    """Return the gradient (thesis eq. 6.28) less its constant part."""
    fft = operator.fft

    def system(scene: Any) -> Any:
        data = operator.adjoint(weight * operator.forward(scene))
        return data + fft.irfft2(prior * fft.rfft2(scene), scene.shape)

    return system


def restore_sparse(
    operator: BlurOperator,
    channels: list[NDArray[np.float32]],
    weight: NDArray[np.float32],
    start: list[NDArray[np.float32]],
    noise: float,
    smoothness: float,
    tolerance: float,
    iterations: int,
    misfit: float = 2.8,
) -> tuple[list[NDArray[np.float32]], int]:
    """Minimise ``||g - H_d f||^2 + alpha sum |D f|^0.7`` by reweighted least squares.

    Every few iterations the prior's weights follow the solution (see `sparse_weights`), and pixels
    that no sharp scene can explain, because their depth is wrong, lose their weight.

    Parameters and results are those of `restore_quadratic`; the channels share their edges. A
    hundredth of the tolerance is for one set of weights, which begins near its solution. `misfit`
    is the residual, in units of the noise, from which a pixel's depth is rather taken for wrong.
    """
    # What is seen of brightness in all channels together has less noise than each of them.
    together = noise / float(np.sqrt(len(channels)))
    alpha = smoothness * _SPARSE_ALPHA * float(np.hypot(together, MODEL_ERROR))
    least = smoothness * _SPARSE_ALPHA * float(np.hypot(together, _LEAST_NOISE))
    shape = operator.scene_shape
    allowed = misfit * float(np.hypot(together, MODEL_ERROR / np.sqrt(2)))
    ranges, powers = operator.ranges(_RANGES), difference_powers(shape)
    scenes = [scene_around(begin, operator) for begin in start]
    trusted = weight
    for done in range(0, iterations, _INNER):
        if done:
            left = [
                coded - operator.forward(scene)
                for coded, scene in zip(channels, scenes, strict=True)
            ]
            trusted = weight * _explained(left, noise, allowed)
            # Not before the larger alpha has nearly been solved, which takes fewer iterations.
            unexplained = _MEDIAN_TO_STD * np.median(np.abs(left[0])) > _DISCREPANCY * noise
            if unexplained and done >= iterations // 2:
                alpha = max(least, _LESS * alpha)
        edges = sparse_weights(scenes)
        # The weights' typical size: between the arithmetic mean, of smooth areas, and the harmonic
        # one, of edges.
        typical = [np.sqrt(of_filter.mean() / (1 / of_filter).mean()) for of_filter in edges]
        penalty = sum(size * power for size, power in zip(typical, powers, strict=True))
        for channel, coded in enumerate(channels):
            strength = np.float32(alpha * (_OF_COLOUR if channel else 1.0))
            scenes[channel], _ = conjugate_gradients(
                _sparse_system(operator, trusted, [strength * of_filter for of_filter in edges]),
                operator.adjoint(trusted * coded),
                scenes[channel],
                _preconditioner(ranges, float(trusted.mean()), strength * penalty, operator),
                _OF_ONE_SET * tolerance,
                min(_INNER, iterations - done),
            )
    return [frame_within(scene, operator) for scene in scenes], iterations


def _sparse_system(
    operator: BlurOperator, weight: NDArray[np.float32], edges: list[NDArray[np.float32]]
) -> Linear:
    """Return the gradient (thesis eq. 6.28), for one set of weights, less its constant part."""

    def system(scene: NDArray[np.float32]) -> NDArray[np.float32]:
        data = operator.adjoint(weight * operator.forward(scene))
        parts = [each * part for each, part in zip(edges, differences(scene), strict=True)]
        return data + differences_adjoint(parts)

    return system


def _preconditioner(
    ranges: list[tuple[Any, Any]], weight: float, penalty: Any, operator: BlurOperator
) -> Linear:
    """Return what nearly solves a system: in each range of blur sizes by one Fourier transform."""
    fft, workers = operator.fft, operator.workers
    inverses = [(share, 1 / (weight * power + penalty)) for share, power in ranges]

    def solve(scene: Any) -> Any:
        sums = [0 * scene for _ in range(workers.threads)]

        def add(of_range: tuple[Any, Any], thread: int) -> None:
            share, inverse = of_range
            solved = fft.irfft2(inverse * fft.rfft2(share * scene), scene.shape)
            sums[thread] += share * solved

        workers.each(add, inverses)
        return sum(sums[1:], sums[0])

    return solve


def _explained(
    residuals: list[NDArray[np.float32]], noise: float, allowed: float
) -> NDArray[np.float32]:
    """Return how far the frame is explained at every pixel, 0 to 1."""
    squared = np.mean([residual**2 for residual in residuals], axis=0)
    misfit = cv2.GaussianBlur(squared, (0, 0), _MISFIT_REACH_PX)
    return 1 / (1 + np.maximum(misfit - np.float32(noise**2), 0) / np.float32(allowed**2))
