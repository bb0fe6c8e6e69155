"""ROS parameters made from configuration dataclasses, and kept in step with them."""

import dataclasses
import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import Option, options_of

Config = TypeVar("Config")

_LARGEST_INTEGER = 2**63 - 1


class NodeParameters:
    """The parameters of a node: one per option of its configuration dataclasses.

    A bad value is refused with the reason and the old one stays. A good one replaces the whole
    (frozen) configuration, so that a worker thread that took one at the start of a frame keeps a
    consistent one, and can tell by identity that something has changed since.

    Parameters
    ----------
    node : rclpy.node.Node
    *configs : dataclass instances
        The defaults, made with `configuration.option`; option names must differ.
    fixed : dict, optional
        Further ones that cannot change while the node runs, by the prefix of their parameters'
        names, such as ``{"learn.": LearnConfig()}``.

    Raises
    ------
    InputError
        Where the node was started with a value that is refused.
    """

    def __init__(
        self, node: Node, *configs: Any, fixed: Mapping[str, Any] = MappingProxyType({})
    ) -> None:
        self._configs: dict[type, Any] = {}
        # Which configuration, and which option of it, a parameter belongs to.
        self._owner: dict[str, tuple[type, str]] = {}
        for config in configs:
            self._declare(node, config, "", read_only=False)
        for prefix, config in fixed.items():
            self._declare(node, config, prefix, read_only=True)
        self._listeners: dict[type, tuple[Callable[[Any], None], Callable[[Any], None]]] = {}
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def __getitem__(self, config_type: type[Config]) -> Config:
        """Return the present configuration of this type."""
        return self._configs[config_type]

    def on_change(
        self,
        config_type: type[Config],
        prepare: Callable[[Config], None],
        take_over: Callable[[Config], None],
    ) -> None:
        """Let a change of a configuration depend on more than its values.

        `prepare` gets the new configuration before it holds, and may refuse it with an
        `InputError`; `take_over` gets it once it holds.
        """
        self._listeners[config_type] = prepare, take_over

    def forget_listeners(self) -> None:
        """Let changes of all configurations depend on their values alone again."""
        self._listeners.clear()

    def _declare(self, node: Node, config: Any, prefix: str, read_only: bool) -> None:
        values = {}
        for name, (field, described) in options_of(config).items():
            if read_only:
                described = dataclasses.replace(described, read_only=True)
            parameter = prefix + name
            values[name] = _declared(node, parameter, getattr(config, name), field, described)
            self._owner[parameter] = type(config), name
        self._configs[type(config)] = dataclasses.replace(config, **values)

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            for owner, config in self._changed(parameters).items():
                if owner in self._listeners and config != self._configs[owner]:
                    self._listeners[owner][0](config)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        for owner, config in self._changed(parameters).items():
            changed = config != self._configs[owner]
            self._configs[owner] = config
            if changed and owner in self._listeners:
                self._listeners[owner][1](config)

    def _changed(self, parameters: list[Parameter]) -> dict[type, Any]:
        values: dict[type, dict[str, Any]] = {}
        for parameter in parameters:
            if parameter.name in self._owner:
                owner, name = self._owner[parameter.name]
                values.setdefault(owner, {})[name] = parameter.value
        return {
            owner: dataclasses.replace(self._configs[owner], **changes)
            for owner, changes in values.items()
        }


def descriptor_of(default: Any, described: Option) -> ParameterDescriptor:
    """Return the ROS descriptor of an option: its description, range and read-only flag."""
    unit = f" [{described.unit}]" if described.unit else ""
    descriptor = ParameterDescriptor(
        description=f"{described.description}{unit}", read_only=described.read_only
    )
    if described.choices is not None:
        descriptor.additional_constraints = described.allowed
    if described.minimum is None and described.maximum is None:
        return descriptor
    if isinstance(default, float):
        largest = sys.float_info.max
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=float(-largest if described.minimum is None else described.minimum),
                to_value=float(largest if described.maximum is None else described.maximum),
            )
        ]
    elif isinstance(default, int):
        descriptor.integer_range = [
            IntegerRange(
                from_value=int(
                    -_LARGEST_INTEGER if described.minimum is None else described.minimum
                ),
                to_value=int(_LARGEST_INTEGER if described.maximum is None else described.maximum),
                step=1,
            )
        ]
    return descriptor


def _declared(
    node: Node, name: str, default: Any, field: dataclasses.Field, described: Option
) -> Any:
    if isinstance(field.default, float):
        default = float(default)
    try:
        return node.declare_parameter(name, default, descriptor_of(default, described)).value
    except ParameterException as error:
        hint = ", write it with a decimal point" if isinstance(default, float) else ""
        allowed = f" (allowed: {described.allowed})" if described.allowed else ""
        raise InputError(f"parameter {name}: {error}{allowed}{hint}") from error
