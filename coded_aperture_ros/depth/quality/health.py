"""How well a frame fits its bank, as one number, and the likeliest cause where it does not."""

import dataclasses
from collections.abc import Iterator
from functools import cached_property, lru_cache

import cv2
import numpy as np

from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.arrays import FloatArray, as_floats
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.quality.evidence import Evidence, HypothesisTest
from coded_aperture_ros.depth.quality.spectra import quantiles
from coded_aperture_ros.frames.noise import ALTERNATING, HALF_AS_FAST
from coded_aperture_ros.optics import PsfStack

SCHEMA = "coded-aperture check of fit"
SCHEMA_VERSION = 1
# What a cause is called, what to say of it, and to do; in the order of the network's outputs.
CAUSES = {
    "mask": "another mask, inverted or dirty, or a lens that blurs otherwise: compare both with "
    "the camera file",
    "none": "no mask in the lens: put it in",
    "turned": "the mask is turned or mirrored: put it in as the camera file has it",
    "compression": "compressed pictures: record them without loss",
    "motion": "motion blur: expose for less time, or use motion",
    "clipped": "clipped light: expose for less time",
    "noise": "noise unlike the camera file's, or with a pattern: measure it with calibrate noise",
    "range": "nearer or farther than the bank's levels, or all in focus: learn the bank for more "
    "depths, or focus as the camera file says",
    "scale": "pictures that were enlarged, binned or cropped: record them as the sensor reads them "
    "out",
    "tone": "values are not linear light: set the gamma",
    "processed": "pictures that were sharpened, denoised or demosaiced, or a raw mosaic: switch "
    "that off in the camera, or say bayer",
}
# From here on a frame is said to fit.
FITS = 0.5
# Confidence falls from the first health to the second, down to what is right by chance where frames
# do not fit. It is about as often right as it says, over frames that fit and others.
_TRUSTED = 0.7
WITHHELD = 0.2
_CHANCE_CONFIDENCE = 0.2
# What the network was trained for.
LARGEST_PX = 22.5
LIMIT = 20.0
SCALED_LIMIT = 5.0
_LAYERS = 3
# Of the largest frames that the network has learned from: what smaller ones say is less certain.
_USUAL_PIXELS = 288 * 288
_LEAST_NOISE = 2e-4
_CLEANEST = 3e-4
_DITHER = 6e-4
_UNSURE_PX = 4.0
_FAR_PX = 1.5
_CONFIDENT = 0.55
_SPARSE = 3
# What is left out on either side of the middle, as shares of the frame.
_MARGIN_SHARE = 0.3
# At most so many windows along a side at the first look, which is enough where confidence is left
# as it is, and at the second.
_CELLS = 5, 10
# Of a video, one frame in so many is looked at, and counts by this share.
_FRAME_INTERVAL = 4
_NEW_FRAME_WEIGHT = 0.4


@dataclasses.dataclass(frozen=True)
class Health:
    """How well a frame fits its bank."""

    # In [0, 1]: how likely what is sure of its depth is right by and large; from `FITS` on it fits.
    value: float
    cause: str = ""  # the likeliest of `CAUSES` if it does not fit; empty if it does

    @property
    def fits(self) -> bool:
        """Whether the depth may be relied on."""
        return self.value >= FITS

    @property
    def withheld(self) -> bool:
        """Whether depth is so unlikely to be right that its confidence is next to nothing."""
        return self.value < WITHHELD

    def __str__(self) -> str:
        """Say it in one line."""
        if self.fits:
            return f"fits ({self.value:.2f})"
        return f"does not fit ({self.value:.2f}): {CAUSES[self.cause]}"

    def limit_confidence(self, confidence: FloatArray) -> FloatArray:
        """Return what is left of a confidence."""
        left = np.float32(np.clip((self.value - WITHHELD) / (_TRUSTED - WITHHELD), 0, 1))
        if left >= 1:
            return confidence
        lowest = np.minimum(confidence, np.float32(_CHANCE_CONFIDENCE))
        return np.asarray(left * confidence + (1 - left) * lowest, np.float32)


