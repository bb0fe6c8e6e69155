"""Two surfaces in one window: nets, leaves and panes before something farther away."""

import dataclasses
from collections.abc import Callable

import numpy as np

from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.core.networks import network_of
from coded_aperture_ros.depth.decoders.network.features import BLUR_SIZES_PX
from coded_aperture_ros.depth.decoders.network.network import Logits, to_half_cells

WEIGHTS = "second.npz"
SCHEMA = "coded-aperture second surface network"
SCHEMA_VERSION = 1
# Of every cell: logits of the blur sizes of the less and of the more blurred surface, of there
# being two, and of the share of the former.
CHANNELS = 2 * len(BLUR_SIZES_PX) + 2
# Logarithm of the odds above which there are two, of weights' files that state none.
LEAST_ODDS = 0.6
# A blur size is the mean over so many bins on either side of the likeliest, as those of pixels.
_REACH = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Pair:
    """The two surfaces that windows of 48 px around cells show; float32 [rows, columns]."""

    odds: FloatArray  # logarithm of the odds that there are two
    less_px: FloatArray  # blur sizes, without sign, of the less and of the more blurred one
    more_px: FloatArray
    share: FloatArray  # of the window, 0 to 1, that the less blurred one takes
    least_odds: float = LEAST_ODDS  # above which there are two

    def map_values(self, draw: Callable[[FloatArray], FloatArray]) -> "Pair":
        """Return what a function makes of each map."""
        return dataclasses.replace(
            self,
            odds=draw(self.odds),
            less_px=draw(self.less_px),
            more_px=draw(self.more_px),
            share=draw(self.share),
        )

    def other_surface(self, size_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return blur size and share of the surface beside one of these sizes; NaN without one."""
        is_less = np.abs(size_px - self.less_px) < np.abs(size_px - self.more_px)
        found_px = np.where(is_less, self.more_px, self.less_px)
        share = np.where(is_less, 1 - self.share, self.share)
        one = self.odds < np.float32(self.least_odds)
        found_px[one] = np.nan
        share[one] = np.nan
        return found_px, share


class SecondSurface:
    """Finds the pairs of surfaces of frames, from what the refinement makes of them.

    By a small network of its own, which OpenCV runs; see `training/second.py`. `tried` [blur
    sizes] as of `Network`. Not for several threads at once.
    """

    def __init__(self, tried: BoolArray) -> None:
        arrays = read_shipped(__file__, WEIGHTS, SCHEMA, SCHEMA_VERSION)
        self._network = network_of(arrays, "second", "opencv", 1)
        self._tried = tried
        self._least_odds = float(arrays.get("least_odds", np.array(LEAST_ODDS)))

    def __call__(self, logits: Logits, scalars: FloatArray) -> Pair:
        """Return the pairs, from logits and the last of `cost_features` [n, rows, columns]."""
        shown = np.concatenate([*in_cells(logits.size, self._tried), scalars, logits.cells])
        told = self._network({"shown": shown[None]})[0]
        told = to_half_cells(told)  # of squares of 16 px
        less, more, (odds, share) = np.split(told, len(BLUR_SIZES_PX) * np.arange(1, 3))
        return Pair(
            odds,
            _mean_around_best(less),
            _mean_around_best(more),
            1 / (1 + np.exp(-share)),
            self._least_odds,
        )


def in_cells(size: FloatArray, tried: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and largest probability of the blur sizes over the four half-cells of each cell.

    Takes logits [tried, 2 rows, 2 columns] and gives [blur sizes, rows, columns].
    """
    probability = np.exp(size - size.max(axis=0))
    probability /= probability.sum(axis=0)
    quarters = [probability[:, i::2, j::2] for i in (0, 1) for j in (0, 1)]
    mean, most = np.zeros((2, len(tried), *quarters[0].shape[1:]), np.float32)
    mean[tried] = sum(quarters) / np.float32(4)
    most[tried] = np.maximum.reduce(quarters)
    return mean, most


def _mean_around_best(logits: FloatArray) -> FloatArray:
    """Return the mean blur size around the likeliest, from logits [blur sizes, rows, columns]."""
    around = logits.argmax(axis=0) + np.arange(-_REACH, _REACH + 1)[:, None, None]
    around = np.clip(around, 0, len(logits) - 1)
    weights = np.take_along_axis(logits, around, axis=0)
    weights = np.exp(weights - weights.max(axis=0))
    found = (weights * BLUR_SIZES_PX[around]).sum(axis=0) / weights.sum(axis=0)
    return found.astype(np.float32)
