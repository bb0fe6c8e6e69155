"""Frames that do not fit their bank: kinds of misfit, each from mild to severe."""

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from coded_aperture_benchmarks.datasets.fitting_frames import (
    Change,
    Fitting,
    Misfit,
    Recorded,
    at_strength,
    of_frame,
    of_light,
    recorded,
    step_of,
)
from coded_aperture_benchmarks.datasets.optical_misfits import OPTICAL_MISFITS
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.frames import SRGB, decode, encode

# Electrons that a pixel of the sensor holds, its noise in the dark, and steps of its 12 bits.
_FULL_WELL, _READ_NOISE, _COUNTS = 10_500.0, 2.4, 4095


def _jpeg(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    return _through_file(
        frame, ".jpg", cv2.IMWRITE_JPEG_QUALITY, int(at_strength(strength, 98, 90, 80, 65, 40))
    )


def _webp(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    return _through_file(
        frame, ".webp", cv2.IMWRITE_WEBP_QUALITY, int(at_strength(strength, 98, 90, 75, 50, 25))
    )


def _stored(frame: FloatArray) -> Any:
    return np.rint(255 * encode(np.clip(frame, 0, 1), SRGB)).astype(np.uint8)


def _through_file(frame: FloatArray, suffix: str, option: int, value: int) -> FloatArray:
    _, data = cv2.imencode(suffix, _stored(frame), [option, value])
    pixels = cv2.imdecode(data, cv2.IMREAD_COLOR if frame.ndim == 3 else cv2.IMREAD_GRAYSCALE)
    return decode(pixels / 255, SRGB)


def _video(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    """Return the last frame of an MPEG-4 film of a picture that moves the faster."""
    shift_px = at_strength(strength, 0.0, 1.0, 2.5, 5.0, 9.0)
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
    share = at_strength(strength, 0.03, 0.08, 0.15, 0.3, 0.5)
    return np.minimum(frame / np.quantile(frame, 1 - share), 1) * 0.9


def _overexposed(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    share = at_strength(strength, 0.03, 0.08, 0.15, 0.3, 0.5)
    return np.minimum(frame / np.quantile(frame, 1 - share), 1)


def _file_noise(more: bool) -> Change:
    """Return frames with more or less noise than the camera file says."""

    def changed(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
        factor = at_strength(strength, 2, 4, 8, 16, 32)
        if more:
            noisy = dataclasses.replace(fit, noise=fit.noise * factor)
            return dataclasses.replace(recorded(noisy, fit.light, random), known_noise=fit.noise)
        return dataclasses.replace(
            recorded(fit, fit.light, random), known_noise=min(fit.noise * factor, 0.4)
        )

    return changed


def _correlated(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    noise = random.standard_normal(frame.shape, dtype=np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), at_strength(strength, 0.5, 0.7, 1.0, 1.4, 2.0))
    return frame + 0.006 * noise / noise.std()


def _stripes(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    rows = random.standard_normal((len(frame), 1, 1)) * at_strength(
        strength, 0.002, 0.004, 0.008, 0.016, 0.03
    )
    return np.asarray(frame + (rows if frame.ndim == 3 else rows[..., 0]), np.float32)


def _hot(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    share = at_strength(strength, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
    out, hit = frame.copy(), random.random(frame.shape[:2]) < share
    out[hit] = random.choice([0.0, 0.9], hit.sum()).reshape(-1, *[1] * (frame.ndim - 2))
    return out


def _flicker(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    depth = at_strength(strength, 0.1, 0.2, 0.4, 0.6, 0.9)
    rows = 1 - depth / 2 * (1 + np.sin(np.arange(len(frame)) * 2 * np.pi / 60))
    return np.asarray(frame * rows.reshape(-1, *[1] * (frame.ndim - 1)), np.float32)


def _rescaled(factors: Sequence[float], enlarge: int = cv2.INTER_CUBIC) -> Change:
    """Return a frame that was enlarged and cropped, or shrunk."""

    def changed(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
        factor = at_strength(strength, *factors)
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
    truth = fit.blur_size_px * at_strength(strength, 0.6, 0.75, 1.25, 1.5, 1.8)
    return dataclasses.replace(recorded(fit, fit.light, random), blur_size_px=truth)


def _encoded(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    return np.clip(frame, 0, 1) ** (1 / at_strength(strength, 1.2, 1.5, 1.8, 2.2, 2.6))


def _sharpened(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    amount = at_strength(strength, 0.3, 0.6, 1.0, 1.8, 3.0)
    return np.clip(frame + amount * (frame - cv2.GaussianBlur(frame, (0, 0), 1.5)), 0, 1)


def _denoised(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    ways: tuple[Callable[[], FloatArray], ...] = (
        lambda: cv2.bilateralFilter(frame, 5, 0.006, 2.0),
        lambda: cv2.bilateralFilter(frame, 5, 0.015, 2.0),
        lambda: cv2.medianBlur(frame, 3),
        lambda: cv2.medianBlur(frame, 5),
        lambda: cv2.GaussianBlur(frame, (0, 0), 1.2),
    )
    return ways[step_of(strength)]()


def _smoothed(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    return cv2.GaussianBlur(frame, (0, 0), at_strength(strength, 0.6, 1.0, 1.5, 2.2, 3.0))


def _mosaic(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    """Return the colours of a sensor's filters as they are, not interpolated."""
    less = at_strength(strength, 0.05, 0.1, 0.2, 0.4, 0.6)
    grey = frame if frame.ndim == 2 else frame.mean(2)
    gains = np.ones(grey.shape, np.float32)
    gains[::2, ::2] -= less
    gains[1::2, 1::2] -= less / 2
    return grey * gains


def _interlaced(frame: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    out = frame.copy()
    out[1::2] = np.roll(frame, round(at_strength(strength, 1, 2, 3, 5, 8)), 1)[1::2]
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
    contrast = at_strength(strength, 0.5, 0.25, 0.12, 0.06, 0.03)
    return np.asarray(light.mean() + contrast * (light - light.mean()), np.float32)


# Light that is not what one would like, but fits.
LIGHT: dict[str, Change] = {
    "less light": lambda fit, strength, random: _exposed(fit, strength, random, gain=False),
    "less light, amplified": lambda fit, strength, random: _exposed(fit, strength, random, True),
    "less contrast": of_light(_faint),
}
_NOISE = ("noise",)
MISFITS = {
    **OPTICAL_MISFITS,
    "JPEG": Misfit(of_frame(_jpeg), ("compression",)),
    "WebP": Misfit(of_frame(_webp), ("compression",)),
    "video": Misfit(of_frame(_video), ("compression",)),
    "clipped": Misfit(of_frame(_clipped), ("clipped",)),
    "overexposed": Misfit(of_frame(_overexposed), ("clipped",)),
    "more noise than the file": Misfit(_file_noise(True), _NOISE),
    "less noise than the file": Misfit(_file_noise(False), _NOISE),
    "correlated noise": Misfit(of_frame(_correlated), (*_NOISE, "processed")),
    "stripes": Misfit(of_frame(_stripes), _NOISE),
    "hot pixels": Misfit(of_frame(_hot), _NOISE),
    "flicker of lamps": Misfit(of_frame(_flicker), ("noise", "processed")),
    "enlarged": Misfit(_rescaled((1.25, 1.5, 2.0, 2.5, 3.0)), ("scale",)),
    "not linear": Misfit(of_frame(_encoded), ("tone",)),
    "sharpened": Misfit(of_frame(_sharpened), ("processed",)),
    "denoised": Misfit(of_frame(_denoised), ("processed", "scale")),
    "mosaic": Misfit(of_frame(_mosaic), ("processed",)),
    "interlaced": Misfit(of_frame(_interlaced), ("processed",)),
    "shrunk": Misfit(_rescaled((0.85, 0.7, 0.6, 0.5, 0.4)), ("scale",), traced=False),
    "other camera": Misfit(_other_camera, ("scale",), traced=False),
    "smoothed": Misfit(of_frame(_smoothed), ("processed", "scale")),
    "enlarged linearly": Misfit(
        _rescaled((1.25, 1.5, 2.0, 2.5, 3.0), cv2.INTER_LINEAR), ("scale",)
    ),
}