@lru_cache(maxsize=1)
def _weights() -> dict[str, FloatArray]:
    """Return what small networks [members, ...] standardise by, and their weights and biases."""
    arrays = read_shipped(__file__, "fit.npz", SCHEMA, SCHEMA_VERSION)
    return {name: as_floats(array) for name, array in arrays.items() if array.ndim}


def _outputs_of(features: FloatArray) -> FloatArray:
    """Return the mean of what the networks say: health, then causes."""
    of = _weights()
    values = (np.clip(features, -LIMIT, LIMIT) - of["mean"]) / of["scale"]
    values = np.clip(values, -SCALED_LIMIT, SCALED_LIMIT)[..., None]
    for layer in range(_LAYERS):
        values = of[f"weight{layer}"] @ values + of[f"bias{layer}"][..., None]
        if layer < _LAYERS - 1:
            np.maximum(values, 0, out=values)
    return np.asarray(values[..., 0].mean(axis=0))


def can_be_checked(stack: PsfStack) -> bool:
    """Return whether the levels are such as the network was trained for."""
    if not stack.in_pixels or len(stack) < 3:
        return False
    return float(np.abs(stack.blur_sizes_px).max()) <= LARGEST_PX


class FitCheck:
    """Checks the frames of a video, or single ones, against a bank's PSFs; see `can_be_checked`.

    With `remembers`, frames are those of a video, in order: then only some are looked at, and what
    they say is averaged. With `guarded`, the levels at the ends stand for what is beyond them. With
    `middle_only`, the PSFs are those of the middle of the image, and only windows there tell.
    """

    def __init__(
        self,
        stack: PsfStack,
        remembers: bool = False,
        guarded: bool = False,
        middle_only: bool = False,
    ) -> None:
        self._stack, self._remembers, self._guarded = stack, remembers, guarded
        self._middle_only = middle_only
        self.reset()

    def reset(self) -> None:
        """Forget the frames so far."""
        self._frames = 0
        self._outputs: FloatArray | None = None
        self._health: Health | None = None

    def __call__(
        self,
        observation: Observation,
        misfit: FloatArray,
        level: FloatArray,
        confidence: FloatArray,
    ) -> Health | None:
        """Return how well a frame fits; None if there is too little to see.

        Takes the misfit of the patches, see `Cost`, the fractional level that was found of every
        pixel, and how sure that is.
        """
        due = not self._remembers or self._frames % _FRAME_INTERVAL == 0
        self._frames += 1
        if not due:
            return self._health
        outputs = None
        for features in self.looks(observation, misfit, level, confidence):
            outputs = _outputs_of(features)
            if _health_of(outputs).value > _TRUSTED:
                break
        if outputs is None:
            return self._health
        if self._remembers and self._outputs is not None:
            outputs = self._outputs + np.float32(_NEW_FRAME_WEIGHT) * (outputs - self._outputs)
        self._outputs, self._health = outputs, _health_of(outputs)
        return self._health

    def looks(
        self,
        observation: Observation,
        misfit: FloatArray,
        level: FloatArray,
        confidence: FloatArray,
    ) -> Iterator[FloatArray]:
        """Yield what the network is told of a frame: of few windows, and, if asked, of more.

        Nothing if there is too little to see. Arguments are those of a call.
        """
        grey, noise = observation.grey, max(observation.noise.typical, _LEAST_NOISE)
        if noise < _CLEANEST:  # as no camera's frames are: simulated ones
            dither = np.random.default_rng(0).standard_normal(grey.shape, dtype=np.float32)
            grey, noise = grey + np.float32(_DITHER) * dither, float(np.hypot(noise, _DITHER))
        known = observation.noise.sigma if observation.noise.highest is None else 0.0
        of_file = frame_statistics(grey, noise, known)
        smaller = max(0.0, float(np.log(_USUAL_PIXELS / grey.size)))
        top, left = (
            int(_MARGIN_SHARE * length) if self._middle_only else 0 for length in grey.shape
        )
        part = np.s_[top : grey.shape[0] - top, left : grey.shape[1] - left]
        unusable = None if observation.unusable is None else observation.unusable[part]
        for cells in _CELLS:
            windows = self._test.score(grey[part], noise, unusable, cells)
            if windows is not None:
                at = windows.rows + top, windows.columns + left
                windows = dataclasses.replace(windows, rows=at[0], columns=at[1])
                of_maps = self._of_maps(windows, observation, misfit, level, confidence)
                numbers = [*windows.features, *of_file, *of_maps, smaller]
                yield np.nan_to_num(np.array(numbers, np.float32))

    def _of_maps(
        self,
        windows: Evidence,
        observation: Observation,
        misfit: FloatArray,
        level: FloatArray,
        confidence: FloatArray,
    ) -> list[float]:
        """Return what was made of the windows by the estimate, for the network."""
        telling = misfit[observation.usable] if observation.usable.any() else misfit
        of_map = (
            centres * length // whole
            for centres, length, whole in zip(
                (windows.rows, windows.columns), level.shape, observation.grey.shape, strict=True
            )
        )
        # What one window says by itself, and what became of it among its neighbours.
        sizes_px, own_px = self._stack.blur_sizes_px, windows.size_px
        if self._guarded:
            own_px = np.clip(own_px, np.abs(sizes_px).min(), np.abs(sizes_px).max())
        found_px = np.interp(level[tuple(of_map)], np.arange(len(sizes_px)), sizes_px)
        apart = np.abs(np.abs(found_px) - own_px)
        some = np.ascontiguousarray(confidence[::_SPARSE, ::_SPARSE])
        return [
            *quantiles(telling.ravel(), 0.1, 0.25, 0.5, 0.75, 0.9),
            some.mean(),
            (some >= _CONFIDENT).mean(),
            np.median(apart),
            windows.weight @ np.minimum(apart, _UNSURE_PX),
            (apart > _FAR_PX).mean(),
        ]

    @cached_property
    def _test(self) -> HypothesisTest:
        return HypothesisTest(self._stack, self._guarded)


