"""Decoder of levels by the network on a device; see `NetworkDecoder`."""

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import torch

from coded_aperture_ros.core.arrays import FloatArray, Shape, constant
from coded_aperture_ros.core.tensors.functions import interp
from coded_aperture_ros.core.tensors.recorded import Recorded, Tensors
from coded_aperture_ros.core.tensors.transfer import download
from coded_aperture_ros.depth.decoders.network.array_forms import REACH, described
from coded_aperture_ros.depth.decoders.network.bilateral import Guide
from coded_aperture_ros.depth.decoders.network.cells import Cells, Drawing
from coded_aperture_ros.depth.decoders.network.decoder import (
    BLANK_COST,
    ONE_CONFIDENCE,
    ONE_DEVIATION,
    ONE_SURFACE_PX,
    NetworkDecoded,
    SizeScale,
    limit_past,
)
from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_SIZES_PX,
    BLUR_STEP_PX,
    LocalContext,
    PatchScale,
    frame_features,
    tried_sizes,
)
from coded_aperture_ros.depth.decoders.network.network import (
    Calibration,
    Logits,
    refinement_weights,
)
from coded_aperture_ros.depth.decoders.network.on_device.features import DeviceFeatures
from coded_aperture_ros.depth.decoders.network.on_device.network import DeviceNetwork
from coded_aperture_ros.depth.decoders.network.probabilities import HalfCells, Votes, width_px
from coded_aperture_ros.depth.levels import Folding, Levels
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.upsample import MapGrid
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import Cost


@dataclasses.dataclass(frozen=True, eq=False)
class DeviceDecoded(NetworkDecoded):
    """Levels decided on a device; nothing waits for it.

    What is not a map of every frame has to be asked for before the next frame.
    """

    found: Tensors  # by name; see `DeviceDecoder`

    def in_memory(self) -> NetworkDecoded:
        """The same with arrays of NumPy, when the device has finished."""
        found = _parts(download(self.found), self.scale, self.drawing, self.half_cells.tried_px)
        return NetworkDecoded(**found)


def _parts(
    found: Mapping[str, Any], scale: SizeScale, drawing: Drawing, tried_px: FloatArray
) -> dict[str, Any]:
    """Fields of `NetworkDecoded` from what was found, tensors or arrays by name."""
    half_cells = HalfCells(
        size_px=found["size_px"],
        about=found["about"],
        spread_px=found["spread_px"],
        width_px=found["width_px"],
        logits=found["logits"],
        tried_px=tried_px,
    )
    names = ("level", "deviation", "confidence", "features", "blank", "checked", "far")
    return {
        **{name: found[name] for name in (*names, "unusable", "blind")},
        "side_confidence": None,
        "logits": Logits(found["logits"], found["log_width"], found["cells"]),
        "half_cells": half_cells,
        "scale": scale,
        "drawing": dataclasses.replace(drawing, quarters=found["quarters"]),
    }


