"""What is known of one frame while the stages work on it."""

import dataclasses
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, PerPatch, Shape
from coded_aperture_ros.depth.decoders.decoded import Decoded
from coded_aperture_ros.depth.estimate import DepthEstimate
from coded_aperture_ros.depth.layer import Layer, LayerSpec
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.quality import Health
from coded_aperture_ros.depth.upsample import MapGrid
from coded_aperture_ros.frames import Frame, frames_of_patches
from coded_aperture_ros.likelihood import Cost


@dataclasses.dataclass(eq=False)
class Work:
    """One frame's way through the stages: each reads what is there, and adds what it finds.

    Fields without a default are set by the stage that is named beside them.
    """

    frame: Frame
    size: Shape  # rows and columns of the maps

    # The front: from light to the cost of every level.
    observation: Observation = dataclasses.field(init=False)  # observe
    # Mean of the frames that are alike [height, width], and how many it is of, by square; None:
    # of this one.
    grey: FloatArray = dataclasses.field(init=False)  # observe, static average
    averaged_frames: FloatArray | None = None
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
    def mean_noise(self) -> PerPatch:
        """Standard deviation of the noise of `grey`, of the frame or around every patch."""
        deviation: Any = self.observation.noise.deviation
        if self.averaged_frames is None:
            return deviation
        return deviation / np.sqrt(frames_of_patches(self.averaged_frames, self.observation.grid))

    @property
    def map_grid(self) -> MapGrid:
        """Where the pixels of the maps lie among the patches."""
        return MapGrid.of(self.observation.grid, self.observation.grey.shape, self.level.shape)

    def add_layer(self, spec: LayerSpec, values: FloatArray, note: str = "") -> None:
        """Add a layer; it is float32."""
        self.layers[spec.name] = Layer(spec, np.asarray(values, np.float32), note)

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
            layers=self.layers,
            stamp_ns=self.frame.stamp_ns,
            seconds=self.seconds,
        ).enlarged(self.size)
