"""Settings of the depth estimate: those of its stages, together."""

import dataclasses
from typing import Any

from coded_aperture_ros.core.options import check_options
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.depth.stages import extension_modules
from coded_aperture_ros.depth.stages.decode import DecodeConfig
from coded_aperture_ros.depth.stages.free_space import FreeSpaceConfig
from coded_aperture_ros.depth.stages.likelihood import LikelihoodConfig
from coded_aperture_ros.depth.stages.observe import ObserveConfig
from coded_aperture_ros.depth.stages.quality_of_fit import QualityOfFitConfig
from coded_aperture_ros.depth.stages.second_surface import SecondSurfaceConfig
from coded_aperture_ros.depth.stages.temporal import TemporalConfig
from coded_aperture_ros.depth.stages.unknown import UnknownConfig
from coded_aperture_ros.likelihood import check_backend


def _extensions() -> tuple[Any, ...]:
    """Configurations of stages that are not listed: a class `Config` in their file."""
    found = (getattr(module, "Config", None) for module in extension_modules())
    return tuple(config for config in found if config is not None)


@dataclasses.dataclass(frozen=True)
class DepthConfig(
    *_extensions(),  # type: ignore[misc]  # mypy cannot see what is not listed
    QualityOfFitConfig,
    TemporalConfig,
    SecondSurfaceConfig,
    FreeSpaceConfig,
    UnknownConfig,
    ObserveConfig,
    DecodeConfig,
    LikelihoodConfig,
):
    """How a frame is turned into depth.

    Every stage finds its own settings here: the fields are those of the stages' configurations.

    Raises
    ------
    InputError
        If a value is out of its range, two do not go together, or what computes is not there.

    Examples
    --------
    >>> DepthConfig(temporal_frames=3).regularize
    'learned'
    """

    def __post_init__(self) -> None:
        check_options(self)
        super().__post_init__()
        thread_count(self.threads)
        check_backend(self.backend)
