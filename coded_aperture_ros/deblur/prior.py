"""Sparse prior of sharp images: small differences nearly everywhere."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, Shape
from coded_aperture_ros.core.compiled import Compiled

# First and second differences of the sparse prior, and how much each counts.
_SHARES = (1.0, 1.0, 0.25, 0.25, 0.25)
# Exponent of the sparse prior, and the difference in linear light below which it is quadratic.
_EXPONENT = 0.7
_SMALL = 0.01


def differences(image: FloatArray) -> list[FloatArray]:
    """First and second differences of an image, each of its shape; 0 across its border."""
    down = _difference(image, 0)
    right = _difference(image, 1)
    return [down, right, *(_difference(*pair) for pair in ((down, 0), (right, 1), (down, 1)))]


def differences_adjoint(parts: list[FloatArray]) -> FloatArray:
    """Transpose of `differences`."""
    down, right, down_down, right_right, down_right = parts
    down = down + _adjoint(down_down, 0) + _adjoint(down_right, 1)
    right = right + _adjoint(right_right, 1)
    return _adjoint(down, 0) + _adjoint(right, 1)


def difference_powers(shape: Shape) -> list[FloatArray]:
    """Power spectra of the `differences` of periodic images, as by ``rfft2``."""
    down = 2 - 2 * np.cos(2 * np.pi * np.fft.fftfreq(shape[0]))[:, None]
    right = 2 - 2 * np.cos(2 * np.pi * np.fft.rfftfreq(shape[1]))[None, :]
    powers = np.broadcast_arrays(down, right, down**2, right**2, down * right)
    return [power.astype(np.float32) for power in powers]


class SparsePrior:
    """Gradient of ``sum |D f|^0.7`` near a scene, as a linear operator.

    The prior keeps few large differences and suppresses many small ones, as edges and smooth areas
    in photographs are. It is minimised by a sequence of quadratic ones, each with weights from the
    last solution.

    Parameters
    ----------
    scenes : list of ndarray, float32 [planes, rows, columns]
        Last solution of each channel. There is a weight for each of the `differences`, 1 for a
        small first difference. All channels of a colour image share their edges.
    hidden : ndarray of bool [rows, columns] or None
        Where there is a second plane. It is judged together with what is beside it in the first.
    """

    def __init__(self, scenes: list[FloatArray], hidden: BoolArray | None) -> None:
        self._hidden = hidden
        self.front_weights = np.stack(_weights([scene[0] for scene in scenes]))
        if hidden is not None:
            around = cv2.dilate(hidden.astype(np.uint8), np.ones((5, 5), np.uint8))
            behind = _weights([np.where(hidden, scene[1], scene[0]) for scene in scenes])
            self.behind_weights = np.stack(behind) * around

    def __call__(self, scene: FloatArray) -> FloatArray:
        """Gradient at a scene [planes, rows, columns]."""
        gradient = np.empty_like(scene)
        weighted_differences(scene[0], self.front_weights, gradient[0])
        if self._hidden is not None:
            behind = np.where(self._hidden, scene[1], scene[0])
            weighted_differences(behind, self.behind_weights, gradient[1])
            gradient[0] += np.where(self._hidden, 0, gradient[1])
            gradient[1] *= self._hidden
        return gradient

    def power(self, shape: Shape) -> FloatArray:
        """Approximate power spectrum of the first plane's prior, as by ``rfft2``."""
        # Typical weights: between the arithmetic mean, of smooth areas, and the harmonic one, of
        # edges.
        typical = [np.sqrt(each.mean() / (1 / each).mean()) for each in self.front_weights]
        pairs = zip(typical, difference_powers(shape), strict=True)
        return np.sum([size * power for size, power in pairs], axis=0)

    def hidden_diagonal(self) -> FloatArray:
        """Approximate diagonal of the prior in the second plane [rows, columns]."""
        first = self.behind_weights[:2].sum(axis=0)
        second = self.behind_weights[2:].sum(axis=0)
        return 2 * first + 6 * second


def _weights(channels: list[FloatArray]) -> list[FloatArray]:
    """Weights of the `differences` of one image in some channels."""
    power = [np.zeros_like(channels[0]) for _ in _SHARES]
    for channel in channels:
        for total, part in zip(power, differences(channel), strict=True):
            total += part * part
    return [
        np.float32(share)
        * (1 + total / np.float32(len(channels) * _SMALL**2)) ** (_EXPONENT / 2 - 1)
        for share, total in zip(_SHARES, power, strict=True)
    ]


def _loop(image: FloatArray, weights: FloatArray, gradient: FloatArray) -> None:
    rows, columns = image.shape
    gradient[:] = 0
    for y in range(rows):
        for x in range(columns):
            here = image[y, x]
            below = image[min(y + 1, rows - 1), x]
            beside = image[y, min(x + 1, columns - 1)]
            # Differences end at the border, where they are 0.
            down = below - here
            right = beside - here
            flow_down = weights[0, y, x] * down
            flow_right = weights[1, y, x] * right
            if y < rows - 1:
                twice = image[min(y + 2, rows - 1), x] - below - down
                part = weights[2, y, x] * twice
                gradient[y, x] += part
                gradient[y + 1, x] -= part
                if y < rows - 2:
                    gradient[y + 1, x] -= part
                    gradient[y + 2, x] += part
            if x < columns - 1:
                twice = image[y, min(x + 2, columns - 1)] - beside - right
                part = weights[3, y, x] * twice
                gradient[y, x] += part
                gradient[y, x + 1] -= part
                if x < columns - 2:
                    gradient[y, x + 1] -= part
                    gradient[y, x + 2] += part
                if y < rows - 1:
                    mixed = image[y + 1, x + 1] - beside - down
                    part = weights[4, y, x] * mixed
                    gradient[y, x] += part
                    gradient[y + 1, x] -= part
                    gradient[y, x + 1] -= part
                    gradient[y + 1, x + 1] += part
            if y < rows - 1:
                gradient[y, x] -= flow_down
                gradient[y + 1, x] += flow_down
            if x < columns - 1:
                gradient[y, x] -= flow_right
                gradient[y, x + 1] += flow_right


def _plain(image: FloatArray, weights: FloatArray, gradient: FloatArray) -> None:
    parts = [each * part for each, part in zip(weights, differences(image), strict=True)]
    gradient[:] = differences_adjoint(parts)


# Writes ``D^T W D`` of an image, for the `differences` D and their weights [5, rows, columns].
weighted_differences = Compiled(_loop, _plain)


def _difference(image: FloatArray, axis: int) -> FloatArray:
    return np.diff(image, axis=axis, append=image[-1:] if axis == 0 else image[:, -1:])


def _adjoint(part: FloatArray, axis: int) -> FloatArray:
    inner = part[:-1] if axis == 0 else part[:, :-1]
    zero = np.float32(0)
    return -np.diff(inner, axis=axis, prepend=zero, append=zero)
