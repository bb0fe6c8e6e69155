"""Test frames: a simulated scene that moves."""

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_benchmarks.speed.setting import Size
from coded_aperture_ros.optics import PsfStack

NOISE = 0.003

_VIDEO_FRAMES = 6
_STEP_PX = (1, 2)
_BANDS = 4
_SLOPE = 1.2  # of the amplitude of natural texture
_CONTRAST = 0.12


def moving_frames(
    stack: PsfStack, shape: Size, count: int = _VIDEO_FRAMES, seed: int = 0
) -> list[NDArray[np.float32]]:
    """Simulate coded frames of a textured scene that moves by a few pixels from frame to frame.

    The texture has the spectrum of photographs; bands of it lie at different levels.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.

    Returns
    -------
    list of ndarray, float32 [rows, columns]
        In linear light around 0.5, with noise of 0.003.
    """
    random = np.random.default_rng(seed)
    rows, columns = (
        scipy.fft.next_fast_len(side + step * count, real=True)
        for side, step in zip(shape, _STEP_PX, strict=True)
    )
    frequency = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)) + 1 / columns
    white = random.standard_normal((rows, columns), dtype=np.float32)
    spectrum = scipy.fft.rfft2(white) / (frequency**_SLOPE).astype(np.float32)
    scene = np.empty((rows, columns), np.float32)
    levels = np.linspace(0, len(stack) - 1, _BANDS).round().astype(int)
    for band, level in zip(np.array_split(np.arange(columns), _BANDS), levels, strict=True):
        transfer = scipy.fft.rfft2(stack.psfs[level].astype(np.float32), (rows, columns))
        scene[:, band] = scipy.fft.irfft2(spectrum * transfer, (rows, columns))[:, band]
    scene = 0.5 + _CONTRAST * (scene - scene.mean()) / scene.std()
    frames = []
    for number in range(count):
        top, left = (number * step for step in _STEP_PX)
        crop = scene[top : top + shape[0], left : left + shape[1]]
        noise = NOISE * random.standard_normal(shape, dtype=np.float32)
        frames.append(np.clip(crop + noise, 0, 0.99).astype(np.float32))
    return frames
