"""The stages that a frame goes through, in order: one file for each.

A stage's file has its options as a class `Config`, its layers and `make`; see `StageModule`. What
is in this folder and not in the lists below runs last: so a new stage is one new file.
"""

import pkgutil
from functools import cache
from importlib import import_module
from typing import cast

from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, Stage, StageModule
from coded_aperture_ros.depth.stages import (
    decode,
    field_doubt,
    focal_side,
    focus_pair,
    free_space,
    from_device,
    likelihood,
    metric,
    motion,
    moving_camera,
    observe,
    periodic_texture,
    quality_of_fit,
    reliability,
    second_surface,
    small_patches,
    static_average,
    temporal,
    to_device,
    unknown,
)

# From light to the cost of every level.
FRONT: tuple[StageModule, ...] = (
    to_device,
    observe,
    static_average,
    likelihood,
    focal_side,
    small_patches,
    temporal,
    focus_pair,
)
# From cost to maps.
BACK: tuple[StageModule, ...] = (
    decode,
    reliability,
    quality_of_fit,
    periodic_texture,
    field_doubt,
    moving_camera,
    unknown,
    free_space,
    second_surface,
    metric,
    from_device,
    motion,
)


@cache
def extension_modules() -> tuple[StageModule, ...]:
    """Stages in this folder that are not in the lists above, in alphabetical order."""
    known = {module.__name__ for module in (*FRONT, *BACK)}
    names = sorted(f"{__name__}.{found.name}" for found in pkgutil.iter_modules(__path__))
    return tuple(cast(StageModule, import_module(name)) for name in names if name not in known)


def stage_modules() -> tuple[StageModule, ...]:
    """Files of all stages, in the order in which they run."""
    return (*FRONT, *BACK, *extension_modules())


def layer_specs() -> tuple[LayerSpec, ...]:
    """All layers that the stages may add, in the order of the stages.

    Examples
    --------
    >>> [spec.name for spec in layer_specs() if spec.unit == "m"]
    ['free_space', 'second']
    """
    return tuple(spec for module in stage_modules() for spec in module.LAYERS)


def make_front(plan: Plan, config: object) -> tuple[Stage, ...]:
    """Stages from light to the cost of every level; `config` is a `DepthConfig`."""
    return _made(FRONT, plan, config)


def make_back(plan: Plan, config: object) -> tuple[Stage, ...]:
    """Stages from cost to maps; `config` is a `DepthConfig`."""
    return _made((*BACK, *extension_modules()), plan, config)


def _made(modules: tuple[StageModule, ...], plan: Plan, config: object) -> tuple[Stage, ...]:
    return tuple(
        module.make(plan, config) for module in modules if _is_wanted(module, plan, config)
    )


def _is_wanted(module: StageModule, plan: Plan, config: object) -> bool:
    when, holders = module.WHEN, (config, plan)
    if when and not any(hasattr(holder, when) for holder in holders):
        raise AttributeError(
            f"{module.__name__}: WHEN = {when!r} is no option of DepthConfig or attribute of Plan"
        )
    return not when or any(getattr(holder, when, None) for holder in holders)
