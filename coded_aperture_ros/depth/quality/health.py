"""Out-of-distribution check: how well a frame fits its bank, and the likeliest cause if not."""

import dataclasses
from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache
from itertools import chain, islice

import numpy as np

from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.arrays import FloatArray, as_floats
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.quality.evidence import Evidence, HypothesisTest
from coded_aperture_ros.depth.quality.spectra import equivalent_sizes_px, quantiles
from coded_aperture_ros.depth.quality.statistics import frame_statistics, is_as_smooth_as_depth
from coded_aperture_ros.optics import PsfStack

# Windows, and features of the whole frame.
_Look = tuple[Evidence, list[float]]
SCHEMA = "coded-aperture check of fit"
SCHEMA_VERSION = 2
# Name of each cause, its description and remedy; in the order of the network's outputs.
CAUSES = {
    "mask": "another mask, inverted or dirty, or a lens that blurs otherwise: compare both with "
    "the camera file",
    "none": "no mask in the lens: put it in",
    "turned": "the mask is turned or mirrored: put it in as the camera file has it",
    "compression": "compressed pictures: record them without loss",
    "motion": "motion blur: expose for less time, or use motion",
    "clipped": "clipped light: expose for less time",
    "noise": "noise unlike the camera file's, or with a pattern: measure it with calibrate noise",
    "range": "nearer or farther than the bank's levels, all in focus, or taken without the mask: "
    "learn the bank for more depths, focus as the camera file says, or put the mask in",
    "scale": "pictures that were enlarged, binned or cropped: record them as the sensor reads them "
    "out",
    "tone": "values are not linear light: set the gamma",
    "processed": "pictures that were sharpened, denoised or demosaiced, or a raw mosaic: switch "
    "that off in the camera, or say bayer",
}
# Cause that is not the network's to find: a depth map in place of a frame.
DEPTH_MAP = "depth_map"
# Description and remedy of every cause.
CAUSE_TEXTS = {
    **CAUSES,
    DEPTH_MAP: "values as smooth as those of a depth map, which no camera takes: give the coded "
    "frame",
}
# Least health of a frame that fits.
FIT_THRESHOLD = 0.5
# Confidence is lowered from the first health on, down to that of a guess at the second, with the
# square of the health between them: then next to nothing is published of frames that do not fit.
TRUSTED = 0.7
WITHHOLD_BELOW = 0.2
_CHANCE_CONFIDENCE = 0.2
# Largest blur size that the network was trained for, px, and limits of its features before and
# after they are standardised.
LARGEST_PX = 22.5
_FEWEST_LEVELS = 3
LIMIT = 20.0
SCALED_LIMIT = 5.0
_LAYERS = 3
# Pixels of the largest frames in training: smaller ones are less certain.
_USUAL_PIXELS = 288 * 288
# Noise, linear light: least value, the value below which frames are simulated ones, and the
# standard deviation of the noise that is added to those.
_LEAST_NOISE = 2e-4
_CLEANEST = 3e-4
_DITHER = 6e-4
# Differences of the windows' blur sizes from the map's, px: the largest that counts, and the least
# that is another depth.
_UNSURE_PX = 4.0
_FAR_PX = 1.5
# Default threshold of the confidence when the network was fitted.
_CONFIDENT = 0.55
# Every third row and column of the confidence is enough for its mean.
_SPARSE = 3
# Margin on every side that is left out with `middle_only`, as a share of the frame.
_MARGIN_SHARE = 0.3
# Most windows along a side in the first pass, which is enough where confidence is not lowered, and
# in the second.
_CELLS = 5, 10
# Frames of a video from one check to the next, and the weight of a new one in the running mean.
_FRAME_INTERVAL = 4
_NEW_FRAME_WEIGHT = 0.4


