"""Metric depth and all-in-focus frames from a single coded-aperture camera.

The names below are all that most programs need; they are imported when first used.
"""

# As in `typing`, whose import would take ten times as long as this package's.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from coded_aperture_ros.deblur import Deblurrer
    from coded_aperture_ros.depth import DepthEstimator
    from coded_aperture_ros.likelihood.bank import FilterBank, learn_bank
    from coded_aperture_ros.optics import Camera
    from coded_aperture_ros.pipeline import FramePipeline

__version__ = "0.1.0"

_ROOMS = {
    "Camera": "optics",
    "Deblurrer": "deblur",
    "DepthEstimator": "depth",
    "FilterBank": "likelihood.bank",
    "FramePipeline": "pipeline",
    "learn_bank": "likelihood.bank",
}
__all__ = ["Camera", "Deblurrer", "DepthEstimator", "FilterBank", "FramePipeline", "learn_bank"]


def __getattr__(name: str) -> object:
    if name not in _ROOMS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_ROOMS[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
