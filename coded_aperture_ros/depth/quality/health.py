"""Out-of-distribution check: how well a frame fits its bank, and the likeliest cause if not."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.arrays import (
    FloatArray,
    as_floats,
    constant,
    in_memory,
    namespace,
    quantiles,
)
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.quality.causes import CAUSE_TEXTS, CAUSES, DEPTH_MAP
from coded_aperture_ros.depth.quality.depth_map import is_as_smooth_as_depth
from coded_aperture_ros.depth.quality.evidence import FEWEST_WINDOWS, Evidence, HypothesisTest
from coded_aperture_ros.depth.quality.mask_test import middle_part
from coded_aperture_ros.depth.quality.optics_test import OpticsFit
from coded_aperture_ros.depth.quality.spectra import equivalent_sizes_px
from coded_aperture_ros.depth.quality.statistics import frame_statistics, share_of
from coded_aperture_ros.optics import PsfStack

SCHEMA = "coded-aperture check of fit"
SCHEMA_VERSION = 2
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
        left = float(np.clip(share, 0, 1) ** 2)
        if left >= 1:
            return confidence
        lowest = namespace(confidence).minimum(confidence, _CHANCE_CONFIDENCE)
        lowered: FloatArray = left * confidence + (1 - left) * lowest
        return lowered


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
    optics_fit : OpticsFit or None
        Of other optics beside what the networks have learned; None: they are not tried.
    """

    def __init__(
        self,
        stack: PsfStack,
        remembers: bool = False,
        guarded: bool = False,
        middle_only: bool = False,
        own_fit: Callable[[FloatArray], FloatArray] | None = None,
        optics_fit: OpticsFit | None = None,
    ) -> None:
        self._stack, self._remembers, self._guarded = stack, remembers, guarded
        self._middle_only, self._own_fit = middle_only, own_fit
        self._optics_fit = optics_fit
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
        """Health of a frame; None if it has too little texture.

        Parameters
        ----------
        observation : Observation
        misfit : ndarray, float32 [grid rows, grid columns]
            Of the patches; see `Cost`.
        level, confidence : ndarray, float32 [rows, columns]
            Estimated fractional level of every pixel, and its confidence.
        """
        due = not self._remembers or self._frames % _FRAME_INTERVAL == 0
        self._frames += 1
        if not due:
            return self._health
        outputs, given = None, given_of(observation, misfit, level, confidence)
        for features in self.features(given):
            outputs = (self._own_fit or outputs_of)(features)
            if _health_of(outputs).value > TRUSTED:
                break
        if outputs is None:
            return self._health
        if self._optics_fit is not None:
            outputs = self._optics_fit(outputs, self._test, given)
        if self._remembers and self._outputs is not None:
            outputs = self._outputs + np.float32(_NEW_FRAME_WEIGHT) * (outputs - self._outputs)
        health = _health_of(outputs)
        # What was enlarged is as smooth, too.
        judged = not health.fits and health.cause != "scale"
        if judged and is_as_smooth_as_depth(in_memory(observation.grey)):
            health = dataclasses.replace(health, cause=DEPTH_MAP)
        self._outputs, self._health = outputs, health
        return self._health

    def features(self, given: dict[str, Any]) -> Iterator[FloatArray]:
        """Features of a frame for the network: from few windows, then, if asked, from more.

        Nothing if the frame has too little texture. For `given` see `given_of`.
        """
        find: Any = self.numbers if isinstance(given["grey"], np.ndarray) else self.on_device
        for cells in _CELLS:
            count, *numbers = find(cells, given) or [0]
            if count >= FEWEST_WINDOWS:
                yield np.nan_to_num(np.array(numbers, np.float32))

    def numbers(self, cells: int, given: dict[str, Any]) -> list[Any] | None:
        """Number of windows that count, at most so many along a side, and features.

        None if too few have texture, where that is seen.
        """
        grey, noise, unusable = (given[name] for name in ("grey", "noise", "unusable"))
        part = middle_part(grey.shape) if self._middle_only else np.s_[0:, 0:]
        top, left = (side.start for side in part)
        inner = None if unusable is None else unusable[part]
        windows = self._test.score(grey[part], noise, inner, cells)
        if windows is None:
            return None
        places = windows.rows + top, windows.columns + left
        windows = dataclasses.replace(windows, rows=places[0], columns=places[1])
        if "statistics" not in given:  # of all windows
            given["statistics"] = frame_statistics(grey, noise, given["known"])
        smaller = max(0.0, float(np.log(_USUAL_PIXELS / np.prod(grey.shape))))
        features = *windows.features, *given["statistics"], *self._map_features(windows, given)
        return [windows.counted.sum(), *features, smaller]

    def _map_features(self, windows: Evidence, given: Mapping[str, Any]) -> list[Any]:
        """Features of misfit, confidence and agreement of the map with single windows."""
        xp, usable, level = namespace(given["grey"]), given["usable"], given["level"]
        rows, columns = (
            centres * length // whole
            for centres, length, whole in zip(
                (windows.rows, windows.columns), level.shape, given["grey"].shape, strict=True
            )
        )
        # Blur size by one window alone, and by the map, which its neighbours have influenced.
        sizes_px, window_px = equivalent_sizes_px(self._stack), windows.size_px
        if self._guarded:
            low_px, high_px = (float(end(np.abs(sizes_px))) for end in (np.min, np.max))
            window_px = xp.clip(window_px, low_px, high_px)
        map_px = xp.interp(level[rows, columns], np.arange(len(sizes_px)), sizes_px)
        apart, counted = xp.abs(xp.abs(map_px) - window_px), windows.counted
        some = xp.ascontiguousarray(given["confidence"][::_SPARSE, ::_SPARSE])
        usable = (usable | ~usable.any()).ravel()
        return [
            *quantiles(given["misfit"].ravel(), 0.1, 0.25, 0.5, 0.75, 0.9, where=usable),
            some.mean(),
            share_of(some >= _CONFIDENT),
            *quantiles(apart, 0.5, where=counted),
            (windows.weight * xp.minimum(apart, _UNSURE_PX)).sum(),
            ((apart > _FAR_PX) & counted).sum() / counted.sum(),
        ]

    @cached_property
    def on_device(self) -> Callable[[int, dict[str, Any]], Sequence[Any]]:
        """Form of `numbers` for tensors."""
        from coded_aperture_ros.depth.quality.on_device import RecordedNumbers

        return RecordedNumbers(self.numbers)

    @cached_property
    def _test(self) -> HypothesisTest:
        return HypothesisTest(self._stack, self._guarded)


def given_of(
    observation: Observation, misfit: FloatArray, level: FloatArray, confidence: FloatArray
) -> dict[str, Any]:
    """What the features of a frame are found from, by name; for parameters see `FitCheck`."""
    known, grey = observation.noise, observation.grey
    noise = max(known.typical, _LEAST_NOISE)
    if noise < _CLEANEST:  # only simulated frames have so little noise
        dither = np.random.default_rng(0).standard_normal(grey.shape, dtype=np.float32)
        grey = grey + constant(np.float32(_DITHER) * dither, grey)
        noise = float(np.hypot(noise, _DITHER))
    sigma = known.sigma if known.highest is None else 0.0
    given: dict[str, Any] = {"grey": grey, "noise": noise, "known": sigma}
    given |= {"unusable": observation.unusable, "usable": observation.usable}
    return given | {"misfit": misfit, "level": level, "confidence": confidence}


def _health_of(outputs: FloatArray) -> Health:
    """Health from the networks' mean output."""
    value = float(1 / (1 + np.exp(-outputs[0])))
    cause = list(CAUSES)[int(outputs[1:].argmax())]
    return Health(value, "" if value >= FIT_THRESHOLD else cause)
