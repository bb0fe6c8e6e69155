"""Features of a frame that do not depend on the mask: noise, codec, values, lines, mosaic."""

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, filters, namespace, quantiles
from coded_aperture_ros.frames.noise import ALTERNATING, HALF_AS_FAST

# Usual noise of cameras, and the least that logarithms are taken of, linear light.
_USUAL_NOISE = 2e-3
_LEAST = 2e-5
# Side of the squares whose noise is compared, px.
_NOISE_PX = 24
# Sides of the blocks of codecs, px.
_BLOCKS_PX = (8, 16)
# Linear light from which a pixel is clipped.
_CLIPPED = 0.985
# Height of the bands of rows that stand for a frame, px, and their number.
_BAND_PX = 48
_BANDS = 3


def frame_statistics(grey: FloatArray, noise: float, known: float) -> list[float]:
    """Features of a frame [rows, columns] that do not depend on the mask.

    `noise` is the standard deviation that the estimate assumes, `known` the one known beforehand;
    0: unknown.
    """
    # A few bands of rows are enough for a large frame.
    step_px = max(len(grey) // _BANDS, _BAND_PX)
    bands = [grey[top : top + _BAND_PX] for top in range(0, len(grey) - _NOISE_PX, step_px)]
    return [
        *_noise(bands, noise, known),
        *_block_grid(grey, noise),
        *_values(grey),
        *_lines(grey, noise),
        _mosaic(grey),
        _isolated_pixels(bands, noise),
    ]


def _noise(bands: list[FloatArray], noise: float, known: float) -> list[float]:
    """Features of the noise: spectrum, size, and its ratio to the known one."""
    xp, cv, found = namespace(bands[0]), filters(bands[0]), []
    for kernel in (ALTERNATING, HALF_AS_FAST):
        some = []
        for band in bands:
            square = cv.sepFilter2D(band, -1, kernel, kernel)
            square *= square
            # Squares that overlap by half, of two by two blocks each.
            size = [max(length // (_NOISE_PX // 2), 2) for length in band.shape[::-1]]
            blocks = cv.resize(square, size, interpolation=cv.INTER_AREA)
            some.append(cv.blur(blocks, (2, 2))[1:, 1:].ravel())
        found += list(xp.sqrt(quantiles(xp.concatenate(some), 0.05, 0.5)) + _LEAST)
    high, high_median, half_high, half_median = found
    # 0 if it is unknown.
    unlike = xp.log(high / (known + (known <= 0) * high))
    return [
        xp.log(high / half_high),
        xp.log(high_median / half_median),
        xp.log(high / _USUAL_NOISE),
        xp.log(noise / _USUAL_NOISE),
        unlike,
        abs(unlike),
        known > 0,
    ]


def _block_grid(grey: FloatArray, noise: float) -> list[float]:
    """Logarithm of the block edges' contrast over that elsewhere, for blocks of 8 and 16 px."""
    xp, cv, found = namespace(grey), filters(grey), []
    step = _step(grey)
    for lines in (xp.ascontiguousarray(grey[:, ::step].T), grey[::step]):
        steps = cv.absdiff(lines[:, 1:], lines[:, :-1])
        profile = xp.minimum(steps, 4 * noise + xp.median(steps[::4, ::4])).mean(axis=0)
        for block in _BLOCKS_PX:
            phases = profile[: len(profile) // block * block].reshape(-1, block).mean(0)
            largest, (median,) = phases.max(), quantiles(phases, 0.5)
            found.append(xp.log(xp.maximum(largest, 1e-9) / xp.maximum(median, 1e-9)))
    return found


def _values(grey: FloatArray) -> list[float]:
    """Shares of equal, clipped and black pixels, brightness, and number of distinct values."""
    xp, step = namespace(grey), _step(grey)
    rows, some = xp.ascontiguousarray(grey[::step]), grey[:: step + step // 2, :: step + step // 2]
    steps = filters(grey).absdiff(rows[:, 1:], rows[:, :-1])
    ordered = xp.sort(xp.floor(xp.clip(some.ravel(), 0, 2) * 65535 + 0.5))
    brightest = grey.max()
    return [
        *(share_of(steps < least) for least in (1e-7, 2e-4)),
        *(share_of(rows > least) for least in (_CLIPPED, 0.9 * brightest)),
        brightest,
        xp.log(xp.maximum(grey.mean(), 0) + 1e-3),
        share_of(rows <= 1e-6),
        xp.log((xp.count_nonzero(ordered[1:] > ordered[:-1]) + 1) / len(ordered)),
    ]


def _lines(grey: FloatArray, noise: float) -> list[float]:
    """Logarithm of the unevenness of columns and rows, relative to the noise."""
    xp, found = namespace(grey), []
    for axis in (0, 1):
        line = grey.mean(1 - axis)
        uneven = xp.abs(line[2:] - 2 * line[1:-1] + line[:-2]).mean()
        found.append(xp.log(uneven * grey.shape[1 - axis] ** 0.5 / noise + 1e-3))
    return found


def _mosaic(grey: FloatArray) -> float:
    """Logarithm of the difference between the four places of 2 x 2 squares: a Bayer mosaic."""
    xp, lines = namespace(grey), [grey[row::2].mean(axis=0) for row in (0, 1)]
    means = xp.stack([line[column::2].mean() for line in lines for column in (0, 1)])
    return xp.log(1e-4 + xp.std(means) / xp.maximum(means.mean(), 1e-9))


def _isolated_pixels(bands: list[FloatArray], noise: float) -> float:
    """Logarithm of the share of pixels that differ from all around them."""
    xp, cv = namespace(bands[0]), filters(bands[0])
    isolated = [cv.absdiff(band, cv.medianBlur(band, 3)) > 6 * noise + 0.02 for band in bands]
    return xp.log(1e-5 + sum(map(share_of, isolated)) / len(isolated))


def share_of(mask: BoolArray) -> float:
    """Share of the pixels of a mask: by counting, several times as fast as a mean."""
    return namespace(mask).count_nonzero(mask) / (mask.shape[0] * mask.shape[1])


def _step(grey: FloatArray) -> int:
    """Step between the rows and columns that are sampled, px: larger for larger frames."""
    return max(2, min(grey.shape) // 96)
