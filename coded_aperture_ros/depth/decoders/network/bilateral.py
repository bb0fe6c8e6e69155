"""Joint bilateral voting: half-cells of like colour decide together where surfaces end.

The cost of a window does not say where in it a surface ends, but colours often do. So every
half-cell takes the blur size that those around it find likeliest, each weighted by how like its
colour is: a joint bilateral filter of probabilities [1], [2]. Then every quarter of a half-cell
belongs to the one of the nine around whose colour is the most like its own.

[1] G. Petschnigg et al., Digital photography with flash and no-flash image pairs, SIGGRAPH 2004.
[2] A. Hosni et al., Fast cost-volume filtering for visual correspondence and beyond, PAMI 2013.
"""

import dataclasses
import itertools
from typing import Any

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network.cells import HALF_CELL_PX, Cells

# Differences from which colours have nothing in common, of square roots of linear light: of
# brightness, which shading and texture change, and of colour. Chosen on photographs with measured
# disparity; half or twice as much changes little.
_BRIGHTNESS = 0.18
_COLOUR = 0.047
# Half-cells in each direction that vote: fewer where colours do not differ, as brightness alone
# parts few surfaces.
_REACH = 5
_GREY_REACH = 2
# Squared difference of colour that outweighs a half-cell's distance.
_DISTANCE = np.float32(0.05)
# Half-cells of so many rows are counted together.
_ROWS = 8


@dataclasses.dataclass(frozen=True, eq=False)
class Guide:
    """Colours of a frame: brightness and two opponent colours; 1 apart is nothing in common.

    Attributes
    ----------
    half_cells : ndarray, float32 [3, rows, columns]
    quarters : ndarray, float32 [3, 2 rows, 2 columns]
    reach : ndarray, int [rows, columns]
        Half-cells in each direction that vote for each.
    """

    half_cells: FloatArray
    quarters: FloatArray
    reach: IndexArray

    @classmethod
    def from_light(cls, light: FloatArray, cells: Cells) -> "Guide":
        """Guide of a frame, linear light [height, width] or [height, width, 3], without NaN."""
        channels = np.atleast_3d(light)
        whole = [cells.pad_frame(channels[..., each]) for each in range(channels.shape[2])]
        half_cells, quarters = (
            _opponents([_shrunk(each, step_px) for each in whole])
            for step_px in (HALF_CELL_PX, HALF_CELL_PX // 2)
        )
        square = np.ones((2 * _REACH + 1,) * 2, np.uint8)
        differences = [cv2.dilate(one, square) - cv2.erode(one, square) for one in half_cells[1:]]
        reach = np.where(np.max(differences, axis=0) > 1, _REACH, _GREY_REACH)
        return cls(half_cells, quarters, reach)

    def owners(self) -> IndexArray:
        """Half-cell that each quarter of one belongs to, flat indices [2 rows, 2 columns]."""
        _, rows, columns = self.half_cells.shape
        bordered = np.pad(self.half_cells, ((0, 0), (1, 1), (1, 1)), mode="edge")
        index = np.pad(np.arange(rows * columns).reshape(rows, columns), 1, mode="edge")
        owner, least = np.empty((2 * rows, 2 * columns), np.intp), None
        # A quarter's middle is a quarter of a half-cell beside that of its own.
        down, right = (np.arange(2 * length) % 2 * 0.5 - 0.25 for length in (rows, columns))
        for i, j in itertools.product((0, -1, 1), repeat=2):
            there = np.s_[..., 1 + i : 1 + i + rows, 1 + j : 1 + j + columns]
            apart = self.quarters - _doubled(bordered[there])
            distance = np.add.outer((i - down) ** 2, (j - right) ** 2).astype(np.float32)
            unlike = np.einsum("kij,kij->ij", apart, apart) + _DISTANCE * distance
            better = ... if least is None else unlike < least
            owner[better] = _doubled(index[there])[better]
            least = unlike if least is None else np.minimum(least, unlike)
        return owner


def _shrunk(picture: FloatArray, step_px: int) -> FloatArray:
    """Square root of the means of squares: as much noise in the dark as in the light."""
    size = picture.shape[1] // step_px, picture.shape[0] // step_px
    return np.sqrt(np.maximum(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), 0))


def _opponents(colours: list[FloatArray]) -> FloatArray:
    """Brightness, red less green, and yellow less blue [3, rows, columns]; of grey, brightness."""
    brightness = np.mean(colours, axis=0) / _BRIGHTNESS
    if len(colours) != 3:
        nothing = np.zeros_like(brightness)
        return np.stack([brightness, nothing, nothing]).astype(np.float32)
    red, green, blue = colours
    opponents = (red - green) / np.sqrt(2), (red + green - 2 * blue) / np.sqrt(6)
    return np.stack([brightness, *(each / _COLOUR for each in opponents)]).astype(np.float32)


