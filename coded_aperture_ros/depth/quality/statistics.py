"""Features of a frame that do not depend on the mask: noise, codec, values, lines, mosaic."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.quality.spectra import quantiles
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
# Linear light of a step of 16 and of 8 bits.
_STEP_16 = 1 / 65535
_STEP_8 = 1 / 255
# Share of pixels, of those that are not 0, whose second difference is at most a step of 16 bits:
# 0.7 to 0.85 in depth maps (simulated, estimated, of a Kinect), 0.02 in frames of 16 bits, and at
# most 0.46 in those of a sensor whose noise is a step.
_SMOOTH_SHARE = 0.6
_STEPPED_SHARE = 0.99


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
    found = []
    for kernel in (ALTERNATING, HALF_AS_FAST):
        some = []
        for band in bands:
            square = cv2.sepFilter2D(band, -1, kernel, kernel)
            cv2.multiply(square, square, square)
            # Squares that overlap by half, of two by two blocks each.
            size = [max(length // (_NOISE_PX // 2), 2) for length in band.shape[::-1]]
            blocks = cv2.resize(square, size, interpolation=cv2.INTER_AREA)
            some.append(cv2.blur(blocks, (2, 2))[1:, 1:].ravel())
        found += list(np.sqrt(quantiles(np.concatenate(some), 0.05, 0.5)) + _LEAST)
    high, high_median, half_high, half_median = found
    unlike = np.log(high / known) if known else 0.0
    return [
        np.log(high / half_high),
        np.log(high_median / half_median),
        np.log(high / _USUAL_NOISE),
        np.log(noise / _USUAL_NOISE),
        unlike,
        abs(unlike),
        float(known > 0),
    ]


def _block_grid(grey: FloatArray, noise: float) -> list[float]:
    """Logarithm of the block edges' contrast over that elsewhere, for blocks of 8 and 16 px."""
    found = []
    step = _step(grey)
    for lines in (np.ascontiguousarray(grey[:, ::step].T), grey[::step]):
        steps = cv2.absdiff(lines[:, 1:], lines[:, :-1])
        profile = np.minimum(steps, 4 * noise + np.median(steps[::4, ::4])).mean(axis=0)
        for block in _BLOCKS_PX:
            phases = profile[: len(profile) // block * block].reshape(-1, block).mean(0)
            found.append(np.log(max(phases.max(), 1e-9) / max(quantiles(phases, 0.5)[0], 1e-9)))
    return found


def _values(grey: FloatArray) -> list[float]:
    """Shares of equal, clipped and black pixels, brightness, and number of distinct values."""
    step = _step(grey)
    rows, some = np.ascontiguousarray(grey[::step]), grey[:: step + step // 2, :: step + step // 2]
    steps = cv2.absdiff(rows[:, 1:], rows[:, :-1])
    values = np.count_nonzero(np.bincount((np.clip(some.ravel(), 0, 2) * 65535 + 0.5).astype(int)))
    brightest = float(grey.max())
    bright = _CLIPPED, 0.9 * brightest
    return [  # shares by counting, which is several times as fast as a mean
        *(np.count_nonzero(steps < least) / steps.size for least in (1e-7, 2e-4)),
        *(np.count_nonzero(rows > least) / rows.size for least in bright),
        brightest,
        np.log(max(float(grey.mean()), 0) + 1e-3),
        np.count_nonzero(rows <= 1e-6) / rows.size,
        np.log(values / some.size),
    ]


def _lines(grey: FloatArray, noise: float) -> list[float]:
    """Logarithm of the unevenness of columns and rows, relative to the noise."""
    found = []
    for axis in (0, 1):
        line = grey.mean(1 - axis)
        uneven = np.abs(line[2:] - 2 * line[1:-1] + line[:-2]).mean()
        found.append(np.log(uneven * np.sqrt(grey.shape[1 - axis]) / noise + 1e-3))
    return found


def _mosaic(grey: FloatArray) -> float:
    """Logarithm of the difference between the four places of 2 x 2 squares: a Bayer mosaic."""
    lines = [grey[row::2].mean(axis=0) for row in (0, 1)]
    means = [line[column::2].mean() for line in lines for column in (0, 1)]
    return float(np.log(1e-4 + np.std(means) / max(np.mean(means), 1e-9)))


def _isolated_pixels(bands: list[FloatArray], noise: float) -> float:
    """Logarithm of the share of pixels that differ from all around them."""
    isolated = [cv2.absdiff(band, cv2.medianBlur(band, 3)) > 6 * noise + 0.02 for band in bands]
    return float(np.log(1e-5 + np.mean([np.count_nonzero(each) / each.size for each in isolated])))


def _step(grey: FloatArray) -> int:
    """Step between the rows and columns that are sampled, px: larger for larger frames."""
    return max(2, min(grey.shape) // 96)


def is_as_smooth_as_depth(grey: FloatArray) -> bool:
    """Whether the values of a picture [rows, columns] are those of a depth map, by their noise.

    Pictures of 8 bits are not judged: their smooth parts have steps.
    """
    light = grey[:, 1:-1]
    known = (light > 0) & (grey[:, 2:] > 0) & (grey[:, :-2] > 0)
    if not known.any():
        return False
    steps = light[known] / _STEP_8
    if np.mean(np.abs(steps - np.rint(steps)) < 1e-3) > _STEPPED_SHARE:
        return False
    bend = np.abs(grey[:, 2:] + grey[:, :-2] - 2 * light)[known]
    return bool(np.mean(bend < 1.5 * _STEP_16) > _SMOOTH_SHARE)