@dataclasses.dataclass(frozen=True)
class Health:
    """How well a frame fits its bank.

    Attributes
    ----------
    value : float
        Probability, in [0, 1], that confident depth is about right; a frame fits from
        `FIT_THRESHOLD` on.
    cause : str
        The likeliest of `CAUSE_TEXTS` if the frame does not fit; empty if it does.

    Examples
    --------
    >>> print(Health(0.9))
    fits (0.90)
    >>> print(Health(0.1, "none"))
    does not fit (0.10): no mask in the lens: put it in
    """

    value: float
    cause: str = ""

    @property
    def fits(self) -> bool:
        """Whether the frame fits."""
        return self.value >= FIT_THRESHOLD

    @property
    def withheld(self) -> bool:
        """Whether the confidence is lowered to that of a guess."""
        return self.value < WITHHOLD_BELOW

    def __str__(self) -> str:
        """Verdict in one line, with the cause and its remedy."""
        if self.fits:
            return f"fits ({self.value:.2f})"
        return f"does not fit ({self.value:.2f}): {CAUSE_TEXTS[self.cause]}"

    def limit_confidence(self, confidence: FloatArray) -> FloatArray:
        """Confidence, lowered if the frame fits badly, float32 [rows, columns]."""
        share = (self.value - WITHHOLD_BELOW) / (TRUSTED - WITHHOLD_BELOW)
        left = np.float32(np.clip(share, 0, 1) ** 2)
        if left >= 1:
            return confidence
        lowest = np.minimum(confidence, np.float32(_CHANCE_CONFIDENCE))
        return np.asarray(left * confidence + (1 - left) * lowest, np.float32)


@lru_cache(maxsize=1)
def _weights() -> dict[str, FloatArray]:
    """Mean, scale, weights and biases of the networks [members, ...], by name."""
    arrays = read_shipped(__file__, "fit.npz", SCHEMA, SCHEMA_VERSION)
    floats = {name: as_floats(array) for name, array in arrays.items() if array.ndim}
    for layer in range(_LAYERS):  # whole numbers, with a scale for each row
        floats[f"weight{layer}"] = floats[f"weight{layer}"] * floats.pop(f"weight{layer}_scale")
    return floats


def outputs_of(features: FloatArray) -> FloatArray:
    """Mean output of the networks: logits of health, then of the causes."""
    arrays = _weights()
    values = (np.clip(features, -LIMIT, LIMIT) - arrays["mean"]) / arrays["scale"]
    values = np.clip(values, -SCALED_LIMIT, SCALED_LIMIT)[..., None]
    for layer in range(_LAYERS):
        values = arrays[f"weight{layer}"] @ values + arrays[f"bias{layer}"][..., None]
        if layer < _LAYERS - 1:
            np.maximum(values, 0, out=values)
    return np.asarray(values[..., 0].mean(axis=0))


def unchecked_reason(stack: PsfStack) -> str:
    """Why frames cannot be checked against a bank's levels; empty if they can."""
    if len(stack) < _FEWEST_LEVELS:
        return f"its {len(stack)} levels are fewer than {_FEWEST_LEVELS}"
    largest_px = float(np.abs(equivalent_sizes_px(stack)).max())
    if largest_px > LARGEST_PX:
        return f"its blur of {largest_px:.3g} px is above {LARGEST_PX:g} px"
    return ""


