"""Interface of the stages of the depth estimate."""

import dataclasses
import time
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, PerPatch, Shape, namespace
from coded_aperture_ros.core.blas import one_blas_thread
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.decoded import Decoded
from coded_aperture_ros.depth.decoders.network import DecoderChoice
from coded_aperture_ros.depth.decoders.regularize import Regularizer
from coded_aperture_ros.depth.decoders.sides import FocalSides
from coded_aperture_ros.depth.estimate import DepthEstimate
from coded_aperture_ros.depth.layer import Layer, LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.moving import Step
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.quality import FitCheck, Health
from coded_aperture_ros.frames import Frame, KnownNoise, PatchGrid, frames_per_patch
from coded_aperture_ros.likelihood import Cost, EngineLikelihood, Likelihood, LikelihoodModel
from coded_aperture_ros.optics import Camera


class SecondFocus(Protocol):
    """Adds the cost of a second frame at another focus distance; see `FocusPair`."""

    def add(self, cost: Cost, frame: Frame) -> tuple[Cost, Health | None]:
        """Cost of both frames together, and how well the second fits its bank."""

    def close(self) -> None:
        """Release threads."""


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """Everything that is equal for all frames of one size.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of the frames.
    model : LikelihoodModel
        For the view that the frames have.
    levels : Levels
        What the model's levels mean.
    likelihood : Likelihood
        Of the model, for frames of this shape.
    known_noise : KnownNoise
        Of one channel, as far as it is known before a frame is seen.
    workers : Workers
        Threads that share the work.
    decoder : DecoderChoice
        What decides the levels; the stages and `refinement_note` go by it.
    sides : FocalSides or None
        Where there are levels on both sides of the focal plane.
    small : Likelihood or None
        Of the small patches, if the network decides the levels.
    regularize : Regularizer or None
        In place of the one that the configuration names.
    second_focus : SecondFocus or None
        For pairs of frames at two focus settings.
    fit_check : FitCheck or None
        Check of the frames, if there is one for the model and it is asked for.
    device : str or None
        PyTorch's name of the device that the network runs on; None: NumPy.
    camera : Camera or None
        For the view that the frames have.
    """

    shape: Shape
    model: LikelihoodModel
    levels: Levels
    likelihood: Likelihood
    known_noise: KnownNoise
    workers: Workers
    decoder: DecoderChoice
    sides: FocalSides | None = None
    small: Likelihood | None = None
    regularize: Regularizer | None = None
    second_focus: SecondFocus | None = None
    fit_check: FitCheck | None = None
    device: str | None = None

    @property
    def costs_on_device(self) -> bool:
        """Whether costs stay on the device, where the network takes them."""
        own = isinstance(self.likelihood, EngineLikelihood) and self.decoder.learned
        return self.device is not None and own and self.sides is None and self.second_focus is None

    camera: Camera | None = None

    @property
    def unmeasured_camera(self) -> Camera | None:
        """The camera, if its lens was not measured away from the axis."""
        camera = self.camera
        known = camera is None or camera.field_is_measured or not camera.focal_length_mm
        return None if known else camera

    @property
    def finds_motion(self) -> bool:
        """Whether the model tells motion blur from defocus."""
        return getattr(self.model, "finds_motion", False)

    @property
    def reliability(self) -> tuple[float, ...]:
        """See `FilterBank`; empty for other models."""
        return getattr(self.model, "reliability", ())

    @property
    def grid(self) -> PatchGrid:
        """Where the patches lie."""
        return self.likelihood.grid


