"""Depth from one coded frame."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank import FilterBank
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.stages import Stages
from coded_aperture_ros.depth.both_sides import (
    far_log_odds,
    given_side,
    has_both_sides,
    side_confidence,
    with_side,
)
from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.depth.levels import (
    agreeing_levels,
    confidence_of,
    is_unsure,
    knows_nothing,
    level_evidence,
    level_probability,
    nearest_plausible_level,
)
from coded_aperture_ros.depth.regularize import regularized_level
from coded_aperture_ros.depth.rims import DEPTH_EDGE_PX, trim_foreground
from coded_aperture_ros.depth.side import SideFinder
from coded_aperture_ros.depth.temporal import TemporalFilter
from coded_aperture_ros.depth.upsample import nearest_patches, upsample
from coded_aperture_ros.imaging import PatchGrid
from coded_aperture_ros.imaging.frame import grey_image
from coded_aperture_ros.imaging.noise import estimate_noise, high_power
from coded_aperture_ros.imaging.patches import brightness_at, usable_windows
from coded_aperture_ros.imaging.static_average import StillAverage, frames_of_patches
from coded_aperture_ros.likelihood import Engine, plan_engine
from coded_aperture_ros.optics import Camera

# Steps between two levels that blur sizes and depths are tabulated at: finer than any estimate.
_STEPS = 128
# Patches so far apart, in px, are worth one pixel of the map for each this many.
_MAP_PX_PER_PATCH = 5


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
        Depth along the optical axis in metres; NaN where unknown (unless the configuration says
        otherwise), +inf for a level at or beyond
        the camera's blur size of infinity. None if neither a camera nor the bank says how far the
        levels are.
    confidence : ndarray
        Probability, in [0, 1], that the depth is right to 5 % (or, without depths, that the level
        is right to one level).
    noise : float
        Standard deviation of the noise of one channel, as estimated or given; without shot noise.
    side_confidence : ndarray or None
        Probability, in [0, 1], that the level is on the right side of the focal plane; it is part
        of `confidence`. None if the bank has levels of one side only.
    """

    level: NDArray[np.float32]
    blur_size_px: NDArray[np.float32]
    depth_m: NDArray[np.float32] | None
    confidence: NDArray[np.float32]
    noise: float
    side_confidence: NDArray[np.float32] | None = dataclasses.field(default=None, kw_only=True)

    def where_confident(self, threshold: float) -> "DepthEstimate":
        """Return the estimate with NaN wherever the confidence is below the threshold."""
        unknown = is_unsure(self.confidence, threshold)

        def known(values: NDArray[np.float32]) -> NDArray[np.float32]:
            values = values.copy()
            np.putmask(values, unknown, np.float32(np.nan))
            return values

        return dataclasses.replace(
            self,
            level=known(self.level),
            blur_size_px=known(self.blur_size_px),
            depth_m=None if self.depth_m is None else known(self.depth_m),
        )

    def enlarged(self, size: tuple[int, int]) -> "DepthEstimate":
        """Return the estimate with maps of `size` (rows, columns), by the nearest pixels."""
        if self.level.shape == size:
            return self

        def large(values: NDArray[np.float32]) -> NDArray[np.float32]:
            # Not linearly: that would make up depths in the air beside every edge.
            return np.asarray(cv2.resize(values, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT))

        return dataclasses.replace(
            self,
            level=large(self.level),
            blur_size_px=large(self.blur_size_px),
            depth_m=None if self.depth_m is None else large(self.depth_m),
            confidence=large(self.confidence),
            side_confidence=None if self.side_confidence is None else large(self.side_confidence),
        )