def middle_part(shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Part of a frame for which PSFs of the middle of the image hold."""
    top, left = (int(_MARGIN_SHARE * length) for length in shape[:2])
    return slice(top, shape[0] - top), slice(left, shape[1] - left)


class FitCheck:
    """Checks the frames of a video, or single ones, against a bank's PSFs.

    Parameters
    ----------
    stack : PsfStack
        PSFs of the bank, with no `unchecked_reason`.
    remembers : bool
        Whether frames are those of a video, in order: then only some are checked, and their
        results averaged.
    guarded : bool
        Whether the first and last level stand for all blur sizes beyond them.
    middle_only : bool
        Whether the PSFs are those of the middle of the image; then only windows there count.
    own_fit : OwnFit or None
        In place of the network's mean output, for PSFs that it was not fitted to.
    """

    def __init__(
        self,
        stack: PsfStack,
        remembers: bool = False,
        guarded: bool = False,
        middle_only: bool = False,
        own_fit: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        self._stack, self._remembers, self._guarded = stack, remembers, guarded
        self._middle_only, self._own_fit = middle_only, own_fit
        self.reset()

    def reset(self) -> None:
        """Forget the frames so far."""
        self._frames = 0
        self._outputs: FloatArray | None = None
        self._health: Health | None = None
        self._begun: Iterator[_Look] | None = None

    def begin(self, observation: Observation) -> None:
        """Look at the next frame, if it is to be checked, before anything is known of its depth."""
        if self._is_due:
            looks = self._looks(observation)
            self._begun = chain(list(islice(looks, 1)), looks)

    @property
    def _is_due(self) -> bool:
        return not self._remembers or self._frames % _FRAME_INTERVAL == 0

    def __call__(
        self,
        observation: Observation,
        misfit: FloatArray,
        level: FloatArray,
        confidence: FloatArray,
    ) -> Health | None:
        """Health of a frame; None if it has too little texture.

        Parameters
        ----------
        observation : Observation
        misfit : ndarray, float32 [grid rows, grid columns]
            Of the patches; see `Cost`.
        level, confidence : ndarray, float32 [rows, columns]
            Estimated fractional level of every pixel, and its confidence.
        """
        due = self._is_due
        self._frames += 1
        if not due:
            return self._health
        outputs = None
        for features in self.features(observation, misfit, level, confidence):
            outputs = (self._own_fit or outputs_of)(features)
            if _health_of(outputs).value > TRUSTED:
                break
        if outputs is None:
            return self._health
        if self._remembers and self._outputs is not None:
            outputs = self._outputs + np.float32(_NEW_FRAME_WEIGHT) * (outputs - self._outputs)
        health = _health_of(outputs)
        # What was enlarged is as smooth, too.
        if not health.fits and health.cause != "scale" and is_as_smooth_as_depth(observation.grey):
            health = dataclasses.replace(health, cause=DEPTH_MAP)
        self._outputs, self._health = outputs, health
        return self._health

    def features(
        self,
        observation: Observation,
        misfit: FloatArray,
        level: FloatArray,
        confidence: FloatArray,
    ) -> Iterator[FloatArray]:
        """Features of a frame for the network: from few windows, then, if asked, from more.

        Nothing if the frame has too little texture. Parameters are those of a call.
        """
        looks, self._begun = self._begun or self._looks(observation), None
        for windows, rest in looks:
            map_features = self._map_features(windows, observation, misfit, level, confidence)
            numbers = [*windows.features, *rest[:-1], *map_features, rest[-1]]
            yield np.nan_to_num(np.array(numbers, np.float32))

    def _looks(self, observation: Observation) -> Iterator[_Look]:
        """Windows of a frame, few and then more, and features of the whole frame."""
        grey, noise = observation.grey, max(observation.noise.typical, _LEAST_NOISE)
        if noise < _CLEANEST:  # only simulated frames have so little noise
            dither = np.random.default_rng(0).standard_normal(grey.shape, dtype=np.float32)
            grey, noise = grey + np.float32(_DITHER) * dither, float(np.hypot(noise, _DITHER))
        known = observation.noise.sigma if observation.noise.highest is None else 0.0
        statistics = frame_statistics(grey, noise, known)
        smaller = max(0.0, float(np.log(_USUAL_PIXELS / grey.size)))
        part = middle_part(grey.shape) if self._middle_only else np.s_[0:, 0:]
        top, left = (side.start for side in part)
        unusable = None if observation.unusable is None else observation.unusable[part]
        for cells in _CELLS:
            windows = self._test.score(grey[part], noise, unusable, cells)
            if windows is not None:
                at = windows.rows + top, windows.columns + left
                windows = dataclasses.replace(windows, rows=at[0], columns=at[1])
                yield windows, [*statistics, smaller]

    def _map_features(
        self,
        windows: Evidence,
        observation: Observation,
        misfit: FloatArray,
        level: FloatArray,
        confidence: FloatArray,
    ) -> list[float]:
        """Features of misfit, confidence and agreement of the map with single windows."""
        usable_misfit = misfit[observation.usable] if observation.usable.any() else misfit
        map_pixels = (
            centres * length // whole
            for centres, length, whole in zip(
                (windows.rows, windows.columns), level.shape, observation.grey.shape, strict=True
            )
        )
        # Blur size by one window alone, and by the map, which its neighbours have influenced.
        sizes_px, window_px = equivalent_sizes_px(self._stack), windows.size_px
        if self._guarded:
            window_px = np.clip(window_px, np.abs(sizes_px).min(), np.abs(sizes_px).max())
        map_px = np.interp(level[tuple(map_pixels)], np.arange(len(sizes_px)), sizes_px)
        apart = np.abs(np.abs(map_px) - window_px)
        some = np.ascontiguousarray(confidence[::_SPARSE, ::_SPARSE])
        return [
            *quantiles(usable_misfit.ravel(), 0.1, 0.25, 0.5, 0.75, 0.9),
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
    """Health from the networks' mean output."""
    value = float(1 / (1 + np.exp(-outputs[0])))
    cause = list(CAUSES)[int(outputs[1:].argmax())]
    return Health(value, "" if value >= FIT_THRESHOLD else cause)
