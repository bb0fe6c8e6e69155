"""Method `cg`: least squares over the whole frame, thesis eq. 6.27 with a quadratic prior."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.deblur.blur_map import MODEL_ERROR
from coded_aperture_ros.deblur.conjugate import Linear, conjugate_gradients
from coded_aperture_ros.deblur.iterative import RANGES, Fit, Iterative, preconditioner
from coded_aperture_ros.deblur.operator import BlurOperator, frame_within, scene_around
from coded_aperture_ros.deblur.prior import quadratic_power

# Variance of photographs in linear light: that of most places, which is less than that of all,
# edges included. From the best of several on ray-traced scenes.
_CONTRAST = 0.0025
# alpha of colour differences relative to that of brightness: they have less texture.
_OF_COLOUR = 4.0


class ConjugateGradients(Iterative):
    """The quadratic prior: one linear system for each channel; see `Method`."""

    runs_on_torch = True
    # Occlusion would take 1.7 times as long for nothing: the iterations stop early.

    def minimise(self, fit: Fit) -> list[NDArray[np.float32]]:
        """Return the channels of the sharp scene within the frame."""
        return restore_quadratic(fit)[0]


def restore_quadratic(fit: Fit) -> tuple[list[NDArray[np.float32]], int]:
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
        prior = (_OF_COLOUR if number else 1.0) * alpha * power
        scene, needed = conjugate_gradients(
            _system(operator, trusted, prior),
            operator.adjoint(trusted * operator.array(coded)),
            operator.array(scene_around(begin, operator)),
            preconditioner(fit, ranges, float(fit.weight.mean()), prior),
            fit.config.tolerance,
            fit.config.iterations,
        )
        restored.append(frame_within(operator.to_numpy(scene), operator))
        most = max(most, needed)
    return restored, most


def _system(operator: BlurOperator, weight: Any, prior: Any) -> Linear:
    """Return the gradient (thesis eq. 6.28) less its constant part."""
    fft = operator.fft

    def system(scene: Any) -> Any:
        data = operator.adjoint(weight * operator.forward(scene))
        return data + fft.irfft2(prior * fft.rfft2(scene), scene.shape)

    return system
