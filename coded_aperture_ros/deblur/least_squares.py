"""Methods `cg` and `sparse`: the scene that explains the whole frame best, thesis eq. 6.27."""

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
from coded_aperture_ros.deblur.operator import BlurOperator, frame_within
from coded_aperture_ros.deblur.prior import SparsePrior

# alpha of colour differences relative to that of brightness: they have less texture.
_COLOUR = 3.0
# alpha relative to the standard deviation of what the model leaves unexplained.
# It was best like this from 0.001 to 0.01, not proportional to the variance: the weights of a
# sparse prior already follow the noise that is left in the solution. More with occlusion, where the
# depth is estimated: from the best on random scenes.
_ALPHA = 4.5
_ALPHA_OF_ESTIMATED = 5.5
# Rounding of a frame to 8 bits, about: the least noise that is reckoned with.
_LEAST_NOISE = 0.0002
# Discrepancy principle, where the PSFs are all that the model has: while more is left unexplained
# than so many times the noise, alpha is too large, and becomes so much smaller with every set of
# weights. Not before the larger alpha has nearly been solved, which takes fewer iterations.
_DISCREPANCY = 1.2
_LESS = 0.7
# Turns the median absolute value of a normal distribution into its standard deviation.
_MEDIAN_TO_STD = 1.4826
# Of `cg` and of `sparse`: iterations between two updates of the prior's weights, and of all.
# Without occlusion in the model alpha is looked for, which takes more of them.
_FEW = (4, 8)
_MANY = (8, 32)
_LOOKING = (8, 112)
# The tolerance for one set of weights, relative to the configured one.
_OF_ONE_SET = 0.01
# Residual, in units of the noise, from which a pixel's depth is taken for wrong, and how far around
# a pixel it is looked at, px.
_MISFIT = 2.5
_MISFIT_REACH_PX = 1.2
# So many times as much may be left by where `cg` begins: what a few steps would explain by ringing,
# such as rods that the depth misses, has to be known before. `sparse` finds out by itself.
_AT_FIRST = 4.0
# Of a frame none of whose pixels counts, so that nothing is divided by 0.
_LEAST_WEIGHT = 1e-3
# How strongly a scene is held near what is expected where its pixels are not explained, relative
# to a pixel that is not blurred; and how far around them, px.
_HELD = np.float32(0.003)
_HELD_PX = 9


def solve_least_squares(fit: Fit) -> list[FloatArray]:
    """Restore a frame in a few steps from the closed forms."""
    wary = fit.operator.hidden is not None
    return restore_sparse(fit, fit.config.iterations or _FEW[1], _FEW[0], wary)


def solve_sparse(fit: Fit) -> list[FloatArray]:
    """Restore a frame until the prior of sharp edges changes little."""
    between, iterations = _MANY if fit.operator.hidden is not None else _LOOKING
    return restore_sparse(fit, fit.config.iterations or iterations, between)


def restore_sparse(fit: Fit, iterations: int, between: int, wary: bool = False) -> list[FloatArray]:
    """Minimise ``||g - H_d f||^2 + alpha sum |D f|^0.7`` by reweighted least squares.

    After each `between` iterations the prior's weights follow the solution (see `SparsePrior`), and
    pixels that no sharp scene can explain, because their depth is wrong, lose their weight: what is
    there is held near `Fit.expected`; if `wary`, before the first iteration too. The channels share
    their edges.
    """
    operator = fit.operator
    channels = fit.channels
    noise = fit.noise
    config = fit.config
    # What is seen of brightness in all channels together has less noise than each of them.
    together = noise / float(np.sqrt(len(channels)))
    unexplained = float(np.hypot(together, MODEL_ERROR))
    least = float(np.hypot(together, _LEAST_NOISE))
    allowed = _MISFIT * float(np.hypot(together, MODEL_ERROR))
    ranges = operator.ranges(RANGES)
    scenes = [operator.around(begin) for begin in fit.start]
    expected = [operator.around(each) for each in fit.expected]
    # Without occlusion in the model it is that of one plane, or of known motion: exact.
    exact = operator.hidden is None
    held_by = np.float32(0) if exact else _HELD
    weight = trusted = fit.weight
    steps = iter(fit.progress(range(iterations * len(channels))))
    for done in range(0, iterations, between):
        if done or wary or fit.shines is not None:
            pairs = zip(channels, scenes, strict=True)
            left = [coded - operator.forward(scene) for coded, scene in pairs]
            if fit.shines is not None:
                # Of saturated pixels only this is known: the scene must not be too dark for them.
                too_dark = fit.shines & (left[0] > 0)
                weight = np.where(too_dark, np.float32(1), fit.weight)
                left = [np.where(fit.shines & ~too_dark, 0, part) for part in left]
            trusted = weight
        if done or wary:
            explained = _explained(left, noise, allowed if done else _AT_FIRST * allowed)
            trusted = weight * (explained if exact else explained**2)
        if done:
            found = _MEDIAN_TO_STD * float(np.median(np.abs(left[0])))
            if not exact:  # the model may be better than it usually is
                unexplained = max(least, min(unexplained, found))
            elif found > _DISCREPANCY * noise and done >= iterations // 2:
                unexplained = max(least, _LESS * unexplained)
        held = operator.around(cv2.blur(held_by * (1 - trusted), (_HELD_PX, _HELD_PX)))
        usual = max(float(trusted.mean()), _LEAST_WEIGHT)
        sparse = SparsePrior(scenes, operator.hidden)
        penalty = sparse.power(operator.scene_shape)
        of_hidden = sparse.of_hidden() if operator.hidden is not None else 1.0
        for channel, coded in enumerate(channels):
            alpha = config.smoothness * (_ALPHA if exact else _ALPHA_OF_ESTIMATED) * unexplained
            strength = np.float32(alpha * (_COLOUR if channel else 1.0))
            right_side = operator.adjoint(trusted * coded)
            right_side += held * expected[channel]

            def prior(scene: FloatArray, strength: np.float32 = strength) -> FloatArray:
                return strength * sparse(scene) + held * scene  # noqa: B023  called in this pass

            scenes[channel], _ = conjugate_gradients(
                _system(operator, trusted, prior),
                right_side,
                scenes[channel],
                preconditioner(fit, ranges, usual, strength * penalty, strength * of_hidden),
                config.tolerance * _OF_ONE_SET,
                min(between, iterations - done),
                steps,
            )
    return [frame_within(scene, operator)[0] for scene in scenes]


def _system(operator: BlurOperator, weight: Any, prior: Linear) -> Linear:
    """Return the gradient (thesis eq. 6.28), with that of the prior, less its constant part."""
    return lambda scene: operator.adjoint(weight * operator.forward(scene)) + prior(scene)


def _explained(residuals: list[FloatArray], noise: float, allowed: float) -> FloatArray:
    """Return how far the frame is explained at every pixel, 0 to 1."""
    squared = np.mean([residual**2 for residual in residuals], axis=0)
    misfit = cv2.GaussianBlur(squared, (0, 0), _MISFIT_REACH_PX)
    return 1 / (1 + np.maximum(misfit - np.float32(noise**2), 0) / np.float32(allowed**2))