def _doubled(values: Any) -> Any:
    """Each value four times, in squares [..., 2 rows, 2 columns]."""
    return np.repeat(np.repeat(values, 2, axis=-2), 2, axis=-1)


def count_votes(
    first: IndexArray, shares: FloatArray, bins: int, guide: Guide, workers: Workers | None = None
) -> tuple[FloatArray, FloatArray]:
    """Likeliest place among all bins by the half-cells of like colour, and its probability.

    Parameters
    ----------
    first : ndarray, int [rows, columns]
        Every half-cell votes for some bins that lie side by side; the first of them.
    shares : ndarray, float32 [rows, columns, n]
        Probability of each of these bins.
    bins : int
        Number of all bins.
    guide : Guide
    workers : Workers, optional
        Threads that share the work.

    Returns
    -------
    place : ndarray, float32 [rows, columns]
        Fractional bin: the mean over the five around the likeliest three.
    about : ndarray, float32 [rows, columns]
        Probability of these five.
    """
    place, about = np.empty((2, *first.shape), np.float32)

    def count_rows(row: int, _: int) -> None:
        rows = row, min(row + _ROWS, len(first))
        colours, votes = guide.half_cells, np.zeros(bins, np.float32)
        _count(first, shares, colours, guide.reach, rows, votes, place, about)

    (workers or Workers()).each(count_rows, range(0, len(first), _ROWS))
    return place, about


def _count_loop(
    first: IndexArray,
    shares: FloatArray,
    colours: FloatArray,
    reaches: IndexArray,
    some_rows: tuple[int, int],
    votes: FloatArray,
    place: FloatArray,
    about: FloatArray,
) -> None:
    rows, columns = first.shape
    for y in range(*some_rows):
        for x in range(columns):
            votes[:] = 0
            total, reach = np.float32(0), reaches[y, x]
            for v in range(max(y - reach, 0), min(y + reach + 1, rows)):
                aside = int(np.sqrt(reach * reach + 1 - (v - y) * (v - y)))
                for u in range(max(x - aside, 0), min(x + aside + 1, columns)):
                    one = colours[0, v, u] - colours[0, y, x]
                    two = colours[1, v, u] - colours[1, y, x]
                    three = colours[2, v, u] - colours[2, y, x]
                    weight = np.float32(1) - (one * one + two * two + three * three)
                    if weight > 0:
                        # Near to a Gaussian, without its exponential.
                        weight *= weight
                        weight *= weight
                        total += weight
                        for k in range(shares.shape[2]):
                            votes[first[v, u] + k] += weight * shares[v, u, k]
            best, most = 1, np.float32(-1)
            for k in range(1, votes.size - 1):
                together = votes[k - 1] + votes[k] + votes[k + 1]
                if together > most:
                    best, most = k, together
            summed, moment = np.float32(0), np.float32(0)
            for k in range(max(best - 2, 0), min(best + 3, votes.size)):
                summed += votes[k]
                moment += votes[k] * np.float32(k)
            place[y, x], about[y, x] = moment / summed, summed / total


def _count_plain(
    first: IndexArray,
    shares: FloatArray,
    colours: FloatArray,
    reaches: IndexArray,
    some_rows: tuple[int, int],
    votes: FloatArray,
    place: FloatArray,
    about: FloatArray,
) -> None:
    # Each half-cell's votes for all bins, and beyond the frame none.
    every = np.zeros((*first.shape, votes.size), np.float32)
    np.put_along_axis(every, first[..., None] + np.arange(shares.shape[2]), shares, axis=2)
    every = np.pad(every, ((_REACH, _REACH), (_REACH, _REACH), (0, 0)))
    margin = (0, 0), (_REACH, _REACH), (_REACH, _REACH)
    bordered = np.pad(colours, margin, constant_values=np.inf)
    here, reach = np.s_[some_rows[0] : some_rows[1]], reaches[slice(*some_rows)]
    counted = np.zeros((*reach.shape, votes.size), np.float32)
    total = np.zeros(reach.shape, np.float32)
    for i, j in itertools.product(range(-_REACH, _REACH + 1), repeat=2):
        rows = slice(some_rows[0] + _REACH + i, some_rows[1] + _REACH + i)
        columns = slice(_REACH + j, _REACH + j + first.shape[1])
        unlike = ((bordered[:, rows, columns] - colours[:, here]) ** 2).sum(axis=0)
        weight = np.maximum(1 - unlike, 0) ** 4 * (i * i + j * j <= reach**2 + 1)
        counted += weight[..., None] * every[rows, columns]
        total += weight
    best = 1 + (counted[..., :-2] + counted[..., 1:-1] + counted[..., 2:]).argmax(axis=-1)
    near = np.abs(np.arange(votes.size) - best[..., None]) <= 2
    summed = (counted * near).sum(axis=-1)
    place[here] = (counted * near * np.arange(votes.size)).sum(axis=-1) / summed
    about[here] = summed / total


_count = Compiled(_count_loop, _count_plain)
