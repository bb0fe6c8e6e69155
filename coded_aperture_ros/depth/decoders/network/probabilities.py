"""Blur size of every half-cell, its spread and probability, from the network's logits."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, filters, namespace
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network.array_forms import REACH, describe_plain
from coded_aperture_ros.depth.decoders.network.bilateral import Guide, count_votes
from coded_aperture_ros.depth.decoders.network.network import Logits, log_odds

# Share of errors within one standard deviation, and its largest ratio to the probability.
_WITHIN_ONE = 0.68
_SUREST = 0.98
# Limits of the logarithm of the mean error in px.
_LOG_WIDTHS = (-4.0, 2.0)
# Neighbours among which other surfaces are looked for, and squares that log-odds are a mean over,
# in half-cells.
_SQUARE = np.ones((5, 5), np.uint8)
_AROUND = (13, 13), (33, 33)
# Half-cells that are processed together: as many as a core's cache holds.
_CHUNK = 5376


def _describe_loop(
    padded: FloatArray,
    tried_px: FloatArray,
    results: FloatArray,
    first: IndexArray,
    shares: FloatArray,
) -> None:
    levels, count = len(tried_px), padded.shape[1]
    largest, best = np.zeros(count, np.float32), np.zeros(count, np.int32)
    total, mean = np.zeros(count, np.float32), np.zeros(count, np.float32)
    square = np.zeros(count, np.float32)
    for level in range(levels):
        px = tried_px[level]
        for x in range(count):
            here = padded[level + REACH, x]
            # With its neighbours: a blur size between two bins shares its probability among them.
            together = padded[level + REACH - 1, x] + here + padded[level + REACH + 1, x]
            if together > largest[x]:
                largest[x] = together
                best[x] = level
            total[x] += here
            mean[x] += px * here
            square[x] += px * px * here
    step = tried_px[1] - tried_px[0]
    for x in range(count):
        about, off = np.float32(0), np.float32(0)
        for at in range(2 * REACH + 1):
            about += padded[best[x] + at, x]
            off += np.float32(at - REACH) * padded[best[x] + at, x]
            shares[x, at] = padded[best[x] + at, x] / total[x]
        size = tried_px[best[x]] + off / about * step
        variance = (square[x] - 2 * mean[x] * size) / total[x] + size * size
        results[0, x], results[1, x] = size, about / total[x]
        results[2, x], results[3, x] = np.sqrt(max(variance, np.float32(0))), mean[x] / total[x]
        first[x] = best[x]


# Writes size, probability, spread (see `HalfCells`) and mean [4, n], and `Votes`, of probabilities,
# up to a factor, of the tried blur sizes, with `REACH` zeros before and after [tried + 2 REACH, n].
describe = Compiled(_describe_loop, describe_plain)


def width_px(logits: Logits) -> FloatArray:
    """Mean error in px, if the likeliest blur size is about right [rows, columns]."""
    xp = namespace(logits.log_width)
    width: FloatArray = xp.exp(xp.clip(logits.log_width, *_LOG_WIDTHS))
    return width


@dataclasses.dataclass(frozen=True, eq=False)
class Votes:
    """What every half-cell finds likely by itself.

    Attributes
    ----------
    first : ndarray, int [rows, columns]
        The first of the bins around its likeliest three; bin `REACH` is the first tried one.
    shares : ndarray, float32 [rows, columns, 2 REACH + 1]
        Probability of these bins.
    mean_px : ndarray, float32 [rows, columns]
        Mean of the whole distribution.
    """

    first: IndexArray
    shares: FloatArray
    mean_px: FloatArray


@dataclasses.dataclass(frozen=True, eq=False)
class HalfCells:
    """Blur size of every half-cell and its uncertainty; float32 [rows, columns].

    Attributes
    ----------
    size_px : ndarray
        Blur size without sign: the mean over the bins around the likeliest three.
    about : ndarray
        Probability that it is about right: the sum over these bins.
    spread_px : ndarray
        Standard deviation of the whole distribution from it.
    width_px : ndarray
        Mean error if it is about right.
    logits : ndarray, float32 [tried, rows, columns]
        Of every tried blur size.
    tried_px : ndarray, float32 [tried]
        The tried blur sizes.
    votes : Votes, optional
        What each finds likely, for `agreed`.
    """

    size_px: FloatArray
    about: FloatArray
    spread_px: FloatArray
    width_px: FloatArray
    logits: FloatArray
    tried_px: FloatArray
    votes: Votes | None = None

    @classmethod
    def from_logits(
        cls, logits: Logits, tried_px: FloatArray, workers: Workers | None = None
    ) -> "HalfCells":
        """Half-cells of the network's output; `workers` share the work."""
        flat = logits.size.reshape(len(tried_px), -1)
        results = np.empty((4, flat.shape[1]), np.float32)
        first = np.empty(flat.shape[1], np.intp)
        shares = np.empty((flat.shape[1], 2 * REACH + 1), np.float32)

        def add_chunk(start: int, _: int) -> None:
            chunk = slice(start, start + _CHUNK)
            some = flat[:, chunk]
            padded = np.zeros((len(some) + 2 * REACH, some.shape[1]), np.float32)
            np.exp(some - some.max(axis=0), out=padded[REACH:-REACH])
            describe(padded, tried_px, results[:, chunk], first[chunk], shares[chunk])

        (workers or Workers()).each(add_chunk, range(0, flat.shape[1], _CHUNK))
        width = width_px(logits)
        size, about, spread, mean = results.reshape(4, *width.shape)
        votes = Votes(first.reshape(width.shape), shares.reshape(*width.shape, -1), mean)
        return cls(size, about, spread, width, logits.size, tried_px, votes)

    def agreed(self, guide: Guide, workers: Workers | None = None) -> "HalfCells":
        """Half-cells with what those of like colour around find the likeliest together."""
        votes = self.votes
        if votes is None:
            raise ValueError("only half-cells from logits can agree")
        bins = len(self.tried_px) + 2 * REACH
        place, about = count_votes(votes.first, votes.shares, bins, guide, workers)
        size = self.tried_px[0] + (place - REACH) * (self.tried_px[1] - self.tried_px[0])
        # The second moment about another size.
        apart = self.size_px - size
        square = self.spread_px**2 + apart * (2 * votes.mean_px - self.size_px - size)
        xp = namespace(square)
        spread = xp.sqrt(xp.clip(square, 0, None))
        return dataclasses.replace(self, size_px=size, about=about, spread_px=spread)

    def right_within(self, tolerance_px: FloatArray) -> FloatArray:
        """Probability that the error is within a tolerance [rows, columns]."""
        share = 1 - namespace(self.about).exp(-tolerance_px / self.width_px)
        probability: FloatArray = self.about * share
        return probability

    def own_features(self, tolerance_px: FloatArray) -> FloatArray:
        """Features of each half-cell alone, float32 [features, rows, columns].

        Log-odds that the error is within the tolerance, blur size, and logarithm of the tolerance.
        """
        xp, odds = namespace(tolerance_px), log_odds(self.right_within(tolerance_px))
        features: FloatArray = xp.stack([odds, self.size_px, xp.log(tolerance_px)])
        return features

    def confidence_features(self, tolerance_px: FloatArray) -> FloatArray:
        """Features that confidence is calibrated by, float32 [features, rows, columns].

        Those of each half-cell alone; the log-odds around; and how much more and less blurred
        neighbours are, in tolerances.
        """
        own, size = self.own_features(tolerance_px), self.size_px
        xp, cv = namespace(size), filters(size)
        means = (cv.blur(own[0], side) for side in _AROUND)
        apart = (xp.abs(turn(size, _SQUARE) - size) for turn in (cv.dilate, cv.erode))
        apart_in_tolerances = (xp.log1p(each / tolerance_px) for each in apart)
        features: FloatArray = xp.stack([*own, *means, *apart_in_tolerances])
        return features

    def deviation_px(self) -> FloatArray:
        """Standard deviation of the blur size [rows, columns]: 68 % of errors are within it."""
        xp = namespace(self.about)
        share = xp.clip(_WITHIN_ONE / self.about, None, _SUREST)
        deviation = -self.width_px * xp.log1p(-share)
        # Where the likeliest size is improbable, the error is the spread over all sizes.
        larger = xp.maximum(deviation, self.spread_px)
        deviation_px: FloatArray = xp.where(self.about < _WITHIN_ONE, larger, deviation)
        return deviation_px
