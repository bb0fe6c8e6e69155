"""Predicted error of a mask, from the expected spectra of texture behind it.

Two levels are distinguished by the Bhattacharyya distance of their Gaussian spectra. The parameters
that depth estimation adapts to (contrast, noise and slope of the texture) are taken out. The
distance bounds the probability of taking one for the other (Chernoff), and these probabilities
weigh the differences of the levels.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.openings import mask_openings
from coded_aperture_ros.design.scores.spectra import (
    Frequencies,
    SceneConfig,
    autocorrelations,
    diffraction_loss,
    expected_spectra,
    lag_matrix,
)
from coded_aperture_ros.optics import Mask

SIGMAS = (0.001, 0.005)
_MODEL_ERROR = 3e-4
# Half the angle that the frequencies of upright and level lines fill.
_LINES_RAD = np.radians(7.0)


@dataclasses.dataclass(frozen=True)
class _Texture:
    """One of the textures that the error is a mean over.

    The numbers were fitted once to the errors that were measured with the masks with names and 54
    random ones; what decides with real photographs is how well a mask does on lines.
    """

    lines: bool  # only upright and level ones, as most photographs have them; else all directions
    contrast: float  # variance of the sharp texture
    share: float  # of a distance that counts: how much of what frequencies tell is new
    weight: float


_TEXTURES = (
    _Texture(True, 10**-2.5, 4.0, 0.188),
    _Texture(True, 10**-0.5, 4.0, 0.05),
    _Texture(False, 10**-0.5, 16.0, 6.4),
)
# For deblurring: the model error of the closed form, and the variance of the texture.
_DEBLUR_ERROR = 0.06
_DEBLUR_CONTRAST = 2e-2
_LEVELS_TO_DEBLUR = 8
_BATCH = 32


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """Expected errors of B masks."""

    # Mean |level error| [B, noises]; comparable between masks, its scale is rough.
    depth_error: DoubleArray
    # Root mean square error of a Wiener filter's picture and its gradient, by the true depth, as a
    # share of that of the texture [B, noises].
    deblurring_error: DoubleArray
    light: DoubleArray  # open fraction of the mask's square [B]


class MaskScorer:
    """Predicts the errors of masks.

    Parameters
    ----------
    sigmas : sequence of float, optional
        Noise behind an open aperture (standard deviation, linear light, > 0); divided by the light
        that a mask passes.
    """

    def __init__(self, scene: SceneConfig | None = None, sigmas: Sequence[float] = SIGMAS) -> None:
        check_sigmas(sigmas)
        self.scene = scene or SceneConfig()
        self.sigmas = tuple(sigmas)
        self.frequencies = Frequencies.from_window()
        self._matrices: dict[int, FloatArray] = {}
        levels = np.arange(self.scene.levels, dtype=np.float32)
        self._steps = np.abs(levels[:, None] - levels)
        # What a change of the slope adds to the log spectrum of texture [K].
        self._slopes = np.log(self.frequencies.radius).astype(np.float32)
        # Directions from 0, of horizontal frequencies, to pi/2, of vertical ones.
        cycles = self.frequencies.vertical, self.frequencies.horizontal
        angle = np.arctan2(np.abs(cycles[0]), cycles[1])
        upright = angle <= _LINES_RAD
        level = angle >= np.pi / 2 - _LINES_RAD
        self._lines = [np.flatnonzero(upright), np.flatnonzero(level)]
        # Expected spectrum of sharp texture, and the weight of each frequency in a picture and its
        # gradient together [K].
        point = Mask("point", np.ones((1, 1), np.float32))
        sharp = dataclasses.replace(self.scene, levels=2, smallest_px=0.5, largest_px=1.0)
        self._sharp = expected_spectra(point, sharp, self.frequencies)[0]
        gradient = sum(4 * np.sin(np.pi * each / 64) ** 2 for each in cycles)
        self._gradient = np.asarray(1 + gradient, np.float32)

    def score(self, masks: Sequence[Mask]) -> Prediction:
        """Predict the errors of a few masks of any kind.

        An `InputError` if a mask has one colour: where nothing is closed, there is no pattern.
        """
        for mask in masks:
            check_two_colours(mask)
        light = np.array([mask.open_fraction for mask in masks])
        power = np.array([expected_spectra(mask, self.scene, self.frequencies) for mask in masks])
        if self.scene.diffraction_px > 0:
            widths = np.array([mask_openings(mask).smallest_width for mask in masks])
            power *= diffraction_loss(widths, self.scene, self.frequencies)[:, None]
        return self._predict(power, light)

    def score_grids(self, grids: NDArray[np.floating]) -> Prediction:
        """Predict the errors of many masks of one size [B, n, n], 0 closed to 1 open."""
        cells = grids.shape[-1]
        if cells not in self._matrices:
            self._matrices[cells] = lag_matrix(cells, self.scene, self.frequencies)
        parts = []
        # A batch's spectra have to stay in the processor's cache.
        for start in range(0, len(grids), _BATCH):
            batch = grids[start : start + _BATCH]
            power = autocorrelations(batch) @ self._matrices[cells]
            power = np.maximum(power, 0).reshape(len(batch), self.scene.levels, -1)
            if self.scene.diffraction_px > 0:
                widths = smallest_openings(batch) / cells
                power *= diffraction_loss(widths, self.scene, self.frequencies)[:, None]
            parts.append(self._predict(power, batch.mean(axis=(1, 2), dtype=np.float64)))
        columns = zip(*(vars(part).values() for part in parts), strict=True)
        return Prediction(*map(np.concatenate, columns))

    def _predict(self, power: FloatArray, light: DoubleArray) -> Prediction:
        signals = [(light / sigma) ** 2 for sigma in self.sigmas]
        depth = [self._depth_error(power, signal) for signal in signals]
        deblurring = [self._deblurring_error(power, signal) for signal in signals]
        return Prediction(np.stack(depth, 1), np.stack(deblurring, 1), light)

    def _depth_error(self, power: FloatArray, signal: DoubleArray) -> DoubleArray:
        error = np.zeros(len(power))
        for texture in _TEXTURES:
            ratio = (texture.contrast * signal).astype(np.float32)
            ways = self._lines if texture.lines else [slice(None)]
            for way in ways:
                distances = _distances(_log_spectra(power[..., way], ratio), self._slopes[way])
                probability = np.exp(-np.float32(texture.share) * distances)
                expected = (probability * self._steps).sum(axis=2) / probability.sum(axis=2)
                error += texture.weight / len(ways) * expected.mean(axis=1)
        return error

    def _deblurring_error(self, power: FloatArray, signal: DoubleArray) -> DoubleArray:
        every = max(1, self.scene.levels // _LEVELS_TO_DEBLUR)
        texture = self._sharp
        transfer = power[:, ::every] / texture
        noise = (1 / (_DEBLUR_CONTRAST * signal))[:, None, None].astype(np.float32)
        error = np.float32(_DEBLUR_ERROR**2)
        # The filter of `deblur.fast`: what it leaves of the texture, and what it makes of noise.
        gain = (1 + error) * texture / ((transfer + error) * texture + noise)
        left = (1 - gain * transfer) ** 2 * texture + gain**2 * transfer * noise
        # Model errors are as if the PSF were wrong by their share.
        left += gain**2 * error * texture * transfer
        weights = self._gradient
        share = (left.mean(axis=1) @ weights) / (texture @ weights)
        return np.sqrt(share.astype(np.float64))


def check_sigmas(sigmas: Sequence[float]) -> None:
    """Refuse noises that nothing can be predicted for: none, or one that is not above 0."""
    if not sigmas or not all(0 < sigma <= 0.5 for sigma in sigmas):
        raise InputError(f"sigmas: expected noises above 0, at most 0.5, got {list(sigmas)}")


def check_two_colours(mask: Mask) -> None:
    """Refuse a mask without a pattern."""
    if mask.transmission.min() == mask.transmission.max():
        raise InputError(
            f"mask {mask.name}: all cells have one colour, so there is no pattern to score: use a "
            "mask with open and closed cells (an open aperture is the mask disc)"
        )


def _log_spectra(power: FloatArray, ratio: FloatArray) -> FloatArray:
    """Return log variances, for noise of one [B, L, K]."""
    logs = power + np.float32(_MODEL_ERROR**2)
    logs *= ratio[:, None, None]
    logs += 1
    return np.log(logs, out=logs)


def _distances(logs: FloatArray, slope: FloatArray) -> FloatArray:
    """Return Bhattacharyya distances of diagonal Gaussians, to second order [B, L, L].

    For log variances that differ by D they are ``sum log cosh(D / 2)``, near 0 the sum of
    ``D^2 / 8``. Noise adds the same to all of D, contrast as much as texture exceeds noise, and
    slope that times the logarithm of the frequency: they do not distinguish levels, and are taken
    out.
    """
    texture = 1 - np.exp(-logs.mean(axis=1))  # [B, K]
    nuisances = np.stack([np.ones_like(texture), texture, texture * slope], axis=1)
    across = nuisances.transpose(0, 2, 1)
    gram = (nuisances @ across).astype(np.float64)
    # Where there is no texture at all, two of them are nothing.
    gram += 1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    mixed = logs @ across  # [B, L, 3]
    fitted = (mixed @ np.linalg.inv(gram).astype(np.float32)) @ nuisances
    products = logs @ logs.transpose(0, 2, 1) - fitted @ logs.transpose(0, 2, 1)
    squares = np.einsum("bll->bl", products)
    return np.maximum(squares[:, :, None] + squares[:, None] - 2 * products, 0) / 8


def smallest_openings(grids: NDArray[np.floating]) -> NDArray[np.int64]:
    """Side of the largest square that each open cell of a mask has a place in [B].

    In cells, of masks [B, n, n]; 0 for a mask without an open cell.
    """
    opened = np.asarray(grids) > 0
    widths = np.zeros(len(opened), np.int64)
    kept = opened.any(axis=(1, 2))
    for side in range(1, opened.shape[-1] + 1):
        kept &= (squares_only(opened, side) == opened).all(axis=(1, 2))
        if not kept.any():
            break
        widths[kept] = side
    return widths


def squares_only(opened: BoolArray, side: int) -> BoolArray:
    """Keep of each mask [B, n, n] the cells that lie in open squares of a side (an opening)."""
    return np.asarray(ndimage.binary_opening(opened, np.ones((1, side, side), bool)))
