"""Check of fit of a bank of PSFs without sizes, measured with frames through these PSFs.

The network of the check was fitted to masks. Of other PSFs it knows neither what fitting frames
look like nor what other optics make of them. So frames are simulated through the PSFs of the bank
and through others, and a logistic regression makes health of what the network says and of how much
better other PSFs explain the frames. What the same PSFs turned and mirrored may explain better is
taken from the fitting frames alone: it says little of most kinds, and a regression hardly sees it.
"""

import dataclasses
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import scipy.optimize

from coded_aperture_ros.calibration.psf.simulated import (
    is_right,
    psfs_of_channels,
    simulated_frames,
)
from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.quality import FitCheck, fit_terms, given_of, turned_gains
from coded_aperture_ros.frames import SRGB, decode, encode
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.optics import Mask, PsfStack, render_psf_stack
from coded_aperture_ros.optics.nominal import widths_px

# Scenes, of which two frames fit.
_SCENES = 16
# Of each scene so many kinds of other optics, and of each frame so many kinds of processing.
_OPTICS = 3
_PROCESSING = 3
_SPARSE = 4
# A frame that does not fit counts as one that does where depth is about as often right as in its
# twin that fits: so many times.
_AS_RIGHT = 0.85
_MASKS = ("levin", "four_hole", "zhou", "mura")
# Blur sizes that another mask has at the ends of the levels, px.
_MASK_SIZES_PX = (2.0, 16.0)
_SHARP_PX = 0.5
_SCALES = (0.6, 1.6)
# Penalty of the squared coefficients, in units of the terms' standard deviations.
_RIDGE = 1e-2
# Terms count up to so many standard deviations.
_LIMIT = 5.0
# Health that all but this share of the fitting frames have.
_FITTING_HEALTH = 0.7
_FALSE_ALARMS = 0.02

_Frame = tuple[FloatArray, FloatArray]  # light, and the true level of each pixel


def measured_fit(bank: FilterBank, progress: Progress = iter) -> tuple[float, ...]:
    """Coefficients of `OwnFit` that make a bank's health.

    Parameters
    ----------
    bank : FilterBank
    progress : callable, optional
        Progress callback around the iteration over scenes.
    """
    looks = _Looks(dataclasses.replace(bank, own_fit=(), reliability=()))
    terms, fits, alike = [], [], []
    as_right = 0.0
    for seed in progress(range(_SCENES)):
        for kind, frame in frames_of_scene(looks.bank, seed):
            found = looks.terms_and_right(frame)
            if found is None:
                continue
            if not kind:
                as_right = found[1]
            terms.append(found[0])
            fits.append(not kind)
            alike.append(bool(kind) and found[1] >= _AS_RIGHT * as_right)
    looks.close()
    use = ~np.array(alike)  # neither one nor the other
    of_frames, fitting = np.array(terms)[use], np.array(fits)[use]
    limits = turned_gains(of_frames[fitting]).max(axis=0, initial=0.0)
    return (*_fitted(of_frames, fitting), *limits.tolist())


def fitting_share(bank: FilterBank, progress: Progress = iter) -> float:
    """Share of simulated frames through a bank's PSFs that the network of the check lets pass.

    Parameters are those of `measured_fit`.
    """
    looks = _Looks(dataclasses.replace(bank, own_fit=(), reliability=()))
    found = [
        looks.terms_and_right(frame)
        for seed in progress(range(_SCENES))
        for frame in simulated_frames(looks.bank, seed)
    ]
    looks.close()
    return float(np.mean([each[0][0] >= 0 for each in found if each is not None] or [1.0]))


