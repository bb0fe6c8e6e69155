"""Joint bilateral voting: half-cells of like colour decide together where surfaces end.

The cost of a window does not say where in it a surface ends, but colours often do. So every
half-cell takes the blur size that those around it find likeliest, each weighted by how like its
colour is: a joint bilateral filter of probabilities [1], [2]. Then every quarter of a half-cell
belongs to the one of the nine around whose colour is the most like its own.

[1] G. Petschnigg et al., Digital photography with flash and no-flash image pairs, SIGGRAPH 2004.
[2] A. Hosni et al., Fast cost-volume filtering for visual correspondence and beyond, PAMI 2013.
"""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import (
    FloatArray,
    IndexArray,
    constant,
    filters,
    namespace,
    zeros,
)
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network.array_forms import (
    DISTANCE,
    VOTERS,
    choose_plain,
    chosen,
    count_plain,
    counted,
)
from coded_aperture_ros.depth.decoders.network.cells import HALF_CELL_PX, Cells

# Differences from which colours have nothing in common, of square roots of linear light: of
# brightness, which shading and texture change, and of colour. Chosen on photographs with measured
# disparity; half or twice as much changes little.
_BRIGHTNESS = 0.18
_COLOUR = 0.047
# Half-cells in each direction that vote, every second as on a chessboard: those beside each other
# say about the same. Fewer where colours do not differ, as brightness alone parts few surfaces.
_REACH = VOTERS
_GREY_REACH = 2
_DISTANCE = np.float32(DISTANCE)
_TO_OPPONENTS = np.stack(
    [
        np.ones(3) / 3 / _BRIGHTNESS,
        np.array([1, -1, 0]) / np.sqrt(2) / _COLOUR,
        np.array([1, 1, -2]) / np.sqrt(6) / _COLOUR,
    ],
    axis=1,
).astype(np.float32)
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
        of_quarters = _shrunk(cells.pad_frame(light), HALF_CELL_PX // 2)
        half_cells, quarters = map(_opponents, (_shrunk(of_quarters, 2), of_quarters))
        xp, cv = namespace(light), filters(light)
        square = np.ones((2 * _REACH + 1,) * 2, np.uint8)
        one, other = (cv.dilate(each, square) - cv.erode(each, square) for each in half_cells[1:])
        reach = xp.where(xp.maximum(one, other) > 1, _REACH, _GREY_REACH)
        return cls(half_cells, quarters, reach)

    def owners(self) -> IndexArray:
        """Half-cell that each quarter of one belongs to [2 rows, 2 columns].

        Flat indices into the half-cells with a border of one.
        """
        if namespace(self.quarters) is not np:
            return chosen(self.half_cells, self.quarters)
        owner = np.empty(self.quarters.shape[1:], np.intp)
        _choose(self.half_cells, self.quarters, owner)
        return owner


def _shrunk(picture: FloatArray, step: int) -> FloatArray:
    """Means of squares of pixels."""
    cv, size = filters(picture), (picture.shape[1] // step, picture.shape[0] // step)
    means: FloatArray = cv.resize(picture, size, interpolation=cv.INTER_AREA)
    return means


def _opponents(light: FloatArray) -> FloatArray:
    """Brightness, red less green, and yellow less blue [3, rows, columns]; of grey, brightness."""
    xp = namespace(light)
    # Of square roots, which noise changes as much in the light as in the dark.
    colours = xp.sqrt(xp.clip(light, 0, None))
    if light.ndim == 2 or light.shape[2] != 3:
        opponents: FloatArray = zeros((3, *light.shape[:2]), light)
        opponents[0] = colours.reshape(*light.shape[:2], -1).mean(axis=-1) / _BRIGHTNESS
        return opponents
    opponents = xp.moveaxis(colours @ constant(_TO_OPPONENTS, light), -1, 0)
    return opponents if xp is not np else np.ascontiguousarray(opponents)


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
    if namespace(shares) is not np:
        return counted(first, shares, bins, guide.half_cells, guide.reach)
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
                left = max(x - aside, 0)
                for u in range(left + (left + v + x + y) % 2, min(x + aside + 1, columns), 2):
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


def _choose_loop(colours: FloatArray, of_quarters: FloatArray, owner: IndexArray) -> None:
    _, rows, columns = colours.shape
    # A row at a time, neighbour by neighbour: loops over rows use a processor's vectors.
    own, least = np.empty((3, columns), np.float32), np.empty(columns, np.float32)
    found = np.empty(columns, np.int32)
    for y in range(2 * rows):
        i = y // 2
        for right in range(2):
            least[:] = np.float32(1e30)
            for k in range(3):
                for j in range(columns):
                    own[k, j] = of_quarters[k, y, 2 * j + right]
            for place in range(9):
                v, side = i + place // 3 - 1, place % 3 - 1
                if not 0 <= v < rows:
                    continue
                # A quarter's middle is a quarter of a half-cell beside that of its own.
                down = np.float32(v - i) - np.float32(y % 2 * 0.5 - 0.25)
                across = np.float32(side) - np.float32(right * 0.5 - 0.25)
                near = _DISTANCE * (down * down + across * across)
                first, last = max(-side, 0), columns - max(side, 0)
                there = slice(first + side, last + side)
                a, b, c = colours[0, v, there], colours[1, v, there], colours[2, v, there]
                d, e, f = own[0, first:last], own[1, first:last], own[2, first:last]
                best, which = least[first:last], found[first:last]
                for j in range(last - first):
                    one, two, three = a[j] - d[j], b[j] - e[j], c[j] - f[j]
                    unlike = near + one * one + two * two + three * three
                    which[j] = place if unlike < best[j] else which[j]
                    best[j] = min(unlike, best[j])
            for j in range(columns):
                down, across = found[j] // 3, found[j] % 3
                owner[y, 2 * j + right] = (i + down) * (columns + 2) + j + across


_count = Compiled(_count_loop, count_plain)
_choose = Compiled(_choose_loop, choose_plain)
