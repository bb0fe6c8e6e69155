"""Depth from coded frames: cost -> temporal -> refine -> level and confidence -> map."""

import dataclasses
from contextlib import ExitStack
from functools import cached_property
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, Shape
from coded_aperture_ros.core.stages import Stages
from coded_aperture_ros.core.workers import Workers, thread_count
from coded_aperture_ros.depth.ambiguity import BY_CHANCE, may_be_periodic
from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.depth.decoders.classical import Regularized
from coded_aperture_ros.depth.decoders.edges import edge_correction
from coded_aperture_ros.depth.decoders.network import (
    CELL_PX,
    Refined,
    small_bank,
    small_cost,
    untrained,
)
from coded_aperture_ros.depth.decoders.posterior import is_unsure
from coded_aperture_ros.depth.decoders.regularize import LEARNED, Regularizer, regularizer
from coded_aperture_ros.depth.decoders.sides import FocalSides
from coded_aperture_ros.depth.estimate import DepthEstimate, check_map_size
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.quality import FitCheck, Health, can_be_checked
from coded_aperture_ros.depth.temporal import TemporalFilter
from coded_aperture_ros.depth.upsample import MapGrid
from coded_aperture_ros.frames import KnownNoise, StaticAverage, frames_of_patches, grey_image
from coded_aperture_ros.likelihood import Cost, Likelihood, LikelihoodModel, MotionField
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.rotation import ExpectedMotion


@dataclasses.dataclass(frozen=True, eq=False)
class _Planned:
    """What was made for frames of one size."""

    shape: tuple[int, ...]
    likelihood: Likelihood
    sides: FocalSides | None
    small: Likelihood | None  # of the small patches
    decide: Regularized | Refined
    workers: Workers


def refinement_note(model: LikelihoodModel, config: DepthConfig) -> str | None:
    """Return one line if the configuration asks for the network and another stands in for it."""
    if config.regularize != LEARNED:
        return None
    why = untrained(model, config.stride_px or model.stride_px)
    if not why:
        if config.second_surface and model.stack.has_both_sides:
            return "second_surface: nothing is told with levels on both sides of the focal plane"
        return None
    return (
        "regularize: semiglobal in place of learned, which was not trained for this model: "
        f"{why}{'; it tells of no free space' if config.free_space_risk else ''}"
        f"{'; it tells of no second surface' if config.second_surface else ''}"
    )


