"""Simulated coded-aperture camera: rendering with occlusion, sensor noise, scenes."""

from coded_aperture_ros.simulation.demo import demo_scene
from coded_aperture_ros.simulation.render import render_coded_frame
from coded_aperture_ros.simulation.scene import (
    MOTORCYCLE_RANGE_M,
    PanningScene,
    Scene,
    SensorModel,
    motorcycle_scene,
)

__all__ = [
    "MOTORCYCLE_RANGE_M",
    "PanningScene",
    "Scene",
    "SensorModel",
    "demo_scene",
    "motorcycle_scene",
    "render_coded_frame",
]
