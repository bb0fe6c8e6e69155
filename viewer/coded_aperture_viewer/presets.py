"""Presets: settings that go together, and the panel and tool that go with them."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from coded_aperture_ros.depth.stages.temporal import VIDEO_FRAMES


@dataclasses.dataclass(frozen=True)
class Preset:
    """Settings for one purpose.

    Attributes
    ----------
    title, help : str
        Of its button.
    values : dict
        Of the settings that it changes; see `Settings.changed`.
    panel : str
        Panel of the page that becomes large.
    tool : str
        What a click does: read, distance or profile.
    """

    title: str
    help: str
    values: Mapping[str, Any]
    panel: str
    tool: str = "read"


PRESETS = (
    Preset(
        "Robot",
        "depth as a robot takes it, with the free-space bound; no all-in-focus picture",
        {
            "depth.confidence_threshold": 0.45,
            "depth.regularize": "learned",
            "depth.unknown": "nothing",
            "depth.temporal_frames": VIDEO_FRAMES,
            "depth.check_fit": True,
            "depth.free_space_risk": 0.01,
            "look.picture": "none",
        },
        panel="depth",
    ),
    Preset(
        "Picture",
        "the all-in-focus picture, with depth everywhere",
        {
            "depth.confidence_threshold": 0.0,
            "depth.unknown": "nearest",
            "depth.free_space_risk": 0.0,
            "depth.second_surface": False,
            "look.picture": "sharp",
        },
        panel="picture",
    ),
    Preset(
        "Measure",
        "sure depth only, averaged over ten frames of a scene that does not move; click two points",
        {
            "depth.confidence_threshold": 0.7,
            "depth.unknown": "nothing",
            "depth.temporal_frames": 10.0,
            "depth.free_space_risk": 0.0,
            "depth.second_surface": False,
            "look.picture": "sharp",
        },
        panel="depth",
        tool="distance",
    ),
)
