"""Depth from one coded frame."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank import FilterBank
from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.depth.frame import grey_image, usable_windows
from coded_aperture_ros.depth.levels import (
    agreeing_levels,
    confidence_of,
    level_probability,
)
from coded_aperture_ros.depth.noise import estimate_noise
from coded_aperture_ros.depth.regularize import regularized_level
from coded_aperture_ros.depth.upsample import upsample
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.optics import Camera


@dataclasses.dataclass(frozen=True, eq=False)
class DepthEstimate:
    """What one frame says about depth; maps are float32 and of one shape [rows, columns].

    Attributes
    ----------
    level : ndarray
        Fractional index into the bank's levels; NaN where unknown.
    blur_size_px : ndarray
        Signed blur size in pixels of the frame; NaN where unknown.
    depth_m : ndarray or None
        Depth along the optical axis in metres; NaN where unknown, +inf for a level at or beyond
        the camera's blur size of infinity. None if neither a camera nor the bank says how far the
        levels are.
    confidence : ndarray
        Probability, in [0, 1], that the depth is right to 5 % (or, without depths, that the level
        is right to one level).
    noise : float
        Standard deviation of the noise of one channel, as estimated or given.
    """

    level: NDArray[np.float32]
    blur_size_px: NDArray[np.float32]
    depth_m: NDArray[np.float32] | None
    confidence: NDArray[np.float32]
    noise: float

    def where_confident(self, threshold: float) -> "DepthEstimate":
        """Return the estimate with NaN wherever the confidence is below the threshold."""
        unknown = ~(self.confidence >= threshold) | ~(self.confidence > 0)

        def known(values: NDArray[np.float32]) -> NDArray[np.float32]:
            return np.where(unknown, np.float32(np.nan), values)

        return dataclasses.replace(
            self,
            level=known(self.level),
            blur_size_px=known(self.blur_size_px),
            depth_m=None if self.depth_m is None else known(self.depth_m),
        )


class DepthEstimator:
    """Turns coded frames into depth; the whole method is `estimate`.

    Parameters
    ----------
    bank : FilterBank
    config : DepthConfig, optional
    camera : Camera, optional
        Turns blur sizes into metres. Without it, depth is given only if the bank was learned
        from PSFs of known depths.
    """

    def __init__(
        self, bank: FilterBank, config: DepthConfig | None = None, camera: Camera | None = None
    ) -> None:
        self.bank = bank
        self.config = config or DepthConfig()
        self.camera = camera
        self._agreement = agreeing_levels(bank, self._level_depths_m())

    def estimate(
        self, frame: NDArray[np.float32], size: tuple[int, int] | None = None
    ) -> DepthEstimate:
        """Estimate the depth of every pixel of a frame.

        Parameters
        ----------
        frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
            Linear light in [0, 1]; NaN and saturated pixels are left out.
        size : (int, int), optional
            Rows and columns of the maps, which cover the whole frame; the frame's by default.

        Returns
        -------
        DepthEstimate

        Raises
        ------
        InputError
            If the frame has a wrong shape or type, or is smaller than the bank's window, or `size`
            is not that of a map.
        """
        config, bank = self.config, self.bank
        grey, unusable = grey_image(frame, config.saturation)
        size = size or (grey.shape[0], grey.shape[1])
        if min(size) < 1:
            raise InputError(f"size of the depth map: expected at least 1x1, got {size}")
        projected = bank.project(grey, config.stride_px)
        # The mean of the channels has less noise than each of them.
        averaging = np.sqrt(1 if frame.ndim == 2 else frame.shape[2])
        given = (config.noise or bank.noise) / averaging
        noise = given or estimate_noise(projected.high_power)

        energies = bank.energies(projected, noise)
        probability = level_probability(energies, bank.fourier)
        level = regularized_level(energies, probability, config)
        confidence = confidence_of(level, probability, self._agreement)

        if unusable is not None:
            confidence[~usable_windows(unusable, projected.grid)] = 0
        level, confidence = upsample(level, confidence, projected.grid, grey.shape, size)
        estimate = self._in_metres(level, confidence, float(noise * averaging))
        return estimate.where_confident(config.confidence_threshold)

    def _in_metres(
        self, level: NDArray[np.float32], confidence: NDArray[np.float32], noise: float
    ) -> DepthEstimate:
        index = np.arange(self.bank.levels)
        blur_size = np.interp(level, index, self.bank.blur_sizes_px).astype(np.float32)
        if self.camera is None:
            depth = self.bank.stack.depth_at(level)
        else:
            depth = self.camera.depth_m(blur_size).astype(np.float32)
        return DepthEstimate(level, blur_size, depth, confidence, noise)

    def _level_depths_m(self) -> NDArray[np.float64] | None:
        if self.camera is None:
            return self.bank.stack.depths_m
        if self.bank.mask_digest not in ("", self.camera.mask.digest):
            raise InputError(
                f"camera: its mask {self.camera.mask.name} is not the one that the bank was "
                f"learned for ({self.bank.learned_from}): learn the bank for this camera"
            )
        wrong_side = self.bank.blur_sizes_px * (1 if self.camera.side == "far" else -1) < 0
        if wrong_side.any():
            raise InputError(
                f"camera: its side is {self.camera.side}, but the bank has blur sizes of the other "
                "side of the focal plane: learn the bank for this camera"
            )
        depths = self.camera.depth_m(self.bank.blur_sizes_px)
        if not np.isfinite(depths).any():
            raise InputError(
                "camera: no point gives the bank's blur sizes of "
                f"{self.bank.blur_sizes_px.min():g} to {self.bank.blur_sizes_px.max():g} px, "
                f"its blur at infinity is {self.camera.blur_at_infinity_px:g} px: "
                "learn the bank for this camera"
            )
        return depths
