"""Second surface in a window, as of nets, leaves and panes in front of something else."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.arrays import BoolArray, FloatArray, constant, namespace, zeros
from coded_aperture_ros.core.networks import network_of
from coded_aperture_ros.depth.decoders.network.features import BLUR_SIZES_PX
from coded_aperture_ros.depth.decoders.network.network import Logits, to_half_cells

WEIGHTS = "second.npz"
SCHEMA = "coded-aperture second surface network"
SCHEMA_VERSION = 1
# Outputs for every cell: logits of the blur sizes of the less and of the more blurred surface, log-
# odds of two surfaces, and log-odds of the share of the less blurred one.
CHANNELS = 2 * len(BLUR_SIZES_PX) + 2
# Log-odds above which there are two surfaces, for weights' files that state none.
LEAST_ODDS = 0.6
# Bins on either side of the likeliest that a blur size is the mean over.
_REACH = 2


@dataclasses.dataclass(frozen=True, eq=False)
class SurfacePair:
    """Two surfaces in the window of 48 px around each cell; float32 [rows, columns]."""

    odds: FloatArray  # log-odds that there are two
    less_px: FloatArray  # unsigned blur size of the less blurred one
    more_px: FloatArray  # unsigned blur size of the more blurred one
    share: FloatArray  # share of the window that the less blurred one covers, 0 to 1
    least_odds: float = LEAST_ODDS  # log-odds above which there are two

    def map_values(self, draw: Callable[[FloatArray], FloatArray]) -> "SurfacePair":
        """Pair with a function applied to each map, such as a resampling."""
        return dataclasses.replace(
            self,
            odds=draw(self.odds),
            less_px=draw(self.less_px),
            more_px=draw(self.more_px),
            share=draw(self.share),
        )

    def other_surface(self, size_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Blur size and share of the surface other than that of `size_px`; NaN if there is one."""
        xp = namespace(size_px)
        is_less = xp.abs(size_px - self.less_px) < xp.abs(size_px - self.more_px)
        other_px = xp.where(is_less, self.more_px, self.less_px)
        share = xp.where(is_less, 1 - self.share, self.share)
        one = self.odds < self.least_odds
        return xp.where(one, np.nan, other_px), xp.where(one, np.nan, share)


class SecondSurface:
    """Finds the pairs of surfaces of a frame, from the outputs of the refinement network.

    With a small network of its own, which OpenCV runs, or PyTorch on a `device`; see
    `training/second.py`. `tried` [blur sizes] as of `Network`. Not for several threads at once.
    """

    def __init__(self, tried: BoolArray, device: str | None = None) -> None:
        arrays = read_shipped(__file__, WEIGHTS, SCHEMA, SCHEMA_VERSION)
        self._network = _network(arrays, device)
        self._tried = tried
        self._least_odds = float(arrays.get("least_odds", np.array(LEAST_ODDS)))

    def __call__(self, logits: Logits, scalars: FloatArray) -> SurfacePair:
        """Pairs of a frame, from logits and the scalar `cost_features` [SCALARS, rows, columns]."""
        probabilities = cell_probabilities(logits.size, self._tried)
        xp = namespace(scalars)
        features = xp.concatenate([*probabilities, scalars, logits.cells])
        outputs = to_half_cells(self._network({"shown": features[None]})[0])  # of squares of 16 px
        count = len(BLUR_SIZES_PX)
        odds, share = outputs[2 * count :]
        return SurfacePair(
            odds,
            _mean_around_best(outputs[:count]),
            _mean_around_best(outputs[count : 2 * count]),
            1 / (1 + xp.exp(-share)),
            self._least_odds,
        )


def cell_probabilities(size: FloatArray, tried: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Mean and largest probability over the half-cells of each cell [blur sizes, rows, columns].

    Takes logits [tried, 2 rows, 2 columns].
    """
    xp, some = namespace(size), np.flatnonzero(tried)
    probability = xp.exp(size - xp.amax(size, 0))
    probability /= probability.sum(axis=0)
    quarters = [probability[:, i::2, j::2] for i in (0, 1) for j in (0, 1)]
    mean, most = zeros((2, len(tried), *quarters[0].shape[1:]), probability)
    mean[constant(some, size)] = sum(quarters) / 4
    most[constant(some, size)] = xp.amax(xp.stack(quarters), 0)
    return mean, most


def _mean_around_best(logits: FloatArray) -> FloatArray:
    """Mean blur size around the likeliest, px, from logits [blur sizes, rows, columns]."""
    xp, steps = namespace(logits), np.arange(-_REACH, _REACH + 1)[:, None, None]
    around = xp.clip(logits.argmax(axis=0) + constant(steps, logits), 0, len(logits) - 1)
    weights = xp.take_along_axis(logits, around, axis=0)
    weights = xp.exp(weights - xp.amax(weights, 0))
    mean_px = (weights * constant(BLUR_SIZES_PX, logits)[around]).sum(axis=0) / weights.sum(axis=0)
    return xp.asarray(mean_px, dtype=xp.float32)


def _network(arrays: Mapping[str, Any], device: str | None) -> Callable[[Mapping[str, Any]], Any]:
    """Function that runs the network, by OpenCV or on PyTorch's device."""
    if device is None:
        return network_of(arrays, "second", "opencv", 1)
    from coded_aperture_ros.core.tensors.networks import TorchNetwork

    return TorchNetwork(arrays, "second", device)
