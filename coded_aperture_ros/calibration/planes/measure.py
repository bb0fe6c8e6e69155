"""Blur sizes of planes, as a bank of the mask found measures them."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.depth.decoders.posterior import refine_level
from coded_aperture_ros.frames import PatchGrid, channel_mean
from coded_aperture_ros.frames.noise import estimate_noise, high_power
from coded_aperture_ros.likelihood.bank import LearnConfig, LearnedPattern, learn_bank
from coded_aperture_ros.likelihood.bank.all_frequencies import RANK_OF_ALL
from coded_aperture_ros.optics import render_psf_stack

# Blur sizes to choose from: beyond those of all planes on either side.
_SIZES = 48
_BEYOND = 1.2
_MIN_SIZE_PX = 0.5
# Whole sizes are this uncertain even on the best of planes; sharp planes are worse.
MIN_ERROR_PX = 0.1
_ITERATIONS = 20
# Smallest ratio of a tilt to its error, and smallest tilt, that is reported.
_SURE = 4.0
_TILT_PX = 0.6


@dataclasses.dataclass(frozen=True, eq=False)
class MeasuredPlane:
    """The blur of one plane, without regard to its depth."""

    size_px: float  # unsigned blur size of the mask, from all windows together
    sizes_px: FloatArray  # [rows, columns]; that of every window
    error_px: float  # standard error of the size, from the scatter of the windows
    # How much more the blur is at the right end than at the left, and at the bottom than at the
    # top.
    tilt_px: tuple[float, float]
    tilt_error_px: float  # standard error of the tilt, likewise

    @property
    def is_tilted(self) -> bool:
        """Whether the blur surely varies over the field."""
        tilt = float(np.hypot(*self.tilt_px))
        return tilt > max(_SURE * self.tilt_error_px, _TILT_PX)

    def scaled(self, scale: float) -> "MeasuredPlane":
        """Blur of a mask whose grid is wider by a factor."""
        return MeasuredPlane(
            size_px=self.size_px * scale,
            sizes_px=self.sizes_px * np.float32(scale),
            error_px=self.error_px * scale,
            tilt_px=(self.tilt_px[0] * scale, self.tilt_px[1] * scale),
            tilt_error_px=self.tilt_error_px * scale,
        )


def measure_planes(
    planes: Planes, pattern: LearnedPattern, config: LearnConfig
) -> list[MeasuredPlane]:
    """Measure the blur of every plane with filters for many sizes of the same mask.

    Of the pattern only its mask is used, and how large it gets at most. `config` names its window.
    """
    # Planes have no depth edges: all frequencies are used.
    config = dataclasses.replace(config, highest_frequency=1.0, rank=RANK_OF_ALL)
    largest = _BEYOND * float(np.abs(pattern.blur_size_px(planes.depths_m)).max())
    largest = min(largest, config.window_px - 1)
    sizes_px = np.linspace(_MIN_SIZE_PX, largest, _SIZES)
    bank = learn_bank(
        render_psf_stack(pattern.mask, sizes_px), config, components=pattern.components(sizes_px)
    )
    measured = []
    for image in planes.images:
        grey = channel_mean(image)
        stride_px = config.window_px // 4
        grid = PatchGrid.covering(grey.shape, config.window_px, stride_px)
        energies = bank.energies(grey, stride_px, estimate_noise(high_power(grey, grid)))
        whole = energies.mean(axis=(0, 1), keepdims=True)

        def sizes_of(energies: FloatArray) -> DoubleArray:
            levels = refine_level(energies, energies.argmin(axis=-1))
            return np.interp(levels, np.arange(_SIZES), sizes_px)

        measured.append(_measured(float(sizes_of(whole)[0, 0]), sizes_of(energies)))
    return measured


def _measured(size_px: float, sizes_px: NDArray) -> MeasuredPlane:
    rows, columns = sizes_px.shape
    down, right = np.meshgrid(
        np.linspace(-0.5, 0.5, rows), np.linspace(-0.5, 0.5, columns), indexing="ij"
    )
    terms = np.stack([np.ones(sizes_px.size), right.ravel(), down.ravel()], axis=1)
    values = sizes_px.ravel()
    weights = np.ones(sizes_px.size)
    for _ in range(_ITERATIONS):  # least absolute deviations: a few windows may be far off
        roots = np.sqrt(weights)[:, None]
        found, *_ = np.linalg.lstsq(roots * terms, roots[:, 0] * values, rcond=None)
        deviation = np.abs(values - terms @ found)
        weights = 1 / np.maximum(deviation, 0.02)
    # Windows a quarter apart share most of their pixels: 16 have about the information of four.
    scatter = 1.48 * float(np.median(deviation)) * np.sqrt(4 / sizes_px.size)
    spread = [float(np.sqrt(np.mean(direction**2))) for direction in (right, down)]
    return MeasuredPlane(
        size_px=size_px,
        sizes_px=sizes_px.astype(np.float32),
        error_px=max(scatter, MIN_ERROR_PX),
        tilt_px=(float(found[1]), float(found[2])),
        tilt_error_px=max(scatter, MIN_ERROR_PX / 2) / max(min(spread), 0.1),
    )
