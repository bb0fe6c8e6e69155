"""The sharp scene that explains a coded frame best: thesis eq. 6.27, solved exactly."""

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.deblur.conjugate import conjugate_gradients
from coded_aperture_ros.deblur.operator import BlurOperator, frame_within, scene_around
from coded_aperture_ros.deblur.prior import (
    differences,
    differences_adjoint,
    quadratic_power,
    sparse_weights,
)

# Variance of photographs in linear light, for the quadratic prior.
_CONTRAST = 0.02
# alpha of the sparse prior, relative to the variance of what the model leaves unexplained.
_SPARSE_ALPHA = 1600.0
# What the model of blur leaves unexplained where there is no noise: standard deviation.
_MODEL_ERROR = 0.0015
# alpha of colour differences relative to that of brightness: they have less texture.
_OF_COLOUR = 4.0
# Iterations between two updates of the sparse prior's weights.
_INNER = 24
# Where the smoothed residual is beyond so many times the noise, the depth must be wrong.
_MISFIT, _MISFIT_REACH_PX = 3.0, 2.0


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
    preconditioner solves the problem for the frame's mean PSF in the Fourier domain.

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
    shape = operator.scene_shape
    alpha = smoothness * (noise**2 + _MODEL_ERROR**2) / _CONTRAST
    power, data_power = quadratic_power(shape), operator.mean_power() * np.float32(weight.mean())
    restored, most = [], 0
    for coded, begin, share in zip(channels, start, _shares(channels), strict=True):
        prior = np.float32(alpha * share) * power
        inverse = 1 / (data_power + prior)

        def system(
            scene: NDArray[np.float32], prior: NDArray[np.float32] = prior
        ) -> NDArray[np.float32]:
            data = operator.adjoint(weight * operator.forward(scene))
            return data + scipy.fft.irfft2(prior * scipy.fft.rfft2(scene), shape)

        def precondition(
            scene: NDArray[np.float32], inverse: NDArray[np.float32] = inverse
        ) -> NDArray[np.float32]:
            return np.asarray(scipy.fft.irfft2(inverse * scipy.fft.rfft2(scene), shape))

        scene, needed = conjugate_gradients(
            system,
            operator.adjoint(weight * coded),
            scene_around(begin, operator),
            precondition,
            tolerance,
            iterations,
        )
        restored.append(frame_within(scene, operator))
        most = max(most, needed)
    return restored, most


def restore_sparse(
    operator: BlurOperator,
    channels: list[NDArray[np.float32]],
    weight: NDArray[np.float32],
    start: list[NDArray[np.float32]],
    noise: float,
    smoothness: float,
    tolerance: float,
    iterations: int,
) -> tuple[list[NDArray[np.float32]], int]:
    """Minimise ``||g - H_d f||^2 + alpha sum |D f|^0.8`` by reweighted least squares.

    Every few iterations the prior's weights follow the solution (see `sparse_weights`), and pixels
    that no sharp scene can explain, because their depth is wrong, lose their weight.

    Parameters and results are those of `restore_quadratic`; the channels share their edges. The
    tolerance is for one set of weights.
    """
    alpha = np.float32(smoothness * _SPARSE_ALPHA * (noise**2 + _MODEL_ERROR**2))
    gain = np.float32(scipy.fft.irfft2(operator.mean_power(), operator.scene_shape)[0, 0])
    right_sides: list[NDArray[np.float32]] = []
    scenes = [scene_around(begin, operator) for begin in start]
    done = 0
    while done < iterations:
        trusted = weight * _explained(operator, channels, scenes, noise) if done else weight
        right_sides = [operator.adjoint(trusted * coded) for coded in channels]
        shares = [alpha * share for share in sparse_weights(scenes)]
        diagonal = sum(
            np.float32(squares) * share
            for squares, share in zip((2, 2, 6, 6, 4), shares, strict=True)
        )
        inverse = 1 / (gain * scene_around(trusted, operator, cv2.BORDER_CONSTANT) + diagonal)

        def system(
            scene: NDArray[np.float32],
            trusted: NDArray[np.float32] = trusted,
            shares: list[NDArray[np.float32]] = shares,
        ) -> NDArray[np.float32]:
            data = operator.adjoint(trusted * operator.forward(scene))
            parts = [share * part for share, part in zip(shares, differences(scene), strict=True)]
            return data + differences_adjoint(parts)

        def precondition(
            scene: NDArray[np.float32], inverse: NDArray[np.float32] = inverse
        ) -> NDArray[np.float32]:
            return inverse * scene

        budget = min(_INNER, iterations - done)
        scenes = [
            conjugate_gradients(system, right, scene, precondition, tolerance, budget)[0]
            for right, scene in zip(right_sides, scenes, strict=True)
        ]
        done += budget
    return [frame_within(scene, operator) for scene in scenes], done


def _shares(channels: list[NDArray[np.float32]]) -> list[float]:
    """Return the relative alpha of every channel."""
    return [1.0 if channel == 0 else _OF_COLOUR for channel in range(len(channels))]


def _explained(
    operator: BlurOperator,
    channels: list[NDArray[np.float32]],
    scenes: list[NDArray[np.float32]],
    noise: float,
) -> NDArray[np.float32]:
    """Return how far the frame is explained at every pixel, 0 to 1."""
    misfit = np.zeros(operator.shape, np.float32)
    for coded, scene in zip(channels, scenes, strict=True):
        misfit += (coded - operator.forward(scene)) ** 2
    misfit = cv2.GaussianBlur(misfit / len(channels), (0, 0), _MISFIT_REACH_PX)
    allowed = _MISFIT**2 * (noise**2 + _MODEL_ERROR**2 / 2)
    return 1 / (1 + misfit / np.float32(allowed))