def check_map_size(size: tuple[int, int] | None) -> None:
    """Refuse a size (rows, columns) that no map can have.

    Raises
    ------
    InputError
    """
    if size is not None and min(size) < 1:
        raise InputError(f"size of the depth map: expected at least 1x1, got {size}")


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """What is seen of one frame before its depth is estimated.

    Attributes
    ----------
    grey : ndarray, float32 [height, width]
        Mean of the channels, without NaN.
    grid : PatchGrid
        Where the patches lie, rows by columns.
    brightness : ndarray, float32 [rows, columns]
    usable : ndarray, bool [rows, columns]
        Patches with next to no saturated and missing pixels.
    noise : float
        Standard deviation of the noise of `grey`, without shot noise.
    shot_variance : ndarray, float32 [rows, columns], or None
        Variance of the shot noise, if it is known.
    channels : int
        Of the frame.
    """

    grey: NDArray[np.float32]
    grid: PatchGrid
    brightness: NDArray[np.float32]
    usable: NDArray[np.bool_]
    noise: float
    shot_variance: NDArray[np.float32] | None
    channels: int


def depths_are_measured(bank: FilterBank) -> bool:
    """Return whether a bank knows its depths from measurement, better than by a camera file."""
    return not bank.mask_digest and bank.stack.depths_m is not None


