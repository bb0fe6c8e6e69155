"""The filter bank at the rate of a camera: planned once for a frame size, run on every frame."""

from coded_aperture_ros.engine.engine import (
    BACKENDS,
    Engine,
    check_backend,
    plan_engine,
    torch_device,
)
from coded_aperture_ros.engine.numpy_engine import NumpyEngine
from coded_aperture_ros.engine.plan import Plan
from coded_aperture_ros.engine.workers import Workers

__all__ = [
    "BACKENDS",
    "Engine",
    "NumpyEngine",
    "Plan",
    "Workers",
    "check_backend",
    "plan_engine",
    "torch_device",
]
