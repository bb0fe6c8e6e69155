"""Frames that do not fit their bank: kinds of misfit, each from mild to severe."""

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.frames import SRGB, decode, encode
from coded_aperture_ros.optics import Mask, PsfStack, render_psf_stack

# How much finer the outline of a changed PSF is drawn than the pixels.
_FINER = 4
# Electrons that a pixel of the sensor holds, its noise in the dark, and steps of its 12 bits.
_FULL_WELL, _READ_NOISE, _COUNTS = 10_500.0, 2.4, 4095


@dataclasses.dataclass(frozen=True, eq=False)
class Fitting:
    """A frame that fits: what a camera would record but for its noise, and its PSFs.

    Attributes
    ----------
    light : ndarray, float32 [rows, columns(, 3)]
        Linear light, without noise.
    sharp : callable
        Returns the frame all in focus.
    ordinary : callable
        Returns the frame through an ordinary lens with so many times the extent of the mask.
    stack : PsfStack
        Of the bank.
    blur_size_px : ndarray, float32 [rows, columns]
        Truth; NaN where unknown.
    noise : float
        Standard deviation to be added.
    """

    light: FloatArray
    sharp: Callable[[], FloatArray]
    ordinary: Callable[[float], FloatArray]
    stack: PsfStack
    blur_size_px: FloatArray
    noise: float


@dataclasses.dataclass(frozen=True, eq=False)
class Recorded:
    """What goes into the estimator, and the truth of the frame.

    `known_noise` is what a camera file says of the noise; 0: nothing.
    """

    frame: FloatArray
    stack: PsfStack
    blur_size_px: FloatArray
    known_noise: float = 0.0


# Of frames that fit: share of the light, and times the noise.
FITTING_LIGHT = ((1.0, 1.0), (1.0, 0.5), (1.0, 2.0), (0.5, 1.0), (0.25, 1.0))
Change = Callable[[Fitting, float, np.random.Generator], Recorded | None]


@dataclasses.dataclass(frozen=True)
class Misfit:
    """One kind of misfit.

    Attributes
    ----------
    change : callable
        Makes what is recorded from a fitting frame, a strength from 0 (mild) to 1, and random
        numbers; None where the frame fits all the same.
    causes : tuple of str
        What it may be called.
    traced : bool
        Whether one frame shows it at all.
    """

    change: Change
    causes: tuple[str, ...]
    traced: bool = True


def _at(strength: float, *values: float) -> float:
    """Return what belongs to a strength, of values that are equally spaced in it."""
    return float(np.interp(strength, np.linspace(0, 1, len(values)), values))


def _step(strength: float) -> int:
    """Return which of five things belongs to a strength."""
    return round(4 * strength)


def recorded(fit: Fitting, light: FloatArray, random: np.random.Generator) -> Recorded:
    """Return the frame with noise, clipped to what a sensor records."""
    frame = light + fit.noise * random.standard_normal(light.shape, dtype=np.float32)
    return Recorded(np.clip(frame, 0, 1).astype(np.float32), fit.stack, fit.blur_size_px)


