"""Steps of the decoder in few large operations: for tensors, and without numba for arrays of NumPy.

Each does what a loop of `bilateral`, `cells` or `probabilities` does. Arguments are arrays of one
kind, and so are results; see `core.arrays.namespace`.
"""

import itertools

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import (
    BoolArray,
    FloatArray,
    IndexArray,
    Shape,
    constant,
    filters,
    namespace,
    zeros,
)

# Half-cells in each direction that vote at most; see `bilateral`.
VOTERS = 5
# Squared difference of colour that outweighs a half-cell's distance.
DISTANCE = 0.05
# Bins on either side of the likeliest that a blur size is the mean over.
REACH = 2
_AROUND = np.ones((3, 3), np.uint8)


def described(padded: FloatArray, tried_px: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Size, probability, spread and mean of half-cells, their votes, and the first bin of these.

    Parameters
    ----------
    padded : ndarray, float32 [tried + 4, n]
        Probabilities of the tried blur sizes up to a factor, with two zeros before and after.
    tried_px : ndarray, float32 [tried]

    Returns
    -------
    results : ndarray, float32 [4 + 5, n]
        Size, probability, spread and mean, see `HalfCells`; then the votes' shares.
    first : ndarray, int [n]
    """
    xp = namespace(padded)
    probability = padded[REACH:-REACH]
    together = padded[1:-3] + probability + padded[3:-1]
    best = together.argmax(0)
    steps = np.arange(-REACH, REACH + 1)
    bins = best + constant(steps[:, None] + REACH, padded)
    around = padded[bins, constant(np.arange(padded.shape[1]), padded)]
    about = around.sum(axis=0)
    off = constant(steps.astype(np.float32), padded) @ around
    size = tried_px[best] + off / about * (tried_px[1] - tried_px[0])
    total, mean, square = xp.stack([xp.ones_like(tried_px), tried_px, tried_px**2]) @ probability
    mean = mean / total
    variance = xp.clip(square / total - 2 * mean * size + size**2, 0, None)
    results = xp.stack([size, about / total, xp.sqrt(variance), mean, *(around / total)])
    return results, best


def counted(
    first: IndexArray,
    shares: FloatArray,
    bins: int,
    colours: FloatArray,
    reaches: IndexArray,
    some: slice | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Place and probability [some rows, columns] by the votes of all; see `count_votes`."""
    xp, columns = namespace(shares), first.shape[1]
    some = slice(0, len(first)) if some is None else some
    start, stop = max(some.start - VOTERS, 0), min(some.stop + VOTERS, len(first))
    # Each half-cell's votes for all bins, and beyond the frame none.
    before, width = VOTERS - (some.start - start), columns + 2 * VOTERS
    height = some.stop - some.start + 2 * VOTERS
    every = zeros((height, width, bins), shares)
    down = constant(np.arange(before, before + stop - start)[:, None, None], shares)
    across = constant(np.arange(VOTERS, VOTERS + columns)[:, None], shares)
    own = first[start:stop, :, None] + constant(np.arange(shares.shape[2]), shares)
    every[down, across, own] = shares[start:stop]
    bordered = zeros((len(colours), height, width), shares) + np.inf
    inside = slice(before, before + stop - start), slice(VOTERS, VOTERS + columns)
    bordered[(slice(None), *inside)] = colours[:, start:stop]

    offsets = [
        (i, j)
        for i, j in itertools.product(range(-VOTERS, VOTERS + 1), repeat=2)
        if (i + j) % 2 == 0 and i * i + j * j <= VOTERS**2 + 1
    ]
    places = [
        np.s_[VOTERS + i : height - VOTERS + i, VOTERS + j : VOTERS + j + columns]
        for i, j in offsets
    ]
    theirs = xp.stack([bordered[(slice(None), *place)] for place in places])
    unlike = ((theirs - colours[:, some]) ** 2).sum(axis=1)
    apart = constant(np.array([i * i + j * j for i, j in offsets])[:, None, None], shares)
    weights = xp.clip(1 - unlike, 0, None) ** 4 * (apart <= reaches[some] ** 2 + 1)
    votes = zeros((*weights.shape[1:], bins), shares)
    for weight, place in zip(weights, places, strict=True):
        votes += weight[..., None] * every[place]
    best = 1 + (votes[..., :-2] + votes[..., 1:-1] + votes[..., 2:]).argmax(-1)
    numbers = constant(np.arange(bins, dtype=np.float32), shares)
    votes = votes * (xp.abs(numbers - best[..., None]) <= REACH)
    summed = votes.sum(axis=-1)
    return votes @ numbers / summed, summed / weights.sum(axis=0)


def chosen(colours: FloatArray, of_quarters: FloatArray) -> IndexArray:
    """Half-cell that each quarter of one belongs to; see `Guide.owners`."""
    xp, (_, rows, columns) = namespace(colours), colours.shape
    bordered = zeros((len(colours), rows + 2, columns + 2), colours) + np.inf
    bordered[:, 1:-1, 1:-1] = colours
    places = np.arange(9)[:, None, None]
    theirs = xp.stack(
        [bordered[:, i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
    )
    down, right = (np.arange(2 * length) % 2 * 0.5 - 0.25 for length in (rows, columns))
    near = (places // 3 - 1 - down[:, None]) ** 2 + (places % 3 - 1 - right) ** 2
    unlike = ((doubled(theirs) - of_quarters) ** 2).sum(axis=1)
    owner = (unlike + constant((DISTANCE * near).astype(np.float32), colours)).argmin(0)
    row, column = (np.arange(2 * length) // 2 for length in (rows, columns))
    corner = constant(row[:, None] * (columns + 2) + column, colours)
    index: IndexArray = corner + owner // 3 * (columns + 2) + owner % 3
    return index


def drawn(values: FloatArray, quarters: IndexArray, one_surface: float) -> FloatArray:
    """Half-cells' values with a border of one at all pixels; see `Drawing.render_map`."""
    xp, cv, own = namespace(values), filters(values), values[1:-1, 1:-1]
    pixels = 2 * quarters.shape[1], 2 * quarters.shape[0]
    linear = cv.resize(own, pixels, interpolation=cv.INTER_LINEAR)
    even = cv.dilate(own, _AROUND) - cv.erode(own, _AROUND) <= one_surface
    at_edges = doubled(values.ravel()[quarters])
    pixel_values: FloatArray = xp.where(doubled(doubled(even)), linear, at_edges)
    return pixel_values


def doubled(values: FloatArray | BoolArray) -> FloatArray:
    """Values [..., rows, columns], each as a square of two by two."""
    *more, rows, columns = values.shape
    squares = values[..., :, None, :, None]
    squares = namespace(values).broadcast_to(squares, (*more, rows, 2, columns, 2))
    return squares.reshape(*more, 2 * rows, 2 * columns)


def put_in_squares(cells: FloatArray, channels: IndexArray, squares: FloatArray) -> None:
    """Form of `gather_squares`."""
    for quarter in range(4):
        squares[:, quarter] = cells[channels, quarter // 2 :: 2, quarter % 2 :: 2]


def add_up_rows(
    cells: FloatArray, squares: FloatArray, costs: FloatArray, first: int, size: FloatArray
) -> None:
    """Form of `add_up` for NumPy."""
    end = first + cells.shape[1]
    around = np.clip(np.arange(first - 1, end + 1), 0, costs.shape[1] - 1)
    for b, cost in enumerate(costs):
        of_cells = cells[4 * b : 4 * b + 4] + _unfolded(squares[b, :16, first // 2 : end // 2])
        less = cv2.resize(cost[around], None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
        size[b, 2 * first : 2 * end] = _unfolded(of_cells)[0] - less[2:-2]


def _unfolded(of_cells: FloatArray) -> FloatArray:
    """Half-cells [n, 2 rows, 2 columns] from the channels of cells [4 n, rows, columns]."""
    count, rows, columns = of_cells.shape
    quarters = np.moveaxis(of_cells.reshape(-1, 2, 2, rows, columns), (1, 2), (2, 4))
    return quarters.reshape(count // 4, 2 * rows, 2 * columns)


def count_plain(
    first: IndexArray,
    shares: FloatArray,
    colours: FloatArray,
    reaches: IndexArray,
    some_rows: tuple[int, int],
    votes: FloatArray,
    place: FloatArray,
    about: FloatArray,
) -> None:
    """Form of `bilateral.count_votes` for NumPy."""
    here = slice(*some_rows)
    place[here], about[here] = counted(first, shares, votes.size, colours, reaches, here)


def describe_plain(
    padded: FloatArray,
    tried_px: FloatArray,
    results: FloatArray,
    first: IndexArray,
    shares: FloatArray,
) -> None:
    """Form of `probabilities.describe` for NumPy."""
    found, first[:] = described(padded, tried_px)
    results[:], shares[:] = found[:4], found[4:].T


def draw_plain(
    values: FloatArray,
    quarters: IndexArray,
    one_surface: np.float32,
    first: Shape,
    whole: FloatArray,
) -> None:
    """Form of `cells.draw` for NumPy."""
    part = tuple(slice(at, at + length) for at, length in zip(first, whole.shape, strict=True))
    whole[:] = drawn(values, quarters, float(one_surface))[part]


def choose_plain(colours: FloatArray, of_quarters: FloatArray, owner: IndexArray) -> None:
    """Form of `Guide.owners` for NumPy."""
    owner[:] = chosen(colours, of_quarters)
