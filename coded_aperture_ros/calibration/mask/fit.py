"""Estimate of mask and blur sizes, and its improvement by quasi-Newton steps."""

import dataclasses
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.mask.likelihood import MaskLikelihood
from coded_aperture_ros.calibration.mask.sizes import FreeSizes, LensSizes
from coded_aperture_ros.core.arrays import DoubleArray

Sizes = TypeVar("Sizes", bound=FreeSizes | LensSizes)


@dataclasses.dataclass(frozen=True, eq=False)
class MaskFit(Generic[Sizes]):
    """Mask, as a mixture, and blur sizes that may explain the pictures of planes."""

    # [R, m, m]; masks whose autocorrelations add up to that of the mask; their squared sums add up
    # to one.
    parts: DoubleArray
    sizes: Sizes  # width of the parts' grid at each of the I planes
    # [I]; logarithm of the variance of every plane's noise, with what the model leaves unexplained.
    log_noise: DoubleArray
    score: float = np.inf  # twice the negative log-likelihood of a window, on average

    @property
    def sizes_px(self) -> DoubleArray:
        """Unsigned blur size of every plane [I]."""
        return self.sizes.px

    def optimise(
        self, likelihood: MaskLikelihood, steps: int, masks: bool = True
    ) -> "MaskFit[Sizes]":
        """Likelier fit: new hypotheses for the windows, then better masks, sizes and noise.

        Without `masks` these stay fixed.
        """
        # Here: it is slow to import, and the nodes, which read a fit in a bank, make none.
        import scipy.optimize

        variables = Variables(self, likelihood, masks)
        result = scipy.optimize.minimize(
            variables.value_and_gradient, variables.start, jac=True, method="L-BFGS-B",
            bounds=variables.bounds, options={"maxiter": steps, "maxcor": 40, "ftol": 1e-12},
        )  # fmt: skip
        parts, sizes, _, log_noise = variables.unpacked(result.x)
        parts = normalised(parts)
        score = likelihood.score(parts, sizes.px, log_noise)
        return dataclasses.replace(self, parts=parts, sizes=sizes, log_noise=log_noise, score=score)


class Variables(Generic[Sizes]):
    """Variables of `MaskFit.optimise`: masks, sizes, textures and noise, in one vector.

    `start` are the variables of the fit, float64 [V], and `bounds` the least and most of each.
    """

    def __init__(self, fit: MaskFit[Sizes], likelihood: MaskLikelihood, masks: bool = True) -> None:
        self._fit = fit
        self._likelihood = likelihood
        self._masks = masks
        self._groups = likelihood.group(fit.parts, fit.sizes_px, fit.log_noise)
        blocks: list[tuple[NDArray, tuple]] = [
            ((fit.parts / fit.parts.max()).ravel() if masks else np.empty(0), (0, None)),
            (fit.sizes.variables, fit.sizes.bounds),
            (self._groups.textures.ravel(), (None, None)),
            (fit.log_noise, (-20, 0)),
        ]
        self.start = np.concatenate([values for values, _ in blocks])
        self.bounds = [one for values, one in blocks for _ in values]
        self._ends = np.cumsum([len(values) for values, _ in blocks])[:-1]

    def unpacked(self, x: NDArray) -> tuple[NDArray, Sizes, NDArray, NDArray]:
        """Parts of any brightness, sizes, textures and noise."""
        cells, sizes, textures, log_noise = np.split(x, self._ends)
        parts = cells.reshape(self._fit.parts.shape) if self._masks else self._fit.parts
        moved: Sizes = self._fit.sizes.moved(sizes)  # type: ignore[assignment]
        return parts, moved, textures.reshape(self._groups.textures.shape), log_noise

    def value_and_gradient(self, x: NDArray) -> tuple[float, NDArray]:
        """Value and gradient of the likelihood; the brightness of the parts does not matter."""
        cells, sizes, textures, log_noise = self.unpacked(x)
        sums = cells.sum(axis=(1, 2))
        norm = np.sqrt(np.sum(sums**2))
        parts = cells / norm
        value, gradient = self._likelihood.value_and_gradient(
            parts, sizes.px, textures, log_noise, self._groups
        )
        by_parts = gradient.parts - np.sum(gradient.parts * parts) * (sums / norm)[:, None, None]
        return value, np.concatenate(
            [
                (by_parts / norm).ravel() if self._masks else np.empty(0),
                sizes.gradient(gradient.sizes_px),
                gradient.textures.ravel(),
                gradient.log_noise,
            ]
        )


def normalised(parts: DoubleArray) -> DoubleArray:
    """Masks scaled so that their autocorrelations together have unit sum."""
    return np.asarray(parts / np.sqrt(np.sum(parts.sum(axis=(1, 2)) ** 2)))


def random_parts(count: int, cells: int) -> DoubleArray:
    """Random masks to start from, brightest in their middle [count, cells, cells]."""
    x = (np.arange(cells) + 0.5) / cells - 0.5
    blob = np.exp(-(x[:, None] ** 2 + x**2) / (2 * 0.3**2))
    return normalised(blob * np.random.default_rng(0).uniform(size=(count, cells, cells)) ** 2)
