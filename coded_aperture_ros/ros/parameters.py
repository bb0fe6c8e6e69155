"""ROS parameters made from configuration dataclasses, and kept in step with them."""

import dataclasses
import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import Option, check_option, options_of, parameter_names

Config = TypeVar("Config")

_LARGEST_INTEGER = 2**63 - 1


class _Setting(NamedTuple):
    """Which option of which configuration a parameter stands for."""

    owner: type
    field: str
    kind: type
    described: Option


class NodeParameters:
    """The parameters of a node: one per option of its configuration dataclasses.

    A bad value is refused with the reason and the old one stays. A good one replaces the whole
    (frozen) configuration, so that a worker thread that took one at the start of a frame keeps a
    consistent one, and can tell by identity that something has changed since. An integer is good
    for a number that may have a fraction.

    `configs` are instances with the defaults, made with `core.options.option`, whose parameters'
    names must differ; `fixed` are further ones that cannot change while the node runs, by the
    prefix of their parameters' names, such as ``{"learn.": LearnConfig()}``. Raises `InputError`
    where the node was started with a value that is refused.
    """

    def __init__(
        self, node: Node, *configs: Any, fixed: Mapping[str, Any] = MappingProxyType({})
    ) -> None:
        self._configs: dict[type, Any] = {}
        self._settings: dict[str, _Setting] = {}
        for config in configs:
            self._declare(node, config, "", read_only=False)
        for prefix, config in fixed.items():
            self._declare(node, config, prefix, read_only=True)
        self._listeners: dict[type, tuple[Callable[[Any], None], Callable[[Any], None]]] = {}
        node.add_pre_set_parameters_callback(self._with_types)
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
        options, names = options_of(config), parameter_names(config)
        for field, (declared, described) in options.items():
            if read_only:
                described = dataclasses.replace(described, read_only=True)
            name = prefix + names[field]
            setting = _Setting(type(config), field, type(declared.default), described)
            self._settings[name] = setting
            values[field] = self._declared(node, name, getattr(config, field))
        self._configs[type(config)] = dataclasses.replace(config, **values)

    def _declared(self, node: Node, name: str, default: Any) -> Any:
        """Declare a parameter, and return what it was started with."""
        setting = self._settings[name]
        value = _given(node, name)
        value = _suiting(default if value is None else value, setting.kind)
        check_option(f"parameter {name}", value, setting.kind, setting.described)
        descriptor = descriptor_of(value, setting.described)
        return node.declare_parameter(name, value, descriptor, ignore_override=True).value

    def _with_types(self, parameters: list[Parameter]) -> list[Parameter]:
        """Return what is to be set, with values of the parameters' types."""
        suiting = []
        for parameter in parameters:
            if setting := self._settings.get(parameter.name):
                value = _suiting(parameter.value, setting.kind)
                # An empty array does not show its type.
                kept = parameter.type_ if value is parameter.value else None
                parameter = Parameter(parameter.name, kept, value)
            suiting.append(parameter)
        return suiting

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if setting := self._settings.get(parameter.name):
                    kind, described = setting.kind, setting.described
                    check_option(parameter.name, parameter.value, kind, described)
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
            if setting := self._settings.get(parameter.name):
                values.setdefault(setting.owner, {})[setting.field] = parameter.value
        return {
            owner: dataclasses.replace(self._configs[owner], **changes)
            for owner, changes in values.items()
        }


def _given(node: Node, name: str) -> Any:
    """Return the value, of any type, that a node was started with for a parameter; else None."""
    any_type = ParameterDescriptor(dynamic_typing=True)
    value = node.declare_parameter(name, None, any_type).value
    node.undeclare_parameter(name)
    return value


def _suiting(value: Any, kind: type) -> Any:
    """Return an integer as a float where that is what is expected."""
    return float(value) if kind is float and type(value) is int else value


def descriptor_of(default: Any, described: Option) -> ParameterDescriptor:
    """Return the ROS descriptor of an option: its description, range and read-only flag."""
    unit = f" [{described.unit}]" if described.unit else ""
    descriptor = ParameterDescriptor(
        description=f"{described.description}{unit}", read_only=described.read_only
    )
    if described.choices is not None:
        descriptor.additional_constraints = described.allowed
    least, most = described.minimum, described.maximum
    if least is None and most is None:
        return descriptor
    kind = type(default)
    largest = sys.float_info.max if kind is float else _LARGEST_INTEGER
    least = kind(-largest if least is None else least)
    most = kind(largest if most is None else most)
    if kind is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=least, to_value=most)]
    elif kind is int:
        descriptor.integer_range = [IntegerRange(from_value=least, to_value=most, step=1)]
    return descriptor
