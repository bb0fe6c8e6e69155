"""Settings described once: defaults, units, ranges and help live in frozen dataclasses.

ROS parameters, command-line options and YAML files are all derived from these dataclasses, so
that a default or a range is written in one place only:

    temporal_frames: float = option(0.0, "...", parameter="temporal.frames")
"""

import dataclasses
import sys
from typing import Any

from coded_aperture_ros.core.errors import InputError


@dataclasses.dataclass(frozen=True)
class Option:
    """What is known about one setting, kept in its dataclass field's metadata."""

    description: str  # for help texts and ROS descriptors
    unit: str = ""  # of the value, of `minimum` and of `maximum`
    # Inclusive bounds.
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None  # exclusive lower bound
    choices: tuple[Any, ...] | None = None  # the only values allowed
    read_only: bool = False  # whether a running node cannot change it
    daily: bool = False  # whether `--help` shows it; `--help-all` shows every option
    needs: tuple[str, Any] | None = None  # field and value without which only the default goes
    # Name of the ROS parameter, such as ``regularize.method``; empty: see `parameter_names`.
    parameter: str = ""

    @property
    def allowed(self) -> str:
        """The allowed values, in words; empty where anything of the right type goes."""
        if self.choices is not None:
            return "one of " + ", ".join(str(choice) or "''" for choice in self.choices)
        unit = f" {self.unit}" if self.unit else ""
        if self.minimum is not None and self.maximum is not None:
            return f"{self.minimum:g} to {self.maximum:g}{unit}"
        if self.above is not None:
            return f"more than {self.above:g}{unit}"
        if self.minimum is not None:
            return f"at least {self.minimum:g}{unit}"
        if self.maximum is not None:
            return f"at most {self.maximum:g}{unit}"
        return ""


def option(
    default: Any, description: str, *, within: tuple[float, float] | None = None, **described: Any
) -> Any:
    """Declare a dataclass field that carries its `Option`.

    The arguments after `default` are the attributes of `Option`; `within` are both bounds. An
    unknown one is a TypeError where the class is defined.
    """
    if within is not None:
        described["minimum"], described["maximum"] = within
    known = Option(description, **described)
    return dataclasses.field(default=default, metadata={"option": known})


def option_of(config: type, name: str) -> Any:
    """Declare a dataclass field with default and `Option` of one of another configuration."""
    field, known = options_of(config)[name]
    return dataclasses.field(default=field.default, metadata={"option": known})


def options_of(config: Any) -> dict[str, tuple[dataclasses.Field[Any], Option]]:
    """Return `{name: (field, option)}` of a configuration dataclass or an instance of one."""
    return {
        field.name: (field, field.metadata["option"])
        for field in dataclasses.fields(config)
        if "option" in field.metadata
    }


def parameter_names(config: Any) -> dict[str, str]:
    """Return `{field name: name of the ROS parameter}` of a configuration dataclass.

    With a `parameter_group` of ``motion.`` those of its fields `motion_rank` and `finalists` are
    ``motion.rank`` and ``motion.finalists``, unless their options say another name.
    """
    group = getattr(config, "parameter_group", "")
    return {
        name: described.parameter or group + name.removeprefix(group.replace(".", "_"))
        for name, (_, described) in options_of(config).items()
    }


def check_options(config: Any) -> None:
    """Check every option of a dataclass instance against its type, choices and range.

    Meant to be called from `__post_init__`. Raises `InputError`, naming the setting, its value and
    what is allowed.
    """
    for name, (field, described) in options_of(config).items():
        value = getattr(config, name)
        check_option(name, value, type(field.default), described)
        if described.needs is not None and value != field.default:
            other, needed = described.needs
            if getattr(config, other) != needed:
                raise InputError(f"{name}: needs {other}: {needed}, else use {field.default}")


def check_option(name: str, value: Any, expected: type, described: Option) -> None:
    """Check one value; see `check_options`."""
    allowed = f" ({described.allowed})" if described.allowed else ""
    if not has_type(value, expected):
        raise InputError(f"{name}: expected {expected.__name__}{allowed}, got {value!r}")
    if described.choices is not None and value not in described.choices:
        raise InputError(f"{name}: {value!r} is not allowed, use {described.allowed}")
    if expected in (int, float):
        too_small = described.minimum is not None and value < described.minimum
        too_small |= described.above is not None and value <= described.above
        too_large = described.maximum is not None and value > described.maximum
        # Not math.isfinite, which fails for integers beyond the range of floats.
        if too_small or too_large or not abs(value) <= sys.float_info.max:
            raise InputError(f"{name}: {value!r} is out of range{allowed}")


def has_type(value: Any, expected: type) -> bool:
    """Return whether a value is of a type: integers are floats too, true and false no numbers."""
    if isinstance(value, bool):
        return expected is bool
    return isinstance(value, (int, float) if expected is float else expected)
