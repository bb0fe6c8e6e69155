"""Checks of pictures of planes before learning: light, noise, texture."""

import dataclasses
import hashlib
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.frames import PatchGrid, channel_mean
from coded_aperture_ros.frames.noise import NOISE_FLOOR, high_power

_SATURATED = 0.995
_SOME_SATURATED = 0.001
_BRIGHTEST = 0.99
_DIM = 0.1
# A window has texture if its variance is so many times that of the noise.
_TEXTURE_OVER_NOISE = 4.0
_MIN_TEXTURED = 0.2
_WELL_TEXTURED = 0.6
_NOISY = 0.01
_MIN_PLANES = 8
_MAX_GAP = 2.5


@dataclasses.dataclass(frozen=True)
class PlaneCheck:
    """Light, noise and texture of a single picture."""

    file: str
    depth_m: float  # NaN where it is not known
    brightness: float  # mean, linear light in [0, 1]
    brightest: float  # what 99 % of the pixels are below
    saturated: float  # share of the pixels
    noise: float  # standard deviation of one channel
    contrast: float  # that of a window with noise taken off (median)
    textured: float  # share of the windows whose contrast is above the noise


@dataclasses.dataclass(frozen=True)
class Advice:
    """Possible improvement, and how; `file` is empty if it is about all pictures."""

    file: str
    text: str

    def __str__(self) -> str:
        return f"{self.file}: {self.text}" if self.file else self.text


def check_pictures(
    images: Sequence[FloatArray], names: Sequence[str], window_px: int, depths_m: ArrayLike = np.nan
) -> list[PlaneCheck]:
    """Light, noise and texture of every picture, with windows of `window_px`.

    Raises `InputError` with every picture that cannot be used, and what to do.
    """
    _refuse_repeated(images, names)
    depths = np.broadcast_to(np.asarray(depths_m, np.float64), len(images))
    checks = [
        _check(image, name, float(depth), window_px)
        for image, name, depth in zip(images, names, depths, strict=True)
    ]
    useless = [
        f"{check.file}: contrast {check.contrast:.2g} is not above the noise of {check.noise:.2g} "
        f"in {1 - check.textured:.0%} of the picture"
        for check in checks
        if check.textured < _MIN_TEXTURED
    ]
    if useless:
        raise InputError(
            "; ".join(useless) + ": use a page with fine texture all over, and more light; leave "
            "out planes so far from the focus that their texture is blurred away"
        )
    return checks


def _refuse_repeated(images: Sequence[FloatArray], names: Sequence[str]) -> None:
    """Raise `InputError` with two pictures that are the same: one of them has a wrong depth."""
    seen: dict[bytes, str] = {}
    for image, name in zip(images, names, strict=True):
        digest = hashlib.sha256(image.tobytes()).digest()
        if digest in seen:
            raise InputError(
                f"{seen[digest]} and {name}: the same picture is listed with two depths: keep one "
                "of them, or take the other again"
            )
        seen[digest] = name


def _check(image: FloatArray, name: str, depth_m: float, window_px: int) -> PlaneCheck:
    grey = channel_mean(image)
    with naming(name):
        grid = PatchGrid.covering(grey.shape, window_px, window_px // 2)
    noise = _noise(grey, grid)
    variances = _window_variances(grey, grid) - noise**2
    middle = max(float(np.median(variances)), 0.0)
    channels = image.reshape(*grey.shape, -1)
    return PlaneCheck(
        file=name,
        depth_m=depth_m,
        brightness=float(grey.mean()),
        brightest=float(np.quantile(image, _BRIGHTEST)),
        saturated=float(np.mean(image >= _SATURATED)),
        noise=float(np.median([_noise(channel, grid) for channel in np.moveaxis(channels, 2, 0)])),
        contrast=math.sqrt(middle),
        textured=float(np.mean(variances > (_TEXTURE_OVER_NOISE - 1) * noise**2)),
    )


def _noise(grey: FloatArray, grid: PatchGrid) -> float:
    power = high_power(np.ascontiguousarray(grey, np.float32), grid)
    return math.sqrt(max(float(np.quantile(power, 0.05)), NOISE_FLOOR**2))


def _window_variances(grey: FloatArray, grid: PatchGrid) -> NDArray:
    n = grid.window_px
    windows = np.lib.stride_tricks.sliding_window_view(grey[grid.top :, grid.left :], (n, n))
    windows = windows[:: grid.stride_px, :: grid.stride_px]
    return np.asarray(windows.reshape(*windows.shape[:2], -1).var(axis=2, dtype=np.float64))


def advice_on_pictures(checks: Sequence[PlaneCheck]) -> list[Advice]:
    """Advice about light, noise and texture."""
    return [Advice(check.file, text) for check in checks for text in _advice_on(check)]


def _advice_on(check: PlaneCheck) -> Iterator[str]:
    if check.saturated > _SOME_SATURATED:
        yield f"{check.saturated:.1%} of the pixels are saturated: expose a little shorter"
    if check.brightest < _DIM:
        yield f"dark: 99 % of the pixels are below {check.brightest:.2f}: expose it longer"
    if check.noise > _NOISY:
        yield f"noise of {check.noise:.3f}: use more light, or the mean of several frames"
    if check.textured < _WELL_TEXTURED:
        yield (
            f"only {check.textured:.0%} of the picture has texture above the noise: "
            "use a page with fine texture all over"
        )


def advice_on_depths(
    depths_m: DoubleArray, wanted_m: tuple[float, float] | None = None
) -> list[Advice]:
    """Advice about depths where planes are missing, for a bank of the `wanted_m` depth range."""
    texts = []
    if len(depths_m) < _MIN_PLANES:
        texts.append(f"{len(depths_m)} planes are few: 10 to 16 give a much better bank")
    inverse = 1 / depths_m
    steps = -np.diff(inverse)
    usual = float(np.median(steps))
    for i in np.flatnonzero(steps > _MAX_GAP * usual):
        between = 2 / (inverse[i] + inverse[i + 1])
        texts.append(
            f"wide gap from {depths_m[i]:.3g} to {depths_m[i + 1]:.3g} m: add one at "
            f"{between:.3g} m"
        )
    near_m, far_m = wanted_m or depths_m[[0, -1]]
    # Half a step beyond the planes is not far.
    if 1 / near_m - inverse[0] > usual / 2:
        texts.append(f"no plane is nearer than {depths_m[0]:.3g} m: add one at {near_m:.3g}")
    if inverse[-1] - 1 / far_m > usual / 2:
        texts.append(f"no plane is beyond {depths_m[-1]:.3g} m: add one at {far_m:.3g}")
    return [Advice("", text) for text in texts]
