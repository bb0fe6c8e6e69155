"""Settings of the depth estimate: those of its stages, together.

The settings of a stage are the class `Config` of its file, wherever the stage is listed or if it is
not: `DepthConfig` has them all.
"""

import dataclasses
import inspect
from typing import TYPE_CHECKING, Any

from coded_aperture_ros.core.options import check_options
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.depth.stages import (
    decode,
    free_space,
    likelihood,
    moving_camera,
    observe,
    quality_of_fit,
    second_surface,
    stage_modules,
    temporal,
    unknown,
)
from coded_aperture_ros.likelihood import check_backend


@dataclasses.dataclass(frozen=True)
class _TypedOptions(
    quality_of_fit.Config,
    moving_camera.Config,
    temporal.Config,
    second_surface.Config,
    free_space.Config,
    unknown.Config,
    observe.Config,
    decode.Config,
    likelihood.Config,
):
    """Options that type checkers and editors know; the last ones come first in `--help`."""


def _further_configs() -> tuple[Any, ...]:
    """`Config` of every stage that is not among the typed ones, the last stage first.

    Raises
    ------
    TypeError
        If the options of a `Config` would get lost: it is no dataclass, or another stage has an
        option of that name.
    """
    owners = dict.fromkeys(inspect.signature(_TypedOptions).parameters, "another stage")
    found: list[type] = []
    for module in stage_modules():
        config: Any = getattr(module, "Config", None)
        if config is None or config in (*_TypedOptions.__mro__, *found):
            continue
        for name in inspect.get_annotations(config):
            if name not in inspect.signature(config).parameters:
                raise TypeError(f"{config.__module__}: make Config a frozen dataclass")
            if name in owners:
                raise TypeError(f"{config.__module__}: option {name} is one of {owners[name]}, too")
            owners[name] = config.__module__
        found.append(config)
    return tuple(reversed(found))


if TYPE_CHECKING:  # what stages of other packages add is known at run time only
    _Options = _TypedOptions
else:
    _Options = type("_Options", (*_further_configs(), _TypedOptions), {})


@dataclasses.dataclass(frozen=True)
class DepthConfig(_Options):
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
        for config in DepthConfig.__mro__[1:]:
            if "__post_init__" in vars(config):  # each stage's own
                vars(config)["__post_init__"](self)
        thread_count(self.threads)
        check_backend(self.backend)