def frames_of_scene(bank: FilterBank, seed: int) -> Iterator[tuple[str, _Frame]]:
    """Yield kind and frame of those of a scene that fit a bank, kind "", and of others."""
    random = np.random.default_rng([seed, 77])
    optics, processing = other_psfs(bank.stack), list(_PROCESSES.items())
    fitting = list(simulated_frames(bank, seed))
    chosen = random.choice(list(optics), _OPTICS, replace=False)
    others = {str(kind): list(simulated_frames(bank, seed, optics[kind])) for kind in chosen}
    for number, frame in enumerate(fitting):
        yield "", frame
        for kind, frames in others.items():
            yield kind, frames[number]
        for index in random.choice(len(processing), _PROCESSING, replace=False):
            kind, process = processing[index]
            yield kind, process(frame, random)


def other_psfs(stack: PsfStack) -> dict[str, FloatArray]:
    """PSFs of other optics [C, L, k, k], by name."""
    own = psfs_of_channels(stack)
    widths = widths_px(stack.psfs)
    along = np.linspace(*_MASK_SIZES_PX, len(stack))
    row = cv2.getGaussianKernel(11, _SHARP_PX)
    sharp = np.broadcast_to((row @ row.T).astype(np.float32), (len(stack), 11, 11))
    grey = {
        "disc": render_psf_stack(Mask.named("disc"), widths).psfs,
        "one disc": render_psf_stack(Mask.named("disc"), np.full(len(stack), widths.mean())).psfs,
        "sharp": sharp,
        **{name: render_psf_stack(Mask.named(name), along).psfs for name in _MASKS},
    }
    turned = {
        "turned": np.rot90(own, axes=(2, 3)).copy(),
        "mirrored": own[..., ::-1].copy(),
        **{f"scaled {scale:g}": _scaled(own, scale) for scale in _SCALES},
    }
    return {name: np.repeat(psfs[None], len(own), 0) for name, psfs in grey.items()} | turned


def _scaled(psfs: FloatArray, scale: float) -> FloatArray:
    """PSFs [C, L, k, k] of so many times the size; the sums are 1."""
    width = int(np.ceil(psfs.shape[-1] * scale)) // 2 * 2 + 1
    offset = (width - 1) / 2 - scale * (psfs.shape[-1] - 1) / 2
    move = np.array([[scale, 0, offset], [0, scale, offset]])
    flat = psfs.reshape(-1, *psfs.shape[2:])
    made = np.stack([cv2.warpAffine(psf, move, (width, width)) for psf in flat])
    made /= np.maximum(made.sum(axis=(1, 2), keepdims=True), 1e-6)
    return np.asarray(made.reshape(*psfs.shape[:2], width, width), np.float32)


def _enlarged(frame: _Frame, random: np.random.Generator) -> _Frame:
    factor = random.uniform(1.3, 2.2)
    return _resampled(frame, factor, cv2.INTER_CUBIC)


def _shrunk(frame: _Frame, random: np.random.Generator) -> _Frame:
    return _resampled(frame, random.uniform(0.5, 0.75), cv2.INTER_AREA)


def _resampled(frame: _Frame, factor: float, way: int) -> _Frame:
    """Frame of another size; of a larger one the middle that is as large as it was."""
    light, level = frame
    large = cv2.resize(light, None, fx=factor, fy=factor, interpolation=way)
    there = cv2.resize(level, large.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    top, left = (max(large.shape[axis] - light.shape[axis], 0) // 2 for axis in (0, 1))
    part = np.s_[top : large.shape[0] - top, left : large.shape[1] - left]
    return np.ascontiguousarray(large[part]), np.ascontiguousarray(there[part])


def _with_gamma(frame: _Frame, random: np.random.Generator) -> _Frame:
    return encode(frame[0], SRGB).astype(np.float32), frame[1]


def _jpeg(frame: _Frame, random: np.random.Generator) -> _Frame:
    pixels = np.rint(255 * encode(frame[0], SRGB)).astype(np.uint8)
    _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, int(random.integers(50, 91))])
    return decode(cv2.imdecode(data, cv2.IMREAD_UNCHANGED) / 255, SRGB), frame[1]


def _sharpened(frame: _Frame, random: np.random.Generator) -> _Frame:
    light = frame[0]
    more = light + random.uniform(1, 3) * (light - cv2.GaussianBlur(light, (0, 0), 1.5))
    return np.clip(more, 0, 1), frame[1]


