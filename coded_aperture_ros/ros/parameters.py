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
from coded_aperture_ros.core.text import shortened

Config = TypeVar("Config")

_LARGEST_INTEGER = 2**63 - 1
_SEE_LOG = "the file or value could not be used: the log of the node says why"


class _Setting(NamedTuple):
    """Option of a configuration that a parameter sets."""

    owner: type
    field: str
    kind: type
    described: Option


class NodeParameters:
    """Parameters of a node: one for each option of its configuration dataclasses.

    A bad value is refused with the reason, and the old one stays. A good one replaces the whole
    (frozen) configuration: a worker thread that took one at the start of a frame keeps a consistent
    one, and a change shows as another object. A parameter of type float also takes integers.

    Parameters
    ----------
    node : Node
    *configs
        Dataclass instances with the defaults, made with `core.options.option`. The names of their
        parameters must differ.
    fixed : mapping
        Further ones that cannot change while the node runs, by the prefix of their parameters'
        names, such as ``{"learn.": LearnConfig()}``.

    Raises
    ------
    InputError
        If the node was started with a value that is refused.
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
        self._reading_files: set[type] = set()
        self._logger = node.get_logger()
        node.add_pre_set_parameters_callback(self._with_types)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def __getitem__(self, config_type: type[Config]) -> Config:
        """Present configuration of this type."""
        return self._configs[config_type]

    def on_change(
        self,
        config_type: type[Config],
        prepare: Callable[[Config], None],
        take_over: Callable[[Config], None],
        *,
        reads_files: bool = False,
    ) -> None:
        """Register callbacks for changes of a configuration.

        `prepare` gets the new configuration before it is set, and may refuse it with an
        `InputError`; `take_over` gets it after it has been set. Where it reads files that the
        configuration names, whoever sets a parameter must not learn from the answer which files
        there are, nor what is in them: the log of the node has the reason.
        """
        if reads_files:
            self._reading_files.add(config_type)
        self._listeners[config_type] = prepare, take_over

    def forget_listeners(self) -> None:
        """Remove the callbacks of all configurations."""
        self._listeners.clear()

    def _declare(self, node: Node, config: Any, prefix: str, read_only: bool) -> None:
        values = {}
        names = parameter_names(config)
        for field, (declared, described) in options_of(config).items():
            if read_only:
                described = dataclasses.replace(described, read_only=True)
            name = prefix + names[field]
            setting = _Setting(type(config), field, type(declared.default), described)
            self._settings[name] = setting
            values[field] = self._declare_parameter(node, name, getattr(config, field))
        self._configs[type(config)] = dataclasses.replace(config, **values)

    def _declare_parameter(self, node: Node, name: str, default: Any) -> Any:
        """Declare a parameter; return its initial value."""
        setting = self._settings[name]
        value = _start_value(node, name)
        value = _converted(default if value is None else value, setting.kind)
        if setting.kind is str and isinstance(value, (bool, int, float)):
            text = str(value).lower()
            raise InputError(
                f"parameter {name}: expected text, and ROS takes {text} for a number or a switch: "
                f"quote it twice, as in -p {name}:=\"'{text}'\", in a file once"
            )
        check_option(f"parameter {name}", value, setting.kind, setting.described)
        descriptor = descriptor_of(value, setting.described)
        return node.declare_parameter(name, value, descriptor, ignore_override=True).value

    def _with_types(self, parameters: list[Parameter]) -> list[Parameter]:
        """Parameters to set, with their values converted to the types of the options."""
        converted = []
        for parameter in parameters:
            if setting := self._settings.get(parameter.name):
                value = _converted(parameter.value, setting.kind)
                # An empty array does not show its type.
                kept = parameter.type_ if value is parameter.value else None
                parameter = Parameter(parameter.name, kept, value)
            converted.append(parameter)
        return converted

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        """Whether parameters can be set; prepares the changes that have a listener."""
        try:
            for parameter in parameters:
                if setting := self._settings.get(parameter.name):
                    check_option(parameter.name, parameter.value, setting.kind, setting.described)
            for owner, config in self._changed(parameters).items():
                listened = owner in self._listeners and config != self._configs[owner]
                if listened and (reason := self._refusal(owner, config)):
                    return SetParametersResult(successful=False, reason=reason)
        except InputError as error:
            return SetParametersResult(successful=False, reason=shortened(str(error), 1000))
        except Exception as error:  # whatever comes with a request, the node goes on
            self._logger.error(f"parameters not set: {type(error).__name__}: {error}")
            return SetParametersResult(successful=False, reason=_SEE_LOG)
        return SetParametersResult(successful=True)

    def _refusal(self, owner: type, config: Any) -> str:
        """Why a configuration cannot be set, for whoever asked for it; empty: it can."""
        try:
            self._listeners[owner][0](config)
        except Exception as error:
            if isinstance(error, InputError) and owner not in self._reading_files:
                return shortened(str(error), 1000)
            kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
            self._logger.warning(f"parameters not set: {kind}{error}")
            return _SEE_LOG
        return ""

    def _apply(self, parameters: list[Parameter]) -> None:
        for owner, config in self._changed(parameters).items():
            # Nothing that `prepare` has accepted fails here.
            changed = config != self._configs[owner]
            self._configs[owner] = config
            if changed and owner in self._listeners:
                self._listeners[owner][1](config)

    def _changed(self, parameters: list[Parameter]) -> dict[type, Any]:
        """Configurations with the parameters set, by their type."""
        values: dict[type, dict[str, Any]] = {}
        for parameter in parameters:
            if setting := self._settings.get(parameter.name):
                values.setdefault(setting.owner, {})[setting.field] = parameter.value
        return {
            owner: dataclasses.replace(self._configs[owner], **changes)
            for owner, changes in values.items()
        }


def _start_value(node: Node, name: str) -> Any:
    """Value, of any type, that the node was started with for a parameter; None without one."""
    any_type = ParameterDescriptor(dynamic_typing=True)
    value = node.declare_parameter(name, None, any_type).value
    node.undeclare_parameter(name)
    return value


def _converted(value: Any, kind: type) -> Any:
    """Value, as a float if it is an integer and a float is expected."""
    return float(value) if kind is float and type(value) is int else value


def descriptor_of(default: Any, described: Option) -> ParameterDescriptor:
    """ROS descriptor of an option: its description, range and read-only flag."""
    unit = f" [{described.unit}]" if described.unit else ""
    descriptor = ParameterDescriptor(
        description=f"{described.description}{unit}", read_only=described.read_only
    )
    if described.choices is not None:
        descriptor.additional_constraints = described.allowed
    least = described.minimum
    most = described.maximum
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