def _of_light(change: Callable[[FloatArray, float, np.random.Generator], FloatArray]) -> Change:
    """Change the light before the sensor adds its noise."""

    def changed(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
        return recorded(fit, change(fit.light, strength, random), random)

    return changed


def _of_frame(change: Callable[[FloatArray, float, np.random.Generator], FloatArray]) -> Change:
    """Change the frame that the sensor has recorded."""

    def changed(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
        whole = recorded(fit, fit.light, random)
        frame = np.asarray(change(whole.frame, strength, random), np.float32)
        return dataclasses.replace(whole, frame=frame)

    return changed


def _of_psfs(change: Callable[[FloatArray, float, float], FloatArray | None]) -> Change:
    """Give the bank PSFs that are not those of the lens."""

    def changed(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded | None:
        stack = fit.stack
        sizes = np.abs(stack.blur_sizes_px)
        psfs = [change(psf, size, strength) for psf, size in zip(stack.psfs, sizes, strict=True)]
        if any(psf is None or not psf.sum() > 0 for psf in psfs):
            return None
        width = max(len(psf) for psf in psfs if psf is not None)
        padded = [np.pad(psf, (width - len(psf)) // 2) for psf in psfs if psf is not None]
        other = np.stack([psf / psf.sum() for psf in padded]).astype(np.float32)
        if other.shape == stack.psfs.shape and np.abs(other - stack.psfs).sum() < 0.1 * len(other):
            return None  # the mask looks the same
        whole = recorded(fit, fit.light, random)
        return dataclasses.replace(whole, stack=dataclasses.replace(stack, psfs=other))

    return changed


def _other_mask(psf: FloatArray, size_px: float, strength: float) -> FloatArray:
    names = ("four_hole", "zhou", "veeraraghavan", "mura", "annulus")
    return render_psf_stack(Mask.named(names[_step(strength)]), [size_px]).psfs[0]


def _covered(size_px: float, width: int) -> FloatArray:
    """Return the share of every pixel that a square of this size covers."""
    along = np.clip(size_px / 2 + 0.5 - np.abs(np.arange(width) - width // 2), 0, 1)
    return np.outer(along, along).astype(np.float32)


def _inverted(psf: FloatArray, size_px: float, strength: float) -> FloatArray:
    open_part = np.clip(psf / np.quantile(psf[psf > 0], 0.95), 0, 1)
    share = _at(strength, 0.35, 0.5, 0.65, 0.8, 1.0)
    return (1 - share) * open_part + share * np.maximum(_covered(size_px, len(psf)) - open_part, 0)


def _margin(psf: FloatArray, size_px: float, strength: float) -> FloatArray:
    wide_px = size_px * _at(strength, 1.1, 1.2, 1.3, 1.45, 1.6)
    width = 2 * int(np.ceil(wide_px / 2)) + 1
    pad = max((width - len(psf)) // 2, 0)
    inner = np.pad(psf / np.quantile(psf[psf > 0], 0.95), pad)
    frame = _covered(wide_px, len(inner)) - _covered(size_px, len(inner))
    return inner + np.maximum(frame, 0)


def _turned(psf: FloatArray, size_px: float, strength: float) -> FloatArray:
    centre = (len(psf) - 1) / 2
    turn = cv2.getRotationMatrix2D((centre, centre), _at(strength, 6, 12, 20, 45, 90), 1)
    return np.maximum(cv2.warpAffine(psf, turn, psf.shape), 0)


def _mirrored(psf: FloatArray, size_px: float, strength: float) -> FloatArray | None:
    ways = (psf[:, ::-1], psf[::-1], psf.T, None, None)
    return ways[_step(strength)]


def _blocked(psf: FloatArray, size_px: float, strength: float) -> FloatArray:
    """Cover a corner of the aperture."""
    share = _at(strength, 0.3, 0.4, 0.5, 0.6, 0.7)
    along = np.arange(len(psf)) - len(psf) // 2 < size_px * (share - 0.5)
    return np.asarray(psf * ~np.outer(along, along))


def _beyond(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded | None:
    """Leave the bank only levels that the scene does not have."""
    sizes = np.abs(fit.stack.blur_sizes_px)
    low, high = np.nanquantile(np.abs(fit.blur_size_px), [0.02, 0.98])
    away_px = 1 + 4 * strength
    keep = sizes > high + away_px
    if keep.sum() < 8:
        keep = sizes < low - away_px
    if keep.sum() < 8:
        return None
    stack = fit.stack
    depths_m = None if stack.depths_m is None else stack.depths_m[keep]
    some = PsfStack(stack.blur_sizes_px[keep], stack.psfs[keep], depths_m, stack.in_pixels)
    return dataclasses.replace(recorded(fit, fit.light, random), stack=some)


def _no_mask(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
    return recorded(fit, fit.ordinary(_at(strength, 0.5, 0.75, 1.0, 1.25, 1.5)), random)


def _sharp(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
    sigma_px = _at(strength, 0.2, 0.5, 0.8, 1.2, 1.6)
    whole = recorded(fit, cv2.GaussianBlur(fit.sharp(), (0, 0), sigma_px), random)
    return dataclasses.replace(whole, blur_size_px=np.full_like(fit.blur_size_px, 0.3))


def _aberrated(light: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    sigma_px = _at(strength, 0.8, 1.2, 1.7, 2.3, 3.0)
    return cv2.GaussianBlur(light, (0, 0), sigmaX=sigma_px, sigmaY=sigma_px / 4)


def _shaken(light: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    length_px, angle = _at(strength, 2, 4, 6, 9, 14), random.uniform(0, np.pi)
    side = 2 * int(length_px / 2) + 3
    kernel = np.zeros((_FINER * side,) * 2, np.float32)
    reach = length_px / 2 * _FINER * np.array([np.cos(angle), np.sin(angle)])
    ends = np.rint(_FINER * side / 2 + np.outer([-1, 1], reach)).astype(int)
    cv2.line(kernel, ends[0].tolist(), ends[1].tolist(), 1.0, _FINER)
    kernel = cv2.resize(kernel, (side, side), interpolation=cv2.INTER_AREA)
    return cv2.filter2D(light, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT)


def _doubled(light: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    share = _at(strength, 0.15, 0.25, 0.35, 0.45, 0.5)
    shift = random.integers(5, 12, 2) * random.choice([-1, 1], 2)
    return (1 - share) * light + share * np.roll(light, shift, (0, 1))


def _jpeg(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    return _through_file(
        frame, ".jpg", cv2.IMWRITE_JPEG_QUALITY, int(_at(strength, 98, 90, 80, 65, 40))
    )


def _webp(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    return _through_file(
        frame, ".webp", cv2.IMWRITE_WEBP_QUALITY, int(_at(strength, 98, 90, 75, 50, 25))
    )


def _stored(frame: FloatArray) -> Any:
    return np.rint(255 * encode(np.clip(frame, 0, 1), SRGB)).astype(np.uint8)


def _through_file(frame: FloatArray, suffix: str, option: int, value: int) -> FloatArray:
    _, data = cv2.imencode(suffix, _stored(frame), [option, value])
    pixels = cv2.imdecode(data, cv2.IMREAD_COLOR if frame.ndim == 3 else cv2.IMREAD_GRAYSCALE)
    return decode(pixels / 255, SRGB)


def _video(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    """Return the last frame of an MPEG-4 film of a picture that moves the faster."""
    shift_px = _at(strength, 0.0, 1.0, 2.5, 5.0, 9.0)
    height, width = (length // 2 * 2 for length in frame.shape[:2])
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "film.mp4")
        writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"mp4v"), 15, (width, height))
        for step in range(4, -1, -1):
            move = np.array([[1, 0, step * shift_px], [0, 1, step * shift_px / 2]])
            moved = cv2.warpAffine(frame, move, frame.shape[1::-1], borderMode=cv2.BORDER_REFLECT)
            picture = _stored(moved[:height, :width])
            writer.write(picture if frame.ndim == 3 else cv2.merge([picture] * 3))
        writer.release()
        film, pixels = cv2.VideoCapture(path), None
        while (read := film.read())[0]:
            pixels = read[1]
        film.release()
    if pixels is None:
        return frame
    light = decode(pixels / 255, SRGB)
    out = frame.copy()
    out[:height, :width] = light if frame.ndim == 3 else light.mean(2)
    return out


def _clipped(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    """Return it overexposed, and darker by a tenth: nothing counts as saturated."""
    share = _at(strength, 0.03, 0.08, 0.15, 0.3, 0.5)
    return np.minimum(frame / np.quantile(frame, 1 - share), 1) * 0.9


def _overexposed(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    share = _at(strength, 0.03, 0.08, 0.15, 0.3, 0.5)
    return np.minimum(frame / np.quantile(frame, 1 - share), 1)


def _file_noise(more: bool) -> Change:
    """Return frames with more or less noise than the camera file says."""

    def changed(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
        factor = _at(strength, 2, 4, 8, 16, 32)
        if more:
            noisy = dataclasses.replace(fit, noise=fit.noise * factor)
            return dataclasses.replace(recorded(noisy, fit.light, random), known_noise=fit.noise)
        return dataclasses.replace(
            recorded(fit, fit.light, random), known_noise=min(fit.noise * factor, 0.4)
        )

    return changed


def _correlated(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    noise = random.standard_normal(frame.shape, dtype=np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), _at(strength, 0.5, 0.7, 1.0, 1.4, 2.0))
    return frame + 0.006 * noise / noise.std()


def _stripes(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    rows = random.standard_normal((len(frame), 1, 1)) * _at(
        strength, 0.002, 0.004, 0.008, 0.016, 0.03
    )
    return np.asarray(frame + (rows if frame.ndim == 3 else rows[..., 0]), np.float32)


def _hot(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    share = _at(strength, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
    out, hit = frame.copy(), random.random(frame.shape[:2]) < share
    out[hit] = random.choice([0.0, 0.9], hit.sum()).reshape(-1, *[1] * (frame.ndim - 2))
    return out


def _flicker(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    depth = _at(strength, 0.1, 0.2, 0.4, 0.6, 0.9)
    rows = 1 - depth / 2 * (1 + np.sin(np.arange(len(frame)) * 2 * np.pi / 60))
    return np.asarray(frame * rows.reshape(-1, *[1] * (frame.ndim - 1)), np.float32)


def _rescaled(factors: Sequence[float], enlarge: int = cv2.INTER_CUBIC) -> Change:
    """Return a frame that was enlarged and cropped, or shrunk."""

    def changed(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
        factor = _at(strength, *factors)
        whole = recorded(fit, fit.light, random)
        way = enlarge if factor > 1 else cv2.INTER_AREA
        frame = cv2.resize(whole.frame, None, fx=factor, fy=factor, interpolation=way)
        truth = cv2.resize(fit.blur_size_px, frame.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        top, left = (
            max(length - before, 0) // 2
            for length, before in zip(frame.shape[:2], whole.frame.shape[:2], strict=True)
        )
        middle = np.s_[top : len(frame) - top, left : frame.shape[1] - left]
        # The truth stays what the depth is, in the blur of the bank.
        return dataclasses.replace(whole, frame=frame[middle], blur_size_px=truth[middle])

    return changed


def _other_camera(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
    """Another focus or focal length behind the same mask: the same blur is another depth."""
    truth = fit.blur_size_px * _at(strength, 0.6, 0.75, 1.25, 1.5, 1.8)
    return dataclasses.replace(recorded(fit, fit.light, random), blur_size_px=truth)


def _encoded(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    return np.clip(frame, 0, 1) ** (1 / _at(strength, 1.2, 1.5, 1.8, 2.2, 2.6))


def _sharpened(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    amount = _at(strength, 0.3, 0.6, 1.0, 1.8, 3.0)
    return np.clip(frame + amount * (frame - cv2.GaussianBlur(frame, (0, 0), 1.5)), 0, 1)


def _denoised(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    ways: tuple[Callable[[], FloatArray], ...] = (
        lambda: cv2.bilateralFilter(frame, 5, 0.006, 2.0),
        lambda: cv2.bilateralFilter(frame, 5, 0.015, 2.0),
        lambda: cv2.medianBlur(frame, 3),
        lambda: cv2.medianBlur(frame, 5),
        lambda: cv2.GaussianBlur(frame, (0, 0), 1.2),
    )
    return ways[_step(strength)]()


def _smoothed(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    return cv2.GaussianBlur(frame, (0, 0), _at(strength, 0.6, 1.0, 1.5, 2.2, 3.0))


def _mosaic(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    """Return the colours of a sensor's filters as they are, not interpolated."""
    less = _at(strength, 0.05, 0.1, 0.2, 0.4, 0.6)
    grey = frame if frame.ndim == 2 else frame.mean(2)
    gains = np.ones(grey.shape, np.float32)
    gains[::2, ::2] -= less
    gains[1::2, 1::2] -= less / 2
    return grey * gains


def _interlaced(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    out = frame.copy()
    out[1::2] = np.roll(frame, round(_at(strength, 1, 2, 3, 5, 8)), 1)[1::2]
    return out


def _exposed(fit: Fitting, strength: float, random: np.random.Generator, gain: bool) -> Recorded:
    """Return a frame of a common machine-vision sensor, with a third of the light at each step.

    With gain, it is amplified to the same brightness, by 1 to 81.
    """
    share = 3.0 ** (-4 * strength)
    electrons = random.poisson(np.clip(fit.light, 0, None) * share * _FULL_WELL)
    electrons = electrons + _READ_NOISE * random.standard_normal(fit.light.shape)
    frame = electrons / (_FULL_WELL * (share if gain else 1))
    frame = np.rint(np.clip(frame, 0, 1) * _COUNTS) / _COUNTS
    return Recorded(frame.astype(np.float32), fit.stack, fit.blur_size_px)


def _faint(light: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    contrast = _at(strength, 0.5, 0.25, 0.12, 0.06, 0.03)
    return np.asarray(light.mean() + contrast * (light - light.mean()), np.float32)


# Light that is not what one would like, but fits.
LIGHT: dict[str, Change] = {
    "less light": lambda fit, strength, random: _exposed(fit, strength, random, gain=False),
    "less light, amplified": lambda fit, strength, random: _exposed(fit, strength, random, True),
    "less contrast": _of_light(_faint),
}
_MASK = ("mask",)
_PATTERN = ("mask", "turned")
_NOISE = ("noise",)
MISFITS = {
    "other mask": Misfit(_of_psfs(_other_mask), _MASK),
    "mask inverted": Misfit(_of_psfs(_inverted), _MASK),
    "mask with an open margin": Misfit(_of_psfs(_margin), _MASK),
    "part of the mask covered": Misfit(_of_psfs(_blocked), _MASK),
    "mask turned": Misfit(_of_psfs(_turned), _PATTERN),
    "mask mirrored": Misfit(_of_psfs(_mirrored), _PATTERN),
    "no mask": Misfit(_no_mask, ("none",)),
    "all in focus": Misfit(_sharp, ("range",)),
    "out of range": Misfit(_beyond, ("range",)),
    "astigmatism": Misfit(_of_light(_aberrated), ("mask", "motion")),
    "shake": Misfit(_of_light(_shaken), ("motion",)),
    "double image": Misfit(_of_light(_doubled), ("motion", "mask")),
    "JPEG": Misfit(_of_frame(_jpeg), ("compression",)),
    "WebP": Misfit(_of_frame(_webp), ("compression",)),
    "video": Misfit(_of_frame(_video), ("compression",)),
    "clipped": Misfit(_of_frame(_clipped), ("clipped",)),
    "overexposed": Misfit(_of_frame(_overexposed), ("clipped",)),
    "more noise than the file": Misfit(_file_noise(True), _NOISE),
    "less noise than the file": Misfit(_file_noise(False), _NOISE),
    "correlated noise": Misfit(_of_frame(_correlated), (*_NOISE, "processed")),
    "stripes": Misfit(_of_frame(_stripes), _NOISE),
    "hot pixels": Misfit(_of_frame(_hot), _NOISE),
    "flicker of lamps": Misfit(_of_frame(_flicker), ("noise", "processed")),
    "enlarged": Misfit(_rescaled((1.25, 1.5, 2.0, 2.5, 3.0)), ("scale",)),
    "not linear": Misfit(_of_frame(_encoded), ("tone",)),
    "sharpened": Misfit(_of_frame(_sharpened), ("processed",)),
    "denoised": Misfit(_of_frame(_denoised), ("processed", "scale")),
    "mosaic": Misfit(_of_frame(_mosaic), ("processed",)),
    "interlaced": Misfit(_of_frame(_interlaced), ("processed",)),
    "shrunk": Misfit(_rescaled((0.85, 0.7, 0.6, 0.5, 0.4)), ("scale",), traced=False),
    "other camera": Misfit(_other_camera, ("scale",), traced=False),
    "smoothed": Misfit(_of_frame(_smoothed), ("processed", "scale")),
    "enlarged linearly": Misfit(
        _rescaled((1.25, 1.5, 2.0, 2.5, 3.0), cv2.INTER_LINEAR), ("scale",)
    ),
}
