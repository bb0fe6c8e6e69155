"""One guess at mask and focus, and its improvement by quasi-Newton steps."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.mask.likelihood import Groups, MaskLikelihood

# Curvatures of the likelihood differ: in these units the focus is as soft as the mask's cells.
_FOCUS_UNIT = 0.02
_LARGEST_RATIO = 0.95


@dataclasses.dataclass(frozen=True, eq=False)
class MaskFit:
    """A mask, as a mixture, and a focus that may explain the pictures of planes.

    Attributes
    ----------
    parts : ndarray, float64 [R, m, m]
        Masks whose autocorrelations add up to that of the mask; their squared sums add up to one.
    near_ratio : float
        Blur size of the least blurred plane over that of the most blurred one, in [0, 1).
    sign : int
        1 if the planes lie beyond the focal plane, -1 if in front of it.
    extent_px : float
        Width of the grid of cells at the most blurred plane, px.
    inverse_depths : ndarray, float64 [I]
        Of the planes, 1/m, in the order of their depths.
    log_noise : ndarray, float64 [I]
        Logarithm of the variance of every plane's noise, with what the model leaves unexplained.
    score : float
        Twice the negative log-likelihood of a window, on average.
    """

    parts: NDArray[np.float64]
    near_ratio: float
    sign: int
    extent_px: float
    inverse_depths: NDArray[np.float64]
    log_noise: NDArray[np.float64]
    score: float

    @property
    def size_range_px(self) -> tuple[float, float]:
        """Unsigned blur sizes of the nearest and of the farthest plane."""
        sizes = self.near_ratio * self.extent_px, self.extent_px
        return sizes if self.sign > 0 else sizes[::-1]

    @property
    def blur_sizes_px(self) -> NDArray[np.float64]:
        """Unsigned blur size of every plane [I]."""
        return self.extent_px * (1 - (1 - self.near_ratio) * self._towards_focus)

    @property
    def _towards_focus(self) -> NDArray[np.float64]:
        """How near the planes are to the focus in inverse depth: 0 for the most blurred, to 1."""
        v = self.inverse_depths
        share = (v - v.min()) / np.ptp(v)
        return np.asarray(share if self.sign > 0 else 1 - share)

    @property
    def _most_and_least_blurred(self) -> tuple[float, float]:
        """Inverse depths of the two planes."""
        near, far = self.inverse_depths[0], self.inverse_depths[-1]
        return (far, near) if self.sign > 0 else (near, far)

    @property
    def focus_distance_m(self) -> float:
        """Where the blur would vanish; infinite if it does so nowhere in front of the camera."""
        most, least = self._most_and_least_blurred
        inverse = (least - self.near_ratio * most) / (1 - self.near_ratio)
        return float(1 / inverse) if inverse > 0 else np.inf

    def depths_m(self, sizes_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Depths of unsigned blur sizes of the grid: inverse depth is linear in blur size."""
        most, least = self._most_and_least_blurred
        towards_focus = (1 - sizes_px / self.extent_px) / (1 - self.near_ratio)
        return np.asarray(1 / (most + (least - most) * towards_focus))

    def climb(self, likelihood: MaskLikelihood, steps: int) -> "MaskFit":
        """Choose hypotheses for the windows, then make mask, focus and noise likelier."""
        # Here: it is slow to import, and the nodes, which read a fit in a bank, make none.
        import scipy.optimize

        groups = likelihood.group(self.parts, self.blur_sizes_px, self.log_noise)
        variables = [
            (self.parts / self.parts.max()).ravel(),
            groups.textures.ravel(),
            self.log_noise,
            [self.near_ratio / _FOCUS_UNIT],
        ]
        ranges = [(0, None), (None, None), (-20, 0), (0, _LARGEST_RATIO / _FOCUS_UNIT)]
        result = scipy.optimize.minimize(
            self._value_and_gradient,
            np.concatenate(variables),
            args=(likelihood, groups),
            jac=True,
            method="L-BFGS-B",
            bounds=[r for r, some in zip(ranges, variables, strict=True) for _ in some],
            options={"maxiter": steps, "maxcor": 40, "ftol": 1e-12},
        )
        parts, _, log_noise, near_ratio = self._unpacked(result.x)
        better = dataclasses.replace(
            self, parts=normalised(parts), log_noise=log_noise, near_ratio=near_ratio
        )
        score = likelihood.score(better.parts, better.blur_sizes_px, better.log_noise)
        return dataclasses.replace(better, score=score)

    def _unpacked(self, x: NDArray) -> tuple[NDArray, NDArray, NDArray, float]:
        """Split the variables of the optimiser: parts, textures, noise, ratio."""
        cells, planes = self.parts.size, len(self.inverse_depths)
        return (
            x[:cells].reshape(self.parts.shape),
            x[cells : -planes - 1],
            x[-planes - 1 : -1],
            float(x[-1] * _FOCUS_UNIT),
        )

    def _value_and_gradient(
        self, x: NDArray, likelihood: MaskLikelihood, groups: Groups
    ) -> tuple[float, NDArray]:
        """Likelihood of the optimiser's variables; the brightness of the parts does not matter."""
        cells, textures, log_noise, near_ratio = self._unpacked(x)
        sums = cells.sum(axis=(1, 2))
        norm = np.sqrt(np.sum(sums**2))
        parts = cells / norm
        sizes_px = dataclasses.replace(self, near_ratio=near_ratio).blur_sizes_px
        value, gradient = likelihood.value_and_gradient(
            parts, sizes_px, textures.reshape(groups.textures.shape), log_noise, groups
        )
        by_parts = gradient.parts - np.sum(gradient.parts * parts) * (sums / norm)[:, None, None]
        by_ratio = gradient.sizes_px @ (self.extent_px * self._towards_focus)
        return value, np.concatenate(
            [
                by_parts.ravel() / norm,
                gradient.textures.ravel(),
                gradient.log_noise,
                [by_ratio * _FOCUS_UNIT],
            ]
        )


def normalised(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale masks so that their autocorrelations together have unit sum."""
    return np.asarray(parts / np.sqrt(np.sum(parts.sum(axis=(1, 2)) ** 2)))
