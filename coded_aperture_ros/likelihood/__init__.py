"""The filter bank at the rate of a camera: planned once for a frame size, run on every frame."""

from coded_aperture_ros.likelihood.engine import (
    BACKENDS,
    Engine,
    check_backend,
    plan_engine,
    torch_device,
)
from coded_aperture_ros.likelihood.numpy_engine import NumpyEngine
from coded_aperture_ros.likelihood.plan import Plan

__all__ = [
    "BACKENDS",
    "Engine",
    "NumpyEngine",
    "Plan",
    "check_backend",
    "plan_engine",
    "torch_device",
]