class DepthEstimator:
    """Turns coded frames into depth; the whole method is `estimate`.

    The work is planned for the size of the first frame, and anew when the size changes. With
    `DepthConfig.temporal_frames` the frames are those of a video, in order; `reset` starts another.

    Parameters
    ----------
    bank : FilterBank
    config : DepthConfig, optional
    camera : Camera, optional
        Turns blur sizes into metres, unless the bank was learned from PSFs or planes of measured
        depths, which say it themselves.

    Attributes
    ----------
    stages : Stages
        How long each part of the work on the last frame took.
    """

    def __init__(
        self, bank: FilterBank, config: DepthConfig | None = None, camera: Camera | None = None
    ) -> None:
        self.bank = bank
        self.config = config or DepthConfig()
        self.camera = camera
        self.stages = Stages()
        self._agreement = agreeing_levels(bank, self._level_depths_m())
        self._blur_sizes_px, self._depths_m = self._tables()
        at_levels = self._blur_sizes_px if self._depths_m is None else self._depths_m
        self._nearest_first = np.argsort(at_levels[::_STEPS], kind="stable")
        self._engine: Engine | None = None
        self._both_sides = has_both_sides(bank)
        self._sides: SideFinder | None = None
        self._shape: tuple[int, ...] = ()
        frames = self.config.temporal_frames
        self._still = StillAverage(2 * frames) if frames else None
        self._temporal = TemporalFilter(frames) if frames else None

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""
        if self._temporal is not None and self._still is not None:
            self._temporal.reset()
            self._still.reset()

    def close(self) -> None:
        """End the threads that the work was shared among."""
        if self._engine is not None:
            self._engine.close()
            self._engine = None

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
        check_map_size(size)
        self.stages.start()
        seen = self.observe(frame)
        self.stages.lap("prepare")
        grey, frames = seen.grey, None
        if self._still is not None:
            grey, frames = self._still.add(seen.grey, seen.noise)
            self.stages.lap("still")
        own = evidence = self.evidence_of(seen, grey, frames)
        if self._temporal is not None:
            evidence = self._temporal.add(own, grey, seen.grid, seen.noise)
            self.stages.lap("temporal")
        return self.decide(seen, evidence, own, size)

    def observe(self, frame: NDArray[np.float32]) -> Observation:
        """Look at a frame by itself; the first step of `estimate`.

        Raises
        ------
        InputError
            If it has a wrong shape or type, or is smaller than the bank's window.
        """
        config = self.config
        grey, unusable = grey_image(frame, config.saturation)
        grid = self._planned(grey.shape).grid
        brightness = brightness_at(grey, grid)
        usable = np.full(brightness.shape, True)
        if unusable is not None:
            usable = usable_windows(unusable, grid)
        # The mean of the channels has less noise than each of them.
        channels = 1 if frame.ndim == 2 else frame.shape[2]
        shot_variance = None
        if config.noise_gain:
            shot_variance = np.float32(config.noise_gain / channels) * np.maximum(brightness, 0)
        noise = (config.noise or self.bank.noise) / float(np.sqrt(channels))
        if not noise:
            # Filled pixels have no noise: windows with many of them say nothing about it.
            telling = usable if usable.any() else ~usable
            shot = None if shot_variance is None else shot_variance[telling]
            noise = estimate_noise(high_power(grey, grid)[telling], shot)
        return Observation(grey, grid, brightness, usable, noise, shot_variance, channels)

    def evidence_of(
        self,
        seen: Observation,
        grey: NDArray[np.float32],
        frames: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Return the evidence against every level [rows, columns, L]; see `level_evidence`.

        Parameters
        ----------
        seen : Observation
        grey : ndarray, float32 [height, width]
            The frame, or a mean of frames.
        frames : ndarray, float32 [squares down, squares across], optional
            How many frames it is the mean of; see `StillAverage`.
        """
        engine, stages = self._planned(grey.shape), self.stages
        engine.project(grey)
        stages.lap("spectra")
        variance = seen.noise**2 + (0 if seen.shot_variance is None else seen.shot_variance)
        if frames is not None:
            variance = variance / frames_of_patches(frames, seen.grid)
        energies = engine.energies(np.sqrt(variance, dtype=np.float32))
        evidence = level_evidence(energies, self.bank.evidence_repetition)
        evidence[~seen.usable] = 0
        stages.lap("energies")
        if self._both_sides:
            evidence = self._with_side(seen, grey, evidence)
            stages.lap("side")
        return evidence

    def _with_side(
        self, seen: Observation, grey: NDArray[np.float32], evidence: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the evidence with what the phase of the frame tells of the side."""
        if self._sides is None:
            self._sides = SideFinder(self.bank.stack, grey.shape)
        noise = seen.noise
        if seen.shot_variance is not None:
            noise = float(np.sqrt(noise**2 + np.median(seen.shot_variance)))
        args = (evidence, self._sides, self.bank, grey, seen.grid, noise, self.config)
        return with_side(*args, seen.brightness)

    def decide(
        self,
        seen: Observation,
        evidence: NDArray[np.float32],
        own: NDArray[np.float32],
        size: tuple[int, int] | None = None,
    ) -> DepthEstimate:
        """Choose the levels of all patches and draw the maps; the last step of `estimate`.

        By the evidence of all frames; `own`, of this frame, says where between two levels.
        """
        config, grid, shape = self.config, seen.grid, seen.grey.shape
        size = size or (shape[0], shape[1])
        level = regularized_level(evidence, config, seen.brightness, own, grid.stride_px)
        self.stages.lap("regularise")

        # Patches that are far apart do not need every pixel of a large map.
        finest = -(-np.array(shape) // max(grid.stride_px // _MAP_PX_PER_PATCH, 1))
        drawn = (min(size[0], int(finest[0])), min(size[1], int(finest[1])))
        of_patches = level
        level = self._trimmed(upsample(level, grid, shape, drawn), drawn[1] / shape[1])
        patches = nearest_patches(grid, shape, drawn)
        probability = level_probability(evidence)
        of_side = None
        if self._both_sides:
            sizes = self.bank.blur_sizes_px
            of_side = side_confidence(of_patches, far_log_odds(evidence, sizes), grid, sizes)
            of_side = of_side[np.ix_(*patches)]
            given = given_side(probability, sizes)
            confidence = confidence_of(level, given, patches, self._agreement)
            # Where both sides' depths are about the same, either is right.
            confidence *= np.where(self._sides_agree(level), 1, of_side)
        else:
            confidence = confidence_of(level, probability, patches, self._agreement)
        unknown = knows_nothing(probability)
        if config.regularize != "none" and not unknown.all():
            unknown[:] = False  # they have the level of their neighbours
        unknown |= ~seen.usable
        if unknown.any():
            confidence[unknown[np.ix_(*patches)]] = 0
        noise = seen.noise * float(np.sqrt(seen.channels))
        if config.unknown == "nearest":
            nearest = nearest_plausible_level(probability, self._nearest_first)[np.ix_(*patches)]
            unsure = is_unsure(confidence, config.confidence_threshold)
            level = np.where(unsure, self._nearer(level, nearest), level)
            estimate = self._in_metres(level, confidence, noise, of_side).enlarged(size)
        else:
            estimate = self._in_metres(level, confidence, noise, of_side)
            estimate = estimate.where_confident(config.confidence_threshold).enlarged(size)
        self.stages.lap("map")
        return estimate

    def _planned(self, shape: tuple[int, ...]) -> Engine:
        """Return the engine for frames of a size; another size starts another video."""
        if self._engine is None or shape != self._shape:
            config = self.config
            engine = self._new_engine(shape, config.stride_px or self.bank.stride_px)
            # Only now: a frame that does not suit leaves the old plan as it is.
            self.close()
            self.reset()
            self._engine, self._shape, self._sides = engine, shape, None
        return self._engine

    def _new_engine(self, shape: tuple[int, ...], stride_px: int) -> Engine:
        """Return what computes the energies of frames of a size."""
        return plan_engine(self.bank, shape, stride_px, self.config.backend, self.config.threads)

    def _trimmed(self, level: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
        """Take the rims off foregrounds; `scale` is that of the map."""
        steps = np.diff(self.bank.blur_sizes_px)
        # In front of the focal plane the nearer surface is the more blurred one, and which of two
        # a window takes is another matter.
        if (self.bank.blur_sizes_px < 0).any() or not self.bank.stack.in_pixels:
            return level
        behind = np.float32(np.sign(steps[0]))
        window_px = self.bank.window_px * scale
        return behind * trim_foreground(
            behind * level,
            reach_px=round(self.config.rim * window_px),
            speck_px=2 * round(window_px / 4) - 1,  # odd: centred on its pixel
            jump_levels=DEPTH_EDGE_PX / float(np.abs(steps).mean()),
        )

    def _nearer(self, level: NDArray[np.float32], other: NDArray[np.intp]) -> NDArray[np.float32]:
        """Return the nearer one of two maps of levels."""
        # Depth grows or falls with the level's index.
        nearer = np.minimum if self._nearest_first[0] == 0 else np.maximum
        return np.asarray(nearer(level, other.astype(np.float32)))

    def _sides_agree(self, level: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return where the level of the other side with the same blur is as good."""
        sizes, index = self.bank.blur_sizes_px, np.arange(self.bank.levels)
        order = np.argsort(sizes)
        mirrored = np.rint(np.interp(-sizes, sizes[order], index[order]))
        first, last = self._agreement
        agree = (first <= mirrored) & (mirrored <= last)
        # A size that the other side does not have is on this one.
        agree &= (-sizes >= sizes.min()) & (-sizes <= sizes.max())
        return np.asarray(agree[np.rint(level).astype(np.intp)])

    def _in_metres(
        self,
        level: NDArray[np.float32],
        confidence: NDArray[np.float32],
        noise: float,
        of_side: NDArray[np.float32] | None = None,
    ) -> DepthEstimate:
        index = (level * _STEPS + np.float32(0.5)).astype(np.int32)
        depth = None if self._depths_m is None else self._depths_m[index]
        return DepthEstimate(
            level, self._blur_sizes_px[index], depth, confidence, noise, side_confidence=of_side
        )

    def _tables(self) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Return blur sizes and depths of fractional levels, `_STEPS` for each."""
        count = self.bank.levels
        level = np.linspace(0, count - 1, (count - 1) * _STEPS + 1)
        blur_size = np.interp(level, np.arange(count), self.bank.blur_sizes_px)
        if self.camera is None or depths_are_measured(self.bank):
            depth = self.bank.stack.depth_at(level)
        else:
            depth = self.camera.depth_m(blur_size).astype(np.float32)
        return blur_size.astype(np.float32), depth

    def _level_depths_m(self) -> NDArray[np.float64] | None:
        if self.camera is None or depths_are_measured(self.bank):
            return self.bank.stack.depths_m
        if not self.bank.stack.in_pixels:
            raise InputError(
                "camera: the bank's PSFs were measured without their sizes, so a camera cannot "
                "tell their depths: learn the bank with the depths (--depths) or sizes_px"
            )
        if self.bank.mask_digest not in ("", self.camera.mask.digest):
            raise InputError(
                f"camera: its mask {self.camera.mask.name} is not the one that the bank was "
                f"learned for ({self.bank.learned_from}): learn the bank for this camera"
            )
        far = {"far": 1, "near": -1, "both": 0}[self.camera.side]
        if (self.bank.blur_sizes_px * far < 0).any():
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
