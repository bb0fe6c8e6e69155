"""Likelihood of the spectra of planes, given a mixture of masks and the blur sizes.

It is that of the filter bank's costs, with textures that are more flexible than power laws.
"""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.mask.spectra import SLOPES, MaskSpectra
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis

_CONTRASTS = 10.0 ** np.arange(-5, -0.9, 0.25)
# Weight that holds the textures to the power laws, relative to a likelihood of one per frequency.
_STIFFNESS = 1e-3
_SCORING_STEPS = 12


@dataclasses.dataclass(frozen=True, eq=False)
class Groups:
    """Windows that share a hypothesis.

    Index of the plane and of the texture's slope [G], number of windows [G], their mean power [G,
    K], and the logarithm of the textures' power over that of the slope, as coefficients of smooth
    functions [G, 9].
    """

    plane: NDArray
    slope: NDArray
    count: NDArray
    mean: NDArray
    textures: NDArray


@dataclasses.dataclass(frozen=True, eq=False)
class Gradient:
    """Derivatives of the likelihood by each of its arguments, in their shapes."""

    parts: NDArray
    sizes_px: NDArray
    textures: NDArray
    log_noise: NDArray


class MaskLikelihood:
    """Likelihood of masks and blur sizes for the spectra of planes; less is likelier.

    Windows that the same hypothesis about contrast and slope explains best are averaged; the
    averages are all that the likelihood depends on while the hypotheses stay. Every average has its
    own texture: the hypothesis' power law times a smooth function of frequency.

    `powers` are the spectra of every plane's windows [W, frequencies], made with `fourier`; no blur
    size is larger than `widest_px`.
    """

    def __init__(
        self, powers: list[FloatArray], fourier: WindowedFourierBasis, widest_px: float
    ) -> None:
        counts = fourier.multiplicity > 0
        self.multiplicity = fourier.multiplicity[counts].astype(np.float64)
        self.powers = [power[:, counts].astype(np.float64) for power in powers]
        self.spectra = MaskSpectra(fourier, counts, widest_px)
        self.widest_px = widest_px
        self.texture = _smooth_functions(fourier.window_px)[:, counts]
        self.first_log_noise = np.log(
            [max(np.quantile(p @ fourier.noise_weights, 0.05), 1e-9) for p in powers]
        )

    def score(self, parts: NDArray, sizes_px: NDArray, log_noise: NDArray) -> float:
        """Twice the negative log-likelihood of a window under its best hypothesis, on average."""
        return float(self.scores(parts, sizes_px[None], log_noise)[0])

    def scores(
        self, parts: NDArray, sizes_px: NDArray, log_noise: NDArray, every: int = 1
    ) -> DoubleArray:
        """Score of several estimates of the blur sizes of all planes [guesses, I].

        Only every `every`-th plane is used.
        """
        chosen = range(0, len(self.powers), every)
        scores = np.zeros(len(sizes_px))
        expected = self.spectra.expected(parts, sizes_px[:, chosen].ravel()).power
        for column in range(expected.shape[1]):
            guess, plane = divmod(column, len(chosen))
            costs = self._costs(chosen[plane], expected[:, column], log_noise[chosen[plane]])
            scores[guess] += costs.min(axis=1).mean() / len(chosen)
        return scores

    def plane_scores(
        self, plane: int, parts: NDArray, sizes_px: NDArray, log_noise: float
    ) -> DoubleArray:
        """Score of a plane by itself for several estimates of its blur size [guesses]."""
        expected = self.spectra.expected(parts, sizes_px).power
        costs = (self._costs(plane, power, log_noise) for power in np.moveaxis(expected, 1, 0))
        return np.array([each.min(axis=1).mean() for each in costs])

    def of_planes(self, planes: Sequence[int]) -> "MaskLikelihood":
        """Likelihood of some of the planes."""
        some = copy.copy(self)
        some.powers = [self.powers[plane] for plane in planes]
        some.first_log_noise = self.first_log_noise[list(planes)]
        return some

    def group(self, parts: NDArray, sizes_px: NDArray, log_noise: NDArray) -> Groups:
        """Groups of windows with the same best hypothesis, averaged."""
        expected = self.spectra.expected(parts, sizes_px).power
        found = []
        for i, powers in enumerate(self.powers):
            best = self._costs(i, expected[:, i], log_noise[i]).argmin(axis=1)
            for hypothesis in np.unique(best):
                members = best == hypothesis
                contrast, slope = divmod(hypothesis, len(SLOPES))
                found.append((i, slope, contrast, members.sum(), powers[members].mean(axis=0)))
        plane, slopes, contrasts, count, mean = map(np.array, zip(*found, strict=True))
        textures = np.zeros((len(plane), len(self.texture)))
        textures[:, 0] = np.log(_CONTRASTS[contrasts])
        groups = Groups(plane, slopes, count.astype(float), mean, textures)
        return self._with_own_textures(groups, expected, log_noise)

    def _costs(self, plane: int, expected: NDArray, log_noise: float) -> NDArray:
        """Cost of every contrast and slope for a plane's windows [W, hypotheses]."""
        variance = _CONTRASTS[:, None, None] * expected + np.exp(log_noise)
        weights = (self.multiplicity / variance).reshape(-1, variance.shape[-1])
        return self.powers[plane] @ weights.T + (np.log(variance) @ self.multiplicity).ravel()

    def _with_own_textures(self, groups: Groups, expected: NDArray, log_noise: NDArray) -> Groups:
        """Groups with their textures fitted to their means, by Fisher scoring."""
        weights = groups.count[:, None] * self.multiplicity
        stiffness = np.full(len(self.texture), 2 * _STIFFNESS * weights.sum() / len(weights))
        stiffness[0] = 0
        textures = groups.textures
        noise = np.exp(log_noise)[groups.plane, None]
        for _ in range(_SCORING_STEPS):
            signal = np.exp(textures @ self.texture) * expected[groups.slope, groups.plane]
            total = signal + noise
            excess = weights * (1 / total - groups.mean / total**2) * signal
            gradient = excess @ self.texture.T + stiffness * textures
            shares = weights * (signal / total) ** 2
            curvature = np.einsum(
                "gk,ik,jk->gij", shares, self.texture, self.texture, optimize=True
            )
            curvature += np.diag(stiffness + 1e-6)
            step = np.linalg.solve(curvature, gradient[..., None])[..., 0]
            textures = textures - np.clip(step, -0.5, 0.5)
        return dataclasses.replace(groups, textures=textures)

    def value_and_gradient(
        self,
        parts: NDArray,
        sizes_px: NDArray,
        textures: NDArray,
        log_noise: NDArray,
        groups: Groups,
    ) -> tuple[float, Gradient]:
        """Mean over all frequencies of ``P / V + log V`` (and stiffness), with its gradient."""
        expected = self.spectra.expected(parts, sizes_px)
        noise = np.exp(log_noise)
        gain = np.exp(textures @ self.texture)
        signal = gain * expected.power[groups.slope, groups.plane]
        total = signal + noise[groups.plane, None]
        weights = groups.count[:, None] * self.multiplicity
        weights /= weights.sum()
        stiffness = _STIFFNESS / len(textures)
        precision = 1 / total
        relative = groups.mean * precision
        value = np.sum(weights * (relative + np.log(total)))
        value += stiffness * np.sum(textures[:, 1:] ** 2)

        by_total = weights * precision * (1 - relative)
        by_textures = (by_total * signal) @ self.texture.T
        by_textures[:, 1:] += 2 * stiffness * textures[:, 1:]
        by_noise = np.bincount(groups.plane, by_total.sum(axis=1), len(noise)) * noise
        # A product adds up the groups of each slope and plane faster than np.add.at.
        member = np.zeros((*expected.power.shape[:2], len(textures)))
        member[groups.slope, groups.plane, np.arange(len(textures))] = 1
        by_power = member @ (gain * by_total)
        by_parts, by_sizes = self.spectra.backward(by_power, expected)
        return float(value), Gradient(by_parts, by_sizes, by_textures, by_noise)


def _smooth_functions(window_px: int) -> NDArray:
    """Smooth functions of frequency [9, K] by which textures depart from power laws."""
    vertical = np.fft.fftfreq(window_px)[:, None]
    horizontal = np.fft.rfftfreq(window_px)
    radius = np.hypot(vertical, horizontal)
    radius[0, 0] = 1 / window_px
    angle = np.arctan2(vertical, horizontal)
    scale = np.log(radius / 0.15)
    directions = [np.cos(2 * angle), np.sin(2 * angle), np.cos(4 * angle)]
    functions = [np.ones_like(scale), scale, scale**2, *directions]
    functions += [direction * scale for direction in directions]
    return np.reshape(functions, (len(functions), -1))