class DepthEstimator:
    """Turns coded frames into depth; the whole method is `estimate`.

    The work is planned for the size of the first frame, and anew when the size changes. With
    `DepthConfig.temporal_frames` the frames are those of a video, in order; `reset` starts another.
    Not for several threads at once.

    Parameters
    ----------
    model : LikelihoodModel
        A filter bank, or what another method knows about the mask.
    camera : Camera, optional
        Turns blur sizes into metres, unless the model was learned from PSFs or planes of measured
        depths, which say it themselves. Its noise stands in for that of the configuration.
    regularize : Regularizer, optional
        In place of the one that the configuration names.
    like : DepthEstimator, optional
        Another one: what it has learned from the same model need not be learned again.
    costs_tell_sides : bool, optional
        The costs that are decided by know the sides of the focal plane: see `FocusPair`.

    Raises
    ------
    InputError
        If the model is not for the camera.
    """

    def __init__(
        self,
        model: LikelihoodModel,
        config: DepthConfig | None = None,
        camera: Camera | None = None,
        *,
        regularize: Regularizer | None = None,
        like: "DepthEstimator | None" = None,
        costs_tell_sides: bool = False,
    ) -> None:
        self.config = config = config or DepthConfig()
        self._given, self.camera = model, camera
        self.model = model.seen_by(camera) if isinstance(model, FilterBank) else model
        self.known_noise = KnownNoise.of(config, camera, model)
        self._levels = Levels.of(model, camera)
        self._learned = regularize is None and config.regularize == LEARNED
        # What is not learned, or was not trained for, is regularised by classical means.
        classical = "semiglobal" if self._learned else config.regularize
        self._regularize = regularize or regularizer(classical, config.smoothness)
        self._neighbours_decide = regularize is not None or classical != "none"
        frames = config.temporal_frames
        self._average = StaticAverage(2 * frames) if frames else None
        self._temporal = TemporalFilter(frames) if frames else None
        self._costs_tell_sides = costs_tell_sides
        self._fit: FitCheck | None = None
        if config.check_fit and isinstance(model, FilterBank) and can_be_checked(model.stack):
            guarded, parts = model.guard_levels > 0, model.field is not None
            self._fit = FitCheck(model.stack, frames > 0, guarded, parts)
        self._planned: _Planned | None = None
        if like is not None and like._given is model and "small_bank" in like.__dict__:
            self.small_bank = like.small_bank.seen_by(camera)

    @property
    def depths_m(self) -> DoubleArray | None:
        """Depths of the levels, m [L], from whoever knows them best; None if nobody does."""
        return self._levels.depths_m

    @cached_property
    def small_bank(self) -> FilterBank:
        """The bank of small patches, for models that `untrained` has nothing to say of."""
        if not isinstance(self.model, FilterBank):
            raise TypeError("only filter banks have small patches")
        return small_bank(self.model)

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""
        for memory in (self._average, self._temporal, self._fit):
            if memory is not None:
                memory.reset()

    def close(self) -> None:
        """End the threads that the work was shared among."""
        if self._planned is not None:
            self._planned.likelihood.close()
            self._planned.workers.close()
            if self._planned.small is not None:
                self._planned.small.close()
            self._planned = None

    def estimate(
        self,
        frame: FloatArray,
        size: Shape | None = None,
        prior: ExpectedMotion | None = None,
        hidden_noise: float = 0.0,
    ) -> DepthEstimate:
        """Estimate the depth of every pixel of a frame.

        Parameters
        ----------
        frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
            Linear light in [0, 1]; NaN and saturated pixels are left out.
        size : (int, int), optional
            Rows and columns of the maps, which cover the whole frame; the frame's by default.
        prior : ExpectedMotion, optional
            Of the picture during the exposure, for methods that find motion.
        hidden_noise : float, optional
            Standard deviation of what lossy compression has hidden in this frame, linear light; see
            `imaging.hidden_noise`.

        Raises
        ------
        InputError
            If the frame has a wrong shape or type, or is smaller than the model's window, or `size`
            is not that of a map.
        """
        check_map_size(size)
        stages = Stages()
        seen = self.observe(frame, hidden_noise)
        stages.lap("prepare")
        grey, frames = seen.grey, None
        if self._average is not None:
            grey, frames = self._average.add(seen.grey, seen.noise.least)
            stages.lap("average")
        own = self.cost(seen, grey, frames, prior)
        stages.take(own.seconds)
        volume = own.volume
        if self._temporal is not None:
            volume = self._temporal.add(volume, grey, seen.grid, seen.noise.least)
            stages.lap("temporal")
        return self.decide(seen, volume, own, size, stages)

    def observe(self, frame: FloatArray, hidden_noise: float = 0.0) -> Observation:
        """Look at a frame by itself: the first step of `estimate`, which says what is refused."""
        grey, unusable = grey_image(frame, self.config.saturation)
        channels = 1 if frame.ndim == 2 else frame.shape[2]
        grid = self._plan_for(grey.shape).likelihood.grid
        least = max(self.config.least_noise, hidden_noise)
        return Observation.of(grey, unusable, grid, self.known_noise, channels, least)

    def cost(
        self,
        seen: Observation,
        grey: FloatArray,
        frames: FloatArray | None = None,
        prior: ExpectedMotion | None = None,
    ) -> Cost:
        """Return the cost of every level for every patch of a frame, or of a mean of frames.

        `grey` is of that, and `frames` how many it is the mean of; see `StaticAverage`.
        """
        planned = self._plan_for(grey.shape)
        noise: Any = seen.noise.deviation
        if frames is not None:
            noise = noise / np.sqrt(frames_of_patches(frames, seen.grid))
        cost = planned.likelihood.cost(grey, noise, seen.usable, prior)
        stages = Stages()
        volume, small = cost.volume, None
        if planned.sides is not None:
            volume = planned.sides.weigh(volume, seen, grey)
            stages.lap("side")
        if planned.small is not None:
            small = small_cost(planned.small, seen, grey, noise)
            stages.lap("small patches")
        seconds = {**cost.seconds, **stages.seconds}
        return dataclasses.replace(cost, volume=volume, small=small, seconds=seconds)

    def decide(
        self,
        seen: Observation,
        volume: FloatArray,
        own: Cost,
        size: Shape | None = None,
        stages: Stages | None = None,
        others: Health | None = None,
    ) -> DepthEstimate:
        """Decide the level of every pixel and draw the maps; the last step of `estimate`.

        By the cost of all frames; `own`, of this frame, says the rest: see `Regularized`. The
        health of `others` counts where it is less than that of this one.
        """
        stages = stages or Stages()
        levels, shape, config = self._levels, seen.grey.shape, self.config
        size = size or (shape[0], shape[1])
        decided = self._plan_for(shape).decide(seen, volume, own, size, stages)
        level, confidence, health = decided.level, decided.confidence, None
        stages.lap("map")
        if self._fit is not None and own.misfit is not None:
            health = self._fit(seen, own.misfit, level, confidence)
            stages.lap("fit")
        if others is not None and (health is None or others.value < health.value):
            health = others
        if health is not None:
            confidence = health.trusted(confidence)
        doubted = np.full(level.shape, health is not None and not health.fits)
        if own.periodic is not None:
            at = MapGrid.of(seen.grid, shape, level.shape)
            as_well = may_be_periodic(
                own, seen.usable, at.at_patches(level), levels.blur_sizes_px, seen.grid
            )
            if as_well.any():
                found = at.nearest(as_well)
                confidence = np.where(found, np.minimum(confidence, BY_CHANCE), confidence)
                doubted |= found
        unknown = is_unsure(confidence, config.confidence_threshold)
        if config.unknown == "nearest":  # so that nothing is run into
            level = np.where(unknown, levels.nearer(level, decided.nearest_plausible()), level)
            unknown = np.zeros_like(unknown)
        free_space_m: FloatArray | None = None
        if risk := config.free_space_risk:
            free = np.full_like(level, levels.nearest_first[0])
            if decided.free_level is not None:
                free = np.where(doubted, free, levels.nearer(level, decided.free_level(risk)))
            free_space_m = levels.meaning(free, np.zeros_like(free), np.zeros_like(unknown))[2]
        second_m: FloatArray | None = None
        second_share: FloatArray | None = None
        if config.second_surface:
            second = second_share = np.full_like(level, np.nan)
            if decided.second is not None:
                second, second_share = (
                    np.where(doubted, np.float32(np.nan), part) for part in decided.second()
                )
            one = np.isnan(second)
            second_m = levels.meaning(np.nan_to_num(second), np.zeros_like(second), one)[2]
            stages.lap("second surface")
        level, blur_size_px, depth_m, std_dev_m = levels.meaning(level, decided.deviation, unknown)
        estimate = DepthEstimate(
            level,
            blur_size_px,
            depth_m,
            confidence,
            seen.channel_noise,
            decided.side_confidence,
            std_dev_m,
            free_space_m,
            second_m,
            second_share,
            health=health,
        ).enlarged(size)
        if own.motion is not None:
            estimate = dataclasses.replace(
                estimate, motion=_drawn(own.motion, MapGrid.of(seen.grid, shape, size))
            )
        stages.lap("map")
        return dataclasses.replace(estimate, seconds=stages.seconds)

    def _plan_for(self, shape: tuple[int, ...]) -> _Planned:
        """Return the plan for frames of a size; another size starts another video."""
        if self._planned is None or shape != self._planned.shape:
            config, model = self.config, self.model
            stride_px = config.stride_px or model.stride_px
            threads = thread_count(config.threads)
            likelihood = model.plan(shape, stride_px, config.backend, threads)
            # Only now: a frame that does not suit leaves the old plan as it is.
            self.close()
            self.reset()
            with ExitStack() as unless_planned:
                unless_planned.callback(likelihood.close)
                workers, sides = Workers(threads), None
                unless_planned.callback(workers.close)
                if model.stack.has_both_sides:
                    sides = FocalSides(
                        model.stack, self._levels, shape, self._regularize, self._costs_tell_sides
                    )
                small: Likelihood | None = None
                decide: Regularized | Refined
                if (bank := self._refined_bank(stride_px)) is not None:
                    small = self.small_bank.plan(
                        shape, CELL_PX, config.backend, threads, periodic=False
                    )
                    unless_planned.callback(small.close)
                    decide = Refined(
                        bank,
                        self._levels,
                        small.grid,
                        sides,
                        workers,
                        config.network,
                        config.second_surface,
                    )
                else:
                    decide = Regularized(
                        self._levels,
                        self._regularize,
                        edge_correction(model, config.edge_correction, workers),
                        sides,
                        self._neighbours_decide,
                        workers,
                    )
                unless_planned.pop_all()
            self._planned = _Planned(shape, likelihood, sides, small, decide, workers)
        return self._planned

    def _refined_bank(self, stride_px: int) -> FilterBank | None:
        """Return the model if its levels are decided by the network."""
        if not self._learned or not isinstance(self.model, FilterBank):
            return None
        return None if untrained(self.model, stride_px) else self.model


def _drawn(motion: MotionField, at: MapGrid) -> MotionField:
    """Return the motion of the nearest patch at every pixel."""
    return MotionField(
        at.nearest(motion.vectors_px), at.nearest(motion.confidence), motion.searched
    )
