"""Power spectra of texture, learned from sharp images of the place where the camera works."""

import dataclasses
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
from scipy.cluster.vq import kmeans2

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import channel_mean
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.prior import NaturalImagePrior, power_spectrum

_WINDOW_PX = 64
# Cycles per pixel at which a spectrum is kept; the lowest that a window resolves comes first.
_FREQUENCIES = np.geomspace(2.5 / _WINDOW_PX, 0.5, 9)
# Windows with less contrast (standard deviation, linear light) mostly show noise.
_MIN_CONTRAST = 0.01
# Windows with texture that a kind is learned from, at least.
_MIN_WINDOWS = 50


@dataclasses.dataclass(frozen=True)
class EmpiricalPrior(NaturalImagePrior):
    """Texture of a few kinds, each with the mean spectrum of its kind.

    Attributes
    ----------
    slopes : tuple of float
        Exponent of the power law nearest to each kind.
    deviations : tuple of tuple of float
        Difference of the logarithm of each kind's power from its power law, at nine frequencies
        from 0.04 to 0.5 cycles per pixel in equal ratios.

    Examples
    --------
    >>> image = np.random.default_rng(0).random((640, 640), np.float32)
    >>> len(EmpiricalPrior.from_images([image], kinds=2).slopes)
    2
    """

    deviations: tuple[tuple[float, ...], ...] = ((0.0,) * len(_FREQUENCIES),) * 3

    def __post_init__(self) -> None:
        super().__post_init__()
        lengths = {len(deviation) for deviation in self.deviations}
        if len(self.deviations) != len(self.slopes) or lengths != {len(_FREQUENCIES)}:
            raise InputError(
                f"prior deviations: expected {len(_FREQUENCIES)} for each of {len(self.slopes)} "
                "slopes"
            )
        if not np.isfinite(self.deviations).all():
            raise InputError("prior deviations: expected finite numbers")

    @classmethod
    def from_images(cls, images: Iterable[FloatArray], kinds: int = 4) -> "EmpiricalPrior":
        """Prior with the kinds of spectra of windows of sharp images.

        Parameters
        ----------
        images : iterable of ndarray, float32 [rows, columns] or [rows, columns, 3]
            All in focus, linear light.
        kinds : int, optional
            Number of kinds, at least 1.

        Raises
        ------
        InputError
            If there is too little texture in the images, or an image is smaller than 64 px.
        """
        fourier = WindowedFourierBasis(_WINDOW_PX)
        spectra = [_log_spectra(fourier, image) for image in images]
        logs = np.concatenate(spectra) if spectra else np.empty((0, len(_FREQUENCIES)))
        if kinds < 1 or len(logs) < _MIN_WINDOWS * kinds:
            raise InputError(
                f"{len(logs)} windows with texture are too few for {kinds} kinds of texture: give "
                f"at least {_MIN_WINDOWS * max(kinds, 1)}, from more or larger sharp images"
            )
        centres, _ = kmeans2(logs, kinds, minit="++", seed=0)
        frequencies = np.log(_FREQUENCIES)
        laws = [np.polyfit(frequencies, centre, 1) for centre in centres]
        order = np.argsort([-law[0] for law in laws])
        return cls(
            # A prior's slope is positive, even if a kind has more power at high frequencies.
            slopes=tuple(float(np.clip(-laws[k][0], 0.2, 6)) for k in order),
            deviations=tuple(
                tuple((centres[k] - np.polyval(laws[k], frequencies)).tolist()) for k in order
            ),
        )

    @property
    def spectra(self) -> tuple[Callable[[tuple[int, int]], DoubleArray], ...]:
        """Power spectrum of each kind as a function of an image's shape."""
        return tuple(
            partial(power_spectrum, slope, deviation=partial(_deviation, deviation))
            for slope, deviation in zip(self.slopes, self.deviations, strict=True)
        )


def _deviation(deviations: tuple[float, ...], logarithm: DoubleArray) -> DoubleArray:
    """Deviations at the logarithms of frequencies; constant beyond the first and the last."""
    return np.interp(logarithm, np.log(_FREQUENCIES), deviations)


def _log_spectra(fourier: WindowedFourierBasis, image: FloatArray) -> DoubleArray:
    """Logarithmic radial spectra of textured windows [windows, 9], without their mean."""
    grey = channel_mean(image)
    if min(grey.shape) < _WINDOW_PX:
        raise InputError(
            f"a sharp image of {grey.shape[1]}x{grey.shape[0]} px is smaller than the "
            f"{_WINDOW_PX} px that are needed: take it out, or use a larger one"
        )
    vertical = np.fft.fftfreq(_WINDOW_PX)[:, None]
    distance = np.log(np.hypot(vertical, np.fft.rfftfreq(_WINDOW_PX)).ravel() + 1e-9)
    edges = np.log(_FREQUENCIES)
    rings = np.argmin(np.abs(distance[:, None] - edges), axis=1)
    inside = fourier.multiplicity * (distance < np.log(0.5) + 0.1)
    filters = np.eye(len(edges))[rings] * inside[:, None]
    filters = np.column_stack([filters / filters.sum(axis=0), fourier.multiplicity])
    power, _ = fourier.power(grey, _WINDOW_PX // 2)
    means = (power.reshape(-1, fourier.size) @ filters.astype(np.float32)).astype(np.float64)
    means = means[means[:, -1] > _MIN_CONTRAST**2 * _WINDOW_PX**2, :-1]
    logs = np.log(np.maximum(means, 1e-12))
    return np.asarray(logs - logs.mean(axis=1, keepdims=True))
