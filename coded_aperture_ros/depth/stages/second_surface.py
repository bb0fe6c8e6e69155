"""A second surface in the window around a pixel, such as a net and the wall behind it."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, namespace
from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.decoders.network import NetworkDecoded, SecondSurface
from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_STEP_PX,
    COST_CHANNELS,
    tried_sizes,
)
from coded_aperture_ros.depth.decoders.regularize import LEARNED
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.stage import Plan, Stage, Work

SECOND = LayerSpec(
    "second",
    "Depth of another surface in the window around the pixel, such as a net or what is behind it.",
    unit="m",
    kind="depth",
    title="a second surface, such as behind a net",
)
SECOND_SHARE = LayerSpec(
    "second_share", "Share of the window that the second surface takes.", unit="", kind="share"
)
LAYERS: tuple[LayerSpec, ...] = (SECOND, SECOND_SHARE)
WHEN = "second_surface"


@dataclasses.dataclass(frozen=True)
class Config:
    """Whether a second surface is looked for."""

    second_surface: bool = option(
        False,
        "Tell of a second surface where windows show two, such as a net and the wall behind it.",
        needs=("regularize", LEARNED),
        parameter="second_surface.enabled",
        daily=True,
    )


def make(plan: Plan, config: Config) -> Stage:
    """Stage of a second surface."""
    # What is more blurred may lie before or behind: with levels on both sides none is found. Nor is
    # it where another refinement than the one that this network knows decides.
    own = getattr(plan.model, "refinement", None)
    if not plan.decoder.learned or plan.sides is not None or own is not None:
        return FindSecondSurface(plan.levels, None)
    device = plan.device if plan.costs_on_device else None
    network = SecondSurface(tried_sizes(plan.levels.blur_sizes_px), device)
    return FindSecondSurface(plan.levels, network)


@dataclasses.dataclass(frozen=True, eq=False)
class FindSecondSurface(Stage):
    """Finds depth and share of the second surface; NaN where there is one surface only."""

    levels: Levels
    network: SecondSurface | None
    name = "second surface"

    def __call__(self, work: Work) -> None:
        """Add depth and share."""
        xp = namespace(work.level)
        level = share = xp.full_like(work.level, np.nan)
        if self.network is not None and isinstance(work.decoded, NetworkDecoded):
            level, share = self._found(self.network, work.decoded)
            level = xp.where(work.doubted, np.nan, level)
            share = xp.where(work.doubted, np.nan, share)
        depth_m = self.levels.depth_m(xp.nan_to_num(level), xp.isnan(level))
        if depth_m is not None:
            work.add_layer(SECOND, depth_m)
        work.add_layer(SECOND_SHARE, share)

    def _found(
        self, network: SecondSurface, decoded: NetworkDecoded
    ) -> tuple[FloatArray, FloatArray]:
        """Level and share of the second surface [rows, columns]; NaN without one."""
        xp = namespace(decoded.level)
        pair = network(decoded.logits, decoded.features[COST_CHANNELS:])
        pair = pair.map_values(decoded.drawing.upsample_nearest)
        signed_px = self.levels.blur_sizes_px
        sizes_px = np.abs(signed_px)
        first_px = xp.interp(decoded.level, np.arange(len(sizes_px)), sizes_px)
        size_px, share = pair.other_surface(xp.asarray(first_px, dtype=xp.float32))
        low_px, high_px = float(sizes_px.min()), float(sizes_px.max())
        beyond_px = xp.abs(xp.clip(size_px, low_px, high_px) - size_px)
        level = decoded.scale.level(-size_px if signed_px.mean() < 0 else size_px)
        unknown = decoded.unusable | decoded.blank | (beyond_px > BLUR_STEP_PX)
        return xp.where(unknown, np.nan, level), xp.where(unknown, np.nan, share)