class DeviceDecoder:
    """Decides the levels of frames of one size on a device.

    Parameters
    ----------
    levels : Levels
        Of a model that the network supports, on one side of the focal plane.
    small : PatchGrid
        Positions of the small patches.
    device : str
        PyTorch's name of the device.
    own : mapping, optional
        Arrays of the network's weights, if a bank has its own.
    stays : bool, optional
        Whether the maps stay on the device.
    """

    def __init__(
        self,
        levels: Levels,
        small: PatchGrid,
        device: str,
        own: Mapping[str, Any] | None = None,
        stays: bool = True,
    ) -> None:
        self._stays = stays
        self._small = small
        self._device = device
        self._scale = SizeScale.from_levels(levels)
        self._folding = Folding.from_sizes(levels.blur_sizes_px)
        tried = tried_sizes(self._folding.sizes_px)
        self._tried_px = BLUR_SIZES_PX[tried].astype(np.float32)
        arrays = refinement_weights(own)
        self._network = DeviceNetwork(arrays, tried, device)
        self._calibration = Calibration.from_weights(arrays)
        self._checked = Calibration.of_check(arrays)
        self._recorded: dict[tuple[Any, ...], Recorded] = {}

    def __call__(
        self, observation: Observation, volume: FloatArray, frame_cost: Cost, size: Shape
    ) -> NetworkDecoded:
        """Decide the level of every pixel; see `NetworkDecoder`."""
        assert frame_cost.small is not None
        inputs = {
            "light": observation.light,
            "grey": observation.grey,
            "usable": observation.usable,
            "noise": np.array(observation.noise.typical, np.float32),
        }
        for name, cost in (("frame", frame_cost), ("small", frame_cost.small)):
            inputs[f"{name} volume"] = cost.volume
            scale = PatchScale.from_cost(cost, observation.grid)
            inputs[f"{name} misfit"] = scale.misfit
        if volume is not frame_cost.volume:
            inputs["volume"] = volume
        found = self._step(observation, size, "volume" in inputs)(inputs)
        cells = Cells.covering(observation.grey.shape, observation.grid)
        drawing = Drawing(cells, size, np.zeros((0, 0), np.intp))
        parts = _parts(found, self._scale, drawing, self._tried_px)
        decoded = DeviceDecoded(**parts, found=found)
        return decoded if self._stays else decoded.in_memory()

    @property
    def is_recorded(self) -> bool:
        """Whether all its work so far is a CUDA graph."""
        steps = self._recorded.values()
        return bool(steps) and all(step.is_recorded for step in steps)

    def _step(self, observation: Observation, size: Shape, has_past: bool) -> Recorded:
        """Recorded work on frames and maps of a size."""
        key = observation.light.shape, size, has_past
        if key not in self._recorded:
            cells = Cells.covering(observation.grey.shape, observation.grid)
            grids = observation.grid, self._small
            near = float(not self._scale.is_far)
            features = DeviceFeatures(cells, grids, self._folding.sizes_px, near)
            at = MapGrid.for_map(observation.grid, observation.grey.shape, size)
            self._recorded[key] = Recorded(partial(self._decide, features, cells, at), self._device)
        return self._recorded[key]

    def _decide(
        self, of_cells: DeviceFeatures, cells: Cells, at: MapGrid, inputs: Tensors
    ) -> Tensors:
        """All maps of a frame, and what they were made of, by name."""
        light, usable, volume = inputs["light"], inputs["usable"], inputs["frame volume"]
        if "volume" in inputs:
            volume = limit_past(inputs["volume"], volume)
        scales = (
            PatchScale(self._folding.fold_volume(volume), inputs["frame misfit"], cells.grid),
            PatchScale(inputs["small volume"], inputs["small misfit"], self._small),
        )
        context = LocalContext.from_frame(inputs["grey"], inputs["noise"])
        features = of_cells(scales, context)
        logits = self._network(features, frame_features(context, cells))
        alone = self._alone(logits)
        guide = Guide.from_light(light, cells)
        half_cells = alone.agreed(guide)
        level, tolerance_px, possible = self._rate(half_cells.size_px)
        told = half_cells.confidence_features(tolerance_px)
        confidence = possible * self._calibration.confidence(told)
        _, tolerance_px, possible = self._rate(alone.size_px)
        checked = possible * self._checked.confidence(alone.own_features(tolerance_px))
        per_px = float(self._scale.levels_per_px)
        deviation = half_cells.deviation_px() * (per_px * float(self._calibration.deviation))
        drawing = Drawing(cells, at.size, guide.owners())
        flat = volume.amax(-1) <= BLANK_COST
        unusable, blind = map(at.nearest_patch_values, (~usable, ~usable & flat))
        blank = flat.all()
        confidence_map: Any = drawing.render_map(confidence, ONE_CONFIDENCE)
        return {
            "level": drawing.render_map(level, ONE_SURFACE_PX * per_px),
            "deviation": drawing.render_map(deviation, ONE_DEVIATION),
            "confidence": confidence_map.masked_fill(unusable | blank, 0),
            "checked": checked,
            "blank": blank,
            "far": torch.full_like(half_cells.size_px, self._scale.is_far),
            "unusable": unusable,
            "blind": blind,
            "features": features,
            "logits": logits.size,
            "log_width": logits.log_width,
            "cells": logits.cells,
            "quarters": drawing.quarters,
            "size_px": half_cells.size_px,
            "about": half_cells.about,
            "spread_px": half_cells.spread_px,
            "width_px": half_cells.width_px,
        }

    def _alone(self, logits: Logits) -> HalfCells:
        """Half-cells, each by itself; see `HalfCells.from_logits`."""
        tried_px, shape = constant(self._tried_px, logits.size), logits.log_width.shape
        flat = torch.flatten(logits.size, 1)
        padded = flat.new_zeros(len(flat) + 2 * REACH, flat.shape[1])
        padded[REACH:-REACH] = torch.exp(flat - flat.amax(0))
        results, first = described(padded, tried_px)
        size_px, about, spread, mean = results[:4].reshape(4, *shape)
        votes = Votes(first.reshape(shape), results[4:].T.reshape(*shape, -1), mean)
        width = width_px(logits)
        return HalfCells(size_px, about, spread, width, logits.size, tried_px, votes)

    def _rate(self, size_px: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Level, its tolerance, and how possible blur sizes are; see `NetworkDecoder`."""
        scale, sizes_px = self._scale, self._scale.sizes_px
        signed_px = size_px if scale.is_far else -size_px
        level = interp(signed_px, sizes_px[scale.order], scale.order)
        tolerance_px = constant(scale.tolerance_px, level)[level.round().long()]
        beyond_px = (signed_px - signed_px.clip(float(sizes_px.min()), float(sizes_px.max()))).abs()
        return level, tolerance_px, (beyond_px <= BLUR_STEP_PX).float()
