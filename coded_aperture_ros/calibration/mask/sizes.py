"""Free parameters of the blur sizes of planes: all sizes, or the focus of a thin lens.

Sizes are a function of an optimiser's variables, whose `bounds` are the least and most of each.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.likelihood.bank.pattern import ThinLens

# Curvatures of the likelihood differ: in these units a focus, or the logarithm of a size, is as
# soft as the mask's cells.
_UNIT = 0.02
_MAX_RATIO = 0.95


@dataclasses.dataclass(frozen=True, eq=False)
class FreeSizes:
    """Blur size of each plane by itself, up to `widest_px`."""

    px: DoubleArray  # [I]; widths of the mask's grid, unsigned
    widest_px: float

    @property
    def variables(self) -> DoubleArray:
        """Logarithms of the sizes."""
        return np.asarray(np.log(self.px) / _UNIT)

    @property
    def bounds(self) -> tuple[float, float]:
        """From a size of one pixel on."""
        return 0.0, float(np.log(self.widest_px) / _UNIT)

    def moved(self, variables: DoubleArray) -> "FreeSizes":
        """Sizes for other variables."""
        return FreeSizes(np.exp(_UNIT * variables), self.widest_px)

    def gradient(self, by_px: DoubleArray) -> DoubleArray:
        """Derivatives by the variables from those by the sizes."""
        return by_px * self.px * _UNIT


@dataclasses.dataclass(frozen=True, eq=False)
class LensSizes:
    """Blur sizes on the line of a thin lens (thesis eq. 3.28), whose focus may vary."""

    # Blur size of the least blurred plane over that of the most blurred one, in [0, 1).
    near_ratio: float
    sign: int  # 1 if the planes lie beyond the focal plane, -1 if in front of it
    extent_px: float  # width of the mask's grid at the most blurred plane, px
    inverse_depths: DoubleArray  # [I]; of the planes, 1/m, in the order of their depths

    @property
    def px(self) -> DoubleArray:
        """Widths of the mask's grid, unsigned [I]."""
        return self.extent_px * (1 - (1 - self.near_ratio) * self._towards_focus)

    @property
    def _towards_focus(self) -> NDArray:
        """Closeness of the planes to the focus in inverse depth: 0 for the most blurred, to 1."""
        v = self.inverse_depths
        share = (v - v.min()) / np.ptp(v)
        return np.asarray(share if self.sign > 0 else 1 - share)

    @property
    def variables(self) -> DoubleArray:
        """The ratio of the sizes."""
        return np.array([self.near_ratio / _UNIT])

    @property
    def bounds(self) -> tuple[float, float]:
        """From no blur of the nearest to the focus to nearly as much as that of the others."""
        return 0.0, _MAX_RATIO / _UNIT

    def moved(self, variables: DoubleArray) -> "LensSizes":
        """See `FreeSizes`."""
        return dataclasses.replace(self, near_ratio=float(variables[0] * _UNIT))

    def gradient(self, by_px: DoubleArray) -> DoubleArray:
        """See `FreeSizes`."""
        return np.array([by_px @ (self.extent_px * self._towards_focus) * _UNIT])

    @property
    def lens(self) -> ThinLens:
        """Thin lens of the line."""
        v = self.inverse_depths
        reach = float(np.ptp(v)) / (1 - self.near_ratio)
        focus = v.min() + reach if self.sign > 0 else v.max() - reach
        return ThinLens(self.extent_px / reach, float(focus))