@dataclasses.dataclass(eq=False)
class Work:
    """State of one frame between the stages: each reads fields, and sets others.

    Fields without a default are set by the stage that is named beside them.
    """

    frame: Frame
    size: Shape  # rows and columns of the maps

    # The front: from light to the cost of every level. On a device light and maps are tensors.
    light: FloatArray | None = None  # to device; None: that of the frame
    observation: Observation = dataclasses.field(init=False)  # observe
    # Mean of the frames that are alike [height, width], and how many it is of, by square; None:
    # of this one.
    grey: FloatArray = dataclasses.field(init=False)  # observe, static average
    averaged_frames: FloatArray | None = None
    # Light of this frame's channels [height, width, C], if the model has PSFs for each.
    channels: FloatArray | None = None  # observe
    frame_cost: Cost = dataclasses.field(init=False)  # likelihood; focal side, small patches
    # Cost of every level by this frame and those of the video around it [rows, columns, L]; None:
    # by this frame.
    fused_cost: FloatArray | None = None  # temporal

    # The back: from cost to maps.
    decoded: Decoded = dataclasses.field(init=False)  # decode
    level: FloatArray = dataclasses.field(init=False)  # decode; unknown
    deviation: FloatArray = dataclasses.field(init=False)  # decode
    confidence: FloatArray = dataclasses.field(init=False)  # decode; lowered by later stages
    health: Health | None = None  # quality of fit; focus pair
    camera_step: Step | None = None  # moving camera
    doubted: BoolArray = dataclasses.field(init=False)  # decode; where nothing may be claimed
    unknown: BoolArray = dataclasses.field(init=False)  # unknown
    blur_size_px: FloatArray = dataclasses.field(init=False)  # metric
    depth_m: FloatArray | None = None  # metric
    std_dev_m: FloatArray | None = None  # metric

    layers: dict[str, Layer] = dataclasses.field(default_factory=dict)
    seconds: dict[str, float] = dataclasses.field(default_factory=dict)  # by stage

    @property
    def volume(self) -> FloatArray:
        """Cost of every level by all frames that count [rows, columns, L]."""
        return self.frame_cost.volume if self.fused_cost is None else self.fused_cost

    @property
    def measured(self) -> FloatArray:
        """What likelihoods take: `channels`, else `grey`."""
        return self.grey if self.channels is None else self.channels

    @property
    def mean_noise(self) -> PerPatch:
        """Standard deviation of the noise of `measured`'s mean, of the frame or every patch."""
        deviation: Any = self.observation.noise.deviation
        if self.averaged_frames is None or self.channels is not None:
            return deviation
        return deviation / np.sqrt(frames_per_patch(self.averaged_frames, self.observation.grid))

    def add_layer(self, spec: LayerSpec, values: FloatArray, note: str = "") -> None:
        """Add a layer; it is float32."""
        xp = namespace(values)
        self.layers[spec.name] = Layer(spec, xp.asarray(values, dtype=xp.float32), note)

    def estimate(self) -> DepthEstimate:
        """What was found, in maps of the size that was asked for."""
        return DepthEstimate(
            level=self.level,
            blur_size_px=self.blur_size_px,
            depth_m=self.depth_m,
            std_dev_m=self.std_dev_m,
            confidence=self.confidence,
            noise=self.observation.channel_noise,
            health=self.health,
            camera_step=self.camera_step,
            layers=self.layers,
            stamp_ns=self.frame.stamp_ns,
            seconds=self.seconds,
        ).enlarged(self.size)


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """Frames of a recorded video that are worked on together, in order.

    Attributes
    ----------
    works : sequence of Work
        In order; the last ones are look-ahead for those before.
    new : int
        Number of frames at the end that no earlier block had.
    finished : int
        Number of frames at the beginning that are complete with this block.
    """

    works: Sequence[Work]
    new: int
    finished: int


class Stage:
    """One step of the work on a frame; the stages of a plan are called in order.

    A stage with memory of a video overrides `reset`, and `both_ways` for recorded videos, where the
    frames before and after each are known.
    """

    name: str  # of its time in diagnostics and JSON

    def __call__(self, work: Work) -> None:
        """Read fields of `work`, and set those of this stage; every stage overrides it."""
        raise NotImplementedError(f"stage {self.name} has no __call__")

    def both_ways(self, block: Block) -> None:
        """Process every frame of a block, using those before and after it."""
        for work in block.works:
            self(work)

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""

    def close(self) -> None:
        """Release threads and device memory."""


class StageModule(Protocol):
    """Interface of a stage's file.

    If the stage has options, the file has them as a frozen dataclass `Config`, of which
    `DepthConfig` is made.
    """

    __name__: str
    LAYERS: tuple[LayerSpec, ...]  # layers that the stage may add
    # Option, or attribute of the plan, that enables the stage; empty: always enabled.
    WHEN: str

    def make(self, plan: Plan, config: Any) -> Stage:
        """Stage for frames of one size.

        `config` is a `DepthConfig`; the stage reads the fields of its own configuration.
        """


@one_blas_thread
def run(stages: Iterable[Stage], work: Work) -> None:
    """Call stages in order, and record the time of each in `work.seconds`.

    Times of its parts that a stage has recorded itself are not counted twice.
    """
    for stage in stages:
        began_s, noted_s = time.perf_counter(), sum(work.seconds.values())
        stage(work)
        took_s = time.perf_counter() - began_s - (sum(work.seconds.values()) - noted_s)
        work.seconds[stage.name] = work.seconds.get(stage.name, 0.0) + took_s
