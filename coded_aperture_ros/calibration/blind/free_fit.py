"""A mask, as a mixture, and the blur size of every plane by itself, made likelier step by step."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.mask.fit import normalised
from coded_aperture_ros.calibration.mask.likelihood import Groups, MaskLikelihood

# Curvatures differ: in these units the logarithm of a size is as soft as the mask's cells.
_SIZE_UNIT = 0.02


@dataclasses.dataclass(frozen=True, eq=False)
class FreeFit:
    """Masks and blur sizes that may explain the pictures of planes.

    Attributes
    ----------
    parts : ndarray, float64 [R, m, m]
        Masks whose autocorrelations add up to that of the mask; their squared sums add up to one.
    sizes_px : ndarray, float64 [planes]
        Width of the parts' grid at each plane.
    log_noise : ndarray, float64 [planes]
        Logarithm of the variance of every plane's noise.
    score : float
        Twice the negative log-likelihood of a window, on average.
    """

    parts: NDArray[np.float64]
    sizes_px: NDArray[np.float64]
    log_noise: NDArray[np.float64]
    score: float = np.inf

    def climb(self, likelihood: MaskLikelihood, steps: int, masks: bool = True) -> "FreeFit":
        """Take quasi-Newton steps; without `masks` only sizes, textures and noise change."""
        import scipy.optimize

        groups = likelihood.group(self.parts, self.sizes_px, self.log_noise)
        variables = [
            (self.parts / self.parts.max()).ravel(),
            np.log(self.sizes_px) / _SIZE_UNIT,
            groups.textures.ravel(),
            self.log_noise,
        ]
        widest = np.log(likelihood.widest_px) / _SIZE_UNIT
        ranges = [(0, None), (0, widest), (None, None), (-20, 0)]
        if not masks:
            variables, ranges = variables[1:], ranges[1:]
        result = scipy.optimize.minimize(
            self._value_and_gradient,
            np.concatenate(variables),
            args=(likelihood, groups, masks),
            jac=True,
            method="L-BFGS-B",
            bounds=[r for r, some in zip(ranges, variables, strict=True) for _ in some],
            options={"maxiter": steps, "maxcor": 40, "ftol": 1e-12},
        )
        parts, sizes_px, _, log_noise = self._unpacked(result.x, groups, masks)
        better = FreeFit(normalised(parts), sizes_px, log_noise)
        score = likelihood.score(better.parts, better.sizes_px, better.log_noise)
        return dataclasses.replace(better, score=score)

    def _unpacked(
        self, x: NDArray, groups: Groups, masks: bool
    ) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Split the variables of the optimiser: parts, sizes, textures, noise."""
        cells = self.parts.size if masks else 0
        planes = len(self.sizes_px)
        parts = x[:cells].reshape(self.parts.shape) if masks else self.parts
        x = x[cells:]
        textures = x[planes:-planes].reshape(groups.textures.shape)
        return parts, np.exp(_SIZE_UNIT * x[:planes]), textures, x[-planes:]

    def _value_and_gradient(
        self, x: NDArray, likelihood: MaskLikelihood, groups: Groups, masks: bool
    ) -> tuple[float, NDArray]:
        """Likelihood of the optimiser's variables; the brightness of the parts does not matter."""
        cells, sizes_px, textures, log_noise = self._unpacked(x, groups, masks)
        sums = cells.sum(axis=(1, 2))
        norm = np.sqrt(np.sum(sums**2))
        parts = cells / norm
        value, gradient = likelihood.value_and_gradient(
            parts, sizes_px, textures, log_noise, groups
        )
        slopes = [
            gradient.sizes_px * sizes_px * _SIZE_UNIT,
            gradient.textures.ravel(),
            gradient.log_noise,
        ]
        if masks:
            by_parts = (
                gradient.parts - np.sum(gradient.parts * parts) * (sums / norm)[:, None, None]
            )
            slopes.insert(0, by_parts.ravel() / norm)
        return value, np.concatenate(slopes)