def _health_of(outputs: FloatArray) -> Health:
    value = float(1 / (1 + np.exp(-outputs[0])))
    cause = list(CAUSES)[int(outputs[1:].argmax())]
    return Health(value, "" if value >= FITS else cause)


_USUAL_NOISE = 2e-3
_NOISE_PX = 24
_LEAST = 2e-5
_BLOCKS_PX = (8, 16)
_CLIPPED = 0.985
_BAND_PX = 48
_BANDS = 3


def frame_statistics(grey: FloatArray, noise: float, known: float) -> list[float]:
    """Return numbers about a frame [rows, columns] that do not depend on the mask.

    `noise` is the standard deviation that is reckoned with, `known` what was known of it
    beforehand; 0: nothing.
    """
    # Of a large frame some bands of rows tell enough.
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
    """Return its colour, its size, and how that compares with what was known."""
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
    """Return how much more neighbours differ at one place in 8, and in 16, than at the others."""
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
    """Return how many pixels are alike, clipped or black, and how many values there are."""
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
    """Return how uneven rows and columns are, beside what noise makes of them."""
    found = []
    for axis in (0, 1):
        line = grey.mean(1 - axis)
        uneven = np.abs(line[2:] - 2 * line[1:-1] + line[:-2]).mean()
        found.append(np.log(uneven * np.sqrt(grey.shape[1 - axis]) / noise + 1e-3))
    return found


def _mosaic(grey: FloatArray) -> float:
    """Return how much the four places of every square of two by two pixels differ."""
    lines = [grey[row::2].mean(axis=0) for row in (0, 1)]
    means = [line[column::2].mean() for line in lines for column in (0, 1)]
    return float(np.log(1e-4 + np.std(means) / max(np.mean(means), 1e-9)))


def _isolated_pixels(bands: list[FloatArray], noise: float) -> float:
    """Return how many pixels are unlike all around them."""
    away = [cv2.absdiff(band, cv2.medianBlur(band, 3)) > 6 * noise + 0.02 for band in bands]
    return float(np.log(1e-5 + np.mean([np.count_nonzero(each) / each.size for each in away])))


def _step(grey: FloatArray) -> int:
    """Return at which distance rows and columns are enough of them: of a larger frame, fewer."""
    return max(2, min(grey.shape) // 96)
