"""Metric depth and all-in-focus frames from a single coded-aperture camera.

The names below are all that most programs need; they are imported when first used.
"""

# As in `typing`, whose import would take ten times as long as this package's.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from coded_aperture_ros.core.errors import InputError
    from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
    from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator
    from coded_aperture_ros.frames import Frame
    from coded_aperture_ros.io import (
        depth_picture,
        read_depth,
        read_image,
        write_depth,
        write_image,
    )
    from coded_aperture_ros.likelihood.bank import (
        FilterBank,
        LearnConfig,
        learn_bank,
        learn_bank_for_camera,
        load_bank,
        save_bank,
    )
    from coded_aperture_ros.optics import Camera, load_camera
    from coded_aperture_ros.pipeline import FramePipeline

__version__ = "0.1.0"

_ROOMS = {
    "Camera": "optics",
    "DeblurConfig": "deblur",
    "Deblurrer": "deblur",
    "DepthConfig": "depth",
    "DepthEstimate": "depth",
    "DepthEstimator": "depth",
    "FilterBank": "likelihood.bank",
    "Frame": "frames",
    "FramePipeline": "pipeline",
    "InputError": "core.errors",
    "LearnConfig": "likelihood.bank",
    "depth_picture": "io",
    "learn_bank": "likelihood.bank",
    "learn_bank_for_camera": "likelihood.bank",
    "load_bank": "likelihood.bank",
    "load_camera": "optics",
    "read_depth": "io",
    "read_image": "io",
    "save_bank": "likelihood.bank",
    "write_depth": "io",
    "write_image": "io",
}
# Type checkers want it written out.
__all__ = [
    "Camera",
    "DeblurConfig",
    "Deblurrer",
    "DepthConfig",
    "DepthEstimate",
    "DepthEstimator",
    "FilterBank",
    "Frame",
    "FramePipeline",
    "InputError",
    "LearnConfig",
    "depth_picture",
    "learn_bank",
    "learn_bank_for_camera",
    "load_bank",
    "load_camera",
    "read_depth",
    "read_image",
    "save_bank",
    "write_depth",
    "write_image",
]


def __getattr__(name: str) -> object:
    if name not in _ROOMS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_ROOMS[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