def _smoothed(frame: _Frame, random: np.random.Generator) -> _Frame:
    return cv2.GaussianBlur(frame[0], (0, 0), random.uniform(0.8, 2.0)), frame[1]


def _shaken(frame: _Frame, random: np.random.Generator) -> _Frame:
    length = int(random.integers(5, 14))
    kernel = np.zeros((15, 15), np.float32)
    angle = random.uniform(0, np.pi)
    reach = length / 2 * np.array([np.cos(angle), np.sin(angle)])
    ends = np.rint(7 + np.outer([-1, 1], reach)).astype(int)
    cv2.line(kernel, ends[0].tolist(), ends[1].tolist(), 1.0)
    return cv2.filter2D(frame[0], -1, kernel / kernel.sum()), frame[1]


_PROCESSES: dict[str, Callable[[_Frame, np.random.Generator], _Frame]] = {
    "enlarged": _enlarged,
    "shrunk": _shrunk,
    "not linear": _with_gamma,
    "JPEG": _jpeg,
    "sharpened": _sharpened,
    "smoothed": _smoothed,
    "shaken": _shaken,
}


class _Looks:
    """Terms of the check for single frames, and how much of their depth is right."""

    def __init__(self, bank: FilterBank) -> None:
        self.bank = bank
        config = DepthConfig(confidence_threshold=0.0, check_fit=False)
        self._estimator = DepthEstimator(bank, config)
        self._check = FitCheck(bank.stack)

    def terms_and_right(self, frame: _Frame) -> tuple[DoubleArray, float] | None:
        """Terms [n] of a frame, and the share of its depths that is right; None without texture."""
        light, level = frame
        work = self._estimator.run_front(light)
        self._estimator.run_back(work)
        misfit = work.frame_cost.misfit
        assert misfit is not None  # of a filter bank
        sure = getattr(work.decoded, "checked", work.confidence)
        looks = list(self._check.features(given_of(work.observation, misfit, work.level, sure)))
        if not looks:
            return None
        sparse = np.s_[::_SPARSE, ::_SPARSE]
        right = is_right(self.bank.stack, work.level[sparse], level[sparse])
        return fit_terms(looks[-1]).astype(np.float64), float(right.mean())  # most windows

    def close(self) -> None:
        """End the estimator's threads."""
        self._estimator.close()


def _fitted(terms: DoubleArray, fits: BoolArray) -> tuple[float, ...]:
    """Coefficients of 1 and the terms [n, k] under which fitting frames [n] are the likeliest.

    The constant is then such that next to all of the fitting frames are trusted.
    """
    mean, scale = terms.mean(axis=0), terms.std(axis=0) + 1e-3
    standard = np.clip((terms - mean) / scale, -_LIMIT, _LIMIT)
    weight = np.where(fits, 0.5 / max(fits.sum(), 1), 0.5 / max((~fits).sum(), 1))

    def cost(coefficients: DoubleArray) -> tuple[float, DoubleArray]:
        odds = coefficients[0] + standard @ coefficients[1:]
        slope = weight * (1 / (1 + np.exp(-odds)) - fits)
        penalty = np.concatenate([[0.0], coefficients[1:]])
        value = weight @ (np.logaddexp(0, odds) - fits * odds) + _RIDGE * penalty @ penalty
        return float(value), np.concatenate(
            [[slope.sum()], slope @ standard]
        ) + 2 * _RIDGE * penalty

    found = scipy.optimize.minimize(cost, np.zeros(terms.shape[1] + 1), jac=True).x
    slopes = found[1:] / scale
    constant = found[0] - slopes @ mean
    least = np.quantile((constant + terms @ slopes)[fits], _FALSE_ALARMS) if fits.any() else 0.0
    constant += max(np.log(_FITTING_HEALTH / (1 - _FITTING_HEALTH)) - float(least), 0.0)
    return (float(constant), *slopes.tolist())
